"""The criteria: what counts as seen, by the paper and by a detector that was measured."""

from lmd.sight.models.fiducial import Fiducial
from lmd.sight.models.limits import Limits
from lmd.sight.models.paper import Visibility

__all__ = ["Fiducial", "Limits", "Visibility"]
