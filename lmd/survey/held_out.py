"""Held-out frames: frames that are localised by a map from the other frames."""

from dataclasses import dataclass, replace

import numpy as np
from threadpoolctl import threadpool_limits

from lmd.adjust.corners import resected, squared_errors
from lmd.adjust.estimate import FEWEST_FRAMES, ONE_THREAD, Estimate, adjust, constraining
from lmd.core.checks import BoolArray, FloatArray

HELD_OUT_STEP = 5  # every fifth frame is held out


@dataclass(frozen=True)
class HeldOut:
    """Held-out frames, localised by a map."""

    errors: FloatArray
    """`(n,)` RMS reprojection errors of the sightings in held-out frames, pixels."""
    shifts: FloatArray
    """`(M,)` distance of each frame from its place in the whole survey, metres."""


def hold_out(found: Estimate, plan: FloatArray | None = None) -> dict[str, HeldOut]:
    """Hold every fifth frame out, and localise it once by the map made from the other frames and once by the plan.

    Args:
        found: estimate from all frames.
        plan: planned poses of tags, `(K, 4, 4)`, NaN if not planned; None without a plan.

    Returns:
        results by `measured` and `planned`; empty if there are too few frames.
    """
    if len(found.frames) < FEWEST_FRAMES:
        return {}
    out = np.isin(found.sightings.frame, found.frames[HELD_OUT_STEP // 2 :: HELD_OUT_STEP])
    with threadpool_limits(limits=ONE_THREAD):
        others = found.sightings.of(~out)
        rest = adjust(others, found.prior, found.poses, found.group, found.floor, found.inflation)
        maps = {"measured": np.where((others.counts(rest.used) > 0)[:, None, None], rest.poses.tags, np.nan)}
        if plan is not None:
            maps["planned"] = plan
        return {name: held for name, tags in maps.items() if (held := _localised(found, tags, out)) is not None}


def _localised(found: Estimate, tags: FloatArray, out: BoolArray) -> HeldOut | None:
    """Localise the frames of the sightings `out` by tags `(K, 4, 4)`; None if there are too few tags."""
    known = out & found.used & np.isfinite(tags[found.sightings.tag, 0, 0])
    some = found.sightings.of(constraining(found.sightings, known))
    if not len(some):
        return None
    poses = resected(some, replace(found.poses, tags=tags), found.floor)
    there = np.unique(some.frame)
    away = poses.frames[there, :3, 3] - found.poses.frames[there, :3, 3]
    return HeldOut(np.sqrt(squared_errors(some, poses) / 4.0), np.linalg.norm(away, axis=1))
