"""Groups of tags that no image connects, joined by the motion of the body between the frames of the groups.

1. Tags that several images show together form a *part*. Each other tag is a part by itself, as an id misread in one
   image would connect distant tags.
2. A frame that shows a single tag of a part has two possible poses relative to the part, as two poses of a tag look
   alike (IPPE). For each part the smoothest sequence of these poses is found (Viterbi).
3. Each part is adjusted by itself, with links of motion between its own frames; this also estimates the noise of the
   motion model (its *spread*).
4. A *relation* is the relative pose of two parts. A relation is measured by pairs of frames, one of each part, that are
   near in time. Relations join the parts; the relations on which most frames agree come first (maximum spanning tree).
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from lmd.adjust.adjustment import Adjustment
from lmd.adjust.corners import Poses, agreeing, squared_errors
from lmd.adjust.drive import LONGEST_GAP, Nodes, measured_motion, smoothest, spread_motion, with_rough_clock
from lmd.adjust.estimate import FLOOR_PIXELS
from lmd.adjust.motion import Motion
from lmd.adjust.prior import EXACT_SIGMA, Mounts, Prior
from lmd.adjust.sightings import Sightings
from lmd.core.checks import BoolArray, FloatArray, IntArray
from lmd.geometry.se3 import inverse, log, median_pose

TOGETHER = 3  # minimum number of images that agree on two tags for these to form a part
# Maximum number of later frames with which a frame gives relations, and of pairs of frames for each relation.
FOLLOWING, PAIRS = 12, 40
AGREE_TURN, AGREE_PLACE = 0.2, 0.3  # maximum difference of a pair of frames from a relation, rad and metres
# A body leaps if, from a frame to one of the next `LEAP_FOLLOWING` frames, it moves farther than `LEAP`, metres, plus
# `LEAP_SPEEDS` times the distance at its highest speed. `FASTEST`, m/s, replaces an unknown highest speed.
LEAP, LEAP_SPEEDS, FASTEST, LEAP_FOLLOWING = 0.5, 2.0, 2.0, 3
STEPS = 12  # steps of the bundle adjustment of parts


class Relation(NamedTuple):
    """Relative pose of two parts."""

    one: int
    """Index of the first part."""
    other: int
    """Index of the second part."""
    way: FloatArray
    """Rigid motion from the world frame of the part `other` to the world frame of the part `one`, `(4, 4)`."""
    agreed: int
    """Number of frames that agree on `way`: of the two parts, the part with fewer such frames counts."""
    seconds: float
    """Median time between the frames of the two parts, seconds."""


def join_groups(sightings: Sightings, poses: Poses, group: IntArray, prior: Prior) -> tuple[Poses, IntArray, Prior]:
    """Join groups of tags that no image connects, by the motion of the body between frames.

    Args:
        sightings: sightings of the tags.
        poses: rough poses; each group of tags that images connect has a world frame of its own.
        group: index of each tag's group, `(K,)`; -1 for tags without a group.
        prior: prior of the unknowns, with a motion model.

    Returns:
        rough poses; the index of each tag's group after joining, `(K,)`; the prior with the estimated noise (spread) of
        the motion model.
    """
    assert prior.motion is not None
    parts = _parts(sightings, poses, group, prior.known)
    nodes = Nodes.of(sightings, parts, prior.motion)
    tags = np.where((group < 0)[:, None, None], np.eye(4), poses.tags)
    rough = smoothest(nodes, replace(poses, tags=tags))
    joint = with_rough_clock(prior.motion, nodes.frame, nodes.part, rough.frames)
    there, motion = _adjusted(replace(nodes, motion=joint.of(nodes.frame, nodes.part)), rough)
    joint = replace(joint, spread=motion.spread, gaps=motion.gaps)
    worlds, joined = _worlds(replace(nodes, motion=motion), there.frames, joint)
    tags = np.where((parts < 0)[:, None, None], np.nan, worlds[parts] @ there.tags)
    frames, views = np.full_like(poses.frames, np.nan), worlds[nodes.part] @ there.frames
    # If a frame has several nodes, the last node counts: the node with most tags or, in a tie, nearest to its
    # neighbours.
    counts = np.bincount(nodes.sightings.frame, minlength=len(nodes.frame))
    before, after = nodes.following(LEAP_FOLLOWING)
    apart = np.linalg.norm(views[after, :3, 3] - views[before, :3, 3], axis=1)
    away = sum(np.bincount(end, apart, minlength=len(counts)) for end in (before, after))
    order = np.lexsort((-np.asarray(away), counts))
    frames[nodes.frame[order]] = views[order]
    whole = np.where(parts < 0, -1, joined[parts])
    alone = (np.bincount(whole[parts >= 0], minlength=len(joined))[whole] == 1) & (group < 0)
    tags[alone], whole[alone] = np.nan, -1
    result = np.where(whole < 0, -1, np.unique(np.append(whole, -1), return_inverse=True)[1][:-1] - 1)
    return Poses(tags, frames, poses.mounts), result, replace(prior, motion=joint)


def _parts(sightings: Sightings, poses: Poses, group: IntArray, known: BoolArray) -> IntArray:
    """Divide the tags into parts: groups of tags that several images show together. Other tags are parts by themselves.

    Args:
        sightings: sightings of K tags.
        poses: rough poses of tags and frames.
        group: index of the larger group of tags that images connect, for each tag, `(K,)`; -1 for tags without a group.
        known: mask of the tags with a prior, `(K,)`; a group with such a tag stays one part.

    Returns:
        index of each tag's part, `(K,)`; -1 for tags without sightings.
    """
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    fits = agreeing(sightings, squared_errors(sightings, poses)) & (group[sightings.tag] >= 0)
    ends, shape = (sightings.frame[fits], sightings.tag[fits]), (sightings.frames, len(group))
    shown = coo_array((np.ones(fits.sum()), ends), shape=shape).tocsr()
    together = (shown.T @ shown).toarray() >= TOGETHER
    for g in np.unique(group[known & (group >= 0)]):
        own = np.flatnonzero(group == g)
        together[own[0], own] = True
    seen, parts = sightings.counts() > 0, np.full(len(group), -1)
    parts[seen] = np.unique(connected_components(together, directed=False)[1][seen], return_inverse=True)[1]
    return parts


def _adjusted(nodes: Nodes, poses: Poses) -> tuple[Poses, Motion]:
    """Adjust each part (group of tags) by itself. Return the adjusted poses of the nodes (pairs of a frame and a part),
    and the motion model with the noise (spread) estimated from all parts.
    """
    some, motion = nodes.sightings, nodes.motion
    of_tag = np.full(len(poses.tags), -1)
    of_tag[some.tag] = nodes.part[some.frame]
    _, first = np.unique(of_tag, return_index=True)
    information = np.zeros((len(of_tag), 6))
    information[first[of_tag[first] >= 0]] = EXACT_SIGMA**-2.0
    for told in (spread_motion, measured_motion):
        joint = Adjustment(some, Prior(poses.tags, information, None, Mounts(poses.mounts, 2 * (EXACT_SIGMA,)), motion))
        poses, floor = joint.run(poses, FLOOR_PIXELS, STEPS)
        motion = told(joint, poses, floor)
    return poses, motion


def _worlds(nodes: Nodes, poses: FloatArray, motion: Motion) -> tuple[FloatArray, IntArray]:
    """Join parts (groups of tags) by relations, that is, estimated relative poses of two parts.

    The body must not leap, that is, move too far, from a frame of one part to a later frame of another. A leap casts
    doubt on the weakest relation that connects the two parts, that is, the relation on which the fewest frames agree.
    If even fewer frames have leaps, the ids of their tags were misread. Otherwise the relation is removed as wrong.

    Args:
        nodes: nodes (pairs of a frame and a part), with the motion between the nodes.
        poses: poses of the nodes, each in the world frame of its part, `(n, 4, 4)`.
        motion: motion between the frames.

    Returns:
        rigid motions from the world frames of the parts to common world frames, `(P, 4, 4)`; index of the common world
        of each part, `(P,)`.
    """
    velocities = nodes.motion.links(np.arange(len(nodes.frame))).velocities(poses)
    relations = _relations(nodes, poses, motion, velocities)
    pairs = np.stack(nodes.following(LEAP_FOLLOWING))
    seconds, parts = np.diff(nodes.motion.times[pairs], axis=0)[0], nodes.part[pairs]
    near = (seconds > 0.0) & (seconds < LONGEST_GAP) & (parts[0] != parts[1])
    pairs, parts, seconds = pairs[:, near], parts[:, near], seconds[near]
    speeds = np.linalg.norm(velocities[:, 3:], axis=1)
    fastest = np.nanquantile(speeds, 0.95) if np.isfinite(speeds).any() else FASTEST
    most = LEAP + LEAP_SPEEDS * fastest * seconds
    misread = np.zeros(len(nodes.frame), dtype=bool)
    while True:
        worlds, joined, joined_by = _spanned(int(nodes.part.max()) + 1, relations)
        places = (worlds[nodes.part] @ poses)[:, :3, 3][pairs]
        leaps = np.linalg.norm(places[1] - places[0], axis=1) > most
        leaps &= (joined[parts[0]] == joined[parts[1]]) & ~misread[pairs].any(axis=0)
        if not leaps.any():
            return worlds, joined
        ends = np.take_along_axis(pairs[:, leaps], np.argsort(parts[:, leaps], axis=0), axis=0)
        between, which, counts = np.unique(nodes.part[ends].T, axis=0, return_inverse=True, return_counts=True)
        fewest = min((np.unique(side) for side in ends[:, which.ravel() == np.argmax(counts)]), key=len)
        weakest = joined_by[tuple(between[np.argmax(counts)])]
        if relations[weakest].agreed > len(fewest):
            misread[fewest] = True
        else:
            del relations[weakest]


def _spanned(count: int, relations: Sequence[Relation]) -> tuple[FloatArray, IntArray, IntArray]:
    """Join parts (groups of tags) into common worlds by a spanning tree of the `relations`. A relation is used if
    earlier relations do not join its two parts.

    Args:
        count: number P of parts.
        relations: relative poses of pairs of parts, the most reliable first.

    Returns:
        rigid motions from the world frames of the parts to common world frames, `(P, 4, 4)`; index of each part's
        common world, `(P,)`. Then the index of the relation that joined each pair of parts, `(P, P)`, -1 if not joined.
        On the way from one part to the other in the tree, this relation is the least reliable.
    """
    worlds, joined = np.tile(np.eye(4), (count, 1, 1)), np.arange(count)
    joined_by = np.full((count, count), -1)
    for number, relation in enumerate(relations):
        if joined[relation.one] == joined[relation.other]:
            continue
        moved, still = joined == joined[relation.other], joined == joined[relation.one]
        joined_by[np.ix_(moved, still)] = joined_by[np.ix_(still, moved)] = number
        worlds[moved] = worlds[relation.one] @ relation.way @ inverse(worlds[relation.other]) @ worlds[moved]
        joined[moved] = joined[relation.one]
    return worlds, joined, joined_by


def _relations(nodes: Nodes, poses: FloatArray, motion: Motion, velocities: FloatArray) -> list[Relation]:
    """Relations (relative poses) of all pairs of parts that have frames near in time. A part is a group of tags. The
    relations on which most frames agree come first.

    Args:
        nodes: nodes (pairs of a frame and a part), with the motion between the nodes of each part.
        poses: poses of the n nodes, each in the world frame of its part, `(n, 4, 4)`.
        motion: motion between the frames.
        velocities: turn rates and velocities at the nodes, in the body's frame, `(n, 6)`; NaN if unknown.
    """
    pairs = np.stack(nodes.following(FOLLOWING))
    i, j = np.take_along_axis(pairs, np.argsort(nodes.part[pairs], axis=0, kind="stable"), axis=0)
    there = (nodes.part[i] < nodes.part[j]) & motion.relates(nodes.frame[i], nodes.frame[j])
    i, j = i[there], j[there]
    steps = nodes.motion.steps(i, j, velocities)
    known = np.isfinite(steps[:, 0, 0])
    i, j = i[known], j[known]
    between = poses[i] @ steps[known] @ inverse(poses[j])
    away = np.abs(nodes.motion.times[j] - nodes.motion.times[i])
    key = nodes.part[i] * len(nodes.frame) + nodes.part[j]
    order, found = np.lexsort((away, key)), []
    for every in np.split(order, np.flatnonzero(np.diff(key[order], prepend=-1)))[1:]:
        own = every[:PAIRS]
        centre = median_pose(between[own])
        off = log(inverse(centre) @ between[own])
        near = (np.linalg.norm(off[:, :3], axis=1) < AGREE_TURN) & (np.linalg.norm(off[:, 3:], axis=1) < AGREE_PLACE)
        # A frame with a misread id is in many pairs, so each frame counts once.
        agreed = min(len(np.unique(i[own[near]])), len(np.unique(j[own[near]])))
        one, other = int(nodes.part[i[own[0]]]), int(nodes.part[j[own[0]]])
        found.append(Relation(one, other, centre, agreed, float(np.median(away[own]))))
    return sorted(found, key=lambda relation: (-relation.agreed, relation.seconds))
