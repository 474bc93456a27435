"""The `.fmap` of Limelight: a matrix for each tag, from the middle of the field, and its edge in millimetres.

The axes of a tag are WPILib's: x out of it, y to the right, z up. The field is the floor of the room.

Source: Limelight's "AprilTag Map Specification".
"""

import json
from pathlib import Path

import numpy as np

from lmd.mapping.tag_map import TagMap, written
from lmd.scene.camera import MM_PER_M
from lmd.scene.tag_map_readers import OUT_RIGHT_UP


def write_limelight(path: Path, tags: TagMap) -> None:
    """Write `tags.fmap`."""
    low, high = tags.room.bounds()
    length, width, _ = (high - low).tolist()
    poses = np.tile(np.eye(4), (len(tags.ids), 1, 1))
    poses[:, :3, :3] = written(tags.turns.as_matrix() @ OUT_RIGHT_UP)
    poses[:, :3, 3] = written(tags.positions - [low[0] + length / 2.0, low[1] + width / 2.0, low[2]])
    rows = zip(tags.ids, (MM_PER_M * tags.sizes).tolist(), poses.reshape(-1, 16).tolist(), strict=True)
    fiducials = [
        {
            "family": f"apriltag3_{tags.tag.family}_classic",
            "id": number,
            "size": round(size, 9),
            "transform": pose,
            "unique": 1,
        }
        for number, size, pose in rows
    ]
    layout = {"type": "frc", "fieldlength": length, "fieldwidth": width, "fiducials": fiducials}
    path.write_text(json.dumps(layout, indent=1) + "\n", encoding="utf-8")
