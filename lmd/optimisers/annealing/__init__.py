"""Simulated annealing on the surfaces of a room: our own method, and the strongest here."""

from lmd.optimisers.annealing.annealing import Annealing
from lmd.optimisers.annealing.stage import Stage

__all__ = ["Annealing", "Stage"]
