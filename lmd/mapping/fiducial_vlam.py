"""The map of fiducial_vlam: one edge for all tags, and for each a position and roll, pitch, yaw.

It detects by OpenCV, so a tag's up is OpenCV's. A tag with `f: 1` stays where it is.

Source: ptrmu/fiducial_vlam, `Map` and `Marker::corners_f_map`.
"""

from pathlib import Path

from lmd.mapping.tag_map import TagMap, write_yaml


def write_fiducial_vlam(path: Path, tags: TagMap) -> None:
    """Write `tags.fiducial_vlam.yaml`."""
    rows = zip(tags.ids, tags.positions.tolist(), tags.roll_pitch_yaw.tolist(), strict=True)
    markers = [{"id": number, "u": 1, "f": 1, "xyz": position, "rpy": turn} for number, position, turn in rows]
    write_yaml(path, {"marker_length": float(tags.sizes[0]), "markers": markers})
