"""Tags that were moved since the map was made, and new tags: a bundle adjustment with the map as the prior.

Let u be the twists of the tags from the map, with the posterior covariance P. The *trusted* tags r, which were not
moved, have the prior N(0, S) with the information J = S_rr^-1. Each tag is compared with its pose by the images and by
all other trusted tags:

- If a trusted tag k was moved by t, its prior holds for u_k - t. The information on t is Q_kk with Q = J - J P J, and
  t = Q_kk^-1 (J u)_k with the covariance Q_kk^-1.
- The map expects another of its tags at A u_r beside the trusted tags, with A = S_kr J. So t = u_k - A u_r, with the
  covariance of u_k - A u_r under P, plus S_kk - A S_rk.

If a tag was not moved, t^T cov(t)^-1 t has the chi^2 distribution with six degrees of freedom. Tags that were moved
lose their prior, those with the largest chi^2 first, until no other tag exceeds the threshold.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from lmd.adjust.candidates import placed_tags
from lmd.adjust.corners import Poses
from lmd.adjust.estimate import FLOOR_PIXELS, Estimate, adjust, inflation
from lmd.adjust.gauge import rows_of
from lmd.adjust.mounts import Mounts
from lmd.adjust.prior import Prior
from lmd.adjust.refinement import Refined, refine
from lmd.adjust.second_places import FEWEST_SIGHTINGS, LEAST_SHARE, SecondPlace, second_places
from lmd.adjust.sightings import Observations
from lmd.adjust.sizes import other_sizes, with_sizes
from lmd.core.checks import BoolArray, FloatArray, IntArray
from lmd.geometry.se3 import angle_between, inverse, log
from lmd.localise.fixed_map import FixedMap, information_of

# Least chi^2, with six degrees of freedom, of a tag that was moved: normal errors exceed it once in a thousand times.
MOVED_CHI_SQUARE = 22.46
OFF_M, OFF_RAD = 0.001, 0.02  # least shift, metres, or rotation, rad, of a tag that was moved
SIZE_ROUNDS = 2  # number of rounds in which sizes are estimated
MOST_ROUNDS = 12  # maximum number of rounds in which tags are found
NEXT = 0.5  # tags with at least this share of the largest chi^2 are taken out together
MOST_MOVED = 0.25  # largest share of the compared tags that may have been moved
UNKNOWN_M = 0.5  # standard deviation of a place beside the other tags above which a tag is not compared, metres
MOST_VARIANCE = 1.0  # variance of a displacement, rad^2 or m^2, above which a tag is not compared


@dataclass(frozen=True)
class Displaced:
    """Pose of a tag that was moved, or of a new tag."""

    tag: int
    """Id."""
    pose: FloatArray
    """`(4, 4)` tag to map."""
    covariance: FloatArray
    """`(6, 6)` covariance of the right-hand twist of the pose, rad and metres."""
    sightings: int
    """Number of sightings that fit."""
    metres: float
    """Distance from the place in the map, metres; NaN for a new tag."""
    radians: float
    """Rotation from the orientation in the map; NaN for a new tag."""
    chi_square: float
    """chi^2 of the difference from the map; NaN for a new tag."""


@dataclass(frozen=True)
class Changes:
    """Changes of a map."""

    moved: tuple[Displaced, ...]
    """Tags of the map that were moved."""
    new: tuple[Displaced, ...]
    """Tags that the map lacks."""
    compared: IntArray
    """Ids of the tags of the map that the images could compare with the others."""
    inflation: float
    """Factor of the standard deviations of sightings, see `lmd.adjust.estimate.inflation`."""
    twice: tuple[SecondPlace, ...] = ()
    """Second poses of tags that hang elsewhere in some images; tags are indices of the ids of all sightings."""
    sizes: Mapping[int, float] = field(default_factory=dict)
    """Estimated edges of the tags with another edge than stated, metres, by id."""
    contradicted: int = 0
    """Number of tags that differ from the map, if these are more than the share `MOST_MOVED` of the compared tags. The
    map and the images then disagree as a whole, and no tag counts as moved.
    """


@dataclass(frozen=True)
class MapPrior:
    """Map as the prior of the K tags of some sightings."""

    tags: FloatArray
    """`(K, 4, 4)` poses in the map; NaN for tags that the map lacks."""
    covariance: FloatArray
    """`(6 K, 6 K)` covariance of their twists; 0 for tags that the map lacks."""
    mounts: Mounts | None
    """Mounts of the cameras; None for one camera."""

    @classmethod
    def of(cls, known: FixedMap, ids: IntArray, mounts: Mounts | None) -> "MapPrior":
        """Prior of the tags `ids` `(K,)`, ascending."""
        _, there, own = np.intersect1d(known.ids, ids, return_indices=True)
        tags, joint = np.full((len(ids), 4, 4), np.nan), np.zeros((6 * len(ids),) * 2)
        tags[own] = known.poses[there]
        joint[np.ix_(rows_of(own), rows_of(own))] = known.joint[np.ix_(rows_of(there), rows_of(there))]
        return cls(tags, joint, mounts)

    @property
    def sigmas(self) -> FloatArray:
        """Standard deviations of the tags, `(K, 6)`."""
        return np.sqrt(np.diag(self.covariance)).reshape(-1, 6)

    @property
    def begin(self) -> Poses:
        """Poses of the tags of the map and expected mounts, without frames."""
        mounts = np.eye(4)[None] if self.mounts is None else self.mounts.poses
        return Poses(self.tags, np.empty((0, 4, 4)), mounts)

    @property
    def in_map(self) -> BoolArray:
        """Mask of the tags of the map, `(K,)`."""
        return np.isfinite(self.tags[:, 0, 0])

    def prior(self, moved: BoolArray) -> Prior:
        """Prior of all unknowns without the tags that were `moved`, mask `(K,)`."""
        trusted = self.in_map & ~moved
        rows, joint = rows_of(np.flatnonzero(trusted)), np.zeros_like(self.covariance)
        joint[np.ix_(rows, rows)] = information_of(self.covariance[np.ix_(rows, rows)])
        tags = np.where(self.in_map[:, None, None], self.tags, np.eye(4))
        return Prior(tags, np.repeat(trusted[:, None], 6, axis=1).astype(float), None, self.mounts, joint=joint)

    def twists(self, now: Refined) -> FloatArray:
        """Twists of all tags from the map at the joint optimum of all unknowns, `(K, 6)`; NaN for unknown ones."""
        joint = now.found.adjustment
        there, *_ = joint.joint_step(now.found.poses, now.found.floor, 0.0, now.units)
        known, twists = self.in_map & np.isfinite(there.tags[:, 0, 0]), np.full((len(self.tags), 6), np.nan)
        twists[known] = log(inverse(self.tags[known]) @ there.tags[known])
        return twists

    def displacements(self, now: Refined) -> tuple[FloatArray, FloatArray]:
        """Displacement `(6,)` of each tag of the map, and its covariance `(6, 6)`, `(K, 6)` and `(K, 6, 6)`; NaN for
        tags that nothing else can be compared with.
        """
        found, count = now.found, len(self.tags)
        twists, values, covariances = self.twists(now), np.full((count, 6), np.nan), np.full((count, 6, 6), np.nan)
        tags = np.flatnonzero(found.prior.information.any(axis=1))
        trusted, joint = rows_of(tags), found.prior.joint
        assert joint is not None
        posterior, information = found.covariance, joint[np.ix_(trusted, trusted)]
        own = posterior[np.ix_(trusted, trusted)]
        remaining, force = information - information @ own @ information, information @ twists[tags].ravel()
        for k in np.flatnonzero(self.in_map & found.known & (found.sightings.counts(found.used) > 0)).tolist():
            rows = np.arange(6 * k, 6 * k + 6)
            if (at := np.flatnonzero(tags == k)).size:
                place = slice(6 * at[0], 6 * at[0] + 6)
                square = (remaining[place, place] + remaining[place, place].T) / 2.0
                if np.linalg.eigvalsh(square)[0] <= 1.0 / MOST_VARIANCE:
                    continue
                covariances[k] = np.linalg.inv(square)
                values[k] = covariances[k] @ force[place]
                continue
            gain = self.covariance[np.ix_(rows, trusted)] @ information
            both = np.hstack([np.eye(6), -gain])
            index = np.concatenate([rows, trusted])
            spread = both @ posterior[np.ix_(index, index)] @ both.T
            spread += self.covariance[np.ix_(rows, rows)] - gain @ self.covariance[np.ix_(trusted, rows)]
            if np.linalg.eigvalsh(spread)[-1] < MOST_VARIANCE:
                covariances[k], values[k] = spread, twists[k] - gain @ twists[tags].ravel()
        unknown = np.isfinite(values[:, 0])
        unknown[unknown] = np.linalg.eigvalsh(covariances[unknown][:, 3:, 3:])[:, -1] > UNKNOWN_M**2
        values[unknown] = np.nan
        return values, covariances


@dataclass(frozen=True)
class Comparison:
    """Estimate beside a map."""

    now: Refined
    """Estimate of all poses."""
    moved: BoolArray
    """Mask of the tags that were moved, `(K,)`."""
    squares: FloatArray
    """chi^2 of the displacement of each tag, `(K,)`; NaN for tags that could not be compared."""
    odd: BoolArray
    """Mask of the tags with another size than stated, `(K,)`."""
    contradicted: int = 0
    """See `Changes.contradicted`."""

    def changes(self, prior: MapPrior) -> Changes:
        """Changes of the map."""
        found = self.now.found
        is_placed = found.known & (found.sightings.counts(found.used) > 0)
        ids = found.sightings.ids[np.isfinite(self.squares)]
        stay = (prior.in_map & ~self.moved)[found.sightings.tag]
        twice = tuple(second_places(found, found.misfits & stay))
        moved, new = (
            tuple(self._displaced(prior, k) for k in np.flatnonzero(which & is_placed).tolist())
            for which in (self.moved, ~prior.in_map)
        )
        sizes = {int(found.sightings.ids[tag]): edge for tag, edge in other_sizes(found, self.odd).items()}
        return Changes(moved, new, ids, found.inflation, twice, sizes, self.contradicted)

    def _displaced(self, prior: MapPrior, k: int) -> Displaced:
        found = self.now.found
        pose, there = found.poses.tags[k], prior.tags[k]
        metres, radians = float(np.linalg.norm(pose[:3, 3] - there[:3, 3])), float(angle_between(pose, there))
        count, number = int(found.sightings.counts(found.used)[k]), int(found.sightings.ids[k])
        return Displaced(number, pose, found.covariances[k], count, metres, radians, float(self.squares[k]))


def _astray(found: Estimate, trusted: BoolArray) -> FloatArray | None:
    """Poses of the `trusted` tags, mask `(K,)`, of which most sightings are outliers and agree on another pose,
    `(K, 4, 4)`, NaN for other tags; None if there are none.
    """
    some, lost = found.sightings, trusted & found.are_astray
    if not lost.any():
        return None
    tags = placed_tags(some.of(found.misfits & lost[some.tag]), found.poses, FEWEST_SIGHTINGS, LEAST_SHARE)
    return tags if np.isfinite(tags).any() else None


def compare(
    seen: Observations, prior: MapPrior, begun: Estimate, gross: BoolArray, odd: BoolArray, calibrate: bool
) -> Comparison:
    """Estimate all poses with the map as the prior, without tags that were moved, and refine the cameras at last.

    Args:
        seen: detections of tags of the map and of other tags.
        prior: the map.
        begun: estimate with rough poses; its tags that have no pose are placed.
        gross: mask of the tags that contradict the others, `(K,)`.
        odd: mask of the tags that are known to have another size than stated, `(K,)`.
        calibrate: False if cameras are exact.
    """
    moved, squares = gross, np.full(len(gross), np.nan)
    tags = np.where(gross[:, None, None], np.nan, prior.tags)
    lost = np.isnan(tags[:, 0, 0])
    tags[lost] = placed_tags(begun.sightings.of(lost[begun.sightings.tag]), begun.poses, 2, 0.3)[lost]
    found = replace(begun, poses=replace(begun.poses, tags=tags), group=np.where(np.isnan(tags[:, 0, 0]), -1, 0))
    now = Refined.begin(found, seen) if calibrate else Refined.exact(found, seen)
    first, is_refined = now, not calibrate
    for number in range(MOST_ROUNDS):
        found = now.found
        found = adjust(found.sightings, prior.prior(moved), found.poses, found.group, FLOOR_PIXELS, found.inflation)
        if found.used.any() and number < SIZE_ROUNDS:
            lost = found.group < 0
            found, odd = with_sizes(
                found, odd | (lost & prior.in_map), np.nan, bool((odd | lost | found.are_astray).any())
            )
        now = replace(now, found=found)
        if not found.used.any():
            return Comparison(now, np.zeros_like(moved), squares, odd)
        if number == 0:
            now = replace(now, found=replace(found, inflation=inflation(found, lambda _done, _most: None)))
        if (astray := _astray(now.found, prior.in_map & ~moved)) is not None:
            lost = np.isfinite(astray[:, 0, 0])
            moved = moved | lost
            tags = np.where(lost[:, None, None], astray, now.found.poses.tags)
            now = replace(now, found=replace(now.found, poses=now.found.poses.with_tags(tags)))
            continue
        displacements, covariances = prior.displacements(now)
        squares = np.array([t @ np.linalg.solve(c, t) for t, c in zip(displacements, covariances, strict=True)])
        turn, shift = np.linalg.norm(displacements.reshape(-1, 2, 3), axis=2).T
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
    found = first.found
    found = adjust(found.sightings, prior.prior(np.zeros_like(moved)), found.poses, found.group, FLOOR_PIXELS)
    now = replace(first, found=found)
    now = refine(now) if calibrate else now
    return Comparison(now, np.zeros_like(moved), squares, odd, int(moved.sum()))
