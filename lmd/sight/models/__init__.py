"""Visibility models: the criteria of the paper, and the criteria of a detector with measured limits."""

from lmd.sight.models.fiducial import Fiducial
from lmd.sight.models.limits import Limits
from lmd.sight.models.paper import Visibility

__all__ = ["Fiducial", "Limits", "Visibility"]
