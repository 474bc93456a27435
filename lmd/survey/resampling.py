"""Errors of a map from parts of its own data: held-out frames, and blocks of time.

*Held-out frames*: frames are localised by a map that is made from the other frames.

*Blocks of time*: the covariance C of an adjustment assumes that errors of sightings are independent. The errors in a
drive are correlated, as exposure, blur and errors of the lens model change slowly. So frames are cut into blocks of
time with equally many sightings. Block b adds S_b to the normal equations S = C^-1, and g_b to their right side, which
sums to 0. Block b contributes x_b = C (1 - S_b C)^-1/2 g_b to the error of the map. The covariance of the map is the
sum of x_b x_b', which equals C if errors are uncorrelated. The inverse instead of the inverse root would be the
jackknife, which leaves each block out; it overrates blocks that alone hold a part of the map.

Source: Bell and McCaffrey, "Bias reduction in standard errors for linear regression with multi-stage samples" (CR2).
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from threadpoolctl import threadpool_limits

from lmd.core.checks import BoolArray, FloatArray, IntArray
from lmd.geometry.se3 import exp
from lmd.survey.adjustment import Adjustment
from lmd.survey.gauge import gauge_free
from lmd.survey.linked_adjustment import constraining
from lmd.survey.map_estimate import ONE_THREAD, Estimate, adjust
from lmd.survey.prior import EXACT_SIGMA
from lmd.survey.residuals import Poses, Reprojection, normal_equations, solved, squared_errors, student_weight, sums_by
from lmd.survey.schur import LEAST_DAMPING
from lmd.survey.sightings import Sightings

FEWEST_FRAMES = 10  # minimum number of frames of a map for held-out frames and for blocks of time
HELD_OUT_STEP = 5  # every fifth frame is held out
RESECTION_STEPS = 10  # Gauss-Newton steps of resection
FEWEST_BLOCKS, MOST_BLOCKS = 5, 8
FEWEST_IN_BLOCK = 3  # minimum number of frames of a block, unless there would be too few blocks
ALONE = 0.98  # a block with a larger share of the information in a direction holds that direction alone
LEAST_RATIO = 1e-2  # minimum ratio of squared errors of a tag to its variance
LEAST_PART = 1e-9  # minimum eigenvalue of a block's information, relative to the largest


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
    some = found.sightings.of(constraining(found.sightings, known, None))
    if not len(some):
        return None
    poses = _resected(some, replace(found.poses, tags=tags), found.floor)
    there = np.unique(some.frame)
    away = poses.frames[there, :3, 3] - found.poses.frames[there, :3, 3]
    return HeldOut(np.sqrt(squared_errors(some, poses) / 4.0), np.linalg.norm(away, axis=1))


def _resected(sightings: Sightings, poses: Poses, floor: float) -> Poses:
    """Poses with refined frames, while tags and mounts are fixed (resection)."""
    seen, owner = np.unique(sightings.frame, return_inverse=True)
    summed, variance = sums_by(owner, len(seen)), sightings.variance(floor)
    for _ in range(RESECTION_STEPS):
        at = Reprojection(sightings, *poses.of(sightings))
        weight = student_weight(at.squared / variance) / variance
        matrix, right = normal_equations(at.by_frame, at.error, weight, summed)
        frames = poses.frames.copy()
        frames[seen] = frames[seen] @ exp(-solved(matrix + LEAST_DAMPING * np.eye(6), right))
        poses = replace(poses, frames=frames)
    return poses


def blocks_of_time(found: Estimate) -> list[IntArray]:
    """Frames of each block of time, in ascending order."""
    counts = np.bincount(found.sightings.frame[found.used], minlength=found.sightings.frames)[found.frames]
    middle = np.cumsum(counts) - counts / 2.0
    blocks = int(np.clip(len(counts) // FEWEST_IN_BLOCK, FEWEST_BLOCKS, MOST_BLOCKS))
    block = (blocks * middle / counts.sum()).astype(int)
    return [found.frames[block == b] for b in range(blocks) if (block == b).any()]


def inflation(found: Estimate, report: Callable[[int, int], object]) -> float:
    """Factor on the standard deviations of places, from blocks of time: the geometric mean over tags, at least 1.

    The factor is 1 if there are too few frames for blocks. If frames are linked, only frames with two or more tags are
    used, in the largest part of the map that such frames connect.

    Args:
        found: estimate with an inflation of 1.
        report: called with the number of finished blocks, and the number of all blocks.
    """
    if found.prior.motion is not None:
        found = _without_links(found)
    if len(found.frames) < FEWEST_FRAMES:
        return 1.0
    with threadpool_limits(limits=ONE_THREAD):
        blocks = blocks_of_time(found)
        slope, spread = Adjustment(found.sightings.of(found.used), found.prior).efficiency(found.poses, found.floor)
        off: list[FloatArray] = []
        for frames in blocks:
            report(len(off), len(blocks))
            off.append(_off(found, frames, slope, spread))
    square = (np.stack(off) ** 2).sum(axis=(0, 2))
    stated = np.trace(found.gauge_free_covariances[found.known][:, 3:, 3:], axis1=1, axis2=2)
    known = stated > 0.0
    if not known.any():
        return 1.0
    ratio = np.maximum(square[known] / stated[known], LEAST_RATIO)
    return float(max(np.exp(np.log(ratio).mean() / 2.0), 1.0))


def _without_links(found: Estimate) -> Estimate:
    """Largest part of a map that images alone connect, as an estimate without links."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    some, count = found.sightings, len(found.group)
    used = constraining(some, found.used, None)
    ends = (some.tag[used], count + some.frame[used])
    whole = coo_array((np.ones(used.sum()), ends), shape=(count + some.frames,) * 2)
    _, part = connected_components(whole, directed=False)
    of_part = np.bincount(part[some.tag[used]], minlength=1)
    used = used & (part[some.tag] == of_part.argmax())
    information = found.prior.information.copy()
    if used.any() and not information[some.tag[used]].any():
        information[some.tag[used][0]] = EXACT_SIGMA**-2.0
    prior = replace(found.prior, motion=None, information=information)
    return replace(found, prior=prior, used=used, group=np.where(some.counts(used) > 0, found.group, -1))


def _off(found: Estimate, frames: IntArray, slope: float, spread: float) -> FloatArray:
    """Displacement x_b, by a block, of each known tag relative to the others, metres, `(n, 3)`.

    Args:
        found: estimate.
        frames: frames of the block.
        slope, spread: results of `Adjustment.efficiency` for all sightings.
    """
    used = found.sightings.of(found.used)
    some = used.of(np.isin(used.frame, frames))
    nothing = replace(found.prior, information=np.zeros_like(found.prior.information), sheets=None, joint=None)
    part = Adjustment(some, nothing, nuisances=True)
    own, *_ = part.schur_system(found.poses, found.floor, 0.0, slope**2 / spread)
    _, right, _ = part.schur_system(found.poses, found.floor, 0.0)
    own[6 * part.posed :, 6 * part.posed :] -= np.eye(len(own) - 6 * part.posed)  # the prior of nuisance parameters
    covariance = found.covariance
    rows = np.flatnonzero((np.diag(own) > 0.0) & np.isfinite(np.diag(covariance)))
    values, vectors = np.linalg.eigh(own[np.ix_(rows, rows)])
    there = values > LEAST_PART * values[-1]
    root = vectors[:, there] * np.sqrt(values[there])
    whitened = vectors[:, there].T @ right.ravel()[rows] * (slope / spread) / np.sqrt(values[there])
    share, turn = np.linalg.eigh(root.T @ covariance[np.ix_(rows, rows)] @ root)
    grown = np.where(share < ALONE, 1.0 / np.sqrt(np.clip(1.0 - share, 1.0 - ALONE, 1.0)), 0.0)
    tags = np.flatnonzero(np.repeat(found.known, 6))
    moved = covariance[np.ix_(tags, rows)] @ (root @ (turn @ (grown * (turn.T @ whitened))))
    return np.asarray((gauge_free(found.poses.tags[found.known]) @ moved).reshape(-1, 6)[:, 3:])
