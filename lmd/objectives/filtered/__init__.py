"""The filtered pose along drives as an objective: the share of the time at which a Kalman filter knows the pose."""

from lmd.objectives.filtered.drives import Drives
from lmd.objectives.filtered.objective import Filtered

__all__ = ["Drives", "Filtered"]
