"""Triangle meshes from files: glTF, OBJ, STL and PLY, by trimesh; rooms of headsets and phones."""

import io
import json
import logging
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from lmd.core.checks import FloatArray, InputError, IntArray, choice, file_path, printable, real, said_of
from lmd.core.files import read_bytes
from lmd.core.optional import optional
from lmd.space.captured_file import Captured, read_captured, triangles_of
from lmd.space.parts import check_metres
from lmd.space.triangles import THINNEST_M

UP_AXES = ("z", "y")
CAPTURED = ".json"
Y_UP = (".gltf", ".glb", CAPTURED)  # what their standard says
FORMATS = (".gltf", ".glb", ".obj", ".stl", ".ply", CAPTURED)
# Corners that differ by less are the same, metres: files have 32 bits for a number.
CORNER_DIGITS = 6
# Of more triangles, what has to be known of each would take gigabytes and minutes.
MOST_TRIANGLES = 5_000_000
# Levels of nodes in glTF, and the numbers in a value of each type.
DEEPEST_LEVEL = 32
NUMBERS_OF_TYPE = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT2": 4, "MAT3": 9, "MAT4": 16}


class Mesh(NamedTuple):
    """Triangles in the world frame, metres, and the objects of the file that they belong to."""

    vertices: FloatArray
    """`(V, 3)`."""
    faces: IntArray
    """`(T, 3)` numbers of the corners."""
    of: IntArray
    """`(T,)` the index of each triangle's object in `names`."""
    names: tuple[str, ...]
    """The objects of the file."""
    up: str
    """The axis of the file that points up."""
    on_walls: tuple[tuple[str, FloatArray], ...] = ()
    """What lies on walls where nothing hangs: names, and corners `(N, 3)`."""


def read_mesh(path: str | Path | None, scale: float = 1.0, up: str | None = None) -> Mesh:
    """Read a mesh; what has no area, or is there twice, is left out.

    Args:
        scale: metres in a unit of the file.
        up: which of its axes points up, `z` or `y`; None for what its format says, `y` for glTF and what headsets and
            phones capture, `z` for others.

    Raises:
        InputError: the file is missing, holds no triangles or cannot be read, or its size is not that of a room.
    """
    if path is None:
        raise InputError("path is missing: a file with a mesh of the room is needed.", "path")
    file = file_path("path", path)
    scale = real("scale", scale, above=0.0)
    if file.suffix.lower() not in FORMATS:
        raise InputError(f"path = {str(file)!r} must end in one of {', '.join(FORMATS)}.", "path")
    if up is None:
        up = "y" if file.suffix.lower() in Y_UP else "z"
    captured = _captured(file) if file.suffix.lower() == CAPTURED else None
    parts = _parts(file, choice("up", up, UP_AXES)) if captured is None else _triangulated(captured, up)
    if not parts:
        raise InputError(f"path: {str(file)!r} holds no triangles.", "path")
    trimesh = optional("trimesh", "mesh")
    names = tuple(map(printable, parts))
    _check_count(file, sum(len(part.faces) for part in parts.values()))
    of = np.repeat(np.arange(len(parts)), [len(part.faces) for part in parts.values()])
    whole = trimesh.util.concatenate(list(parts.values()))
    mesh = trimesh.Trimesh(whole.vertices * scale, whole.faces, process=False)
    size = np.ptp(mesh.vertices[mesh.faces].reshape(-1, 3), axis=0)
    check_metres(size, f"scale = {scale:g} makes {str(file)!r}", "a file in millimetres takes 0.001", "scale")
    mesh.merge_vertices(digits_vertex=CORNER_DIGITS)
    kept = mesh.unique_faces() & mesh.nondegenerate_faces(height=THINNEST_M)
    if not kept.any():
        raise InputError(f"path: {str(file)!r} holds no triangles with an area.", "path")
    mesh.update_faces(kept)
    mesh.remove_unreferenced_vertices()
    things = () if captured is None else captured.on_walls
    on_walls = tuple((part.name, scale * _turned(face, up)) for part in things for face in part.faces)
    return Mesh(np.array(mesh.vertices), np.array(mesh.faces, dtype=np.int64), of[kept], names, up, on_walls)


def _turned(points: FloatArray, up: str) -> FloatArray:
    """Points of a file with z up."""
    return (points if up == "z" else points[:, [0, 2, 1]] * [1.0, -1.0, 1.0]) + 0.0


def _captured(file: Path) -> Captured:
    try:
        keys = json.loads(read_bytes(file, "path"))
    except (ValueError, RecursionError) as error:
        if isinstance(error, InputError):
            raise
        raise InputError(f"path: {str(file)!r} cannot be read as JSON ({error}).", "path") from None
    if not isinstance(keys, dict):
        raise InputError(f"path: {str(file)!r} has no keys.", "path")
    with said_of(f"path: {str(file)!r}", "path"):
        return read_captured(keys)


def _triangulated(captured: Captured, up: str) -> dict[str, Any]:
    """The things of a captured room as meshes, by their names."""
    trimesh = optional("trimesh", "mesh")
    parts = {}
    for part in captured.parts:
        corners = np.concatenate([triangles_of(_turned(face, up)) for face in part.faces])
        parts[part.name] = trimesh.Trimesh(
            corners.reshape(-1, 3), np.arange(corners.size // 3).reshape(-1, 3), process=False
        )
        parts[part.name].merge_vertices(digits_vertex=CORNER_DIGITS)
    return parts


def _parts(file: Path, up: str) -> dict[str, Any]:
    """The objects of a file that have triangles, as meshes in its scene, by their names."""
    trimesh = optional("trimesh", "mesh")
    logging.getLogger("trimesh").setLevel(logging.WARNING)  # it would say of every object that it has quads
    content, kind = read_bytes(file, "path"), file.suffix.lower().removeprefix(".")
    options = {"split_objects": True} if kind == "obj" else {}
    try:
        if file.suffix.lower() in Y_UP:
            _check_gltf(file, content)
        # Of bytes, nothing says where they are from: no other file is looked for, such as materials or textures.
        # Not processed, or corners that are no numbers would be left out with their triangles.
        with np.errstate(all="ignore"):  # of numbers that are refused below
            scene = trimesh.load_scene(io.BytesIO(content), kind, skip_materials=True, process=False, **options)
        parts = {}
        for name in sorted(scene.graph.nodes_geometry):
            matrix, geometry = scene.graph[name]
            part = scene.geometry[geometry]
            if isinstance(part, trimesh.Trimesh) and len(part.faces):
                with np.errstate(all="ignore"):
                    vertices = trimesh.transform_points(part.vertices, matrix)
                _check_corners(file, name, vertices, part.faces)
                parts[name] = trimesh.Trimesh(_turned(vertices, up), part.faces, process=False)
    except InputError:
        raise
    except Exception as error:  # whatever a reader of a broken file runs into
        raise InputError(f"path: {str(file)!r} cannot be read as a mesh ({error}).", "path") from None
    named = len(parts) > 1 or not any(name.startswith("geometry") for name in parts)
    return parts if named else {"": next(iter(parts.values()))}


def _check_corners(file: Path, name: str, vertices: FloatArray, faces: IntArray) -> None:
    """Raise `InputError` if a corner of a face is not finite, `ValueError` if there is none of its number."""
    if not ((faces >= 0) & (faces < len(vertices))).all():
        raise ValueError("a triangle has a corner that is not there")
    corners = vertices[faces].reshape(-1, 3)
    if not (finite := np.isfinite(corners).all(axis=1)).all():
        place = ", ".join(f"{x:g}" for x in corners[~finite][0])
        raise InputError(f"path: {str(file)!r} has a corner of {name!r} at ({place}), which is no place.", "path")


def _check_gltf(file: Path, content: bytes) -> None:
    """Raise `InputError` if a glTF has its triangles in another file, or stands for far more than it holds.

    What is read must be in the file that is named: by its contents another run knows whether it is the same.
    """
    header = json.loads(content if file.suffix.lower() == ".gltf" else content[20 : 20 + _word(content, 12)])
    for buffer in header.get("buffers", []):
        if not buffer.get("uri", "data:").startswith("data:"):
            where = f"path = {str(file)!r} has its triangles in {buffer['uri']!r}"
            raise InputError(f"{where}; save it as one file, .glb with everything in it.", "path")
    accessors = header.get("accessors", [])
    if any("sparse" in part for part in accessors):
        raise ValueError("an accessor is sparse, which is not read")
    counts = [part["count"] for part in accessors]
    if not all(isinstance(count, int) and count >= 0 for count in counts):
        raise ValueError("an accessor has a count that is none")
    numbers = sum(n * NUMBERS_OF_TYPE[part["type"]] for n, part in zip(counts, accessors, strict=True))
    if numbers > len(content):
        raise InputError(f"path: {str(file)!r}, of {len(content)} bytes, asks for {numbers:.4g} numbers.", "path")
    corners = []
    for mesh in header.get("meshes", []):
        read = [i for part in mesh["primitives"] for i in (part["attributes"]["POSITION"], part.get("indices"))]
        corners.append(sum(counts[i] for i in read if i is not None))
    nodes = header.get("nodes", [])
    _check_count(file, sum(corners[node["mesh"]] for node in nodes if "mesh" in node) / 3)
    _check_tree([node.get("children", []) for node in nodes])


def _check_tree(children: list[list[int]]) -> None:
    """Raise `ValueError` if nodes are no tree, or one so deep that the way to a node takes long to be multiplied."""
    parents = {child: node for node, theirs in enumerate(children) for child in theirs}
    if len(parents) < sum(map(len, children)):
        raise ValueError("a node has two parents")
    for node in range(len(children)):
        above, depth = parents.get(node), 0
        while above is not None:
            above, depth = parents.get(above), depth + 1
            if depth > DEEPEST_LEVEL:
                raise ValueError(f"its nodes are nested more than {DEEPEST_LEVEL} deep")


def _word(content: bytes, at: int) -> int:
    return int.from_bytes(content[at : at + 4], "little")


def _check_count(file: Path, triangles: float) -> None:
    if triangles > MOST_TRIANGLES:
        raise InputError(
            f"path: {str(file)!r} has {triangles:.4g} triangles, more than {MOST_TRIANGLES:.4g}; simplify it.", "path"
        )
