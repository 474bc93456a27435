"""Objectives of a deployment: the value of each position, and the fitness that optimisers maximise."""

from typing import TYPE_CHECKING, Any

from lmd.objectives.base import Objective
from lmd.objectives.coverage import Coverage, MeanCoverage
from lmd.objectives.sampling import Sampling

if TYPE_CHECKING:
    from lmd.objectives.filtered import Drives, Filtered
    from lmd.objectives.localisation import Localisation

__all__ = ["Coverage", "Drives", "Filtered", "Localisation", "MeanCoverage", "Objective", "Sampling"]
LATER = {"Drives": "filtered", "Filtered": "filtered", "Localisation": "localisation"}  # modules that take long


def __getattr__(name: str) -> Any:
    """Import an objective at its first use, and return it."""
    if name not in LATER:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    from importlib import import_module

    return getattr(import_module(f"{__name__}.{LATER[name]}"), name)
