"""The floor tags of a map of Duckietown, as its `objects`: where they lie, and how they are turned about the vertical.

Source: duckietown/duckietown-world, `SE2Transform` and the maps of autolabs.
"""

from pathlib import Path

import numpy as np

from lmd.core.checks import InputError
from lmd.mapping.tag_map import TagMap, write_yaml, written

OFF_THE_FLOOR = 1e-6  # metres, and the same of a normal


def check_on_floor(tags: TagMap) -> None:
    """Raise `InputError` if a tag does not lie on the floor z = 0: the map knows no height."""
    off = np.abs(np.column_stack([tags.positions[:, 2], tags.deployment.normals - [0.0, 0.0, 1.0]])).max(axis=1)
    if (wrong := np.flatnonzero(off > OFF_THE_FLOOR)).size:
        raise InputError(f"it takes tags that lie on the floor only, which tag {tags.ids[wrong[0]]} does not")


def write_duckietown(path: Path, tags: TagMap) -> None:
    """Write `tags.duckietown.yaml`, whose objects go into the map of the city."""
    degrees = written(np.degrees(tags.turns.as_euler("xyz")[:, 2]))
    objects = {
        f"tag{number}": {
            "kind": "floor_tag",
            "pose": {"~SE2Transform": {"p": position[:2], "theta_deg": turn}},
            "tag": {"~TagInstance": {"family": tags.tag.family, "size": size, "tag_id": number}},
        }
        for number, position, turn, size in zip(
            tags.ids, tags.positions.tolist(), degrees.tolist(), tags.sizes.tolist(), strict=True
        )
    }
    write_yaml(path, {"objects": objects})
