"""The filtered pose along drives as an objective: the fraction of the time in which a Kalman filter knows the pose to a
tolerance.
"""

from lmd.objectives.filtered.drives import Drives
from lmd.objectives.filtered.objective import Filtered

__all__ = ["Drives", "Filtered"]
