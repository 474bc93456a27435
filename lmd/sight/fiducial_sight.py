"""What a detector sees of fiducial tags as scalar functions: `lmd.sight.fiducial` compiled for a camera.

The same operations in the same order as the reference there, hence the same bits.
"""

import math
from typing import NamedTuple

import numpy as np
from numba import njit

from lmd.checks import FloatArray
from lmd.compiled import kernel
from lmd.sight.criteria import TOLERANCE, from_position, hide, in_image


class FiducialSight(NamedTuple):
    """The criteria as numbers, tolerance included; a `lmd.sight.criteria.Sight`.

    outer_cosine, inner_cosine, reach: see there; facing cosine of the greatest incidence; half, plate half the edge of
    the black square and of the paper, metres; level: see `lmd.tag.upright`; left, right, top, bottom tangents of the
    angles to the borders, less the margin; focal_u, focal_v pixels; area least |det J|, pixels^2 / metre^2. The least
    eigenvalue of J^T J, pixels^2 / metre^2, is sharp + blurred (defocus - focus / depth)^2 with `focus` in metres.
    steady: sine of the angle between the inner cone and the nearest border.
    """

    outer_cosine: float
    inner_cosine: float
    reach: float
    facing: float
    half: float
    plate: float
    level: float
    left: float
    right: float
    top: float
    bottom: float
    focal_u: float
    focal_v: float
    area: float
    sharp: float
    blurred: float
    defocus: float
    focus: float
    steady: float

    def unhidden(self) -> "FiducialSight":
        """See `Sight.unhidden`."""
        return self._replace(reach=-1.0)

    def among(self, low: FloatArray, high: FloatArray, landmarks: FloatArray, normals: FloatArray) -> "FiducialSight":
        """See `Sight.among`: flush plates of a convex room never hide each other."""
        if self.reach >= 0.0 and not _may_hide(low, high, landmarks, normals, self.half, self.level):
            return self.unhidden()
        return self

    def shrunk(self, size: float) -> "FiducialSight":
        """See `Sight.shrunk`."""
        return self._replace(plate=self.plate * size)


@njit(inline="always")
def _upright(nx, ny, nz, level):  # type: ignore[no-untyped-def]
    """See `lmd.tag.upright`: right and up of a tag with a unit normal."""
    across = nx * nx + ny * ny
    on_wall = across > level * level
    square = across if on_wall else nx * nx + nz * nz
    length = math.sqrt(square)
    tx, ty, tz = (
        (-ny if on_wall else nz) / length,
        (nx if on_wall else 0.0) / length,
        (0.0 if on_wall else -nx) / length,
    )
    ux, uy = -(nx * (nz if on_wall else ny)) / length, (-(ny * nz) if on_wall else square) / length
    uz = (square if on_wall else -(ny * nz)) / length
    return tx, ty, tz, ux, uy, uz


@from_position.register(FiducialSight)
def _from_position(sight, x, y, z, nx, ny, nz, slack):  # type: ignore[no-untyped-def]
    distance = math.sqrt(x * x + y * y + z * z)
    nearest = distance - slack
    along = -(nx * x + ny * y + nz * z)
    least = nearest * sight.outer_cosine
    # |det J| is at least the smaller eigenvalue of J^T J and falls with the depth; moving in the plane leaves n . d.
    product = sight.focal_u * sight.focal_v * along
    resolved = least * least * least * max(sight.area, sight.sharp) <= product * (1.0 + TOLERANCE)
    reached = (along >= sight.facing * nearest) & (along >= 0.0) & resolved
    # Within the inner cone, the larger eigenvalue is at most (f_max d)^2 / z^4, and the product of both det^2.
    slope = min(sight.focal_u, sight.focal_v) * along / (distance * distance)
    here, there = sight.defocus - sight.focus / distance, sight.defocus - sight.focus / (distance * sight.inner_cosine)
    most = sight.sharp + sight.blurred * max(here * here, there * there)
    sure = (slope * slope * (1.0 - TOLERANCE) >= most) & (product * (1.0 - TOLERANCE) >= sight.area * distance**3)
    sure = sure & (distance * sight.steady >= 1.5 * sight.half)  # more than half the diagonal
    return reached, least - slack, not sure


@in_image.register(FiducialSight)
def _in_image(sight, x, y, z, nx, ny, nz, low, slack, ax, ay, az, rx, ry, rz):  # type: ignore[no-untyped-def]
    tx, ty, tz, ux, uy, uz = _upright(nx, ny, nz, sight.level)
    dx, dy, dz = ay * rz - az * ry, az * rx - ax * rz, ax * ry - ay * rx
    # The centre, and the tag's right and up, in the camera's frame.
    u, v, w = rx * x + ry * y + rz * z, dx * x + dy * y + dz * z, ax * x + ay * y + az * z
    tu, tv, tw = rx * tx + ry * ty + rz * tz, dx * tx + dy * ty + dz * tz, ax * tx + ay * ty + az * tz
    uu, uv, uw = rx * ux + ry * uy + rz * uz, dx * ux + dy * uy + dz * uz, ax * ux + ay * uy + az * uz
    half, left, right, top, bottom = sight.half, sight.left, sight.right, sight.top, sight.bottom
    inside = half * (abs(tw) + abs(uw)) < w
    inside &= u + half * (abs(tu - right * tw) + abs(uu - right * uw)) <= right * w
    inside &= half * (abs(tu + left * tw) + abs(uu + left * uw)) - u <= left * w
    inside &= v + half * (abs(tv - bottom * tw) + abs(uv - bottom * uw)) <= bottom * w
    inside &= half * (abs(tv + top * tw) + abs(uv + top * uw)) - v <= top * w
    per = 1.0 / w
    fu, fv, at_u, at_v = sight.focal_u * per, sight.focal_v * per, u * per, v * per
    one, two, three, four = tu - at_u * tw, uu - at_u * uw, tv - at_v * tw, uv - at_v * uw
    square = fu * fu * (one * one + two * two) + fv * fv * (three * three + four * four)
    determinant = fu * fv * per * abs(nx * x + ny * y + nz * z)
    blur = sight.defocus - sight.focus * per
    least = sight.sharp + sight.blurred * (blur * blur)
    clear = (2.0 * least <= square) & (determinant >= sight.area)
    clear &= least * least + determinant * determinant >= square * least
    covered = inside & clear & (w >= low)
    return covered | ((slack > 0.0) & (w >= low))


@njit(inline="always")
def _passes(sight, x, y, z, nx, ny, nz, tx, ty, tz, ux, uy, uz, height, cx, cy, cz):  # type: ignore[no-untyped-def]
    """Whether the line of sight to c passes through the paper at (x, y, z), above which the camera is by `height`."""
    side = nx * cx + ny * cy + nz * cz + height
    share = height / (height - side)
    qx, qy, qz = share * cx - x, share * cy - y, share * cz - z
    crosses = ((height > 0.0) & (side < -TOLERANCE)) | ((height < 0.0) & (side > TOLERANCE))
    within = (abs(tx * qx + ty * qy + tz * qz) <= sight.plate) & (abs(ux * qx + uy * qy + uz * qz) <= sight.plate)
    return crosses & within


@njit(inline="always")
def _hides(sight, ax, ay, az, nx, ny, nz, tx, ty, tz, ux, uy, uz, bx, by, bz, rx, ry, rz, sx, sy, sz):  # type: ignore[no-untyped-def]
    """Whether plate A hides the centre or a corner of B, whose right and up, half an edge long, are r and s."""
    h = -(nx * ax + ny * ay + nz * az)
    hides = _passes(sight, ax, ay, az, nx, ny, nz, tx, ty, tz, ux, uy, uz, h, bx, by, bz)
    px, py, pz, mx, my, mz = rx + sx, ry + sy, rz + sz, rx - sx, ry - sy, rz - sz
    hides |= _passes(sight, ax, ay, az, nx, ny, nz, tx, ty, tz, ux, uy, uz, h, bx + px, by + py, bz + pz)
    hides |= _passes(sight, ax, ay, az, nx, ny, nz, tx, ty, tz, ux, uy, uz, h, bx - px, by - py, bz - pz)
    hides |= _passes(sight, ax, ay, az, nx, ny, nz, tx, ty, tz, ux, uy, uz, h, bx + mx, by + my, bz + mz)
    hides |= _passes(sight, ax, ay, az, nx, ny, nz, tx, ty, tz, ux, uy, uz, h, bx - mx, by - my, bz - mz)
    return hides


@hide.register(FiducialSight)
def _hide(sight, ax, ay, az, a, bx, by, bz, b, ux, uy, uz, vx, vy, vz):  # type: ignore[no-untyped-def]
    px, py, pz, qx, qy, qz = _upright(ux, uy, uz, sight.level)
    rx, ry, rz, sx, sy, sz = _upright(vx, vy, vz, sight.level)
    h = sight.half
    one = _hides(
        sight, ax, ay, az, ux, uy, uz, px, py, pz, qx, qy, qz,
        bx, by, bz, h * rx, h * ry, h * rz, h * sx, h * sy, h * sz,
    )  # fmt: skip
    two = _hides(
        sight, bx, by, bz, vx, vy, vz, rx, ry, rz, sx, sy, sz,
        ax, ay, az, h * px, h * py, h * pz, h * qx, h * qy, h * qz,
    )  # fmt: skip
    return one, two


@kernel
def _may_hide(low, high, landmarks, normals, half, level):  # type: ignore[no-untyped-def]
    """False only if all cameras are in front of all plates, and no corner is behind another plate; see `among`."""
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
                tx, ty, tz, ux, uy, uz = _upright(normals[b, 0, k], normals[b, 1, k], normals[b, 2, k], level)
                side = nx * (landmarks[b, 0, k] - x) + ny * (landmarks[b, 1, k] - y) + nz * (landmarks[b, 2, k] - z)
                side -= half * (abs(nx * tx + ny * ty + nz * tz) + abs(nx * ux + ny * uy + nz * uz))
                if side < -0.1 * TOLERANCE:
                    return True
    return False
