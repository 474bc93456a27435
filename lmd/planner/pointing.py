"""Which place on a surface somebody points at."""

from typing import NamedTuple

import numpy as np

from lmd.core.checks import FloatArray
from lmd.space.surface import SurfaceArrays

EDGE_ON = 1e-6  # cosine of a surface that is looked at along its plane
ON_SURFACE_M = 1e-6  # metres beside a surface that still count as on it


class Place(NamedTuple):
    """A place on a surface: its index, and the coordinates there `(2,)`, metres."""

    surface: int
    at: FloatArray


def pointed_at(surfaces: SurfaceArrays, eye: FloatArray, way: FloatArray, own: int = -1) -> Place | None:
    """The first place where a ray meets the front of a surface.

    Surfaces are looked at from the front only, so that walls between the viewer and the room are no obstacle. A ray
    that meets none goes to the plane of the surface `own`, from whichever side: so a tag that is dragged beyond the
    edge of its wall, or seen from behind, stays on it.

    Args:
        surfaces: W of them, rectangles here: landmarks may hang in some places of them only.
        eye: where the ray begins, `(3,)`, world frame, metres.
        way: its direction, `(3,)`.
        own: index of a surface; -1 for none.

    Returns:
        None if the ray meets nothing, or its numbers are none.
    """
    every = np.arange(len(surfaces.normal))
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        towards = surfaces.normal @ way
        far = ((surfaces.origin - eye) * surfaces.normal).sum(axis=1) / towards
        is_met = (np.abs(towards) > EDGE_ON) & (far > 0.0)
        at = surfaces.coordinates(every, eye + np.where(is_met, far, 0.0)[:, None] * way)
    within = ((at >= -ON_SURFACE_M) & (at <= surfaces.extent + ON_SURFACE_M)).all(axis=1)
    front = is_met & within & (towards < 0.0)
    if front.any():
        first = int(np.argmin(np.where(front, far, np.inf)))
        return Place(first, at[first])
    return Place(own, at[own]) if own >= 0 and is_met[own] and np.isfinite(at[own]).all() else None
