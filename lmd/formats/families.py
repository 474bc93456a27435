"""Families of tags by the names that others give them, such as `TAG16h5` or `DICT_4X4_50`."""

import re
from collections.abc import Iterable
from typing import Any

from lmd.core.checks import InputError
from lmd.scene.tag import FAMILIES

# A family as Limelight, the ArUco library, OpenCV and apriltag_ros write it.
_NAME = re.compile(
    r"(?:cv2?\.|aruco[._]|dict_|apriltag(?:\d?[_ -])?|tag[_ -]?)*(\d+h\d+|\dx\d_\d+)(?:b1)?(?:_classic)?"
)
# Places in OpenCV's list of dictionaries, by which RTAB-Map names them.
NUMBERS = dict(
    enumerate([*(name for name in FAMILIES if FAMILIES[name].apriltag is None), "ARUCO_ORIGINAL", "16h5", "25h9"])
) | {19: "36h10", 20: "36h11", 21: "ARUCO_MIP_36h12"}


def family_named(name: Any) -> str:
    """The family with a name of others: one of `FAMILIES`, or the name itself where it is none of these.

    Raises:
        InputError: the name is no text.
    """
    if not isinstance(name, str):
        raise InputError(f"the family of a tag must be a text, got {name!r}.")
    found = _NAME.fullmatch(name.strip().lower())
    return found[1] if found is not None and found[1] in FAMILIES else name.strip()


def one_family(named: Iterable[str | None]) -> str | None:
    """The family of the tags of a map, of which each may say its own; None where none says any.

    Raises:
        InputError: they are of several families.
    """
    families = sorted({family for family in named if family is not None})
    if len(families) > 1:
        raise InputError(
            f"its tags are of the families {' and '.join(families)}, which may have equal ids: leave the tags of one "
            "family in the file."
        )
    return families[0] if families else None


def check_family(path: Any, told: str | None, wanted: str | None) -> None:
    """Raise `InputError` if the tags of a map at `path` are of another family than is wanted, if both are known."""
    if told is None or wanted is None or told == wanted:
        return
    if told not in FAMILIES:
        raise InputError(
            f"{path}: its tags are of the family {told}, which is not known here: it must be one of "
            f"{', '.join(FAMILIES)}, or the landmarks be points."
        )
    raise InputError(f"family={told} is needed: the tags of {path} are of that family, and not of {wanted}.", "family")
