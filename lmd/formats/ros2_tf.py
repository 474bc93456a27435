"""Launch file of ROS 2 with a static transform from the frame of the map to each tag.

Frames have the names and the axes of apriltag_ros: `tag36h11:7`, with x to the right, y up, z out of the tag. One
container publishes all transforms, as one process per transform would exceed the number of DDS participants of a
computer.

Sources: christianrauch/apriltag_ros, `pnp` and `child_frame_id`; `tf2_ros::StaticTransformBroadcasterNode`.
"""

from pathlib import Path

import numpy as np

from lmd.formats.tag_map import TagMap, rounded_values
from lmd.scene.families import FAMILIES

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
    """Write `tags.ros2_tf.launch.py`, which `ros2 launch` runs; its argument `frame` is the frame of the map."""
    family = FAMILIES[tags.tag.family].apriltag or tags.tag.family
    poses = np.hstack([tags.positions, rounded_values(tags.turns.as_quat(canonical=True))]).tolist()
    rows = "\n".join(
        f'    ("{family}:{number}", {", ".join(map(repr, pose))}),'
        for number, pose in zip(tags.ids, poses, strict=True)
    )
    text = LAUNCH.format(count=len(tags.ids), file="tags.ros2_tf.launch.py", rows=rows)
    path.write_text(text, encoding="utf-8")
