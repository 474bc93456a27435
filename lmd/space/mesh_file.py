"""Triangle meshes from files: glTF, OBJ, STL and PLY, by trimesh."""

import json
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from lmd.checks import FloatArray, InputError, IntArray, choice, file_path, real
from lmd.optional import optional
from lmd.space.triangles import THINNEST

UPS = ("z", "y")
Y_UP = (".gltf", ".glb")  # what their standard says
FORMATS = (*Y_UP, ".obj", ".stl", ".ply")
# Corners that differ by less are the same, metres: files have 32 bits for a number.
DIGITS = 6
# A room whose longest side is not between these was not in metres.
SHORTEST, LONGEST = 0.3, 1000.0


class Mesh(NamedTuple):
    """Triangles in the world frame, metres, and the objects of the file that they belong to.

    vertices `(V, 3)`; faces `(T, 3)`; of `(T,)`, the index of its object in `names`, which are those in the file.
    """

    vertices: FloatArray
    faces: IntArray
    of: IntArray
    names: tuple[str, ...]


def read_mesh(path: str | Path | None, scale: float = 1.0, up: str | None = None) -> Mesh:
    """Read a mesh; what has no area, or is there twice, is left out.

    Args:
        path: the file.
        scale: metres in a unit of the file.
        up: which of its axes points up, `z` or `y`; None for what its format says, `y` for glTF and `z` for others.

    Raises:
        InputError: the file is missing, holds no triangles or cannot be read, or its size is not that of a room.
    """
    if path is None:
        raise InputError("path is missing: a file with a mesh of the room is needed.", "path")
    file = file_path("path", path)
    scale = real("scale", scale, above=0.0)
    if file.suffix.lower() not in FORMATS:
        raise InputError(f"path = {str(file)!r} must end in one of {', '.join(FORMATS)}.", "path")
    if not file.is_file():
        raise InputError(f"path: there is no file {str(file)!r}.", "path")
    if file.suffix.lower() == ".gltf" and (outside := _outside(file)):
        raise InputError(f"path = {str(file)!r} has its triangles in {outside!r}; save it as one file, .glb.", "path")
    if up is None:
        up = "y" if file.suffix.lower() in Y_UP else "z"
    parts = _parts(file, choice("up", up, UPS))
    if not parts:
        raise InputError(f"path: {str(file)!r} holds no triangles.", "path")
    trimesh = optional("trimesh", "mesh")
    names = tuple(parts)
    of = np.repeat(np.arange(len(parts)), [len(part.faces) for part in parts.values()])
    whole = trimesh.util.concatenate(list(parts.values()))
    mesh = trimesh.Trimesh(whole.vertices * scale, whole.faces, process=False)
    mesh.merge_vertices(digits_vertex=DIGITS)
    kept = mesh.unique_faces() & mesh.nondegenerate_faces(height=THINNEST)
    if not np.isfinite(mesh.vertices).all() or not kept.any():
        raise InputError(f"path: {str(file)!r} holds no triangles with an area.", "path")
    mesh.update_faces(kept)
    mesh.remove_unreferenced_vertices()
    size = np.ptp(mesh.vertices, axis=0)
    if not SHORTEST <= size.max() <= LONGEST:
        box = " x ".join(f"{length:.4g}" for length in size)
        raise InputError(
            f"scale = {scale:g} makes {str(file)!r} a room of {box} m; a file in millimetres takes 0.001.", "scale"
        )
    return Mesh(np.array(mesh.vertices), np.array(mesh.faces, dtype=np.int64), of[kept], names)


def _outside(file: Path) -> str | None:
    """Another file that a glTF keeps its numbers in: what is read must be in the file that is named."""
    try:
        buffers = json.loads(file.read_text()).get("buffers", [])
        names = [buffer.get("uri", "data:") for buffer in buffers]
    except (ValueError, AttributeError):  # no glTF, which the reader says better
        return None
    return next((name for name in names if not name.startswith("data:")), None)


def _parts(file: Path, up: str) -> dict[str, Any]:
    """The objects of a file that have triangles, as meshes in its scene, by their names."""
    trimesh = optional("trimesh", "mesh")
    options = {"split_objects": True} if file.suffix.lower() == ".obj" else {}
    try:
        scene = trimesh.load_scene(file, **options)
        parts = {}
        for name in sorted(scene.graph.nodes_geometry):
            matrix, geometry = scene.graph[name]
            part = scene.geometry[geometry]
            if isinstance(part, trimesh.Trimesh) and len(part.faces):
                vertices = trimesh.transform_points(part.vertices, matrix)
                vertices = vertices if up == "z" else vertices[:, [0, 2, 1]] * [1.0, -1.0, 1.0]
                parts[name] = trimesh.Trimesh(vertices + 0.0, part.faces, process=False)
    except Exception as error:  # whatever a reader of a broken file runs into
        raise InputError(f"path: {str(file)!r} cannot be read as a mesh ({error}).", "path") from None
    named = len(parts) > 1 or not any(name.startswith((file.name, "geometry_")) for name in parts)
    return parts if named else {"": next(iter(parts.values()))}
