"""Triangles of a room, as a file or a program gives them."""

from dataclasses import dataclass

from lmd.core.checks import FloatArray, IntArray


@dataclass(frozen=True, eq=False)
class Mesh:
    """V corners and T triangles in the world frame, z up, metres, and the objects that they belong to."""

    vertices: FloatArray
    """Corners, `(V, 3)`."""
    faces: IntArray
    """Indices of the corners of each triangle, `(T, 3)`."""
    of: IntArray
    """Index in `names` of the object of each triangle, `(T,)`."""
    names: tuple[str, ...]
    """Names of the objects."""
    path: str = "the mesh"
    """The file, for messages."""
    up: str = "z"
    """The axis of the file that points up, `z` or `y`."""
    up_is_sure: bool = True
    """True if the user or the format says which axis points up."""
    on_walls: tuple[tuple[str, FloatArray], ...] = ()
    """Names and corners `(N, 3)` of what lies on walls, such as doors: nothing hangs there."""
    note: str = ""
    """A sentence on how the file was read; empty for nothing."""
