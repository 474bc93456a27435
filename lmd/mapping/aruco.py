"""The marker map of the ArUco library.

Corners are in the order in which the library finds them, clockwise from the top left of the tag's own picture.

Source: ArUco 3, `MarkerMap::saveToFile`, `Dictionary` and `DictionaryBased::touulong`: it reads the code of an
AprilTag from the top left on, so its up is AprilTag's.
"""

from pathlib import Path

from lmd.mapping.tag_map import TagMap
from lmd.scene.tag import FAMILIES
from lmd.scene.tag_map_readers import METRES


def write_aruco(path: Path, tags: TagMap) -> None:
    """Write `tags.aruco.yaml`; a family that only OpenCV has goes by OpenCV's name.

    The lines are those of OpenCV's `FileStorage`, which reads no other indentation.
    """
    family = FAMILIES[tags.tag.family]
    markers = zip(tags.ids, tags.corners.tolist(), strict=True)
    lines = [
        "%YAML:1.0",
        "---",
        f"aruco_bc_dict: {f'TAG{tags.tag.family}' if family.apriltag else family.dictionary}",
        f"aruco_bc_nmarkers: {len(tags.ids)}",
        f"aruco_bc_mInfoType: {METRES}",
        "aruco_bc_markers:",
        *(f"   - {{ id: {number}, corners: {corners} }}" for number, corners in markers),
    ]
    path.write_text("".join(f"{line}\n" for line in lines), encoding="utf-8")
