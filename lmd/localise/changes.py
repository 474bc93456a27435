"""Tags that were moved since the map was made, new tags, and tags that vanished.

*Moved tags* are found by a bundle adjustment with the map as the prior. Let u be the twists of the tags from the map,
with the posterior covariance P. The *trusted* tags r, which were not moved, have the prior N(0, S) with the information
J = S_rr^-1. The pose of each tag in the map is compared with the pose by the images and all other trusted tags:

- If a trusted tag k was moved by t, its prior holds for u_k - t. The information on t is Q_kk with Q = J - J P J, and t
  = Q_kk^-1 (J u)_k with the covariance Q_kk^-1.
- A tag k of the map that is not trusted is expected at A u_r, given the trusted tags, with A = S_kr J. So t = u_k - A
u_r, with the
  covariance of u_k - A u_r under P, plus S_kk - A S_rk.

If a tag was not moved, t^T cov(t)^-1 t has the chi^2 distribution with six degrees of freedom. Moved tags lose their
prior, in the order of decreasing chi^2, until no other tag exceeds the threshold.

*Vanished tags* were detected in no image, although several images should show them. A tag should be seen in an image if
the tag is entirely within the image and is not hidden by a surface of the room. The tag must also be as large and as
little oblique as tags that were detected in the drive. The probability of a detection is the share of such views of
other tags in which the tag was detected; views from nearly the same pose count once.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from lmd.adjust.candidates import placed_tags
from lmd.adjust.estimate import Estimate, inflation
from lmd.adjust.faults import FEWEST_SIGHTINGS, LEAST_SHARE, with_sizes
from lmd.adjust.gauge import rows_of, twists_between, worst_sigmas
from lmd.adjust.intrinsics import Optics
from lmd.adjust.prior import Mounts
from lmd.adjust.refinement import nuisances_off, refine
from lmd.adjust.sightings import SQUARE
from lmd.core.checks import BoolArray, FloatArray
from lmd.detection.corner_errors import shortest_side
from lmd.geometry.projection import project
from lmd.geometry.se3 import act, angle_between
from lmd.localise.fixed_map import FixedMap
from lmd.space.space import Space

# Minimum chi^2, with six degrees of freedom, of a moved tag; normal errors exceed it with probability 1e-3.
MOVED_CHI_SQUARE = 22.46
OFF_M, OFF_RAD = 0.001, 0.02  # least shift, metres, or rotation, rad, of a tag that was moved
SIZE_ROUNDS = 2  # number of rounds in which sizes are estimated
MOST_ROUNDS = 12  # maximum number of rounds in which tags are found
NEXT = 0.5  # tags with at least this share of the largest chi^2 lose their prior together
MOST_MOVED = 0.25  # maximum share of moved tags among the compared tags
UNKNOWN_M = 0.5  # a tag is compared only if its position relative to the other tags is known better, metres
MOST_VARIANCE = 1.0  # a tag is not compared if a variance of its displacement, rad^2 or m^2, exceeds this
VANISHED = 1e-3  # greatest probability that a tag was missed in all views by chance
MOST_RATE = 0.9  # maximum probability of a detection that is assumed
FEWEST_VIEWS = 4  # minimum number of views, where views from nearly the same pose count once
LOWEST = 0.1  # quantile of sizes, and of cosines of incidence, below which a tag need not be detected
BORDER = 5.0  # minimum distance of corners from the border of the image, pixels
OFF_WALL = 0.02  # distance in front of a tag at which lines of sight end, metres
APART_M, APART_RAD = 0.2, 0.2  # minimum distance, or rotation, between views that count separately


class Change(NamedTuple):
    """Change of a map."""

    tag: int
    """Id of the tag."""
    kind: str
    """`moved`, `vanished` or `new`."""
    images: int
    """Number of images that show the tag; for a vanished tag, number of views that should show it."""
    pose: FloatArray
    """`(4, 4)` present pose, tag to map; NaN if the tag vanished."""
    covariance: FloatArray
    """`(6, 6)` covariance of the right-hand twist of the pose, rad and metres; NaN if the tag vanished."""
    before: FloatArray
    """`(4, 4)` pose in the map; NaN for a new tag."""
    chi_square: float = np.nan
    """chi^2 of the difference from the map; NaN unless the tag was moved."""

    @property
    def shift(self) -> FloatArray:
        """Shift along the axes of the tag's pose in the map, metres, `(3,)`."""
        return np.asarray(self.before[:3, :3].T @ (self.pose - self.before)[:3, 3])

    @property
    def radians(self) -> float:
        """Rotation from the orientation in the map, rad."""
        return float(angle_between(self.pose, self.before))


class Comparison(NamedTuple):
    """Estimate compared with a map of K tags."""

    found: Estimate
    """Estimate of all poses."""
    moved: BoolArray
    """Mask of the tags that were moved, `(K,)`."""
    squares: FloatArray
    """chi^2 of the displacement of each tag, `(K,)`; NaN for tags that cannot be compared with the others."""
    odd: BoolArray
    """Mask of the tags with another size than stated, `(K,)`."""
    contradicted: int = 0
    """Number of tags that differ from the map if it exceeds the share `MOST_MOVED` of the compared tags. The map and
    the images then disagree as a whole, and no tag counts as moved.
    """

    def changes(self, here: FixedMap) -> list[Change]:
        """Tags that were moved, and new tags."""
        found, counts = self.found, self.found.sightings.counts(self.found.used)
        poses, covariances, squares = found.poses.tags, found.covariances, self.squares.tolist()
        return [
            Change(int(here.ids[k]), kind, int(counts[k]), poses[k], covariances[k], here.poses[k], squares[k])
            for kind, which in (("moved", self.moved), ("new", ~here.has))
            for k in np.flatnonzero(which & found.known & (counts > 0)).tolist()
        ]


def twists_from(found: Estimate, here: FixedMap) -> FloatArray:
    """Twists of all tags from the map at the joint optimum of all unknowns, `(K, 6)`; NaN for unknown tags."""
    there, *_ = found.adjustment.joint_step(found.poses, found.floor, 0.0, nuisances_off(found))
    return twists_between(here.poses, there.tags)


def displacements(found: Estimate, here: FixedMap) -> tuple[FloatArray, FloatArray]:
    """Displacement of each tag from the map, `(K, 6)`, and covariance of the displacement, `(K, 6, 6)`; NaN for tags
    that cannot be compared with any others.
    """
    twists, count = twists_from(found, here), len(here.ids)
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
    """Estimate all poses with the map as the prior, except the prior of moved tags, and refine the cameras at the end.

    Args:
        begun: estimate with rough poses; cameras are refined if it has `lenses`.
        here: map of the tags.
        mounts: prior of the mounts.
        gross: mask of the tags that contradict the others, `(K,)`.
        odd: mask of the tags known to have another size than stated, `(K,)`.
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
            now = replace(now, inflation=inflation(now, lambda _done, _most: None))
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


def vanished_tags(found: Estimate, known: FixedMap, optics: Sequence[Optics], room: Space) -> list[Change]:
    """Find the tags of the map that vanished.

    Args:
        found: estimate of the frames, with the present poses of the tags that were seen.
        known: map.
        optics: cameras of the body.
        room: room of the map, whose surfaces hide tags.
    """
    frames, every = np.flatnonzero(found.poses.known_frames), found.sightings
    of_map = np.isin(every.ids, known.ids)[every.tag]
    some, used = every.of(of_map), found.used[of_map]
    if not len(frames) or not used.any():
        return []
    _, own, there = np.intersect1d(known.ids, every.ids, return_indices=True)
    tags, tag, present = known.poses.copy(), np.searchsorted(known.ids, every.ids)[some.tag], found.poses.tags[there]
    tags[own] = np.where(np.isfinite(present), present, tags[own])
    frontal = _cosines(found.poses.frames[some.frame] @ found.poses.mounts[some.camera], tags[tag])
    least_size, least_cosine = (float(np.quantile(values[used], LOWEST)) for values in (some.sizes, frontal))
    in_view, seen = np.zeros((2, some.frames, len(tags)), dtype=bool)
    seen[some.frame, tag] = True
    for one, mount in zip(optics, found.poses.mounts, strict=True):
        poses, size = found.poses.frames[frames] @ mount, np.array([one.camera.image_width, one.camera.image_height])
        for k, pose in enumerate(tags):
            ahead = np.flatnonzero(_cosines(poses, pose[None]) >= least_cosine)
            image = project(one.camera, poses[ahead], act(pose, known.edges[k] / 2.0 * SQUARE)[None])
            inside = ((image >= BORDER) & (image <= size - BORDER)).all(axis=(1, 2))
            ahead, end = ahead[inside & (shortest_side(image) >= least_size)], pose[:3, 3] + OFF_WALL * pose[:3, 2]
            if len(ahead) and room.contains(end[None])[0]:
                clear = room.clear(poses[ahead, :3, 3], np.tile(end, (len(ahead), 1)))
                in_view[frames[ahead[clear]], k] = True
    detected, changes = np.bincount(tag, minlength=len(tags)) > 0, []
    others = in_view[:, detected]
    rate = min(float(seen[:, detected][others].mean()), MOST_RATE) if others.any() else 0.0
    for k in np.flatnonzero(~detected).tolist():
        views = _separate(found.poses.frames[in_view[:, k]])
        if views >= FEWEST_VIEWS and (1.0 - rate) ** views < VANISHED:
            gone = np.full((4, 4), np.nan), np.full((6, 6), np.nan)
            changes.append(Change(int(known.ids[k]), "vanished", views, *gone, known.poses[k]))
    return changes


def _cosines(poses: FloatArray, tags: FloatArray) -> FloatArray:
    """Cosine of the angle between the normal of each tag and the direction to the camera, `(n,)`."""
    way = poses[:, :3, 3] - tags[:, :3, 3]
    return np.asarray((way * tags[:, :3, 2]).sum(axis=1) / np.linalg.norm(way, axis=1))


def _separate(poses: FloatArray) -> int:
    """Number of poses when poses close to an earlier counted pose are not counted."""
    kept = poses[:0]
    for pose in poses:
        near = np.linalg.norm(kept[:, :3, 3] - pose[:3, 3], axis=1) < APART_M
        if not (near & (angle_between(kept, pose[None]) < APART_RAD)).any():
            kept = np.concatenate([kept, pose[None]])
    return len(kept)
