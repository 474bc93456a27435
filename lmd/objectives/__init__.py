"""Objectives of a deployment: the value of each position, and the fitness that optimisers maximise."""

from lmd.objectives.base import Objective
from lmd.objectives.coverage import Coverage, MeanCoverage
from lmd.objectives.filtered import Drives, Filtered
from lmd.objectives.localisation import Localisation
from lmd.objectives.sampling import Sampling

__all__ = ["Coverage", "Drives", "Filtered", "Localisation", "MeanCoverage", "Objective", "Sampling"]
