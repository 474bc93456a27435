"""Tags that were moved since the map was made, and new tags: a bundle adjustment with the map as the prior.

Each tag is compared with its pose by the images and by all *other* tags of the map, see `lmd.localise.displacement`. If
a tag was not moved, its squared normalised displacement has the chi^2 distribution with six degrees of freedom. Tags
that were moved lose their prior, those with the largest chi^2 first, until no other tag exceeds the threshold.

Tags that were moved by more than the adjustment can correct contradict the other tags of their images: see `_suspects`.
"""

from dataclasses import dataclass

import numpy as np
from threadpoolctl import threadpool_limits

from lmd.core.checks import BoolArray, FloatArray, IntArray
from lmd.geometry.se3 import angle_between
from lmd.localise.displacement import LinearMap
from lmd.localise.fixed_map import FixedMap, information_of, rows_of
from lmd.localise.image_poses import ImagePoses, State, image_poses
from lmd.survey.adjustment import Adjustment
from lmd.survey.faults import FEWEST_SIGHTINGS, OFF_M, OFF_RAD, SecondPlace, placed_beside, second_places
from lmd.survey.initialisation import FLOOR_PIXELS
from lmd.survey.linked_adjustment import constraining
from lmd.survey.map_estimate import ONE_THREAD, STEPS, Estimate, fitting
from lmd.survey.prior import Prior
from lmd.survey.resampling import inflation
from lmd.survey.residuals import Poses, squared_errors
from lmd.survey.sightings import Sightings

# Least chi^2, with six degrees of freedom, of a tag that was moved: normal errors exceed it once in a thousand times.
MOVED_CHI_SQUARE = 22.46
# A tag contradicts the map if the share `CONTRADICTS` of its sightings beside other tags does; tags with the share
# `SURELY` are taken out together.
CONTRADICTS, SURELY = 0.5, 0.75
MOST_ROUNDS = 12  # maximum number of rounds in which tags are found
NEXT = 0.5  # tags with at least this share of the largest chi^2 are taken out together
MOST_MOVED = 0.25  # largest share of the compared tags that may have been moved
UNKNOWN_M = 0.5  # standard deviation of a place beside the other tags above which a tag is not compared, metres


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
    """Factor of the standard deviations of sightings, see `lmd.survey.resampling`."""
    twice: tuple[SecondPlace, ...] = ()
    """Second poses of tags that hang elsewhere in some images; tags are indices of the ids of all sightings."""
    contradicted: int = 0
    """Number of tags that differ from the map, if these are more than the share `MOST_MOVED` of the compared tags. The
    map and the images then disagree as a whole, and no tag counts as moved.
    """

    def updated(self, known: FixedMap) -> FixedMap:
        """Map with the present poses of the tags that were moved."""
        if not self.moved:
            return known
        tags = np.searchsorted(known.ids, [one.tag for one in self.moved])
        poses, covariances = (np.array([getattr(one, name) for one in self.moved]) for name in ("pose", "covariance"))
        return known.with_poses(tags, poses, covariances)


def find_changes(sightings: Sightings, known: FixedMap, mounts: FloatArray, found: ImagePoses) -> Changes:
    """Find tags that were moved, and new tags.

    Args:
        sightings: sightings of tags of the map and of other tags.
        known: map; all its ids are ids of the sightings.
        mounts: poses of the cameras on the body, `(C, 4, 4)`.
        found: poses of the images in the map.
    """
    place = np.searchsorted(sightings.ids, known.ids)
    rows, joint = rows_of(place), np.zeros((6 * len(sightings.ids),) * 2)
    joint[np.ix_(rows, rows)] = known.joint
    tags, sigmas = np.full((len(sightings.ids), 4, 4), np.nan), np.full((len(sightings.ids), 6), np.inf)
    tags[place], sigmas[place] = known.poses, known.sigmas
    with threadpool_limits(limits=ONE_THREAD):
        gross, found = _suspects(sightings, tags, mounts, sigmas, found)
        frames = found.poses.frames
        current = np.where(gross[:, None, None], np.nan, tags)
        lost = np.isnan(current[:, 0, 0])
        current[lost] = _placed(sightings, current, frames, mounts)[lost]
        comparison = _Comparison(sightings, tags, joint, Poses(current, frames, mounts))
        if not comparison.used.any():
            return Changes((), (), np.empty(0, dtype=np.int64), 1.0)
        moved = comparison.search(gross & np.isfinite(current[:, 0, 0]))
    new = np.isnan(tags[:, 0, 0]) & comparison.is_placed
    differ = int(moved.sum())
    if differ > max(MOST_MOVED * comparison.is_compared.sum(), FEWEST_SIGHTINGS):
        moved = np.zeros_like(moved)
    compared = comparison.is_compared & np.isfinite(tags[:, 0, 0])
    return Changes(
        tuple(comparison.displaced(k) for k in np.flatnonzero(moved)),
        tuple(comparison.displaced(k) for k in np.flatnonzero(new)),
        sightings.ids[compared],
        comparison.inflation,
        comparison.second_places(moved),
        0 if moved.any() else differ,
    )


def _suspects(
    sightings: Sightings, tags: FloatArray, mounts: FloatArray, sigmas: FloatArray, found: ImagePoses
) -> tuple[BoolArray, ImagePoses]:
    """Mask of the tags that contradict the other tags of their images, `(K,)`, and the poses of images without them.

    A sighting that does not fit the pose of its image counts fully, and all sightings of an image without a majority
    count half. Tags with the largest share of such sightings are taken out, and images are localised again.
    """
    gross = np.zeros(len(tags), dtype=bool)
    refused = np.array([state is State.RESIDUAL for state in found.states])
    for _ in range(MOST_ROUNDS):
        some = found.sightings
        tag = np.searchsorted(sightings.ids, some.ids)[some.tag]
        beside = np.bincount(some.frame, minlength=some.frames)[some.frame] > 1
        blame = np.where(refused[some.frame], 0.5, ~found.used & found.localised[some.frame]) * beside
        total = np.bincount(tag, blame, minlength=len(tags))
        share = total / np.maximum(np.bincount(tag, beside, minlength=len(tags)), 1)
        share[total < FEWEST_SIGHTINGS / 2.0] = 0.0
        if share.max(initial=0.0) < CONTRADICTS:
            break
        gross |= (share >= SURELY) | (share == share.max())
        found = image_poses(sightings, np.where(gross[:, None, None], np.nan, tags), mounts, sigmas)
        refused = np.array([state is State.RESIDUAL for state in found.states])
    return gross, found


def _placed(sightings: Sightings, tags: FloatArray, frames: FloatArray, mounts: FloatArray) -> FloatArray:
    """Poses of the tags without a pose in `tags`, `(K, 4, 4)`, by at least two sightings that agree; else NaN."""
    lost = np.isnan(tags[sightings.tag, 0, 0]) & np.isfinite(frames[sightings.frame, 0, 0])
    if not lost.any():
        return np.full_like(tags, np.nan)
    some = sightings.of(np.flatnonzero(lost)).with_separate_cameras()
    return placed_beside(Poses(tags, frames, mounts), some, fewest=2).tags


class _Comparison:
    """Adjustment of the tags with the map as the prior.

    Args:
        sightings: all sightings.
        tags: poses in the map, `(K, 4, 4)`; NaN for tags that the map lacks.
        joint: covariance of the tags in the map, `(6 K, 6 K)`; 0 for tags that the map lacks.
        poses: initial poses.
    """

    def __init__(self, sightings: Sightings, tags: FloatArray, joint: FloatArray, poses: Poses) -> None:
        self.sightings, self.poses, self.floor, self.inflation = sightings, poses, FLOOR_PIXELS, 1.0
        self.in_map = np.isfinite(tags[:, 0, 0])
        self.tags = np.where(self.in_map[:, None, None], tags, np.eye(4))
        self.joint = joint
        self.is_posed = np.isfinite(poses.tags[sightings.tag, 0, 0]) & np.isfinite(poses.frames[sightings.frame, 0, 0])
        self.used = constraining(sightings, self.is_posed, None)
        self.twists, self.squares = np.full((len(tags), 6), np.nan), np.full(len(tags), np.nan)
        self.covariances = np.full((len(tags), 6, 6), np.nan)

    @property
    def is_placed(self) -> BoolArray:
        """Mask of the tags with a covariance, `(K,)`."""
        return np.asarray(np.isfinite(self.covariances).all(axis=(1, 2)) & self._seen)

    @property
    def is_compared(self) -> BoolArray:
        """Mask of the tags with a chi^2, `(K,)`."""
        return np.asarray(np.isfinite(self.squares))

    def search(self, moved: BoolArray) -> BoolArray:
        """Mask of the tags that were moved and have a present pose, `(K,)`, from those that are known to be moved."""
        for number in range(MOST_ROUNDS):
            prior = self._adjust(moved)
            if number == 0:
                self.inflation = inflation(self._estimate(prior), lambda _done, _most: None)
            self._compare(prior)
            off = np.nan_to_num(np.where(self._is_off, self.squares, 0.0))
            stays = moved & (off < MOVED_CHI_SQUARE) & self.is_compared
            fresh = ~moved & (off > MOVED_CHI_SQUARE) & (off >= NEXT * off[~moved].max(initial=0.0))
            if not fresh.any():
                return np.asarray(moved & ~stays & self.is_placed)
            moved = (moved & ~stays) | fresh
        return np.asarray(moved & self.is_placed)

    def second_places(self, moved: BoolArray) -> tuple[SecondPlace, ...]:
        """Second poses of the tags of the map that were not `moved`, mask `(K,)`."""
        own = self._estimate(Prior(self.tags, np.zeros((len(self.tags), 6))))
        stay = (self.in_map & ~moved)[self.sightings.tag]
        return tuple(second_places(own, self.is_posed & ~self.used & stay))

    def _estimate(self, prior: Prior) -> Estimate:
        group = np.where(self._seen, 0, -1)
        return Estimate(self.sightings, prior, self.poses, group, self.used, ~self.used, self.floor)

    @property
    def _seen(self) -> BoolArray:
        return np.asarray(self.sightings.counts(self.used) > 0)

    @property
    def _is_off(self) -> BoolArray:
        """Mask of the tags that differ from the map by more than the least difference that counts."""
        turn, shift = np.linalg.norm(self.twists[:, :3], axis=1), np.linalg.norm(self.twists[:, 3:], axis=1)
        return np.asarray((shift > OFF_M) | (turn > OFF_RAD))

    def _adjust(self, moved: BoolArray) -> Prior:
        """Adjust all poses, with the priors of the tags that were not moved."""
        trusted = np.flatnonzero(~moved & self._seen & self.in_map)
        information, joint = np.zeros((len(self.tags), 6)), np.zeros_like(self.joint)
        information[trusted] = 1.0
        rows = rows_of(trusted)
        joint[np.ix_(rows, rows)] = information_of(self.joint[np.ix_(rows, rows)])
        prior = Prior(self.tags, information, None, self.poses.mounts, joint=joint)
        for _ in range(2):
            adjustment = Adjustment(self.sightings.of(self.used), prior)
            self.poses, self.floor = adjustment.run(self.poses, FLOOR_PIXELS, STEPS)
            error = squared_errors(self.sightings, self.poses)
            fits = self.is_posed & fitting(self.sightings, error, self.floor)
            self.used = constraining(self.sightings, fits, None)
        return prior

    def _compare(self, prior: Prior) -> None:
        """Compute twists from the map, covariances and chi^2 of all tags, each without the prior of its own."""
        adjustment = Adjustment(self.sightings.of(self.used), prior, True, self.inflation)
        slope, spread = adjustment.efficiency(self.poses, self.floor)
        robust, fixed = (
            LinearMap.of(adjustment, self.poses, self.floor, self.joint, weight) for weight in (None, slope**2 / spread)
        )
        self.squares[:], self.twists[:] = np.nan, np.nan
        self.covariances = fixed.covariances
        for k in np.flatnonzero(self.is_placed & self.in_map):
            found, stated = robust.displacement(k), fixed.displacement(k)
            if found is None or stated is None or np.linalg.eigvalsh(stated[1][3:, 3:])[-1] > UNKNOWN_M**2:
                continue
            self.twists[k] = found[0]
            self.squares[k] = found[0] @ np.linalg.solve(stated[1], found[0])

    def displaced(self, k: int) -> Displaced:
        """Result for the tag of index k."""
        pose, there = self.poses.tags[k], self.tags[k]
        metres = float(np.linalg.norm(pose[:3, 3] - there[:3, 3])) if self.in_map[k] else np.nan
        radians = float(angle_between(pose, there)) if self.in_map[k] else np.nan
        count = int(self.sightings.counts(self.used)[k])
        number, square = int(self.sightings.ids[k]), float(self.squares[k])
        return Displaced(number, pose, self.covariances[k], count, metres, radians, square)
