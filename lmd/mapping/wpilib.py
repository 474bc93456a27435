"""The field layout of WPILib, which PhotonVision reads too.

The x axis of a tag points out of it and its z axis up; the field is the floor of the room. The file has no size: that
of the tags is set where the detector is.

Source: WPILib's `AprilTagFieldLayout`.
"""

import json
from pathlib import Path

import numpy as np

from lmd.mapping.tag_map import TagMap, axes, written

# The columns are WPILib's axes in the frame of `TagMap.turns`: out of the tag (z), to the right (x), up (y).
OUT_RIGHT_UP = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [1.0, 0.0, 0.0]])


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
