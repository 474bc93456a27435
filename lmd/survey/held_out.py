"""A survey on frames that it was not made from: what is left of the corners, and what the map is worth to a pose."""

from dataclasses import dataclass, replace

import numpy as np
from threadpoolctl import threadpool_limits

from lmd.core.checks import FloatArray
from lmd.geometry.se3 import exp
from lmd.survey.adjustment import LEAST_DAMPING
from lmd.survey.estimate import ONE_THREAD, Estimate, adjusted
from lmd.survey.linked import telling
from lmd.survey.residuals import Poses, errors_at, gathered, linearise, summing
from lmd.survey.sightings import Sightings
from lmd.survey.student import solved, weight_of

HELD_OUT_STEP = 5  # one frame of so many is held out
FEWEST_FRAMES = 10  # of the map; with fewer, those that are left would say too little
RESECTION_STEPS = 10  # steps of Gauss and Newton for frames alone


@dataclass(frozen=True)
class Localised:
    """Frames that were localised by a map.

    Args:
        errors: root mean square reprojection errors of the sightings in them, pixels, `(n,)`.
        shifts: from where the whole survey puts each frame to where the map does, metres, `(M,)`.
    """

    errors: FloatArray
    shifts: FloatArray


def held_out(found: Estimate, plan: FloatArray | None = None) -> dict[str, Localised]:
    """Hold every fifth frame out, and localise it by the map made from the other frames, and by the plan.

    Args:
        found: made from all frames.
        plan: where each tag should hang, `(K, 4, 4)`, NaN where none is planned; None without a plan.

    Returns:
        by `measured` and `planned`; nothing if there are too few frames.
    """
    if len(found.frames) < FEWEST_FRAMES:
        return {}
    out = np.isin(found.sightings.frame, found.frames[HELD_OUT_STEP // 2 :: HELD_OUT_STEP])
    others = found.sightings.of(~out)
    with threadpool_limits(limits=ONE_THREAD):
        rest = adjusted(others, found.prior, found.poses, found.group, found.floor, found.inflation)
        seen = np.isin(np.arange(len(found.group)), others.tag[rest.used])
        maps = {"measured": np.where(seen[:, None, None], rest.poses.tags, np.nan)}
        if plan is not None:
            maps["planned"] = plan
        return {name: found_by for name, tags in maps.items() if (found_by := _localised(found, tags, out)) is not None}


def _localised(found: Estimate, tags: FloatArray, out: np.ndarray) -> Localised | None:
    """The frames of the sightings `out` by a map; None if it has too few of their tags."""
    known = out & found.used & np.isfinite(tags[found.sightings.tag, 0, 0])
    some = found.sightings.of(telling(found.sightings, known, None))
    if not len(some):
        return None
    frames = _resected(some, replace(found.poses, tags=tags), found.floor)
    there = np.unique(some.frame)
    errors = errors_at(some, replace(found.poses, tags=tags, frames=frames))
    away = frames[there, :3, 3] - found.poses.frames[there, :3, 3]
    return Localised(np.sqrt(errors / 4.0), np.linalg.norm(away, axis=1))


def _resected(sightings: Sightings, poses: Poses, floor: float) -> FloatArray:
    """The frames with everything else fixed, `(F, 4, 4)`, from where `poses` has them."""
    frames = poses.frames
    seen, of = np.unique(sightings.frame, return_inverse=True)
    summed = summing(of, len(seen))
    for _ in range(RESECTION_STEPS):
        at = linearise(sightings, *gathered(sightings, replace(poses, frames=frames)))
        variance = sightings.noise**2 + floor**2
        weight = weight_of((at.error**2).sum(axis=1) / variance) / variance
        turned = np.swapaxes(at.by_frame, 1, 2) * weight[:, None, None]
        matrix = summed(turned @ at.by_frame) + LEAST_DAMPING * np.eye(6)
        right = summed((turned @ at.error[..., None])[..., 0])
        frames = frames.copy()
        frames[seen] = frames[seen] @ exp(-solved(matrix, right))
    return frames
