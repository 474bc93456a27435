"""Occlusion of one tag by the footprint of another."""

from typing import Any

import numpy as np

from lmd.core.checks import FloatArray
from lmd.core.compiled import inner, kernel
from lmd.geometry.squares import upright_axes
from lmd.geometry.vectors import Vector, column3, dot3, minus3, plus3, times3
from lmd.scene.criteria import TOLERANCE


@inner
def footprint_hides(sight: Any, half: float, a: Vector, n: Vector, b: Vector, m: Vector) -> Any:
    """True if the footprint of tag A with normal n hides the centre or a corner of tag B with normal m.

    `half` is half the edge of B; a and b are the offsets from the camera, metres.
    """
    height, (t, u), (r, s) = -dot3(n, a), upright_axes(n, sight.level), upright_axes(m, sight.level)
    r, s = times3(half, r), times3(half, s)
    for i in range(5):
        # The centre b, then b + (r + s), b - (r + s), b + (r - s), b - (r - s).
        way, up = (0.0 if i == 0 else 1.0 if i % 2 == 1 else -1.0), (1.0 if i < 3 else -1.0)
        c = plus3(b, times3(way, plus3(r, times3(up, s))))
        side = dot3(n, c) + height
        if (height > 0.0 and side < -TOLERANCE) or (height < 0.0 and side > TOLERANCE):
            q = minus3(times3(height / (height - side), c), a)
            if abs(dot3(t, q)) <= sight.footprint and abs(dot3(u, q)) <= sight.footprint:
                return True
    return False


def may_hide(
    sight: Any, horizon: float, low: FloatArray, high: FloatArray, landmarks: FloatArray, normals: FloatArray
) -> bool:
    """False if no landmark can hide another.

    The function returns False if all camera positions are in front of all footprints, and no corner of a tag is behind
    a footprint within the `horizon` (metres). Other arguments as in `SightModel.among`.
    """
    return sight.reach >= 0.0 and _some_behind(
        low, high, landmarks, normals, float(np.max(sight.half)), sight.level, horizon
    )


@kernel
def _some_behind(
    low: FloatArray, high: FloatArray, landmarks: FloatArray, normals: FloatArray, half: float, level: float,
    horizon: float,
) -> bool:  # fmt: skip
    count = landmarks.shape[2]
    for b in range(len(landmarks)):
        for j in range(count):
            at, n = column3(landmarks[b], j), column3(normals[b], j)
            height = min(n[0] * (low[0] - at[0]), n[0] * (high[0] - at[0]))
            height += min(n[1] * (low[1] - at[1]), n[1] * (high[1] - at[1])) + min(
                n[2] * (low[2] - at[2]), n[2] * (high[2] - at[2])
            )
            if not height >= TOLERANCE:
                return True
            for k in range(count):
                d = minus3(column3(landmarks[b], k), at)
                if dot3(d, d) > horizon * horizon:
                    continue
                t, u = upright_axes(column3(normals[b], k), level)
                if dot3(n, d) - half * (abs(dot3(n, t)) + abs(dot3(n, u))) < -0.1 * TOLERANCE:
                    return True
    return False
