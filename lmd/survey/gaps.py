"""Errors of a constant velocity across gaps without images, as stretches of the drive without gaps tell.

White noise is not what drives a body, so what short links are off by does not say what long ones are.
"""

from dataclasses import replace

import numpy as np

from lmd.core.checks import FloatArray, IntArray
from lmd.geometry.se3 import exp, inverse, log
from lmd.survey.links import turning
from lmd.survey.motion import SHORTEST_GAP, Motion

# So many lengths of gaps are tried, seconds, of which so many at least fit into stretches without gaps; the velocity on
# each side is that over a pace, seconds.
LONGEST_GAP, GAPS, FEWEST_GAPS, LEAST_PACE = 5.0, 13, 6, 0.2


def tried(motion: Motion, poses: FloatArray) -> Motion:
    """The motion with how well a constant velocity bridges gaps, as stretches without gaps tell.

    Of two frames that are a gap apart, the velocities before and after the gap say how they are to each other, which
    the stretch knows better.

    Args:
        motion: of a constant velocity, in pieces.
        poses: of the frames; those of one piece are in one world, and stand together.
    """
    assert motion.piece is not None
    gaps, bridged, clock = [], [], motion.times - np.nanmin(motion.times)
    clock = clock + motion.piece * (np.nanmax(clock) + 10.0 * LONGEST_GAP)

    def near(seconds: FloatArray) -> IntArray:
        """The frame nearest to each time of `clock`."""
        after = np.clip(np.searchsorted(clock, seconds), 1, len(clock) - 1)
        return np.asarray(after - (seconds - clock[after - 1] < clock[after] - seconds))

    pace = max(LEAST_PACE, float(np.median(np.diff(clock))))
    for gap in np.geomspace(SHORTEST_GAP, LONGEST_GAP, GAPS):
        ends = np.stack([near(clock + by) for by in (-pace, 0.0, gap, gap + pace)])
        before, lasts, after = np.diff(clock[ends], axis=0)
        fits = (np.abs(lasts - gap) < 0.13 * gap) & (np.abs(before - pace) < 0.5 * pace)
        fits &= np.abs(after - pace) < 0.5 * pace
        whole = np.unique((clock[ends[1][fits]] / gap).astype(np.int64))
        if len(whole) < FEWEST_GAPS:
            continue
        first, i, j, last = poses[ends[:, fits]]
        into, out = (
            log(inverse(one) @ other)[:, :3] / h[fits, None] for one, other, h in ((first, i, before), (j, last, after))
        )
        moving = (i - first)[:, :3, 3] / before[fits, None], (last - j)[:, :3, 3] / after[fits, None]
        half = lasts[fits, None] / 2.0
        turn = log(exp(-turning(half * (into + out))) @ inverse(i) @ j)[:, :3]
        place = (j - i)[:, :3, 3] - half * (moving[0] + moving[1])
        squares = np.array([(turn**2).sum(axis=1).mean(), (place**2).sum(axis=1).mean()])
        gaps.append(gap)
        bridged.append(np.sqrt(12.0 * squares / gap**3))
    return replace(motion, gaps=np.array(gaps), bridged=np.array(bridged).reshape(-1, 2))
