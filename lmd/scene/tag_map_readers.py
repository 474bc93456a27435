"""The keys of tag maps in YAML and JSON, as several ecosystems write them.

Every reader gives the poses of tags in one frame: x to the right of the tag, y up, z out of it to whoever looks at it.
A format is the same with axes named otherwise, or counted from another origin.

Sources: `AprilTagFieldLayout` of WPILib; `TagDetector` of AprilRobotics/apriltag_ros; `Board::parse` and
`example/tagslam.yaml` of TagSLAM; `Marker::corners_f_map` of ptrmu/fiducial_vlam; `MarkerMap` of ArUco 3;
`SE2Transform` of duckietown-world; `target_map.fbs` of frc971; "AprilTag Map Specification" of Limelight.
"""

from collections.abc import Callable, Iterable, Mapping
from typing import Any, NamedTuple

import numpy as np

from lmd.core.checks import FloatArray, InputError, integer, real, vector
from lmd.geometry.frames import roll_pitch_yaw
from lmd.geometry.se3 import QUATERNION_TOLERANCE, are_rotations, exp, nearest_rotations
from lmd.scene.edges import EDGE

Keys = Mapping[str, Any]
MM = 1e-3  # metres
SQUARE_TOLERANCE = 0.05  # of the sides of a measured square, relative to the longest
METRES = 1  # aruco_bc_mInfoType of a map in metres
# The columns are a format's axes in the frame of a tag: x right, y up, z out.
OUT_RIGHT_UP = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [1.0, 0.0, 0.0]])  # WPILib: x out, y to the right, z up
INTO = np.diag([1.0, -1.0, -1.0])  # frc971, as AprilTag 3: x right, y down, z into the tag
FACING_BACK = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]])  # the axes of frc971 if it looks along -y
# OpenCV has the pictures of AprilTag turned by half a turn: whoever detects with it means another up.
HALF_TURN = np.diag([-1.0, -1.0, 1.0])


class PlacedTag(NamedTuple):
    """A tag of a map.

    Args:
        number: its id.
        position: of its centre, `(3,)`, metres.
        axes: from its frame (x right, y up, z out) to that of the map, `(3, 3)`.
        edge: of the black square, metres; None where the map does not say.
    """

    number: int
    position: FloatArray
    axes: FloatArray
    edge: float | None = None


def _numbers(keys: Keys, names: Iterable[str]) -> FloatArray:
    return np.array([real(name, keys[name]) for name in names])


def number_of(value: Any) -> int:
    """The id of a tag; raises `InputError` if it is none."""
    return integer("id", value, low=0)


def _turn(x: float, y: float, z: float, w: float) -> FloatArray:
    """The matrix of a unit quaternion.

    Raises:
        InputError: its length is not 1.
    """
    from scipy.spatial.transform import Rotation  # slow to load

    length = float(np.linalg.norm([x, y, z, w]))
    if abs(length - 1.0) > QUATERNION_TOLERANCE:
        raise InputError(
            f"the quaternion x, y, z, w = {x:g}, {y:g}, {z:g}, {w:g} must have length 1, it has {length:g}."
        )
    return np.asarray(Rotation.from_quat([x, y, z, w]).as_matrix())


def _wpilib(keys: Keys) -> Iterable[PlacedTag]:
    for tag in keys["tags"] if "tags" in keys else keys["field-tags"]:  # which it is from 2027 on
        pose = tag["pose"]
        turn = _turn(*_numbers(pose["rotation"]["quaternion"], "XYZW"))
        yield PlacedTag(number_of(tag["ID"]), _numbers(pose["translation"], "xyz"), turn @ OUT_RIGHT_UP.T)


def _own_json(keys: Keys) -> Iterable[PlacedTag]:
    for tag in keys["tags"]:
        turn = _turn(*_numbers(tag["quaternion"], "xyzw"))
        edge = real(EDGE, tag.get(EDGE, keys[EDGE]), above=0.0)
        yield PlacedTag(number_of(tag["id"]), np.array(vector("position", tag["position"], 3)), turn, edge)


def _limelight(keys: Keys) -> Iterable[PlacedTag]:
    """From the middle of the field, as the file counts; from its corner where the file says how large the field is."""
    middle = np.array([real(name, keys.get(name, 0.0)) / 2.0 for name in ("fieldlength", "fieldwidth")])
    for tag in keys["fiducials"]:
        pose = np.array(vector("transform", tag["transform"], 16)).reshape(4, 4)
        axes = _orthonormal(pose[:3, :3])
        edge = MM * real("size", tag["size"], above=0.0) if "size" in tag else None
        yield PlacedTag(number_of(tag["id"]), pose[:3, 3] + [*middle, 0.0], axes @ OUT_RIGHT_UP.T, edge)


def _orthonormal(matrix: FloatArray) -> FloatArray:
    """The rotation nearest to a matrix printed with a few decimals.

    Raises:
        InputError: it is none.
    """
    if not are_rotations(matrix):
        raise InputError(f"the rotation {np.round(matrix, 4).tolist()} must be orthonormal and right-handed.")
    return nearest_rotations(matrix)


def _frc971(keys: Keys) -> Iterable[PlacedTag]:
    """By a quaternion, or by degrees about the turning axes of a tag that looks along -y, as in 2025."""
    from scipy.spatial.transform import Rotation  # slow to load

    for tag in keys["target_poses"]:
        if "w" in (turned := tag["orientation"]):
            turn = _turn(*_numbers(turned, "xyzw"))
        else:
            turn = FACING_BACK @ Rotation.from_euler("XYZ", _numbers(turned, "xyz"), degrees=True).as_matrix()
        yield PlacedTag(number_of(tag["id"]), _numbers(tag["position"], "xyz"), turn @ INTO)


def _apriltag_ros(keys: Keys) -> Iterable[PlacedTag]:
    bundles = [bundle for bundle in keys.get("tag_bundles") or () if bundle.get("layout")]
    if not bundles:
        raise InputError("its tags are standalone_tags, which have no places; a map is a bundle of tag_bundles.")
    if len(bundles) > 1:
        names = ", ".join(str(bundle.get("name", "without a name")) for bundle in bundles)
        raise InputError(f"it has the bundles {names}, each in a frame of its own: leave one of them in the file.")
    # What TagDetector takes for keys that are not there.
    defaults = {"x": 0.0, "y": 0.0, "z": 0.0, "qx": 0.0, "qy": 0.0, "qz": 0.0, "qw": 1.0}
    for tag in bundles[0]["layout"]:
        values = _numbers({**defaults, **tag}, defaults)
        yield PlacedTag(number_of(tag["id"]), values[:3], _turn(*values[3:]), real("size", tag["size"], above=0.0))


def _tagslam(keys: Keys) -> Iterable[PlacedTag]:
    """Tags of the static bodies; the others are what TagSLAM looks for."""
    bodies = [body for entry in keys["bodies"] for body in entry.values()]
    if not any(body.get("is_static") for body in bodies if body.get("tags") or body.get("board")):
        raise InputError("no body with tags is static: a map is of tags on bodies with is_static: true and a pose.")
    for entry in keys["bodies"]:
        for name, body in entry.items():
            own = list(_on_body(body)) if body.get("is_static") else []
            if own and not body.get("pose"):
                raise InputError(f"the body {name!r} has no pose: give it one, such as that which TagSLAM found.")
            if own:
                position, turn = _tagslam_pose(body["pose"])
                for tag in own:
                    yield tag._replace(position=turn @ tag.position + position, axes=turn @ tag.axes)


def _on_body(body: Keys) -> Iterable[PlacedTag]:
    """The tags of a body in its frame: listed, or those of a board in rows from its corner on."""
    for tag in body.get("tags") or ():
        position, turn = _tagslam_pose(tag.get("pose") or {})
        size = real("size", tag.get("size", body.get("default_tag_size")), above=0.0)
        yield PlacedTag(number_of(tag["id"]), position, turn, size)
    if board := body.get("board"):
        size = real("tag_size", board["tag_size"], above=0.0)
        pitch = size * (1.0 + real("tag_spacing", board["tag_spacing"]))
        rows, columns = (integer(name, board[name], low=1, high=1000) for name in ("tag_rows", "tag_columns"))
        for k in range(rows * columns):
            centre = pitch * np.array([k % columns, k // columns, 0.0])
            yield PlacedTag(number_of(board["tag_start_id"]) + k, centre, np.eye(3), size)


def _tagslam_pose(pose: Keys) -> tuple[FloatArray, FloatArray]:
    """Position and rotation; what is not there is zero."""
    position, rotation = (
        _numbers(pose.get(key) or dict.fromkeys("xyz", 0.0), "xyz") for key in ("position", "rotation")
    )
    return position, exp(np.concatenate([rotation, np.zeros(3)]))[:3, :3]


def _fiducial_vlam(keys: Keys) -> Iterable[PlacedTag]:
    edge = real("marker_length", keys["marker_length"], above=0.0)
    for tag in keys["markers"]:
        if "q" in tag:  # of older files
            position, turn = tag["t"], _turn(*vector("q", tag["q"], 4))
        else:
            position, turn = tag["xyz"], roll_pitch_yaw(vector("rpy", tag["rpy"], 3))
        yield PlacedTag(number_of(tag["id"]), np.array(vector("xyz", position, 3)), turn, edge)


def _aruco(keys: Keys) -> Iterable[PlacedTag]:
    if keys.get("aruco_bc_mInfoType", METRES) != METRES:
        raise InputError(f"aruco_bc_mInfoType must be {METRES}, metres, got {keys['aruco_bc_mInfoType']!r}.")
    for tag in keys["aruco_bc_markers"]:
        corners = np.array([vector("corners", corner, 3) for corner in tag["corners"]])
        if corners.shape != (4, 3):
            raise InputError(f"the marker {tag['id']} must have four corners, it has {len(corners)}.")
        sides = np.linalg.norm(corners - np.roll(corners, 1, axis=0), axis=1)
        if np.ptp(sides) > SQUARE_TOLERANCE * sides.max():
            raise InputError(f"the marker {tag['id']} must be a square, its sides are {np.round(sides, 6).tolist()} m.")
        # From the left to the right and from the lower to the upper corners, clockwise from the top left.
        right, up = corners[1] + corners[2] - corners[0] - corners[3], corners[0] + corners[1] - corners[2] - corners[3]
        right /= np.linalg.norm(right)
        up -= (up @ right) * right
        up /= np.linalg.norm(up)
        axes = np.stack([right, up, np.cross(right, up)], axis=-1)
        yield PlacedTag(number_of(tag["id"]), corners.mean(axis=0), axes, float(sides.mean()))


def _duckietown(keys: Keys) -> Iterable[PlacedTag]:
    """Tags that lie on the floor; those of traffic signs belong to signs, whose heights the map does not say."""
    for thing in keys["objects"].values():
        if thing.get("kind") != "floor_tag":
            continue
        tag, pose = thing["tag"]["~TagInstance"], thing["pose"]["~SE2Transform"]
        x, y = vector("p", pose["p"], 2)
        theta = real("theta", np.radians(pose["theta_deg"]) if "theta_deg" in pose else pose.get("theta", 0.0))
        edge = real("size", tag["size"], above=0.0)
        yield PlacedTag(number_of(tag["tag_id"]), np.array([x, y, 0.0]), roll_pitch_yaw([0.0, 0.0, theta]), edge)


class Reader(NamedTuple):
    """A format in YAML or JSON.

    Args:
        format: what it is called.
        marks: keys that only files of this format have.
        read: gives the tags.
        by_opencv: whether those who read such files detect by OpenCV.
    """

    format: str
    marks: frozenset[str]
    read: Callable[[Keys], Iterable[PlacedTag]]
    by_opencv: bool = False


READERS = (
    Reader("lmd", frozenset({"tags", "family", EDGE}), _own_json),
    Reader("WPILib", frozenset({"tags"}), _wpilib),
    Reader("WPILib", frozenset({"field-tags"}), _wpilib),
    Reader("Limelight", frozenset({"fiducials"}), _limelight),
    Reader("frc971", frozenset({"target_poses"}), _frc971),
    Reader("apriltag_ros", frozenset({"tag_bundles"}), _apriltag_ros),
    Reader("apriltag_ros", frozenset({"standalone_tags"}), _apriltag_ros),
    Reader("TagSLAM", frozenset({"bodies"}), _tagslam),
    Reader("fiducial_vlam", frozenset({"markers", "marker_length"}), _fiducial_vlam, by_opencv=True),
    Reader("ArUco", frozenset({"aruco_bc_markers"}), _aruco),
    Reader("Duckietown", frozenset({"objects"}), _duckietown),
)
