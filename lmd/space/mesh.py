"""Triangle meshes of rooms."""

from dataclasses import dataclass

from lmd.core.checks import FloatArray, IntArray


@dataclass(frozen=True, eq=False)
class Mesh:
    """Mesh of V vertices and T triangles of named objects; world frame, z up, metres."""

    vertices: FloatArray
    """Vertices, `(V, 3)`."""
    faces: IntArray
    """Indices of the vertices of each triangle, `(T, 3)`."""
    of: IntArray
    """Index in `names` of the object of each triangle, `(T,)`."""
    names: tuple[str, ...]
    """Names of the objects, empty for an object without a name."""
    path: str = "the mesh"
    """Path of the file, for messages."""
    up: str = "z"
    """Axis of the file that points up, `z` or `y`."""
    up_is_sure: bool = True
    """True if the user or the file format defines the up axis."""
