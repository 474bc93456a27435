"""The target map of frc971: the z axis of a tag points into it, x to its right, y down. It has no edge.

Source: frc971/971-Robot-Code, `frc971/vision/target_map.fbs` and its README.
"""

import json
from pathlib import Path

from lmd.mapping.tag_map import TagMap, axes, written
from lmd.scene.tag_map_readers import INTO


def write_frc971(path: Path, tags: TagMap) -> None:
    """Write `tags.frc971.json`."""
    from scipy.spatial.transform import Rotation

    quaternions = written((tags.turns * Rotation.from_matrix(INTO)).as_quat(canonical=True))
    poses = [
        {"id": number, "position": axes(position), "orientation": dict(zip("xyzw", turn.tolist(), strict=True))}
        for number, position, turn in zip(tags.ids, tags.positions, quaternions, strict=True)
    ]
    path.write_text(json.dumps({"target_poses": poses}, indent=1) + "\n", encoding="utf-8")
