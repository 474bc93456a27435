"""The marker map of Clover: a line `id length x y z yaw pitch roll` for each tag, metres and radians.

Clover detects by OpenCV, so a tag's up is OpenCV's. Turns are ROS's `setRPY`: Rz(yaw) Ry(pitch) Rx(roll).

Source: CopterExpress/clover, `ArucoMap::addMarker`.
"""

from pathlib import Path

import numpy as np

from lmd.mapping.tag_map import TagMap


def write_clover(path: Path, tags: TagMap) -> None:
    """Write `tags.clover.txt`."""
    values = np.column_stack([tags.sizes, tags.positions, tags.roll_pitch_yaw[:, ::-1]])
    rows = zip(tags.ids, values.tolist(), strict=True)
    lines = ["# id length x y z yaw pitch roll", *("\t".join(map(str, (number, *row))) for number, row in rows)]
    path.write_text("".join(f"{line}\n" for line in lines), encoding="utf-8")
