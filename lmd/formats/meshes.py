"""Meshes of rooms from files, read by trimesh: glTF, OBJ, STL and PLY.

trimesh cuts polygons into fans of triangles, which is wrong for concave faces. So polygons of an OBJ are cut before
trimesh reads it.
"""

import io
import json
import logging
import re
from dataclasses import fields
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from lmd.core.checks import FloatArray, InputError, IntArray, bounded, choice, file_path, printable, real
from lmd.core.files import read_bytes
from lmd.core.optional import optional
from lmd.formats.registry import read
from lmd.formats.trees import File
from lmd.space.mesh import Mesh
from lmd.space.mesh_room import MeshRoom
from lmd.space.parts import UNITS, box_text, check_metres
from lmd.space.scan import Scan
from lmd.space.triangles import THINNEST_M

TEXT = ".gltf"
# Maximum number of levels of nodes; of nodes and of pieces (a building has 10,000); and number of components in a value
# of each type.
DEEPEST_LEVEL, MOST_NODES = 32, 50_000
NUMBERS_OF_TYPE = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT2": 4, "MAT3": 9, "MAT4": 16}
FAN = 6  # code of the mode in which triangles share their first corner
# Extensions that a file may require, as they do not affect the positions of triangles.
HARMLESS = (
    "KHR_mesh_quantization",
    *("KHR_materials_", "KHR_texture_", "KHR_lights_", "KHR_xmp", "KHR_animation_", "EXT_texture_", "EXT_lights_"),
)


def check_gltf(file: Path, content: bytes, most: int) -> None:
    """Raise `InputError` for a glTF that trimesh would read wrongly, that needs other files, or that is too large.

    All data must be in the file itself, as a later run recognises the room by the content of this file.

    Args:
        file: path of the file, for its suffix and messages.
        content: content of the file.
        most: maximum number of triangles.

    Raises:
        ValueError, TypeError, KeyError, IndexError, AttributeError: the file is damaged.
    """
    size = int.from_bytes(content[12:16], "little")
    header = json.loads(content if file.suffix.lower() == TEXT else content[20 : 20 + size])
    source, accessors, nodes = f"path: {str(file)!r}", header.get("accessors", []), header.get("nodes", [])
    for buffer in header.get("buffers", []):
        if not buffer.get("uri", "data:").startswith("data:"):
            where = f"path = {str(file)!r} has its triangles in {buffer['uri']!r}"
            raise InputError(f"{where}; save mesh and triangles as one .glb file.", "path")
    meshes = [mesh["primitives"] for mesh in header.get("meshes", [])]
    for name, number in (("nodes", len(nodes)), ("pieces of meshes", sum(map(len, meshes)))):
        bounded(name, number, MOST_NODES, source, "path")
    if told := _unread(header, [piece for mesh in meshes for piece in mesh]):
        how = f"run `gltf-transform {'dequantize' if 'quantised' in told else 'cp'} {file.name} plain.glb`"
        raise InputError(f"{source} {told}, which is not read; {how}, or import and export it in Blender.", "path")
    counts = [part["count"] for part in accessors]
    if not all(isinstance(count, int) and count >= 0 for count in counts):
        raise ValueError("an accessor has an invalid count")
    numbers = sum(count * NUMBERS_OF_TYPE[part["type"]] for count, part in zip(counts, accessors, strict=True))
    if numbers > len(content):
        raise InputError(f"{source} declares {numbers:.4g} numbers, too many for its {len(content)} bytes.", "path")
    _check_tree([node.get("children", []) for node in nodes])
    read = [[i for part in mesh for i in (part["attributes"]["POSITION"], part.get("indices"))] for mesh in meshes]
    corners = [sum(counts[i] for i in mesh if i is not None) for mesh in read]
    placed = sum(corners[node["mesh"]] for node in nodes if "mesh" in node)
    # trimesh would also read meshes that no node refers to
    bounded("triangles", float(max(placed, sum(corners)) / 3), most, source, "path")


def _unread(header: dict[str, Any], pieces: list[dict[str, Any]]) -> str:
    """Reason why trimesh cannot read a glTF, as a predicate such as `has sparse accessors`; empty if it can.

    `header` is the JSON of the glTF, `pieces` are the primitives of its meshes.
    """
    instanced = "EXT_mesh_gpu_instancing"
    needed = [str(name) for name in header.get("extensionsRequired", [])]
    needed += [instanced for node in header.get("nodes", []) if instanced in node.get("extensions", {})]
    for name in needed:
        if not name.startswith(HARMLESS):
            return f"{'is compressed' if 'compression' in name else 'needs an extension'} ({name})"
    accessors = header.get("accessors", [])
    if FAN in [piece.get("mode") for piece in pieces]:
        return "has fans of triangles"
    if any("sparse" in part for part in accessors):
        return "has sparse accessors"
    fractions = any(accessors[piece["attributes"]["POSITION"]].get("normalized") for piece in pieces)
    return "has quantised corners" if fractions else ""


def _check_tree(children: list[list[int]]) -> None:
    """Raise `ValueError` if nodes do not form a tree, or if the tree has too many levels.

    `children` has the indices of each node's children.
    """
    parents = {child: node for node, theirs in enumerate(children) for child in theirs}
    if len(parents) < sum(map(len, children)):
        raise ValueError("a node has two parents")
    for node in range(len(children)):
        above, depth = parents.get(node), 0
        while above is not None:
            above, depth = parents.get(above), depth + 1
            if depth > DEEPEST_LEVEL:
                raise ValueError(f"its nodes are nested more than {DEEPEST_LEVEL} deep")


UP_AXES = ("z", "y")
Y_UP = (".gltf", ".glb")  # formats whose standard has y up
SUFFIXES = (*Y_UP, ".obj", ".stl", ".ply")
# Decimals of a metre to which corners are rounded before they are compared, as files store numbers with 32 bits.
CORNER_DIGITS = 6
# Maximum longest side of a room, metres, above which a message suggests another unit.
LIKELY = (2.0, 100.0)
# Maximum number of triangles; more triangles would take gigabytes and minutes.
MOST_TRIANGLES = 5_000_000
# Maximum number of corners of a face in an OBJ (a floor has a few hundred), and of names in an OBJ (a building has
# 10,000).
MOST_CORNERS, MOST_PARTS = 2000, 30_000
_CORNER = re.compile(r"(-?\d+)")
_PLY_FACES = re.compile(rb"^element\s+face\s+(\d+)\s*$", re.MULTILINE)


class RoomFile(File):
    """File of a room. The setting `up` in its attribute `asked` is the axis of the file that points up."""

    @cached_property
    def content(self) -> bytes:
        """Bytes of the file."""
        return read_bytes(self.path, self.argument)

    def refused(self, reason: str) -> InputError:
        """Make an error about a refused room file; the message lists the supported suffixes."""
        return InputError(f"path = {str(self.path)!r} must end in one of {', '.join(SUFFIXES)}; {reason}.", "path")


def read_mesh(path: str | Path | None, scale: float = 1.0, up: str | None = None) -> Mesh:
    """Read a mesh; triangles without area and repeated triangles are left out.

    Args:
        scale: metres per unit of the file.
        up: axis of the file that points up, `z` or `y`; None for the standard of the format: `y` for glTF, `z` for all
            other formats.

    Raises:
        InputError: the file is missing, cannot be read or has no triangles, or its size is implausible for a room.
    """
    if path is None:
        raise InputError("path is missing: a file with a mesh of the room is needed.", "path")
    file = file_path("path", path)
    scale = real("scale", scale, above=0.0)
    is_sure = up is not None or file.suffix.lower() in Y_UP
    up = choice("up", up or ("y" if file.suffix.lower() in Y_UP else "z"), UP_AXES)
    parts = read("room", RoomFile(file, asked={"up": up}))
    if not parts:
        cure = "make a mesh of a cloud of points in MeshLab or CloudCompare"
        raise InputError(f"path: {str(file)!r} holds no triangles; {cure}.", "path")
    trimesh = optional("trimesh", "mesh")
    names = tuple(map(printable, parts))
    flat = InputError(f"path: {str(file)!r} holds no triangles with an area.", "path")
    count = sum(len(part.faces) for part in parts.values())
    if not count:
        raise flat
    bounded("triangles", count, MOST_TRIANGLES, f"path: {str(file)!r}", "path")
    of = np.repeat(np.arange(len(parts)), [len(part.faces) for part in parts.values()])
    whole = trimesh.util.concatenate(list(parts.values()))
    mesh = trimesh.Trimesh(whole.vertices * scale, whole.faces, process=False)
    size = np.ptp(mesh.vertices[mesh.faces].reshape(-1, 3), axis=0)
    check_metres(size, f"scale = {scale:g} makes {str(file)!r}", _hint(size / scale), "scale")
    mesh.merge_vertices(digits_vertex=CORNER_DIGITS)
    kept = mesh.unique_faces() & mesh.nondegenerate_faces(height=THINNEST_M)
    if not kept.any():
        raise flat
    mesh.update_faces(kept)
    mesh.remove_unreferenced_vertices()
    faces = np.array(mesh.faces, dtype=np.int64)
    return Mesh(np.array(mesh.vertices), faces, of[kept], names, str(path), up, is_sure)


def read_mesh_room(
    path: Any, reachable: Any, spacing: Any, scale: float = 1.0, up: str | None = None, **more: Any
) -> MeshRoom:
    """Make a room from the mesh in a file.

    Args:
        path, scale, up: the file, its unit in metres and its upward axis, see `read_mesh`.
        reachable, spacing: reachable volume, and largest distance between positions, see `MeshRoom`.
        more: further arguments of `Scan` and of `MeshRoom`.
    """
    names = {field.name for field in fields(Scan)}
    scan, own = ({name: more[name] for name in more if (name in names) == of_mesh} for of_mesh in (True, False))
    return MeshRoom(Scan(read_mesh(path, scale, up), **scan), reachable, spacing, **own)


def _hint(size: FloatArray) -> str:
    """Advice on the unit that a file probably has, for a message. `size` `(3,)` is the extent of its mesh along x, y
    and z, in the file's own unit.
    """
    told = [
        f"a file in {unit} needs {per:g}, which makes {box_text(per * size)}"
        for unit, per in UNITS.items()
        if LIKELY[0] <= per * size.max() <= LIKELY[1]
    ]
    return "; ".join(told) or "no usual unit gives it the size of a room"


def _turned(points: FloatArray, up: str) -> FloatArray:
    """Points of a file, rotated so that z points up."""
    return (points if up == "z" else points[:, [0, 2, 1]] * [1.0, -1.0, 1.0]) + 0.0


def triangles(room: RoomFile) -> dict[str, Any]:
    """Objects of a file that have triangles, keyed by name, as meshes of trimesh that are rotated so that z is up."""
    file, up = Path(room.path), room.asked["up"]
    trimesh = optional("trimesh", "mesh")
    logging.getLogger("trimesh").setLevel(logging.WARNING)  # trimesh would warn about quads in every object
    content, kind = room.content, file.suffix.lower().removeprefix(".")
    options = {"split_objects": True} if kind == "obj" else {}
    try:
        if file.suffix.lower() in Y_UP:
            check_gltf(file, content, MOST_TRIANGLES)
        if kind == "obj":
            content = _with_triangles(content, f"path: {str(file)!r}")
        # Bytes have no path, so trimesh cannot read other files, such as materials or textures. Processing is off, as
        # it would drop triangles with corners that are not numbers.
        with np.errstate(all="ignore"):  # the check below refuses invalid numbers
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
        if kind == "ply":
            _check_ply(str(file), content, sum(len(part.faces) for part in parts.values()))
    except InputError:
        raise
    except Exception as error:  # readers may raise any error for a broken file
        raise InputError(f"path: {str(file)!r} cannot be read as a mesh ({error}).", "path") from None
    named = len(parts) > 1 or not any(name.startswith("geometry") for name in parts)
    return parts if named else {"": next(iter(parts.values()))}


def _check_corners(file: Path, name: str, vertices: FloatArray, faces: IntArray) -> None:
    """Raise `InputError` if a corner of a face is not finite, `ValueError` if a face refers to a missing vertex."""
    if not ((faces >= 0) & (faces < len(vertices))).all():
        raise ValueError("a triangle refers to a corner that does not exist")
    corners = vertices[faces].reshape(-1, 3)
    if not (finite := np.isfinite(corners).all(axis=1)).all():
        place = ", ".join(f"{x:g}" for x in corners[~finite][0])
        raise InputError(f"path: {str(file)!r} has a corner of {name!r} at ({place}), which is not finite.", "path")


def _with_triangles(content: bytes, source: str) -> bytes:
    """Content of an OBJ in which faces with more than three corners are cut into triangles; faces that cannot be cut
    are unchanged.
    """
    lines = content.decode("utf-8", "surrogateescape").splitlines()
    places: list[list[float]] = []
    parts, result = 0, []
    for line in lines:
        words = line.split()
        if words[:1] in (["o"], ["g"], ["usemtl"]):
            parts += 1
            bounded("names of objects and materials", parts, MOST_PARTS, source, "path")
        if words[:1] == ["v"] and len(words) >= 4:
            places.append([_place(word) for word in words[1:4]])
        if words[:1] == ["f"] and len(words) > 4:
            bounded("corners in a face", len(words) - 1, MOST_CORNERS, source, "path")
            result += _cut_face(line, words[1:], places)
        else:
            result.append(line)
    return "\n".join([*result, ""]).encode("utf-8", "surrogateescape")


def _place(word: str) -> float:
    try:
        return float(word)
    except ValueError:
        return np.nan  # the reader of the file then refuses NaN


def _cut_face(line: str, words: list[str], places: list[list[float]]) -> list[str]:
    """Cut a face of an OBJ into triangles; return the lines that replace the line of the face.

    A face that is bent, crosses itself or has no area is not cut: the given line is returned.

    Args:
        line: line of the face.
        words: corners of the face, as in the line.
        places: positions of all vertices above the line.
    """
    import shapely

    found = [_CORNER.match(word) for word in words]
    numbers = [int(each[1]) for each in found if each is not None]
    index = [number - 1 if number > 0 else len(places) + number for number in numbers]
    if len(index) < len(words) or not all(0 <= i < len(places) for i in index):
        return [line]
    corners: FloatArray = np.array([places[i] for i in index])
    if not np.isfinite(corners).all():
        return [line]
    _, _, basis = np.linalg.svd(corners - corners.mean(axis=0))
    flat = (corners - corners.mean(axis=0)) @ basis[:2].T
    polygon, place = shapely.Polygon(flat), {tuple(at): i for i, at in enumerate(flat.tolist())}
    cut = shapely.get_parts(shapely.constrained_delaunay_triangles(polygon)) if polygon.is_valid else []
    if len(cut) != len(words) - 2:
        return [line]
    ahead = shapely.is_ccw(polygon.exterior)
    steps = [1 if shapely.is_ccw(part.exterior) == ahead else -1 for part in cut]
    triangles = [[place[tuple(at)] for at in shapely.get_coordinates(part)[:3].tolist()] for part in cut]
    return [
        f"f {' '.join(words[i] for i in triangle[::step])}" for triangle, step in zip(triangles, steps, strict=True)
    ]


def _check_ply(name: str, content: bytes, triangles: int) -> None:
    """Raise `InputError` for a PLY in which a face has more than three corners, which may be cut wrongly.

    `triangles` is the number of triangles after reading: it exceeds the number of faces if a face was cut.
    """
    found = _PLY_FACES.search(content[: content.find(b"end_header")])
    if found is not None and triangles > int(found[1]):
        raise InputError(
            f"path: {name!r} has faces of more than three corners, which may be triangulated wrongly: export triangles "
            "(in Blender, `Triangulated Mesh`), or an .obj file.",
            "path",
        )
