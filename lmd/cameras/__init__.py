"""Where the cameras of a robot go: its body, what each camera would see, and that as a problem for optimisers."""

from lmd.cameras.body import Body, Box
from lmd.cameras.mounts import MountSpace
from lmd.cameras.problem import CameraProblem

__all__ = ["Body", "Box", "CameraProblem", "MountSpace"]
