"""The colours of the picture and of its legend."""

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lmd.plot import common

Rgb = tuple[int, int, int]
Colours = NDArray[np.uint8]


def rgb(colour: str) -> Rgb:
    """`#rrggbb` as three numbers."""
    red, green, blue = bytes.fromhex(colour[1:])
    return red, green, blue


FREE, PINNED = rgb(common.LANDMARK), rgb(common.FIXED)
SELECTED, SEEN = rgb("#ff7f0e"), rgb("#ffdd33")
MEASURED, ASKED = rgb("#17becf"), rgb("#2ca02c")  # tags of a survey, photographs that it asks for
UNKNOWN = rgb("#cdcdcd")
BODY = rgb("#7f8fa6")  # of a robot
VALUES = common.COLOUR_MAP  # of the objective's value
GAINS = "magma"  # of what a tag would add


def alike(colour: Rgb, count: int) -> Colours:
    """So many times the same colour, `(count, 3)`."""
    return np.tile(np.array(colour, dtype=np.uint8), (count, 1))


def mapped(name: str, shares: ArrayLike) -> Colours:
    """Shares of 1 `(N,)` as colours of a map of matplotlib, `(N, 3)`."""
    from matplotlib import colormaps

    return np.asarray(colormaps[name](np.asarray(shares), bytes=True))[:, :3]
