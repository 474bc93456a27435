"""The `tagslam.yaml` of TagSLAM: the room is a static body, and its tags are where they were planned.

The axes of a tag are x to the right, y up, z out of it; a rotation is a rotation vector.

Source: berndpfrommer/tagslam, `example/tagslam.yaml` and `Tag::get_object_corners`.
"""

from pathlib import Path
from typing import Any

import numpy as np

from lmd.core.checks import FloatArray
from lmd.mapping.tag_map import TagMap, axes, write_yaml, written

BODY = "room"
# Standard deviations that TagSLAM's own example gives to what is known: a tag that stays where it is, m and rad.
FIXED = {"position_noise": 1e-4, "rotation_noise": 1e-5}


def write_tagslam(path: Path, tags: TagMap) -> None:
    """Write `tags.tagslam.yaml`, to which the camera's body and the parameters of TagSLAM are added."""
    poses = zip(tags.ids, tags.sizes.tolist(), tags.positions, written(tags.turns.as_rotvec()), strict=True)
    body = {
        "is_static": True,
        "type": "simple",
        "default_tag_size": tags.tag.size,
        "pose": _pose(np.zeros(3), np.zeros(3)),
        "tags": [{"id": number, "size": size, "pose": _pose(position, turn)} for number, size, position, turn in poses],
    }
    write_yaml(path, {"default_body": BODY, "bodies": [{BODY: body}]})


def _pose(position: FloatArray, rotation: FloatArray) -> dict[str, Any]:
    noise = {name: axes(np.full(3, deviation)) for name, deviation in FIXED.items()}
    return {"position": axes(position), "rotation": axes(rotation), **noise}
