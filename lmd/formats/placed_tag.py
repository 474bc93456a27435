"""Tags in maps that other programs wrote: family and number of a tag from its name, and checks of its pose.

All readers return tag poses with one convention: x to the right of the tag, y up, z along the normal towards the
viewer.
"""

import re
from collections.abc import Iterable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from lmd.core.checks import FloatArray, InputError, integer, real, vector
from lmd.core.tables import Table, radians
from lmd.formats.trees import Keys
from lmd.geometry.frames import roll_pitch_yaw
from lmd.geometry.se3 import QUATERNION_TOLERANCE, are_rotations, exp, nearest_rotations, pose_of
from lmd.scene.families import FAMILIES, family_named

METRE = 1.0  # unit, metres
SMALLEST_EDGE, LARGEST_EDGE = 0.005, 2.0  # plausible edges of a tag in a map, metres; other edges are refused
SQUARE_TOLERANCE = 0.05  # tolerance of the sides of a measured square, relative to the longest side
# OpenCV rotates the pictures of AprilTag by half a turn, so the up of its detections is opposite.
HALF_TURN = np.diag([-1.0, -1.0, 1.0])
LAST_ROW = (0.0, 0.0, 0.0, 1.0)  # last row of a transform
LAST_ROW_TOLERANCE = 1e-6
DIRECTIONS = {
    "right": (1.0, 0.0, 0.0),
    "left": (-1.0, 0.0, 0.0),
    "up": (0.0, 1.0, 0.0),
    "down": (0.0, -1.0, 0.0),
    "out": (0.0, 0.0, 1.0),
    "into": (0.0, 0.0, -1.0),
}
RIGHT_UP_OUT = ("right", "up", "out")
# OpenCV's dictionaries in the order of its list; RTAB-Map names a dictionary by its index.
_SQUARE = [f"{bits}x{bits}_{ids}" for bits in (4, 5, 6, 7) for ids in (50, 100, 250, 1000)]
NUMBERS = dict(enumerate([*_SQUARE, "aruco_original", "16h5", "25h9", "36h10", "36h11", "aruco_mip_36h12"]))

# Families in names of pictures, models and frames.
APRILTAG = re.compile(r"(?<!\d)(16|21|25|36|41|48|49|52)(?:[_-]?h[_-]?|[_-])(0?\d|1[0-3])(?!\d)", re.I)
ARUCO = re.compile(r"(?<!\d)(?:(50|100|250|1000)[_-])?([4-7]x[4-7])(?:[_-](50|100|250|1000)(?=[_/ :-]))?", re.I)
ORIGINAL = re.compile(r"original", re.I)
# Words for a tag and its number, of which the names of tags and of columns consist.
TAG_WORDS = (
    r"(?:(?:april|aruco|ar|tags?|markers?|fiducials?|landmarks?|dict|mip|family|standard|custom|circle|original|child|frame|names?"
    r"|labels?|ids?|number|num|nr|no)[\s_:.#=-]*)+"
)
TAG_NAME = re.compile(rf"(?:{TAG_WORDS})?(\d{{1,15}})", re.I)


class PlacedTag(NamedTuple):
    """Tag of a map.

    Args:
        number: id of the tag.
        position: position of the centre, `(3,)`, metres.
        axes: rotation matrix from the tag's frame (x right, y up, z out) to the map's frame, `(3, 3)`.
        edge: edge length of the black square, metres; None if the map does not state it.
        family: name of the family, see `lmd.scene.families.family_named`; None if the map does not name it.
    """

    number: int
    position: FloatArray
    axes: FloatArray
    edge: float | None = None
    family: str | None = None


class Found(NamedTuple):
    """Tags found in a file.

    Args:
        tags: tags of another program's map.
        table: table of tags if `tags` is empty, see `lmd.formats.tag_tables`; else None.
        by_opencv: True if the programs that read such files detect tags with OpenCV.
        note: sentence for the user on an assumption about the file; empty if none was made.
    """

    tags: Sequence[PlacedTag]
    table: Table | None = None
    by_opencv: bool = False
    note: str = ""


def axes_of(words: Sequence[str] | None) -> FloatArray:
    """Axes x, y and z of a tag's frame, made from their directions in words.

    Args:
        words: three of `DIRECTIONS`; None for right, up, out.

    Returns:
        matrix `(3, 3)` whose columns are the axes, in the frame with x right, y up and z out of the tag.

    Raises:
        InputError: the directions do not form a right-handed frame.
    """
    given = RIGHT_UP_OUT if words is None else words
    if isinstance(given, list | tuple) and len(given) == 3 and all(isinstance(word, str) for word in given):
        axes = np.array([DIRECTIONS.get(word, (0.0, 0.0, 0.0)) for word in given]).T
        if np.linalg.det(axes) > 0.5:
            return axes
    raise InputError(
        f"axes must be three of {', '.join(DIRECTIONS)}, which make a right-handed frame, such as [right,up,out] or "
        f"[right,down,into], got {words!r}.",
        "axes",
    )


def number_of(value: Any) -> int:
    """Id of a tag; raises `InputError` if `value` is not an integer >= 0."""
    return integer("id", value, low=0)


def family_and_rest(text: str) -> tuple[str | None, str]:
    """Family that the name of a tag contains, or None; and the name with the word `tag` in place of the family."""
    for found in APRILTAG.finditer(text):
        names = [family_named(f"{kind}{found[1]}h{int(found[2])}") for kind in ("", "circle", "aruco_mip_")]
        known = [name for name in names if name in FAMILIES]
        if known or "h" in found[0].lower():
            return (known or names)[0], f"{text[: found.start()]}tag_{text[found.end() :]}"
    if aruco := ARUCO.search(text):
        ids = aruco[1] or aruco[3]
        family = None if ids is None else f"{aruco[2].lower()}_{ids}"
        return family, f"{text[: aruco.start()]}tag_{text[aruco.end() :]}"
    return ("aruco_original" if ORIGINAL.search(text) else None), text


def tag_named(value: Any) -> tuple[str | None, int] | None:
    """Family and number of a tag, from its number or from a name such as `tag36h11:7`.

    The family is None if it is unknown. The result is None if `value` does not determine the number.
    """
    text = str(value).strip().removesuffix(".0").rpartition("/")[2]
    family, rest = family_and_rest(text)
    found = TAG_NAME.fullmatch(rest)
    if found is None or (family is None and rest != text):  # 4x4_50 is a family, 4x4_7 is not
        return None
    return family, int(found[1])


def mapping(name: str, value: Any) -> Keys:
    """Return `value` if it is a mapping; otherwise raise an `InputError` that names `name`."""
    if not isinstance(value, Mapping):
        raise InputError(f"{name} must be a mapping with keys, got {_kind(value)}.")
    return value


def mappings(name: str, value: Any) -> list[Keys]:
    """Return `value` if it is a list of mappings; otherwise raise an `InputError` that names `name`."""
    if not isinstance(value, list | tuple):
        raise InputError(f"{name} must be a list, got {_kind(value)}.")
    return [mapping(f"{name}[{i}]", entry) for i, entry in enumerate(value)]


def _kind(value: Any) -> str:
    """Short description of a value for a message; the value itself may be too long to show."""
    if isinstance(value, Mapping | list | tuple):
        return "a mapping" if isinstance(value, Mapping) else "a list"
    return "nothing" if value is None else repr(value)[:80]


def edge_of(name: str, value: Any, unit: float = METRE) -> float:
    """Edge length of a tag's black square, metres.

    Args:
        unit: length of the unit of the value, metres.

    Raises:
        InputError: the value is not a number, or is implausible as an edge length.
    """
    edge = unit * real(name, value, above=0.0)
    if not SMALLEST_EDGE <= edge <= LARGEST_EDGE:
        counted = "metres" if unit == METRE else "millimetres"
        raise InputError(
            f"{name} = {value:g} is read in {counted}, as an edge of {edge:g} m; edges must be {SMALLEST_EDGE:g} to "
            f"{LARGEST_EDGE:g} m, except in a table with a column edge."
        )
    return edge


def turn_by_quaternion(x: float, y: float, z: float, w: float) -> FloatArray:
    """Rotation matrix of a unit quaternion.

    Raises:
        InputError: the length of the quaternion is not 1.
    """
    from scipy.spatial.transform import Rotation  # importing it is slow

    length = float(np.linalg.norm([x, y, z, w]))
    if not abs(length - 1.0) <= QUATERNION_TOLERANCE:
        raise InputError(
            f"the quaternion x, y, z, w = {x:g}, {y:g}, {z:g}, {w:g} must have length 1, it has {length:g}."
        )
    return np.asarray(Rotation.from_quat([x, y, z, w]).as_matrix())


def turn_by_angles(number: int, roll: float, pitch: float, yaw: float) -> FloatArray:
    """Rotation matrix from ROS's roll, pitch and yaw of a tag, rad.

    Raises:
        InputError: an angle is so large that the angles seem to be in degrees.
    """
    radians(f"tag {number}", roll=np.array([roll]), pitch=np.array([pitch]), yaw=np.array([yaw]))
    return roll_pitch_yaw([roll, pitch, yaw])


def turn_by_vector(source: str, rotation: FloatArray) -> FloatArray:
    """Rotation matrix of a rotation vector `(3,)`, whose length is the angle, rad; `source` is for messages.

    Raises:
        InputError: the vector is so long that it seems to be in degrees.
    """
    radians(source, rotation=rotation)
    return exp(np.concatenate([rotation, np.zeros(3)]))[:3, :3]


def transform_of(values: Any, called: str, source: str = "") -> FloatArray:
    """Rigid motion `(4, 4)` from the 16 numbers of a matrix, row by row; the rotation is made orthonormal.

    Args:
        called: name of the matrix, for messages.
        source: prefix of messages, such as `tag 7: `.

    Raises:
        InputError: the numbers are not a rigid motion, or are written column by column instead of row by row.
    """
    pose = np.array(vector(called, values, 16)).reshape(4, 4)
    if np.abs(pose[3] - LAST_ROW).max() > LAST_ROW_TOLERANCE:
        last = ", ".join(f"{value:g}" for value in pose[3])
        columns = np.abs(pose[:, 3] - LAST_ROW).max() <= LAST_ROW_TOLERANCE
        guess = ": it looks as if it was written column by column, and must be written row by row" if columns else ""
        raise InputError(f"{source}the last row of its {called} must be 0, 0, 0, 1, it is {last}{guess}.")
    if not are_rotations(turn := pose[:3, :3]):
        raise InputError(f"the rotation {np.round(turn, 4).tolist()} must be orthonormal and right-handed.")
    return pose_of(nearest_rotations(turn), pose[:3, 3])


def tag_of_corners(number: int, corners: FloatArray, family: str | None) -> PlacedTag:
    """Tag with four corners `(4, 3)`, metres, clockwise from the top left.

    Raises:
        InputError: there are not four corners, they do not form a square, or they are not in order around the square's
            outline.
    """
    if corners.shape != (4, 3):
        raise InputError(f"the marker {number} must have four corners, it has {len(corners)}.")
    sides = np.linalg.norm(corners - np.roll(corners, 1, axis=0), axis=1)
    if np.ptp(sides) > SQUARE_TOLERANCE * sides.max():
        raise InputError(f"the marker {number} must be a square, its sides are {np.round(sides, 6).tolist()} m.")
    edge = edge_of("side", float(sides.mean()))
    # Vectors from the left to the right corners, and from the lower to the upper corners.
    right, up = corners[1] + corners[2] - corners[0] - corners[3], corners[0] + corners[1] - corners[2] - corners[3]
    if min(np.linalg.norm(right), np.linalg.norm(up)) < edge:  # for a square, each vector is twice the edge
        raise InputError(f"the marker {number} must have its corners in order around its outline.")
    right /= np.linalg.norm(right)
    up -= (up @ right) * right
    up /= np.linalg.norm(up)
    axes = np.stack([right, up, np.cross(right, up)], axis=-1)
    return PlacedTag(number, corners.mean(axis=0), axes, edge, family)


def one_family(named: Iterable[str | None]) -> str | None:
    """The one family of the tags of a map; None if no tag has a known family.

    Args:
        named: family of each tag; None if it is unknown.

    Raises:
        InputError: the tags have several families.
    """
    families = sorted({family for family in named if family is not None})
    if len(families) > 1:
        raise InputError(
            f"its tags are of the families {' and '.join(families)}, which may have equal ids: keep the tags of one "
            "family only."
        )
    return families[0] if families else None


def check_family(path: Any, told: str | None, wanted: str | None) -> None:
    """Raise `InputError` if the tags of a map have another family than the family `wanted`.

    Args:
        path: path of the map, for messages.
        told: family that the map names; None if it names none.
        wanted: required family; None for any family.
    """
    if told is None or wanted is None or told == wanted:
        return
    if told not in FAMILIES:
        raise InputError(
            f"{path}: its tags are of the family {told}, which is not supported: it must be one of "
            f"{', '.join(FAMILIES)}, unless tag.edge is null."
        )
    raise InputError(f"family={told} is needed: the tags of {path} are of that family, not of {wanted}.", "family")
