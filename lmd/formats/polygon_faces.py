"""Faces of more than three corners in files of meshes: readers cut them from their first corner, wrong if concave."""

import re

import numpy as np

from lmd.core.checks import FloatArray, InputError
from lmd.formats.captured_rooms import cut

_CORNER = re.compile(r"(-?\d+)")
_PLY_FACES = re.compile(rb"^element\s+face\s+(\d+)\s*$", re.MULTILINE)


def with_triangles(content: bytes) -> bytes:
    """An OBJ with triangles in place of faces of more than three corners; what cannot be cut stays as it is."""
    lines = content.decode("utf-8", "surrogateescape").splitlines()
    places: list[list[float]] = []
    result = []
    for line in lines:
        words = line.split()
        if words[:1] == ["v"] and len(words) >= 4:
            places.append([_number(word) for word in words[1:4]])
        if words[:1] == ["f"] and len(words) > 4:
            result += _cut_face(line, words[1:], places)
        else:
            result.append(line)
    return "\n".join([*result, ""]).encode("utf-8", "surrogateescape")


def _number(word: str) -> float:
    try:
        return float(word)
    except ValueError:
        return np.nan  # which the reader of the file refuses


def _cut_face(line: str, words: list[str], places: list[list[float]]) -> list[str]:
    """The lines of the triangles of a face; the line of the face itself if they cannot be found."""
    found = [_CORNER.match(word) for word in words]
    numbers = [int(each[1]) for each in found if each is not None]
    index = [number - 1 if number > 0 else len(places) + number for number in numbers]
    if len(index) < len(words) or not all(0 <= i < len(places) for i in index):
        return [line]
    corners: FloatArray = np.array([places[i] for i in index])
    triangles = cut(corners) if np.isfinite(corners).all() else np.empty((0, 3, 3))
    if len(triangles) != len(words) - 2:  # it is bent, crosses itself, or has no area
        return [line]
    nearest = np.linalg.norm(triangles[:, :, None] - corners, axis=-1).argmin(axis=-1)
    ahead = np.cross(corners, np.roll(corners, -1, axis=0)).sum(axis=0)
    around = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0]) @ ahead
    order = np.where(around[:, None] < 0.0, nearest[:, ::-1], nearest)
    return [f"f {' '.join(words[i] for i in triangle)}" for triangle in order.tolist()]


def check_ply(name: str, content: bytes, triangles: int) -> None:
    """Raise `InputError` for a PLY with faces of more than three corners, of which a reader made `triangles`."""
    found = _PLY_FACES.search(content[: content.find(b"end_header")])
    if found is not None and triangles > int(found[1]):
        raise InputError(
            f"path: {name!r} has faces of more than three corners, which may be cut wrongly: export triangles (in "
            "Blender, `Triangulated Mesh`), or an .obj, whose faces are cut as they are outlined.",
            "path",
        )
