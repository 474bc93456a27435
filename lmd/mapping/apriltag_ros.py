"""Files for the two packages called apriltag_ros.

In ROS 1 a bundle says where its tags are: x to the right, y up, z out of the tag. In ROS 2 the node only names the
tags that it looks for and their size; where they are is for the map of whoever uses it.

Sources: AprilRobotics/apriltag_ros, `tags.yaml` and `TagDetector::addObjectPoints`; christianrauch/apriltag_ros, `cfg`.
"""

from pathlib import Path

from lmd.mapping.tag_map import QUATERNION, TagMap, axes, write_yaml
from lmd.scene.tag import FAMILIES

BUNDLE = "room"


def write_apriltag_ros(path: Path, tags: TagMap) -> None:
    """Write `tags.apriltag_ros.yaml`: one bundle, whose frame is the world frame."""
    layout = [
        {
            "id": number,
            "size": size,
            **axes(position),
            **dict(zip(QUATERNION, turn, strict=True)),
        }
        for number, size, position, turn in zip(
            tags.ids, tags.sizes.tolist(), tags.positions, tags.quaternions.tolist(), strict=True
        )
    ]
    family = f"# Its settings.yaml must have tag_family: {FAMILIES[tags.tag.family].apriltag}"
    write_yaml(path, {"standalone_tags": [], "tag_bundles": [{"name": BUNDLE, "layout": layout}]}, family)


def write_apriltag_ros2(path: Path, tags: TagMap) -> None:
    """Write `tags.apriltag_ros2.yaml`: the parameters of the node, with a frame for each tag."""
    parameters = {
        "family": tags.tag.family,
        "size": tags.tag.size,
        "tag": {
            "ids": tags.ids,
            "frames": [f"tag_{number}" for number in tags.ids],
            "sizes": tags.sizes.tolist(),
        },
    }
    write_yaml(path, {"/**": {"ros__parameters": parameters}})
