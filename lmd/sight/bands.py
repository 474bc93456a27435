"""Which axes may cover a landmark, bounded by height: for work whose landmarks are too many for tables of directions.

A cap lies in a cone around the direction of its landmark. Axes are sorted by height (their z coordinate), so the cone's
lowest and highest point bound the axes that need the exact test to one contiguous band.
"""

import math

import numpy as np

from lmd.core.checks import FloatArray
from lmd.core.compiled import inlined

# Number of equal intervals of [-1, 1] in which the start of a band of axes is tabulated.
HEIGHT_BINS = 512
# Heights this far beyond the cone's ends are still tested; rounding moves the end of a narrow cone by 2e-8.
HEIGHT_MARGIN = 1e-6


def height_index(heights: FloatArray) -> np.ndarray:
    """`index[b]`: the first axis at or above the bottom of height bin b, less a margin, `(HEIGHT_BINS + 2,)`.

    Args:
        heights: z coordinates of the axes in ascending order, `(D,)`.
    """
    edges = np.linspace(-1.0, 1.0, HEIGHT_BINS + 1)
    return np.append(np.searchsorted(heights, edges - HEIGHT_MARGIN), len(heights)).astype(np.int64)


@inlined
def band_of(x, y, z, low, slack):
    """The heights of the axes whose depth of a landmark at offset (x, y, z) may reach `low`.

    They lie in a cone around the direction of the landmark. With a `slack`, in that of any landmark so far away.
    Scalars only and no branch: a loop over landmarks or positions vectorises with it.

    Returns:
        the first and last height bin, to be looked up in `height_index`.
    """
    distance = np.sqrt(x * x + y * y + z * z)
    height, cosine = z / distance, min(max(low / distance, -1.0), 1.0)
    sine = math.sqrt(1.0 - cosine * cosine)
    across = math.sqrt(max(0.0, 1.0 - height * height))
    wide = distance - slack <= 0.0  # the slack reaches the camera: any axis
    bottom = -1.0 if wide | (-height >= cosine) else height * cosine - across * sine
    top = 1.0 if wide | (height >= cosine) else height * cosine + across * sine
    scale = HEIGHT_BINS / 2.0
    first = math.floor((bottom - HEIGHT_MARGIN + 1.0) * scale)
    # Twice the margin: the table starts each bin one margin early.
    last = math.floor((top + 2.0 * HEIGHT_MARGIN + 1.0) * scale) + 1
    return max(first, 0), min(last, HEIGHT_BINS + 1)
