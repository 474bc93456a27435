"""Tags that were moved since the map was made, and new tags.

*Moved tags* are found by a bundle adjustment with the map as the prior. Subscripts select the rows and columns of tags.
Let u be the twists of the tags from their poses in the map to their estimated poses. The posterior covariance of u is
P, and the prior covariance is S. The *trusted* tags r, which were not moved, have the prior N(0, S_rr) with the
information matrix J = S_rr^-1. The pose of each tag in the map is compared with its pose according to the images and
all other trusted tags.

- If a trusted tag k was moved by the twist t, its prior holds for u_k - t. The information matrix of t is Q_kk with
  Q = J - J P_rr J, and t = Q_kk^-1 (J u)_k with the covariance Q_kk^-1.
- For a tag k of the map that is not trusted, the trusted tags predict the twist A u_r with A = S_kr J. So
  t = u_k - A u_r, with the covariance of u_k - A u_r under P, plus S_kk - A S_rk.

If a tag was not moved, t^T cov(t)^-1 t has the chi^2 distribution with six degrees of freedom. Moved tags lose their
prior, in the order of decreasing chi^2, until no other tag exceeds the threshold.
"""

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from lmd.adjust.candidates import placed_tags
from lmd.adjust.estimate import Estimate, inflation
from lmd.adjust.faults import FEWEST_SIGHTINGS, LEAST_SHARE, with_sizes
from lmd.adjust.gauge import rows_of, twists_between, worst_sigmas
from lmd.adjust.prior import Mounts
from lmd.adjust.refinement import nuisances_off, refine
from lmd.core.checks import BoolArray, FloatArray
from lmd.geometry.se3 import angle_between
from lmd.localise.fixed_map import FixedMap

# Minimum chi^2, with six degrees of freedom, of a moved tag; normal errors exceed it with probability 1e-3.
MOVED_CHI_SQUARE = 22.46
OFF_M, OFF_RAD = 0.001, 0.02  # least shift, metres, or rotation, rad, of a tag that was moved
SIZE_ROUNDS = 2  # number of rounds in which sizes are estimated
MOST_ROUNDS = 12  # maximum number of rounds in which tags are found
NEXT = 0.5  # tags with at least this share of the largest chi^2 lose their prior together
MOST_MOVED = 0.25  # maximum share of moved tags among the compared tags
UNKNOWN_M = 0.5  # a tag is compared only if its position relative to the other tags is known better, metres
MOST_VARIANCE = 1.0  # a tag is not compared if a variance of its displacement, rad^2 or m^2, exceeds this


class Change(NamedTuple):
    """Change of a map: a tag that was moved, or a new tag."""

    tag: int
    """Id of the tag."""
    kind: str
    """`moved` or `new`."""
    images: int
    """Number of images that show the tag."""
    pose: FloatArray
    """`(4, 4)` present pose, tag to map."""
    covariance: FloatArray
    """`(6, 6)` covariance of the twist of the pose, X -> X exp(twist), rad and metres."""
    before: FloatArray
    """`(4, 4)` pose in the map; NaN for a new tag."""
    chi_square: float = np.nan
    """chi^2 of the difference between the present pose and the pose in the map; NaN for a new tag."""

    @property
    def shift(self) -> FloatArray:
        """Shift of the tag from its position in the map, along the axes of its pose in the map, metres, `(3,)`."""
        return np.asarray(self.before[:3, :3].T @ (self.pose - self.before)[:3, 3])

    @property
    def radians(self) -> float:
        """Rotation from the orientation in the map, rad."""
        return float(angle_between(self.pose, self.before))


class Comparison(NamedTuple):
    """Result of the comparison of an estimate with a map of K tags."""

    found: Estimate
    """Estimate of all poses."""
    moved: BoolArray
    """Mask of the tags that were moved, `(K,)`."""
    squares: FloatArray
    """chi^2 of the displacement of each tag, `(K,)`; NaN for tags whose pose in the map cannot be compared with the
    other tags.
    """
    odd: BoolArray
    """Mask of the tags whose size differs from the stated size, `(K,)`."""
    contradicted: int = 0
    """Number of tags that differ from the map, if above the fraction `MOST_MOVED` of the compared tags; else 0. Above
    this fraction the map and the images disagree as a whole, and no tag counts as moved.
    """

    def changes(self, here: FixedMap) -> list[Change]:
        """List the tags that were moved relative to the map `here`, followed by the new tags."""
        found, counts = self.found, self.found.sightings.counts(self.found.used)
        poses, covariances, squares = found.poses.tags, found.covariances, self.squares.tolist()
        return [
            Change(int(here.ids[k]), kind, int(counts[k]), poses[k], covariances[k], here.poses[k], squares[k])
            for kind, which in (("moved", self.moved), ("new", ~here.has))
            for k in np.flatnonzero(which & found.known & (counts > 0)).tolist()
        ]


def displacements(found: Estimate, here: FixedMap) -> tuple[FloatArray, FloatArray]:
    """Twist by which each tag is displaced from its pose in the map, `(K, 6)`, and the twist's covariance, `(K, 6, 6)`.
    The twist is NaN if the tag's pose in the map cannot be compared with other tags.
    """
    there, *_ = found.adjustment.joint_step(found.poses, found.floor, 0.0, nuisances_off(found))
    twists, count = twists_between(here.poses, there.tags), len(here.ids)
    values, covariances = np.full((count, 6), np.nan), np.full((count, 6, 6), np.nan)
    tags, joint, posterior = np.flatnonzero(found.prior.known), found.prior.joint, found.covariance
    trusted = rows_of(tags)
    assert joint is not None
    information, own = joint[np.ix_(trusted, trusted)], posterior[np.ix_(trusted, trusted)]
    remaining, force = information - information @ own @ information, information @ twists[tags].ravel()
    for k in np.flatnonzero(here.has & found.known & (found.sightings.counts(found.used) > 0)).tolist():
        if k in tags:
            place = slice(6 * (first := int(np.searchsorted(tags, k))), 6 * first + 6)
            square = (remaining[place, place] + remaining[place, place].T) / 2.0
            if np.linalg.eigvalsh(square)[0] > 1.0 / MOST_VARIANCE:
                covariances[k] = np.linalg.inv(square)
                values[k] = covariances[k] @ force[place]
            continue
        rows = np.arange(6 * k, 6 * k + 6)
        gain = here.joint[np.ix_(rows, trusted)] @ information
        both, index = np.hstack([np.eye(6), -gain]), np.concatenate([rows, trusted])
        spread = both @ posterior[np.ix_(index, index)] @ both.T
        spread += here.joint[np.ix_(rows, rows)] - gain @ here.joint[np.ix_(trusted, rows)]
        if np.linalg.eigvalsh(spread)[-1] < MOST_VARIANCE:
            covariances[k], values[k] = spread, twists[k] - gain @ twists[tags].ravel()
    values[worst_sigmas(covariances)[:, 0] > UNKNOWN_M] = np.nan
    return values, covariances


def compare(begun: Estimate, here: FixedMap, mounts: Mounts | None, gross: BoolArray, odd: BoolArray) -> Comparison:
    """Estimate all poses with the map as the prior, and find the tags that were moved. Moved tags lose their prior. The
    cameras are refined at the end.

    Args:
        begun: estimate with rough poses; if its `lenses` are not None, cameras are refined.
        here: map of the tags.
        mounts: prior of the poses of the cameras on the body.
        gross: mask of the tags that contradict the other tags, `(K,)`; these tags have no prior at first.
        odd: mask of the tags whose stated size is known to be wrong, `(K,)`.
    """
    now, moved, squares, is_refined = begun, gross, np.full(len(gross), np.nan), begun.lenses is None
    for number in range(MOST_ROUNDS):
        now = replace(now, prior=here.prior(moved, mounts)).adjusted()
        if not now.used.any():
            return Comparison(now, np.zeros_like(moved), squares, odd)
        if number < SIZE_ROUNDS:
            lost = now.group < 0
            tried = bool((odd | lost | now.are_astray).any())
            now, odd = with_sizes(now, odd | (lost & here.has), np.nan, tried)
        if number == 0:
            now = replace(now, inflation=inflation(now))
        astray = (here.has & ~moved & now.are_astray)[now.sightings.tag]
        tags = placed_tags(now.sightings.of(now.misfits & astray), now.poses, FEWEST_SIGHTINGS, LEAST_SHARE)
        if (elsewhere := np.isfinite(tags[:, 0, 0])).any():
            moved, now = moved | elsewhere, now.with_tags(elsewhere, tags[elsewhere])
            continue
        values, covariances = displacements(now, here)
        squares = np.array([t @ np.linalg.solve(c, t) for t, c in zip(values, covariances, strict=True)])
        turn, shift = np.linalg.norm(values.reshape(-1, 2, 3), axis=2).T
        off = np.nan_to_num(np.where((shift > OFF_M) | (turn > OFF_RAD), squares, 0.0))
        stays = moved & (off < MOVED_CHI_SQUARE) & np.isfinite(squares)
        fresh = ~moved & (off > MOVED_CHI_SQUARE) & (off >= NEXT * off[~moved].max(initial=0.0))
        if fresh.any() or stays.any():
            moved = (moved & ~stays) | fresh
        elif is_refined:
            break
        else:
            now, is_refined = refine(now), True
    if moved.sum() <= max(MOST_MOVED * np.isfinite(squares).sum(), FEWEST_SIGHTINGS):
        return Comparison(now, moved, squares, odd)
    none = np.zeros_like(moved)
    now = replace(begun, prior=here.prior(none, mounts)).adjusted()
    return Comparison(now if now.lenses is None else refine(now), none, squares, odd, int(moved.sum()))
