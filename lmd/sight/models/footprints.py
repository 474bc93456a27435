"""Occlusion of one tag by the footprint of another."""

from typing import Any

import numpy as np

from lmd.core.checks import FloatArray
from lmd.core.compiled import inner, kernel
from lmd.geometry.squares import upright_axes
from lmd.scene.criteria import TOLERANCE


@inner
def footprint_hides(
    sight: Any, half: float, ax: float, ay: float, az: float, nx: float, ny: float, nz: float, bx: float, by: float,
    bz: float, mx: float, my: float, mz: float,
) -> Any:  # fmt: skip
    """True if the footprint of tag A with normal n hides the centre or a corner of tag B with normal m.

    `half` is half the edge of B; a and b are the offsets from the camera, metres.
    """
    height = -(nx * ax + ny * ay + nz * az)
    tx, ty, tz, ux, uy, uz = upright_axes(nx, ny, nz, sight.level)
    rx, ry, rz, sx, sy, sz = upright_axes(mx, my, mz, sight.level)
    rx, ry, rz = half * rx, half * ry, half * rz
    sx, sy, sz = half * sx, half * sy, half * sz
    for i in range(5):
        # The centre b, then b + (r + s), b - (r + s), b + (r - s), b - (r - s).
        way, up = (0.0 if i == 0 else 1.0 if i % 2 == 1 else -1.0), (1.0 if i < 3 else -1.0)
        cx, cy, cz = bx + way * (rx + up * sx), by + way * (ry + up * sy), bz + way * (rz + up * sz)
        side = nx * cx + ny * cy + nz * cz + height
        if (height > 0.0 and side < -TOLERANCE) or (height < 0.0 and side > TOLERANCE):
            share = height / (height - side)
            qx, qy, qz = share * cx - ax, share * cy - ay, share * cz - az
            along, across = abs(tx * qx + ty * qy + tz * qz), abs(ux * qx + uy * qy + uz * qz)
            if along <= sight.footprint and across <= sight.footprint:
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
            x, y, z = landmarks[b, 0, j], landmarks[b, 1, j], landmarks[b, 2, j]
            nx, ny, nz = normals[b, 0, j], normals[b, 1, j], normals[b, 2, j]
            height = min(nx * (low[0] - x), nx * (high[0] - x))
            height += min(ny * (low[1] - y), ny * (high[1] - y)) + min(nz * (low[2] - z), nz * (high[2] - z))
            if not height >= TOLERANCE:
                return True
            for k in range(count):
                dx, dy, dz = landmarks[b, 0, k] - x, landmarks[b, 1, k] - y, landmarks[b, 2, k] - z
                if dx * dx + dy * dy + dz * dz > horizon * horizon:
                    continue
                tx, ty, tz, ux, uy, uz = upright_axes(normals[b, 0, k], normals[b, 1, k], normals[b, 2, k], level)
                side = nx * dx + ny * dy + nz * dz
                side -= half * (abs(nx * tx + ny * ty + nz * tz) + abs(nx * ux + ny * uy + nz * uz))
                if side < -0.1 * TOLERANCE:
                    return True
    return False
