"""Optimisers: each maximises a `Problem` within an exact budget."""

from lmd.optimisers.annealing import Annealing
from lmd.optimisers.base import AskTell, Optimiser, Result
from lmd.optimisers.camera_annealing import CameraAnnealing
from lmd.optimisers.genetic import EGA, SGA, RandomSearch
from lmd.optimisers.greedy import Greedy
from lmd.optimisers.ledger import Budget

__all__ = [
    "EGA",
    "SGA",
    "Annealing",
    "AskTell",
    "Budget",
    "CameraAnnealing",
    "Greedy",
    "Optimiser",
    "RandomSearch",
    "Result",
]
