"""Turns of tags beside their plan: centres and normals say where the world is, and only then are ups compared.

Corners may be numbered from another one than the tag's top left: OpenCV begins at the bottom right of an AprilTag. Then
each tag seems to hang upside down, and its pose is wrong by half a turn about its normal. A centre and a normal are the
same in any order. So the map is laid on the plan by these alone. A tag that then differs from its plan by a quarter or
by half a turn is turned, or its corners are in another order.
"""

from dataclasses import dataclass, replace

import numpy as np

from lmd.core.checks import BoolArray, FloatArray, IntArray
from lmd.geometry.se3 import inverse, pose_of
from lmd.survey.residuals import Poses, Prior, errors_at
from lmd.survey.sightings import QUARTERS, Sightings
from lmd.survey.start import agreeing

# A normal counts as a point so far off the centre, metres.
ARM = 0.1
# Points whose squares about their line sum up to less, square metres, fix no turn.
NO_TURN = 0.05**2
# How far centres and normals are off where they begin to count less, metres and rad.
PLACE_SCALE, NORMAL_SCALE = 0.05, 0.2
# So many pairs of tags are tried.
PAIRS = 600
REFINING_STEPS = 8
# A tag is at its place, metres, faces as planned, and is turned by quarters, rad; so many tags of a group must be.
NEAR, FACING, IN_QUARTERS, LEAST_SHARE = 0.3, 0.5, 0.35, 0.5


def by_places(here: FloatArray, there: FloatArray) -> FloatArray | None:
    """The motion `(4, 4)` that brings centres and normals of tags nearest to others; None if these fix no turn.

    Pairs of tags propose motions. That with which most tags fit is improved by all.

    Args:
        here, there: poses of the same tags, `(K, 4, 4)`.
    """
    points, others = _points(here), _points(there)
    one, other = np.triu_indices(len(here), 1)
    some = np.unique(np.linspace(0, len(one) - 1, PAIRS).astype(np.int64)) if len(one) else one
    pairs = np.stack([one[some], other[some]], axis=1)
    turns, ways, fixed = _fitted(points[pairs].reshape(-1, 4, 3), others[pairs].reshape(-1, 4, 3), np.ones((1, 4)))
    if not fixed.any():
        return None
    motions = pose_of(turns[fixed], ways[fixed])
    best: FloatArray = motions[int(np.argmin([np.log1p(_squares(motion @ here, there)).sum() for motion in motions]))]
    for _ in range(REFINING_STEPS):
        weights = np.repeat(1.0 / (1.0 + _squares(best @ here, there)), 2)[None]
        turns, ways, fixed = _fitted(points.reshape(1, -1, 3), others.reshape(1, -1, 3), weights)
        if not fixed[0]:
            break
        best = pose_of(turns[0], ways[0])
    return best


def _points(tags: FloatArray) -> FloatArray:
    """The centre of each tag and a point before it, `(K, 2, 3)`."""
    return np.stack([tags[:, :3, 3], tags[:, :3, 3] + ARM * tags[:, :3, 2]], axis=1)


def _squares(here: FloatArray, there: FloatArray) -> FloatArray:
    """Squared distances of centres and normals, in units of their scales, `(K,)`."""
    away = np.linalg.norm(here[:, :3, 3] - there[:, :3, 3], axis=1) / PLACE_SCALE
    return np.asarray(away**2 + (_between_normals(here, there) / NORMAL_SCALE) ** 2)


def _between_normals(here: FloatArray, there: FloatArray) -> FloatArray:
    return np.asarray(np.arccos(np.clip((here[:, :3, 2] * there[:, :3, 2]).sum(axis=1), -1.0, 1.0)))


def _fitted(points: FloatArray, others: FloatArray, weights: FloatArray) -> tuple[FloatArray, FloatArray, BoolArray]:
    """Turns `(n, 3, 3)`, ways `(n, 3)` from points `(n, m, 3)` to others by least squares, and which these fix."""
    share = weights / weights.sum(axis=1, keepdims=True)
    middles = [(share[..., None] * each).sum(axis=1, keepdims=True) for each in (points, others)]
    away, towards = points - middles[0], others - middles[1]
    left, spread, right = np.linalg.svd(np.swapaxes(weights[..., None] * away, 1, 2) @ towards)
    right[:, 2] *= np.sign(np.linalg.det(left @ right))[:, None]
    turns = np.swapaxes(left @ right, 1, 2)
    ways = middles[1][:, 0] - (turns @ middles[0][:, 0, :, None])[..., 0]
    return turns, ways, spread[:, 1] > NO_TURN


@dataclass(frozen=True)
class Turns:
    """Turns of the tags of a survey, in quarters, clockwise as one looks at them, `(K,)` each.

    Args:
        renumbered: those by which the corners of its detections are renumbered.
        hung: those by which each hangs turned beside its plan; 0 where that is not known.
        on_sheets: likewise beside its sheet.
    """

    renumbered: IntArray
    hung: IntArray
    on_sheets: IntArray

    @classmethod
    def none(cls, count: int) -> "Turns":
        """None of so many tags is turned."""
        return cls(*np.zeros((3, count), dtype=np.int64))

    def __bool__(self) -> bool:
        return any(turned.any() for turned in (self.renumbered, self.hung, self.on_sheets))

    def __add__(self, other: "Turns") -> "Turns":
        """These, and what is found beside what was made of them."""
        names = ("renumbered", "hung", "on_sheets")
        return Turns(*((getattr(self, name) + getattr(other, name)) % 4 for name in names))

    def planned(self, prior: Prior) -> Prior:
        """A prior for tags as they hang."""
        sheets = prior.sheets
        if sheets is not None:
            sheets = replace(sheets, poses=sheets.poses @ QUARTERS[self.on_sheets[sheets.tag]])
        return replace(prior, tags=prior.tags @ QUARTERS[self.hung], sheets=sheets)


def as_seen(sightings: Sightings, poses: Poses) -> Poses:
    """The same with those tags turned whose sightings only agree if they are turned by quarters."""
    turned = [replace(poses, tags=poses.tags @ quarter) for quarter in QUARTERS]
    agree = [agreeing(sightings, errors_at(sightings, each)) for each in turned]
    counts = [np.bincount(sightings.tag, each, minlength=len(poses.tags)) for each in agree]
    return replace(poses, tags=poses.tags @ QUARTERS[np.argmax(counts, axis=0)])


def turns_of(poses: Poses, group: IntArray, prior: Prior, in_order: bool) -> Turns:
    """Turns of tags beside what the prior has of them.

    Where most are turned alike, that is the order of the corners, unless it is known. Those that are exactly known are
    where and as they are known to be.

    Args:
        poses: rough ones of tags.
        group: of each tag, see `lmd.survey.estimate.Estimate`.
        prior: what is known.
        in_order: whether the corners are known to begin at the top left.
    """
    known = prior.information[:, :3].any(axis=1) & (group >= 0)
    seen = _beside(poses.tags, prior.tags, np.where(known, group, -1))
    if (lost := prior.exact & (seen < 0)).any():  # because the plan of the others is another one
        seen = np.where(lost, _beside(poses.tags, prior.tags, np.where(known & prior.exact, group, -1)), seen)
    on_sheets = np.full(len(group), -1)
    if (sheets := prior.sheets) is not None:
        own = np.where(group[sheets.tag] >= 0, sheets.board * (group.max() + 1) + group[sheets.tag], -1)
        on_sheets[sheets.tag] = _beside(poses.tags[sheets.tag], sheets.poses, own)
    either = np.where(seen < 0, on_sheets, seen)
    counts = np.bincount(either[either >= 0], minlength=4)
    renumbered = np.zeros_like(seen)
    if not in_order and 2 * counts.max() > counts.sum():
        renumbered[:] = np.argmax(counts)
    exact = prior.exact & (seen >= 0)
    renumbered[exact] = seen[exact]
    hung, hung_on_sheets = (np.where(turned < 0, 0, (turned - renumbered) % 4) for turned in (seen, on_sheets))
    return Turns(renumbered, hung, hung_on_sheets)


def _beside(tags: FloatArray, planned: FloatArray, group: IntArray) -> IntArray:
    """Quarters by which tags `(K, 4, 4)` are turned beside where they are planned, in groups `(K,)`; -1 for unknown."""
    turned = np.full(len(group), -1)
    for g in np.unique(group[group >= 0]):
        own = np.flatnonzero(group == g)
        here, there = tags[own], planned[own]
        motion = by_places(here, there)
        if motion is None:
            continue
        between = inverse(there) @ motion @ here
        near = np.linalg.norm(between[:, :3, 3], axis=1) < NEAR
        if near.sum() < 2 or near.mean() < LEAST_SHARE:
            continue
        angle = np.arctan2(between[:, 1, 0] - between[:, 0, 1], between[:, 0, 0] + between[:, 1, 1])
        quarters = np.round(-2.0 * angle / np.pi).astype(np.int64)
        whole = near & (_between_normals(motion @ here, there) < FACING)
        whole &= np.abs(angle + quarters * np.pi / 2.0) < IN_QUARTERS
        turned[own[whole]] = quarters[whole] % 4
    return turned
