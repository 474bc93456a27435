"""Families of the tags in a map of others."""

from collections.abc import Iterable
from typing import Any

from lmd.core.checks import InputError
from lmd.scene.families import FAMILIES

# Places in OpenCV's list of dictionaries, by which RTAB-Map names them.
_SQUARE = [f"{bits}x{bits}_{ids}" for bits in (4, 5, 6, 7) for ids in (50, 100, 250, 1000)]
NUMBERS = dict(enumerate([*_SQUARE, "aruco_original", "16h5", "25h9", "36h10", "36h11", "aruco_mip_36h12"]))


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
