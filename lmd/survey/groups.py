"""Groups of tags that no image connects, joined by the motion of the body between their frames.

Tags that several images show together stay together, and all others begin alone: an id that was misread in one image
would connect tags that hang far from each other. A frame that shows one tag of a group has two poses beside it that
look alike (IPPE); of each group, the frames follow each other as smoothly as they can (Viterbi). Then each group is
adjusted by itself, with links between its own frames, which also tells the spread of the motion. At last frames of two
groups that are near in time, or one, say how these are to each other: pairs of groups of which most frames agree go
first.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from lmd.core.checks import FloatArray, InputError, IntArray
from lmd.geometry.se3 import angle_between, inverse, log, middle
from lmd.survey.gaps import LONGEST_GAP, tried
from lmd.survey.linked import LinkedAdjustment
from lmd.survey.links import MOST_SQUARE
from lmd.survey.motion import Motion
from lmd.survey.proposals import proposals
from lmd.survey.residuals import EXACT_SIGMA, Poses, Prior, errors_at
from lmd.survey.sightings import Sightings
from lmd.survey.start import FLOOR_PIXELS, agreeing

# Tags stay together that so many images show together, and agree.
TOGETHER = 3
# What the poses of two frames are off by before they are adjusted, rad and metres; and by moving, in a second.
ROUGH_TURN, ROUGH_PLACE, MOVING = 0.1, 0.15, 1.0
# How two groups are to each other is asked of frames among so many that follow, and of so many pairs of them.
FOLLOWING, PAIRS = 12, 40
# Pairs of frames agree on how two groups are to each other up to this, rad and metres, by which groups are joined.
AGREE_TURN, AGREE_PLACE = 0.2, 0.3
# A body leaps that moves farther than so many metres, and so many times what it does at its fastest, m/s, from one
# frame to one of the next.
LEAP, LEAP_SPEEDS, FASTEST, LEAP_FOLLOWING = 0.5, 2.0, 2.0, 3
# Odometry is of another camera or drive if more of its links do not fit, or every metre is off by more, in units of
# `lmd.survey.motion.LEAN`.
MOST_OFF, MOST_LEAN = 0.5, 8.0
STEPS = 12  # of the adjustment of groups by themselves


class Pair(NamedTuple):
    """Two parts, and how they are to each other."""

    one: int
    other: int
    way: FloatArray
    """`(4, 4)` from the world of the other to that of the one."""
    agreed: int
    """Frames of each that agree on it."""
    seconds: float
    """Between frames of the two, the median."""


@dataclass(frozen=True)
class Nodes:
    """Frames as single groups have them, n of them, those of the first group first, each in the order of time.

    Args:
        sightings: of these nodes in place of frames.
        frame, group: of each node, `(n,)`.
        motion: between them.
    """

    sightings: Sightings
    frame: IntArray
    group: IntArray
    motion: Motion

    @classmethod
    def of(cls, sightings: Sightings, group: IntArray, motion: Motion) -> "Nodes":
        """The nodes of all sightings of tags in groups `(K,)`."""
        own = group[sightings.tag]
        key, node = np.unique(own * sightings.frames + sightings.frame, return_inverse=True)
        order = np.argsort(node, kind="stable")
        frame, of_group = key % sightings.frames, key // sightings.frames
        some = replace(sightings.of(order), frame=node[order], frames=len(key))
        return cls(some, frame, of_group, motion.of(frame, of_group))


def joined_by_motion(
    sightings: Sightings, poses: Poses, group: IntArray, prior: Prior
) -> tuple[Poses, IntArray, Prior]:
    """Rough poses in as few groups as motion leaves, and the prior with the spread that the drive tells.

    Args:
        poses: rough ones of the groups that images connect, each in a world of its own.
        group: of each tag, `(K,)`, -1 for none.
        prior: with a motion.
    """
    assert prior.motion is not None
    parts = _parts(sightings, poses, group, prior)
    nodes = Nodes.of(sightings, parts, prior.motion)
    tags = np.where((group < 0)[:, None, None], np.eye(4), poses.tags)
    there, motion = _adjusted(nodes, _smoothest(nodes, replace(poses, tags=tags)))
    told = replace(prior.motion, spread=motion.spread, gaps=motion.gaps, bridged=motion.bridged)
    worlds, joined = _worlds(replace(nodes, motion=motion), there.frames, told)
    tags = np.where((parts < 0)[:, None, None], np.nan, worlds[parts] @ there.tags)
    frames = np.full_like(poses.frames, np.nan)
    views = worlds[nodes.group] @ there.frames
    # Of a frame in several parts, the one comes last that has most of its tags, or is nearest to the frames around it.
    counts = np.bincount(nodes.sightings.frame, minlength=len(nodes.frame))
    before, after = _following(nodes, LEAP_FOLLOWING)
    apart = np.linalg.norm(views[after, :3, 3] - views[before, :3, 3], axis=1)
    away = sum(np.bincount(end, apart, minlength=len(counts)) for end in (before, after))
    order = np.lexsort((-np.asarray(away), counts))
    frames[nodes.frame[order]] = views[order]
    whole = np.where(parts < 0, -1, joined[parts])
    alone = (np.bincount(whole[parts >= 0], minlength=len(joined))[whole] == 1) & (group < 0)
    tags[alone], whole[alone] = np.nan, -1
    result = np.where(whole < 0, -1, np.unique(np.append(whole, -1), return_inverse=True)[1][:-1] - 1)
    return Poses(tags, frames, poses.mounts), result, replace(prior, motion=told)


def _parts(sightings: Sightings, poses: Poses, group: IntArray, prior: Prior) -> IntArray:
    """Tags that stay together, as numbers `(K,)`; -1 for those that were not seen.

    A group of which the prior knows where a tag is stays as it is.
    """
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    count = len(group)
    error = errors_at(sightings, poses)
    fits = np.isfinite(error) & (group[sightings.tag] >= 0)
    fits[fits] = agreeing(sightings.of(fits), error[fits])
    shown = coo_array(
        (np.ones(fits.sum()), (sightings.frame[fits], sightings.tag[fits])), shape=(sightings.frames, count)
    ).tocsr()
    together = (shown.T @ shown).tocoo()
    often = together.data >= TOGETHER
    one, other = together.row[often], together.col[often]
    known = np.unique(group[(group >= 0) & prior.information.any(axis=1)])
    kept = np.flatnonzero(np.isin(group, known))
    first = {int(g): int(k) for g, k in zip(group[kept][::-1], kept[::-1], strict=True)}
    one = np.concatenate([one, kept])
    other = np.concatenate([other, np.array([first[int(g)] for g in group[kept]], dtype=one.dtype)])
    graph = coo_array((np.ones(len(one)), (one, other)), shape=(count, count))
    seen = np.bincount(sightings.tag, minlength=count) > 0
    parts = np.full(count, -1)
    parts[seen] = np.unique(connected_components(graph, directed=False)[1][seen], return_inverse=True)[1]
    return parts


def _smoothest(nodes: Nodes, poses: Poses) -> Poses:
    """Poses of the nodes in the worlds of their parts, by the best of their sightings; `poses` are those of frames."""
    some, count = nodes.sightings, len(nodes.frame)
    order = np.lexsort((-some.sizes, some.frame))
    best = order[np.searchsorted(some.frame[order], np.arange(count))]
    proposed = proposals(some.of(best))
    views = poses.tags[some.tag[best]][:, None] @ inverse(poses.mounts[some.camera[best]][:, None] @ proposed.poses)
    costs = np.stack([np.zeros(count), proposed.odds], axis=1)
    placed = poses.frames[nodes.frame]
    error = errors_at(some, replace(poses, frames=placed))
    fits = np.isfinite(error)
    fits[fits] = agreeing(some.of(fits), error[fits])
    several = np.bincount(some.frame[fits], minlength=count) >= 2
    views[several] = placed[several, None]
    follows = np.flatnonzero(nodes.motion.follows(np.arange(count)))
    between = np.zeros((count, 2, 2))  # what it costs to come from one of the two before
    steps, seconds = (
        nodes.motion.steps(follows, follows + 1),
        nodes.motion.times[follows + 1] - nodes.motion.times[follows],
    )
    for here in range(2):
        for there in range(2):
            off = inverse(views[follows, here] @ steps) @ views[follows + 1, there]
            moving = 0.0 if nodes.motion.path is not None else MOVING * seconds
            turn = angle_between(off, np.eye(4)) / np.hypot(ROUGH_TURN, moving)
            place = np.linalg.norm(off[:, :3, 3], axis=1) / np.hypot(ROUGH_PLACE, moving)
            between[follows + 1, there, here] = np.log1p(turn**2 + place**2)
    chosen = np.zeros((count, 2), dtype=np.int64)
    total = costs[:1].repeat(count, axis=0)
    for k in range(1, count):
        ways = between[k] + total[k - 1]
        chosen[k] = np.argmin(ways, axis=1)
        total[k] = costs[k] + ways.min(axis=1)
        total[k] -= total[k].min()
    which = np.zeros(count, dtype=np.int64)
    which[-1] = np.argmin(total[-1])
    for k in range(count - 1, 0, -1):
        which[k - 1] = chosen[k, which[k]]
    return replace(poses, frames=views[np.arange(count), which])


def _adjusted(nodes: Nodes, poses: Poses) -> tuple[Poses, Motion]:
    """The parts, each adjusted by itself, and the motion as they tell it."""
    some, motion = nodes.sightings, nodes.motion
    of_tag = np.full(len(poses.tags), -1)
    of_tag[some.tag] = nodes.group[some.frame]
    _, first = np.unique(of_tag, return_index=True)
    information = np.zeros((len(of_tag), 6))
    information[first[of_tag[first] >= 0]] = EXACT_SIGMA**-2.0
    for _ in range(2):
        adjustment = LinkedAdjustment(some, Prior(poses.tags, information, None, poses.mounts, motion))
        found = adjustment.run(poses, FLOOR_PIXELS, STEPS)
        poses, motion = found.poses, adjustment.told(found.poses, found.floor)
    _check_odometry(adjustment, poses)
    return poses, motion if motion.path is not None else tried(motion, poses.frames)


def _check_odometry(adjustment: LinkedAdjustment, poses: Poses) -> None:
    """Raise `InputError` if odometry says otherwise than the images how the body moves."""
    if adjustment.motion.path is None or not len(adjustment.links.one):
        return
    at = adjustment.links.at(poses.frames[adjustment.seen])
    off = float((adjustment.links.squares(at.error) > MOST_SQUARE).mean())
    if off > MOST_OFF or np.abs(at.lean).max() > MOST_LEAN:
        raise InputError(
            "odometry does not move as the images do: does it need a mount or frame=body, as it is that of a body and "
            "not of the (first) camera, or is it of another drive?",
            "odometry",
        )


def _worlds(nodes: Nodes, poses: FloatArray, motion: Motion) -> tuple[FloatArray, IntArray]:
    """Motions of the parts to worlds in common, `(P, 4, 4)`, and the number of the world of each, `(P,)`.

    The surest pairs go first. A body does not leap from one frame to the next: where it would have, either the frames
    are fewer in which it does, and their ids were misread, or the least sure of the pairs that led there is wrong.
    """
    velocities = nodes.motion.links(np.arange(len(nodes.frame))).velocities(poses)
    pairs = _pairs(nodes, poses, motion, velocities)
    before, after = _following(nodes, LEAP_FOLLOWING)
    seconds = nodes.motion.times[after] - nodes.motion.times[before]
    near = (seconds > 0.0) & (seconds < LONGEST_GAP)
    before, after, seconds = before[near], after[near], seconds[near]
    speeds = np.linalg.norm(velocities[:, 3:], axis=1)
    fastest = np.nanquantile(speeds, 0.95) if np.isfinite(speeds).any() else FASTEST
    most = LEAP + LEAP_SPEEDS * fastest * seconds
    misread = np.zeros(len(nodes.frame), dtype=bool)
    while True:
        worlds, joined, tree = _spanned(int(nodes.group.max()) + 1, pairs)
        places = (worlds[nodes.group] @ poses)[:, :3, 3]
        leaps = np.linalg.norm(places[after] - places[before], axis=1) > most
        leaps &= (joined[nodes.group[before]] == joined[nodes.group[after]]) & ~misread[before] & ~misread[after]
        leaps &= nodes.group[before] != nodes.group[after]
        if not leaps.any():
            return worlds, joined
        ends = np.stack([before[leaps], after[leaps]], axis=1)
        ends = np.take_along_axis(ends, np.argsort(nodes.group[ends], axis=1), axis=1)
        between, which, counts = np.unique(nodes.group[ends], axis=0, return_inverse=True, return_counts=True)
        own = ends[which.ravel() == np.argmax(counts)]
        fewest = min((np.unique(side) for side in own.T), key=len)
        weakest = max(_path(tree, *between[np.argmax(counts)].tolist()))  # pairs come in the order of how sure they are
        if pairs[weakest].agreed > len(fewest):
            misread[fewest] = True
        else:
            del pairs[weakest]


def _spanned(count: int, pairs: Sequence[Pair]) -> tuple[FloatArray, IntArray, dict[int, dict[int, int]]]:
    """Worlds as of `_worlds` by the first pairs that join anything, and by which pairs each part hangs on others."""
    worlds, joined = np.tile(np.eye(4), (count, 1, 1)), np.arange(count)
    tree: dict[int, dict[int, int]] = {part: {} for part in range(count)}
    for number, pair in enumerate(pairs):
        if joined[pair.one] == joined[pair.other]:
            continue
        moved = joined == joined[pair.other]
        worlds[moved] = worlds[pair.one] @ pair.way @ inverse(worlds[pair.other]) @ worlds[moved]
        joined[moved] = joined[pair.one]
        tree[pair.one][pair.other] = tree[pair.other][pair.one] = number
    return worlds, joined, tree


def _path(tree: dict[int, dict[int, int]], one: int, other: int) -> list[int]:
    """The pairs by which one part hangs on another."""
    led: dict[int, list[int]] = {one: []}
    waiting = [one]
    while other not in led:
        part = waiting.pop()
        for beside, number in tree[part].items():
            if beside not in led:
                led[beside] = [*led[part], number]
                waiting.append(beside)
    return led[other]


def _following(nodes: Nodes, count: int) -> tuple[IntArray, IntArray]:
    """Pairs of nodes of which the second is among so many that follow the first."""
    order = np.lexsort((nodes.group, nodes.frame))
    ends = [(order[:-k], order[k:]) for k in range(1, min(count, len(order) - 1) + 1)]
    first, second = zip(*ends, strict=True) if ends else ((order[:0],), (order[:0],))
    return np.concatenate(first), np.concatenate(second)


def _pairs(nodes: Nodes, poses: FloatArray, motion: Motion, velocities: FloatArray) -> list[Pair]:
    """The pairs of parts of which motion tells how they are to each other, the surest first."""
    i, j = _following(nodes, FOLLOWING)
    swap = nodes.group[i] > nodes.group[j]
    i, j = np.where(swap, j, i), np.where(swap, i, j)
    there = (nodes.group[i] < nodes.group[j]) & motion.tells(nodes.frame[i], nodes.frame[j])
    i, j = i[there], j[there]
    steps = nodes.motion.steps(i, j, velocities)
    known = np.isfinite(steps[:, 0, 0])
    i, j, steps = i[known], j[known], steps[known]
    between = poses[i] @ steps @ inverse(poses[j])
    away = np.abs(nodes.motion.times[j] - nodes.motion.times[i])
    key = nodes.group[i] * len(nodes.frame) + nodes.group[j]
    order = np.lexsort((away, key))
    starts = np.flatnonzero(np.diff(key[order], prepend=-1))
    found = []
    for own in np.split(order, starts[1:]) if len(order) else []:
        own = own[:PAIRS]
        centre = middle(between[own])
        off = log(inverse(centre) @ between[own])
        near = (np.linalg.norm(off[:, :3], axis=1) < AGREE_TURN) & (np.linalg.norm(off[:, 3:], axis=1) < AGREE_PLACE)
        # A frame with a misread id is near to many frames, so each counts once.
        agreed = min(len(np.unique(i[own[near]])), len(np.unique(j[own[near]])))
        one, other = int(nodes.group[i[own[0]]]), int(nodes.group[j[own[0]]])
        found.append(Pair(one, other, centre, agreed, float(np.median(away[own]))))
    return sorted(found, key=lambda pair: (-pair.agreed, pair.seconds))
