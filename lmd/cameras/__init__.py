"""Placement of cameras on a robot: the robot's body, the views of each camera, and the optimisation problem."""

from lmd.cameras.body import Body, Box
from lmd.cameras.mounts import MountSpace
from lmd.cameras.problem import CameraProblem

__all__ = ["Body", "Box", "CameraProblem", "MountSpace"]
