"""Families of fiducial tags, their names, and the pictures of their tags.

The edge length of a tag is the distance between adjacent corners that detectors find. In most families these corners
are the corners of the outer black square. In AprilTag's newer families (41h12, 52h13, circle21h7), which also have data
around the black ring, the detected corners are the corners of the white square within the ring. The top of a tag is the
top of its published picture. For ArUco families this is the picture of `cv2.aruco.generateImageMarker`. For AprilTag
families this is AprilTag's own picture, which OpenCV shows rotated by 180 degrees.
"""

import re
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np

from lmd.core.checks import BoolArray, InputError, integer
from lmd.core.optional import optional


@dataclass(frozen=True)
class Family:
    """Family of tags, whose pictures consist of square modules that are black or white.

    Args:
        modules: N, number of modules along the edge between the detected corners.
        ids: number of tags.
        dictionary: name of the dictionary in `cv2.aruco`; None if OpenCV lacks the family.
        apriltag: name in the AprilTag library; None if the library lacks the family.
        around: width of the border (ring and data) outside the detected square, modules.
        square: phrase for the detected square in messages, such as `black square`. The edge length of a tag is the edge
            length of this square.
    """

    modules: int
    ids: int
    dictionary: str | None = None
    apriltag: str | None = None
    around: int = 0
    square: str = "black square"

    @property
    def picture_modules(self) -> int:
        """Number of modules along the edge of the whole picture."""
        return self.modules + 2 * self.around


WITHIN_RING = "white square inside the black ring"
FAMILIES = (
    {
        "36h11": Family(8, 587, "DICT_APRILTAG_36h11", "tag36h11"),
        "25h9": Family(7, 35, "DICT_APRILTAG_25h9", "tag25h9"),
        "16h5": Family(6, 30, "DICT_APRILTAG_16h5", "tag16h5"),
        "41h12": Family(5, 2115, None, "tagStandard41h12", 2, WITHIN_RING),
        "52h13": Family(6, 48714, None, "tagStandard52h13", 2, WITHIN_RING),
        "circle21h7": Family(5, 38, None, "tagCircle21h7", 2, WITHIN_RING),
    }
    | {
        f"{bits}x{bits}_{ids}": Family(bits + 2, ids, f"DICT_{bits}X{bits}_{ids}")
        for bits in (4, 5, 6, 7)
        for ids in (50, 100, 250, 1000)
    }
    | {
        "aruco_original": Family(7, 1024, "DICT_ARUCO_ORIGINAL"),
        "aruco_mip_36h12": Family(8, 250, "DICT_ARUCO_MIP_36h12"),
    }
)

# Prefixes and suffixes of the names of families in Limelight, the ArUco library, OpenCV and apriltag_ros.
_AROUND = re.compile(
    r"^(?:cv2?\.|aruco[._]|dict_|apriltag(?:\d?[_ -])?|k?tag[_ -]?|standard[_ -]?)+|(?:b1)?(?:_classic)?$"
)


def _short(name: str) -> str:
    return _AROUND.sub("", name.strip().lower())


# The ArUco library calls its original family ARUCO.
_NAMED = {_short(name): name for name in FAMILIES} | {"aruco": "aruco_original"}


def family_named(name: Any) -> str:
    """Convert a library's name of a family, such as `tagStandard41h12` or `DICT_4X4_50`, to the name in `FAMILIES`.

    Returns:
        one of `FAMILIES`, or `name` without surrounding spaces if no family has that name.

    Raises:
        InputError: the name is not a text.
    """
    if not isinstance(name, str):
        raise InputError(f"the family of a tag must be a text, got {name!r}.")
    return _NAMED.get(_short(name), name.strip())


def picture(family: str, number: int) -> BoolArray:
    """Picture of tag `number`: the colours of its M x M modules, `(M, M)`, row 0 at the top; True for white.

    Raises:
        InputError: the family has no such tag.
    """
    integer("tag id", number, low=0, high=FAMILIES[family].ids - 1)
    if FAMILIES[family].dictionary is None:
        return _apriltag_picture(family, int(number))
    aruco = optional("cv2", "detection").aruco
    shown = aruco.generateImageMarker(dictionary(family), int(number), FAMILIES[family].modules) > 0
    return np.asarray(shown[::-1, ::-1] if FAMILIES[family].apriltag else shown)


def dictionary(family: str) -> Any:
    """Object of `cv2.aruco` that contains the codes of a family's tags (a dictionary of ArUco)."""
    aruco = optional("cv2", "detection").aruco
    return aruco.getPredefinedDictionary(getattr(aruco, str(FAMILIES[family].dictionary)))


def _apriltag_picture(family: str, number: int) -> BoolArray:
    """Picture of tag `number`, `(M, M)`, drawn from its code as in `apriltag_to_image` of AprilTag; True for white."""
    known, described = FAMILIES[family], _described(family)
    size, first = known.picture_modules, known.around
    shown = np.ones((size, size), dtype=bool)  # the corners of a circular family's picture are white paper
    ring = first - 1
    shown[ring : size - ring, ring : size - ring] = False
    shown[first : size - first, first : size - first] = True
    inner = first + 1
    shown[inner : size - inner, inner : size - inner] = False
    code, bits = described.codes[number], described.nbits
    for i in range(bits):
        shown[described.bit_y[i] + first, described.bit_x[i] + first] = bool(code >> (bits - 1 - i) & 1)
    return shown


@lru_cache
def _described(family: str) -> Any:
    """Description of a family in the AprilTag library: codes of the tags, and place of each code bit in the picture."""
    # No detector is made for the family: its table of codes with errors would take up to 3.2 GB.
    library = optional("pyapriltags", "detection").Detector(families="").libc
    return getattr(library, f"{FAMILIES[family].apriltag}_create")().contents
