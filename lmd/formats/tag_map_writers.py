"""Writers of tag maps: in the formats of several ecosystems, and as this project's table and JSON document.

Unless a writer states another convention, the frame of a tag has x to the right, y up and z along the normal.
"""

import json
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np

from lmd.core.checks import FloatArray
from lmd.core.tables import write_table
from lmd.formats.columns import FAMILY
from lmd.formats.placed_tag import axes_of
from lmd.formats.tag_map import QUATERNION, TagMap, axes, rounded_values, write_yaml
from lmd.geometry.camera import MM_PER_M
from lmd.scene.deployment import COLUMNS, UP_COLUMNS
from lmd.scene.families import FAMILIES
from lmd.scene.labels import EDGE, ID

OUT_RIGHT_UP = axes_of(("out", "right", "up"))  # axes of WPILib and Limelight, as columns
METRES = 1  # code for metres in aruco_bc_mInfoType of a map
CORNER_NAMES = ("top_left", "top_right", "bottom_right", "bottom_left")
FRAME = "metres; z up; of a tag x is right, y up, z out of it; its quaternion turns this frame to the world"
ROOM = "room"  # name of the body, or of the bundle, that has the tags
# Standard deviations of known poses in TagSLAM's example, m and rad; small values fix the tags.
FIXED = {"position_noise": 1e-4, "rotation_noise": 1e-5}


def write_apriltag_ros(path: Path, tags: TagMap) -> None:
    """Write `tags.apriltag_ros.yaml` for ROS 1: the tags are one bundle (a rigid group), in the world frame.

    Source: AprilRobotics/apriltag_ros, `tags.yaml` and `TagDetector::addObjectPoints`.
    """
    rows = zip(tags.ids, tags.sizes.tolist(), tags.positions, tags.quaternions.tolist(), strict=True)
    layout = [
        {"id": number, "size": size, **axes(position), **dict(zip(QUATERNION, turn, strict=True))}
        for number, size, position, turn in rows
    ]
    family = f"# Its settings.yaml must have tag_family: {FAMILIES[tags.tag.family].apriltag}"
    write_yaml(path, {"standalone_tags": [], "tag_bundles": [{"name": ROOM, "layout": layout}]}, family)


def write_apriltag_ros2(path: Path, tags: TagMap) -> None:
    """Write `tags.apriltag_ros2.yaml`, the parameters of the node that detects tags.

    The parameters list the ids and sizes of the tags, and name the frame of each tag. The parameters have no poses:
    programs that use the detections need a map.

    Source: christianrauch/apriltag_ros, `cfg` and `tag_functions`.
    """
    own = {"ids": tags.ids, "frames": [f"tag_{number}" for number in tags.ids], "sizes": tags.sizes.tolist()}
    family = str(FAMILIES[tags.tag.family].apriltag).removeprefix("tag")
    parameters = {"family": family, "size": tags.tag.size, "tag": own}
    write_yaml(path, {"/**": {"ros__parameters": parameters}})


def write_aruco(path: Path, tags: TagMap) -> None:
    """Write `tags.aruco.yaml`, the marker map of the ArUco library.

    Corners are in the order in which the library finds them, clockwise from the top left of the tag's own picture. The
    top of an AprilTag's picture is that of the AprilTag library, not that of OpenCV. A family that only OpenCV supports
    has OpenCV's name. Lines are indented as by OpenCV's `FileStorage`, which reads no other indentation.

    Source: ArUco 3, `MarkerMap::saveToFile`, `Dictionary` and `DictionaryBased::touulong`.
    """
    family = FAMILIES[tags.tag.family]
    markers = zip(tags.ids, tags.corners.tolist(), strict=True)
    lines = [
        "%YAML:1.0",
        "---",
        f"aruco_bc_dict: {f'TAG{tags.tag.family}' if family.apriltag else family.dictionary}",
        f"aruco_bc_nmarkers: {len(tags.ids)}",
        f"aruco_bc_mInfoType: {METRES}",
        "aruco_bc_markers:",
        *(f"   - {{ id: {number}, corners: {corners} }}" for number, corners in markers),
    ]
    _write_lines(path, lines)


def write_limelight(path: Path, tags: TagMap) -> None:
    """Write `tags.fmap` for Limelight: for each tag its pose as a matrix, with the origin in the middle of the field,
    and its edge length in millimetres.

    The axes of a tag are WPILib's: x out of the tag, y to the right, z up. The field is the floor of the room.

    Source: Limelight's "AprilTag Map Specification".
    """
    (low, _), (length, width) = tags.room.bounds(), _field(tags)
    poses = np.tile(np.eye(4), (len(tags.ids), 1, 1))
    poses[:, :3, :3] = rounded_values(tags.turns.as_matrix() @ OUT_RIGHT_UP)
    poses[:, :3, 3] = rounded_values(tags.positions - [low[0] + length / 2.0, low[1] + width / 2.0, low[2]])
    rows = zip(tags.ids, (MM_PER_M * tags.sizes).tolist(), poses.reshape(-1, 16).tolist(), strict=True)
    family = f"apriltag3_{tags.tag.family}_classic"
    fiducials = [
        {"family": family, "id": number, "size": round(size, 9), "transform": pose, "unique": 1}
        for number, size, pose in rows
    ]
    write_document(path, {"type": "frc", "fieldlength": length, "fieldwidth": width, "fiducials": fiducials})


def write_rtabmap(path: Path, tags: TagMap) -> None:
    """Write `tags.rtabmap.txt`, the value of the parameter `Marker/Priors`.

    The value is `id x y z roll pitch yaw` for each tag, with `|` between tags. RTAB-Map detects tags with OpenCV, so a
    tag's upward direction is that of OpenCV. The edge length is another parameter, `Marker/Length`.

    Source: introlab/rtabmap, `Parameters` and `MarkerDetector::detect`.
    """
    rows = zip(tags.ids, np.hstack([tags.positions, tags.roll_pitch_yaw]).tolist(), strict=True)
    _write_lines(path, ["|".join(" ".join(map(str, (number, *row))) for number, row in rows)])


def write_tagslam(path: Path, tags: TagMap) -> None:
    """Write `tags.tagslam.yaml`, in which the room is a static body with the tags at their planned poses.

    Rotations are rotation vectors. Users must add the camera's body and the parameters of TagSLAM.

    Source: berndpfrommer/tagslam, `example/tagslam.yaml` and `Tag::get_object_corners`.
    """
    poses = zip(tags.ids, tags.sizes.tolist(), tags.positions, rounded_values(tags.turns.as_rotvec()), strict=True)
    body = {
        "is_static": True,
        "type": "simple",
        "default_tag_size": tags.tag.size,
        "pose": _fixed(np.zeros(3), np.zeros(3)),
        "tags": [{"id": number, "size": size, "pose": _fixed(*pose)} for number, size, *pose in poses],
    }
    write_yaml(path, {"default_body": ROOM, "bodies": [{ROOM: body}]})


def write_wpilib(path: Path, tags: TagMap) -> None:
    """Write `tags.wpilib.json`, the field layout of WPILib, which PhotonVision also reads.

    The x axis of a tag points out of the tag, and the z axis up; the field is the floor of the room. The file has no
    tag size: the size is a setting of the detector.

    Source: WPILib's `AprilTagFieldLayout`.
    """
    from scipy.spatial.transform import Rotation

    quaternions = rounded_values(
        (tags.turns * Rotation.from_matrix(OUT_RIGHT_UP)).as_quat(canonical=True, scalar_first=True)
    )
    length, width = _field(tags)
    layout = {
        "tags": [
            {
                "ID": number,
                "pose": {
                    "translation": axes(position),
                    "rotation": {"quaternion": dict(zip("WXYZ", quaternion.tolist(), strict=True))},
                },
            }
            for number, position, quaternion in zip(tags.ids, tags.positions, quaternions, strict=True)
        ],
        "field": {"length": length, "width": width},
    }
    write_document(path, layout)


def _write_lines(path: Path, lines: Iterable[str]) -> None:
    path.write_text("".join(f"{line}\n" for line in lines), encoding="utf-8")


def _field(tags: TagMap) -> tuple[float, float]:
    """Length and width of the floor of the room, metres."""
    low, high = tags.room.bounds()
    length, width, _ = (high - low).tolist()
    return length, width


def _fixed(position: FloatArray, rotation: FloatArray) -> dict[str, Any]:
    noise = {name: axes(np.full(3, deviation)) for name, deviation in FIXED.items()}
    return {"position": axes(position), "rotation": axes(rotation), **noise}


def write_csv(path: Path, tags: TagMap) -> None:
    """Write `tags.csv`: the columns of `Deployment.to_csv`, followed by quaternion, corners and family."""
    deployment = tags.deployment
    placed = np.hstack([deployment.places, deployment.normals, deployment.ups])
    turned = np.hstack([tags.quaternions, tags.corners.reshape(-1, 12)])
    corners = [f"{corner}_{axis}" for corner in CORNER_NAMES for axis in "xyz"]
    columns: dict[str, Any] = {
        ID: tags.ids,
        **dict(zip((*COLUMNS, *UP_COLUMNS), placed.T, strict=True)),
        **({EDGE: tags.sizes} if deployment.has_own_edges else {}),
        **dict(zip((*QUATERNION, *corners), turned.T, strict=True)),
        FAMILY: [tags.tag.family] * len(tags.ids),
    }
    labels = {} if deployment.labels is None else deployment.labels.columns
    write_table(path, columns | {name: texts for name, texts in labels.items() if name not in columns})


def write_json(path: Path, tags: TagMap) -> None:
    """Write `tags.json`, the tag map as a JSON document of this project."""
    rows = zip(tags.ids, tags.sizes.tolist(), tags.positions, tags.quaternions, tags.corners, strict=True)
    document = {
        "family": tags.tag.family,
        EDGE: tags.tag.size,
        "frame": FRAME,
        "tags": [
            {
                ID: number,
                EDGE: size,
                "position": position.tolist(),
                "quaternion": dict(zip("wxyz", quaternion.tolist(), strict=True)),
                "corners": dict(zip(CORNER_NAMES, corners.tolist(), strict=True)),
            }
            for number, size, position, quaternion, corners in rows
        ],
    }
    write_document(path, document)


def write_document(path: Path, keys: dict[str, Any]) -> None:
    """Write a mapping as JSON."""
    path.write_text(f"{json.dumps(keys, indent=1)}\n", encoding="utf-8")


LAUNCH = '''"""Static transforms from the frame of the map to {count} tags.

    ros2 launch ./{file} frame:=map

The frame of a tag is named as apriltag_ros names it: x is to the right of the tag, y up, z out of it. A frame has one
parent, so let the detector name what it sees otherwise (its parameter frames, as in tags.apriltag_ros2.yaml).
"""

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import ComposableNodeContainer
from launch_ros.descriptions import ComposableNode

# The frame of each tag; x, y, z, metres; qx, qy, qz, qw from the frame of the tag to that of the map.
TAGS = [
{rows}
]
NAMES = ["child_frame_id", *("translation." + axis for axis in "xyz"), *("rotation." + axis for axis in "xyzw")]


def generate_launch_description():
    transforms = [
        ComposableNode(
            package="tf2_ros",
            plugin="tf2_ros::StaticTransformBroadcasterNode",
            name=tag[0].replace(":", "_"),
            parameters=[dict(zip(NAMES, tag), frame_id=LaunchConfiguration("frame"))],
        )
        for tag in TAGS
    ]
    container = ComposableNodeContainer(
        name="tags",
        namespace="",
        package="rclcpp_components",
        executable="component_container",
        composable_node_descriptions=transforms,
    )
    return LaunchDescription([DeclareLaunchArgument("frame", default_value="map"), container])
'''


def write_ros2_tf(path: Path, tags: TagMap) -> None:
    """Write `tags.ros2_tf.launch.py` for `ros2 launch`, which publishes the frames of the tags.

    The argument `frame` of the launch file names the frame of the map.
    """
    family = FAMILIES[tags.tag.family].apriltag or tags.tag.family
    poses = np.hstack([tags.positions, rounded_values(tags.turns.as_quat(canonical=True))]).tolist()
    rows = "\n".join(
        f'    ("{family}:{number}", {", ".join(map(repr, pose))}),'
        for number, pose in zip(tags.ids, poses, strict=True)
    )
    text = LAUNCH.format(count=len(tags.ids), file="tags.ros2_tf.launch.py", rows=rows)
    path.write_text(text, encoding="utf-8")
