"""Errors that are alike in time: by what factor the blocks of a drive disagree more than independent errors would.

The covariance C of an adjustment takes the errors of all sightings for independent. Those of a drive are not: what
changes slowly, such as exposure, blur and what the lens model lacks, is alike in images that follow each other. So the
frames are cut into blocks of time with equally many sightings. Block b adds S_b to the normal equations S = C^-1, and
g_b to their right side, which is 0 in sum. The map is off by the sum of x_b = C (1 - S_b C)^-1/2 g_b, whose squares add
up to its covariance: without correlations C is expected. With the root in place of the inverse, which would leave each
block out (the jackknife), blocks that alone hold a part of the map do not count as many times as they weigh.

Source: Bell and McCaffrey, "Bias reduction in standard errors for linear regression with multi-stage samples" (CR2).
"""

from dataclasses import replace

import numpy as np
from threadpoolctl import threadpool_limits

from lmd.core.checks import FloatArray, IntArray
from lmd.survey.adjustment import Adjustment
from lmd.survey.estimate import ONE_THREAD, Estimate
from lmd.survey.gauge import gauge_free
from lmd.survey.linked import telling
from lmd.survey.residuals import EXACT_SIGMA
from lmd.survey.stages import Observer, Stage, unobserved

FEWEST_BLOCKS, MOST_BLOCKS = 5, 8
FEWEST_IN_BLOCK = 3  # frames, where there are more than the fewest blocks
FEWEST_FRAMES = 10  # of a drive that is cut into blocks
ALONE = 0.98  # share of what is known in a direction from which on a block has it to itself
LEAST_RATIO = 1e-2  # of the squares of a tag that no block moves
LEAST_PART = 1e-9  # of the largest eigenvalue; what is less is none


def blocks_of_time(found: Estimate) -> list[IntArray]:
    """The frames of each block, in their order."""
    counts = np.bincount(found.sightings.frame[found.used], minlength=found.sightings.frames)[found.frames]
    middle = np.cumsum(counts) - counts / 2.0
    blocks = int(np.clip(len(counts) // FEWEST_IN_BLOCK, FEWEST_BLOCKS, MOST_BLOCKS))
    block = (blocks * middle / counts.sum()).astype(int)
    return [found.frames[block == b] for b in range(blocks) if (block == b).any()]


def inflation(found: Estimate, observer: Observer = unobserved) -> float:
    """The factor of standard deviations of places by blocks of time, the geometric mean of tags; 1 if it would be less.

    It is 1, too, if there are too few frames for blocks. Where frames are linked, those count that show two tags, as
    far as they connect all without links.

    Args:
        found: as if no errors were alike, with an inflation of 1.
        observer: told how many blocks are done.
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
            observer(Stage.COMPARING, len(off), len(blocks))
            off.append(_off(found, frames, slope, spread))
    square = (np.stack(off) ** 2).sum(axis=(0, 2))
    stated = np.trace(found.precisions[found.known][:, 3:, 3:], axis1=1, axis2=2)
    known = stated > 0.0
    if not known.any():
        return 1.0
    ratio = np.maximum(square[known] / stated[known], LEAST_RATIO)
    return float(max(np.exp(np.log(ratio).mean() / 2.0), 1.0))


def _without_links(found: Estimate) -> Estimate:
    """The largest part of a map that images connect, by themselves."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    some, count = found.sightings, len(found.group)
    used = telling(some, found.used, None)
    ends = (some.tag[used], count + some.frame[used])
    whole = coo_array((np.ones(used.sum()), ends), shape=(count + some.frames,) * 2)
    _, part = connected_components(whole, directed=False)
    of_part = np.bincount(part[some.tag[used]], minlength=1)
    used = used & (part[some.tag] == of_part.argmax())
    information = found.prior.information.copy()
    if used.any() and not information[some.tag[used]].any():
        information[some.tag[used][0]] = EXACT_SIGMA**-2.0
    prior = replace(found.prior, motion=None, information=information)
    group = np.where(np.bincount(some.tag[used], minlength=count) > 0, found.group, -1)
    return replace(found, prior=prior, used=used, group=group)


def _off(found: Estimate, frames: IntArray, slope: float, spread: float) -> FloatArray:
    """By how much the frames of a block move the place of each tag that is known, beside the others, `(n, 3)`, m.

    Args:
        frames: of the block.
        slope, spread: of the equations of all sightings, see `Adjustment.efficiency`.
    """
    used = found.sightings.of(found.used)
    some = used.of(np.isin(used.frame, frames))
    nothing = replace(found.prior, information=np.zeros_like(found.prior.information), sheets=None)
    part = Adjustment(some, nothing, nuisances=True)
    own, *_ = part.reduced(found.poses, found.floor, 0.0, slope**2 / spread)
    _, right, _ = part.reduced(found.poses, found.floor, 0.0)
    own[6 * part.placed :, 6 * part.placed :] -= np.eye(len(own) - 6 * part.placed)  # the prior of nuisances
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
