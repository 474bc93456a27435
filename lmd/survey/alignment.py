"""From the world of a group of tags to the one that is known, and how tags are turned against what is known of them.

Places decide first, ups second. The corners of a tag begin at another one where its detector counts them otherwise
(OpenCV has the pictures of AprilTags turned by half a turn), or where the tag hangs on its side or upside down: then
its place is right and its up is not.
"""

from collections.abc import Iterator
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from lmd.core.checks import FloatArray, IntArray
from lmd.geometry.se3 import inverse, laid_over, pose_of
from lmd.survey.known import FEWEST_POINTS, NO_LINE
from lmd.survey.residuals import Prior
from lmd.survey.student import DEGREES_OF_FREEDOM

# Poses of tags are rough at first: their places are off by this share of how far apart tags are, their normals by rad.
ROUGH_SHARE, ROUGH_TILT = 0.02, 0.2
# What a turned tag costs beside places, as much as a place that is some standard deviations off.
TURNED_COST = 1.0
# A tag is turned by quarters if it is so near to one, rad, and its normal is known.
NEAR_QUARTER, FACING = 0.35, 0.7
ROUNDS = 5  # of fits to the tags that fit


def _quarters() -> FloatArray:
    """Turns about z by 0 to 3 quarters, counter-clockwise, `(4, 4, 4)`."""
    right = np.array([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
    out = np.broadcast_to([0.0, 0.0, 1.0], right.shape)
    return pose_of(np.stack([right, np.cross(out, right), out], axis=-1), np.zeros((4, 3)))


QUARTERS = _quarters()


class Alignment(NamedTuple):
    """How a group of tags lies in the known world."""

    motion: FloatArray
    """`(4, 4)` from the world of the group to the known one."""
    turns: IntArray
    """`(K,)` by how many quarters, counter-clockwise as one looks at it, each tag is turned against what is known."""


def aligned(tags: FloatArray, prior: Prior) -> Alignment | None:
    """How a group lies in the world of a prior; None if the prior does not fix that.

    Motions are proposed by the centres that are known, if there are three, and by each tag whose pose is known, turned
    by any quarter. The one is taken that brings most centres to where they are known to be, and of those that do
    equally well the one that leaves fewest tags turned.

    Args:
        tags: poses in the world of the group, `(K, 4, 4)`; NaN for tags of other groups.
        prior: what is known.
    """
    there = np.isfinite(tags[:, 0, 0])
    known = np.flatnonzero(prior.information.any(axis=1) & there)
    posed = prior.information[known, :3].any(axis=1)
    found, told = tags[known], prior.tags[known]
    best: tuple[float, FloatArray, IntArray] | None = None
    for motion in _proposed(found, told, posed):
        cost, turns = _judged(motion @ found, told, posed, prior.information[known])
        if best is None or cost < best[0]:
            best = cost, motion, turns
    if best is None:
        return None
    turns = np.zeros(len(tags), dtype=np.int64)
    turns[known] = best[2]
    own = best[2][posed]
    if len(own) > 1 and (own == own[0]).all():  # so it is how the detector counts
        turns[there] = own[0]
    return Alignment(best[1], turns)


def _proposed(found: FloatArray, told: FloatArray, posed: FloatArray) -> Iterator[FloatArray]:
    """Motions that may bring tags `found` to where they are `told` to be, `(n, 4, 4)` each."""
    fits = _fitted(found, told, np.ones(len(found), dtype=bool))
    if fits is not None:
        yield fits
    for k in np.flatnonzero(posed):
        for quarter in QUARTERS:
            motion = told[k] @ quarter @ inverse(found[k])
            yield motion
            for _ in range(ROUNDS):
                away = np.linalg.norm((motion @ found - told)[:, :3, 3], axis=1)
                fits = _fitted(found, told, away <= 3.0 * np.median(away))
                if fits is None:
                    break
                motion = fits
                yield motion


def _fitted(found: FloatArray, told: FloatArray, chosen: FloatArray) -> FloatArray | None:
    """The motion that brings the centres of chosen tags nearest to where they should be; None if they are in a line."""
    here, there = found[chosen, :3, 3], told[chosen, :3, 3]
    if len(here) < FEWEST_POINTS or np.linalg.svd(here - here.mean(axis=0), compute_uv=False)[1] < NO_LINE:
        return None
    return laid_over(here, there)


def _judged(found: FloatArray, told: FloatArray, posed: FloatArray, information: FloatArray) -> tuple[float, IntArray]:
    """How badly tags fit to where they are told to be, and the quarters by which they are turned there."""
    spread = np.sqrt(((told[:, :3, 3] - told[:, :3, 3].mean(axis=0)) ** 2).sum(axis=1).mean())
    away = ((found - told)[:, :3, 3] ** 2).sum(axis=1)
    places = away / (1.0 / information[:, 3:].min(axis=1) + max(ROUGH_SHARE * spread, 1e-9) ** 2)
    beside = np.swapaxes(told[:, :3, :3], 1, 2) @ found[:, :3, :3]
    tilts = np.arccos(np.clip(beside[:, 2, 2], -1.0, 1.0)) / ROUGH_TILT
    angles = np.arctan2(beside[:, 1, 0] - beside[:, 0, 1], beside[:, 0, 0] + beside[:, 1, 1])
    quarters = np.rint(angles / (np.pi / 2.0))
    sure = posed & (beside[:, 2, 2] > FACING) & (np.abs(angles - quarters * np.pi / 2.0) < NEAR_QUARTER)
    turns = np.where(sure, quarters % 4, 0).astype(np.int64)
    cost = np.log1p(places / DEGREES_OF_FREEDOM).sum() + np.log1p(tilts[posed] ** 2 / DEGREES_OF_FREEDOM).sum()
    return float(cost + TURNED_COST * np.count_nonzero(turns)), turns


def turned_as(prior: Prior, tags: FloatArray) -> Prior:
    """The prior with those tags of which only the centre is known turned as `tags` `(K, 4, 4)` are, if these are known.

    How a twist changes the way to a centre depends on how the tag is turned.
    """
    only = ~prior.information[:, :3].any(axis=1) & prior.information.any(axis=1) & np.isfinite(tags[:, 0, 0])
    poses = prior.tags.copy()
    poses[only, :3, :3] = tags[only, :3, :3]
    return replace(prior, tags=poses)
