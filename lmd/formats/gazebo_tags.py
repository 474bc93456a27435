"""Tags in a world of Gazebo: plates, planes and meshes that show the picture of a tag.

A box shows its picture on each side. On upright sides the picture is upright; on the upper side its up is x, on the
lower side minus x. So a plate shows a tag on both sides. A side that another body covers is not visible, nor is the
lower side of a lying plate. For an upright plate with two free sides, and for a mesh, the user must name the directions
of the model's axes. A plane shows its picture with x right and y up.

Sources: `MeshManager::CreateBox` and `CreatePlane` of Gazebo classic and gz-common; the models of
koide3/gazebo_apriltag.
"""

import re
from collections.abc import Iterable, Iterator, Sequence
from typing import Any
from xml.etree.ElementTree import Element

import numpy as np

from lmd.core.checks import FloatArray, InputError
from lmd.formats.gazebo_worlds import Seen, seen_in
from lmd.formats.placed_tag import Found, PlacedTag, axes_of, family_and_rest, number_of

# Words for tags in names of pictures, models and materials; a number after such a word is the number of the tag.
WORD = re.compile(
    r"april[_/ .-]?tag|aruco|(?<![a-z])ar[_/ .-]?tag|fiducial|(?<![a-z])tag(?=[_/ .-]?\d|standard|circle|custom)", re.I
)
NUMBER = re.compile(r"(?<![\dx.])(\d+)(?!\d|(?:[.]\d+)?(?:mm|cm|m)(?![a-z])|x\d|[.]\d)", re.I)
KNOWN_PLATE = re.compile(r"Apriltag36_11_\d{5}")  # models of koide3/gazebo_apriltag
KNOWN_SIZE = (1.0, 1.0, 0.01)  # size of these models, metres
PLAIN = "Gazebo/"  # prefix of the names of materials without a picture of a tag
THIN = 0.2  # greatest thickness of a plate, relative to its next larger side
LYING = 0.99  # least cosine of the tilt of a plate that counts as lying
BESIDE = (1e-6, 1e-3)  # distances in front of a side at which a body covers the side, metres
# Right, up and out of the picture on the sides of a box, by the axis across the side and its sign, as columns.
SIDES = {
    (0, 1): np.array([[0, 0, 1], [1, 0, 0], [0, 1, 0]], dtype=float),
    (0, -1): np.array([[0, 0, -1], [-1, 0, 0], [0, 1, 0]], dtype=float),
    (1, 1): np.array([[-1, 0, 0], [0, 0, 1], [0, 1, 0]], dtype=float),
    (1, -1): np.array([[1, 0, 0], [0, 0, -1], [0, 1, 0]], dtype=float),
    (2, 1): np.array([[0, 1, 0], [-1, 0, 0], [0, 0, 1]], dtype=float),
    (2, -1): np.array([[0, -1, 0], [-1, 0, 0], [0, 0, -1]], dtype=float),
}


def gazebo(root: Element, path: Any, axes: Sequence[str] | None) -> Found:
    """Tags of a world or a model.

    Args:
        axes: directions of the axes of a plate's or mesh's frame, see `axes_of`; None if the user names none.

    Raises:
        InputError: there is no tag, or the file does not determine the side of a tag.
    """
    visuals = list(seen_in(root, path, "visual"))
    sized = [
        (seen, _numbers(seen.element, "geometry/box/size")) for seen in (*visuals, *seen_in(root, path, "collision"))
    ]
    bodies = [(seen, size) for seen, size in sized if size is not None and len(size) == 3]
    tags, up = list[PlacedTag](), False
    for seen in visuals:
        named = _named(seen)
        if named is None:
            continue
        family, number = named
        boxes = [(body.pose, size) for body, size in bodies if body is not seen]
        centre, turn, lies = _side(seen, number, boxes, axes)
        up |= lies
        tags.append(PlacedTag(number_of(number), centre, turn, None, family))
    if not tags:
        raise InputError(
            "it is a file of Gazebo in which no model, picture or material has a name with the number of a tag, such "
            "as Apriltag36_11_00003 or aruco_marker_7: rename the model, or write its tags as a table "
            "(docs/mounting.md)."
        )
    sides = "plates that lie show their tag on the upper side" if up else "tags are where their pictures are"
    return Found(tags, note=f"{path}: {sides}; their edges are not read, as pictures include a margin")


def _named(seen: Seen) -> tuple[str | None, int] | None:
    """Family and number of the tag that a visual shows; None if the visual shows no tag."""
    if seen.element is None:  # the file of the model was not found
        return _first(seen.names)
    pictures = [text for text in _texts(seen.element, "material") if not text.startswith(PLAIN)]
    if pictures:
        return _first(pictures) or _first(seen.names)
    meshes = _texts(seen.element, "geometry/mesh/uri")
    return _first([*meshes, *seen.names]) if meshes else None


def _texts(element: Element, path: str) -> list[str]:
    """Names of pictures, scripts and meshes below elements, without colours."""
    below = [part for found in element.findall(path) for part in found.iter()]
    return [part.text.strip() for part in below if part.tag in ("name", "uri", "albedo_map") and part.text]


def _first(texts: Iterable[str]) -> tuple[str | None, int] | None:
    """Family and number in the first of the names that has a word for a tag and a number."""
    for text in texts:
        word = WORD.search(text)
        if word is None:
            continue
        family, rest = family_and_rest(text[word.end() :])
        if numbers := NUMBER.findall(rest):
            return family, int(numbers[-1])
    return None


def _numbers(element: Element | None, path: str) -> FloatArray | None:
    """Positive sizes of an element; None for an element without sizes."""
    text = None if element is None else element.findtext(path)
    try:
        values = np.array([float(word) for word in (text or "").split()])
    except ValueError:
        return None
    return values if values.size and (values > 0.0).all() and np.isfinite(values).all() else None


def _side(
    seen: Seen, number: int, boxes: Sequence[tuple[FloatArray, FloatArray]], axes: Sequence[str] | None
) -> tuple[FloatArray, FloatArray, bool]:
    """Centre and axes of the tag that a visual shows; and True if the side was decided because the plate lies."""
    size = _numbers(seen.element, "geometry/box/size")
    if seen.element is None and any(KNOWN_PLATE.search(name) for name in seen.names):
        size = np.array(KNOWN_SIZE)
    plate = size is not None and len(size) == 3 and np.sort(size)[0] <= THIN * np.sort(size)[1]
    if axes is not None:
        turn = axes_of(axes).T
        half = 0.0 if size is None or len(size) != 3 else float(np.abs(turn[:, 2]) @ size) / 2.0
        return *_placed(seen, turn, half), False
    if seen.element is not None and (normal := seen.element.findtext("geometry/plane/normal")) is not None:
        if np.allclose([float(word) for word in normal.split()], [0.0, 0.0, 1.0]):
            return *_placed(seen, np.eye(3), 0.0), False
    elif seen.element is not None and seen.element.find("geometry/plane") is not None:
        return *_placed(seen, np.eye(3), 0.0), False
    if not plate or size is None:
        raise InputError(
            f"the tag {number} ({', '.join(seen.names)[:120]}) is on a model whose shape does not say which side shows "
            "it: say by axes which way x, y and z of the model point, such as axes=[out,right,up], or put the folder "
            "of the model beside the file."
        )
    thin = int(np.argmin(size))
    sides = [(thin, 1), (thin, -1)]
    found = [(*_placed(seen, SIDES[side], float(size[thin]) / 2.0), side) for side in sides]
    free = [one for one in found if not any(_covered(one[0] + by * one[1][:, 2], boxes) for by in BESIDE)]
    if len(free) == 1:
        return *free[0][:2], False
    upper = [one for one in found if one[1][2, 2] > LYING]
    if upper:
        return *upper[0][:2], True
    raise InputError(
        f"the tag {number} ({', '.join(seen.names)[:120]}) is on both sides of an upright plate: {_choices(sides)}."
    )


def _placed(seen: Seen, turn: FloatArray, half: float) -> tuple[FloatArray, FloatArray]:
    """Centre and axes, world frame, of a picture at the distance `half`, metres, in front of the middle of a visual."""
    axes: FloatArray = seen.pose[:3, :3] @ turn
    return seen.pose[:3, 3] + half * axes[:, 2], axes


def _covered(point: FloatArray, boxes: Iterable[tuple[FloatArray, FloatArray]]) -> bool:
    """True if a point of the world is in a box."""
    return any((np.abs(pose[:3, :3].T @ (point - pose[:3, 3])) < size / 2.0).all() for pose, size in boxes)


def _choices(sides: Sequence[tuple[int, int]]) -> str:
    """Values of `axes` that choose one of the sides of a plate."""
    words = [
        f"axes=[{','.join(_words(SIDES[side]))}] takes that towards {'-+'[side[1] > 0]}{'xyz'[side[0]]} of it"
        for side in sides
    ]
    return ", ".join(words)


def _words(turn: FloatArray) -> Iterator[str]:
    """Directions of the axes x, y and z of a model in the frame of its picture, in words."""
    for row in turn:
        axis = int(np.argmax(np.abs(row)))
        yield (("left", "right"), ("down", "up"), ("into", "out"))[axis][int(row[axis] > 0.0)]
