"""The value of RTAB-Map's parameter `Marker/Priors`: `id x y z roll pitch yaw`, tags with a `|` between them.

RTAB-Map detects by OpenCV, so a tag's up is OpenCV's. The edge is another parameter, `Marker/Length`.

Source: introlab/rtabmap, `Parameters` and `MarkerDetector::detect`.
"""

from pathlib import Path

import numpy as np

from lmd.mapping.tag_map import TagMap


def write_rtabmap(path: Path, tags: TagMap) -> None:
    """Write `tags.rtabmap.txt`."""
    rows = zip(tags.ids, np.hstack([tags.positions, tags.roll_pitch_yaw]).tolist(), strict=True)
    path.write_text("|".join(" ".join(map(str, (number, *row))) for number, row in rows) + "\n", encoding="utf-8")
