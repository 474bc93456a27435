"""The field layout of WPILib, which PhotonVision reads too.

The x axis of a tag points out of it and its z axis up; the field is the floor of the room. The file has no size: that
of the tags is set where the detector is.

Source: WPILib's `AprilTagFieldLayout`.
"""

import json
from pathlib import Path

from lmd.mapping.tag_map import TagMap, axes, written
from lmd.scene.tag_map_readers import OUT_RIGHT_UP


def write_wpilib(path: Path, tags: TagMap) -> None:
    """Write `tags.wpilib.json`."""
    from scipy.spatial.transform import Rotation

    quaternions = written((tags.turns * Rotation.from_matrix(OUT_RIGHT_UP)).as_quat(canonical=True, scalar_first=True))
    low, high = tags.room.bounds()
    length, width, _ = (high - low).tolist()
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
    path.write_text(json.dumps(layout, indent=1) + "\n", encoding="utf-8")
