"""Rooms: surfaces that carry landmarks, and reachable positions of the camera."""

from lmd.space.cuboid import Cuboid
from lmd.space.floor_plan import FloorPlan
from lmd.space.mesh_room import MeshRoom
from lmd.space.parts import Reachable
from lmd.space.prism import Prism
from lmd.space.scan import Scan
from lmd.space.space import Space

__all__ = ["Cuboid", "FloorPlan", "MeshRoom", "Prism", "Reachable", "Scan", "Space"]
