"""Simulated annealing of landmarks on the surfaces of a room."""

from lmd.optimisers.annealing.annealing import Annealing
from lmd.optimisers.annealing.moves import Stage

__all__ = ["Annealing", "Stage"]
