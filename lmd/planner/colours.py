"""Colours of the picture and of its legend."""

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lmd.core.checks import FloatArray
from lmd.plot import common

Rgb = tuple[int, int, int]
Colours = NDArray[np.uint8]


def rgb(colour: str) -> Rgb:
    """Red, green and blue, 0 to 255, of `#rrggbb`."""
    red, green, blue = bytes.fromhex(colour[1:])
    return red, green, blue


FREE, PINNED = rgb(common.LANDMARK), rgb(common.FIXED)
SELECTED, SEEN = rgb("#ff7f0e"), rgb("#ffdd33")
MEASURED = rgb("#17becf")  # tags of a survey
UNKNOWN = rgb("#cdcdcd")
WALL, PATTERN = rgb("#ececec"), rgb("#1a1a1a")
BODY = rgb("#7f8fa6")  # body of a robot
VALUES = common.COLOUR_MAP  # colour map of the objective's values
GAINS = "magma"  # colour map of gains by one more tag


def alike(colour: Rgb, count: int) -> Colours:
    """`count` times one colour, `(count, 3)`."""
    return np.tile(np.array(colour, dtype=np.uint8), (count, 1))


def span_of(values: FloatArray) -> tuple[float, float]:
    """Least and greatest of values from 0 to 1 `(N,)`; 0 and 1 if all are equal."""
    low, high = float(values.min()), float(values.max())
    return (low, high) if low < high else (0.0, 1.0)


def mapped(name: str, shares: ArrayLike) -> Colours:
    """Colours of a matplotlib map for values from 0 to 1 `(N,)`, `(N, 3)`."""
    from matplotlib import colormaps

    return np.asarray(colormaps[name](np.asarray(shares), bytes=True))[:, :3]
