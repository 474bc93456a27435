"""Motion of a body, estimated from a drive: noise of the motion model, and smoothest sequence of poses.

A motion model predicts the relative poses of successive frames, which are then *linked*. The noise of the model is
described by the *spread* s, a factor on the model's standard deviations. The spread is estimated by maximum evidence.
With theta = log s^2,

    d chi^2 / d theta + d log |Q| / d theta + d log |H| / d theta = 0.

Here chi^2 is that of the links' errors, Q is the covariance of these errors, and H is the normal matrix of all
unknowns. The prior of s counts like `ASSUMED_LINKS` more links.

Errors of the constant-velocity model across gaps between frames are measured where the drive has no gaps. Two frames
are taken that are as far apart as the gap is long. The velocities before the first and after the second frame predict
the relative pose of the two. The error is the difference between this prediction and the estimated relative pose.

A frame that shows one tag has two poses with similar images. The pose that makes the sequence of poses smoothest is
taken (Viterbi).

Source: MacKay, "Bayesian Interpolation".
"""

from copy import copy
from dataclasses import dataclass, replace

import numpy as np

from lmd.adjust.adjustment import CHANGE, Adjustment
from lmd.adjust.candidates import single_poses
from lmd.adjust.corners import Poses, agreeing, squared_errors
from lmd.adjust.links import turn_twist
from lmd.adjust.motion import DRIFT, SHORTEST_GAP, STEADY, SURE, Motion
from lmd.adjust.sightings import Sightings
from lmd.core.checks import FloatArray, IntArray
from lmd.geometry.se3 import angle_between, exp, inverse, log

ASSUMED_LINKS = 3.0  # weight of the prior of a spread, as a number of links
# Estimate of a spread: maximum number of steps, largest factor on the variance in a step, and relative change of the
# square that ends the estimate.
SPREAD_STEPS, MOST_CHANGE, SETTLED = 3, 10.0, 0.03
LONGEST_GAP, GAPS = 5.0, 13  # maximum length of a gap that is tested, seconds, and number of lengths that are tested
FEWEST_GAPS = 6  # minimum number of artificial gaps of each length
LEAST_PACE = 0.2  # minimum time over which the velocity on each side of a gap is measured, seconds
ROUGH_OFFSETS = np.arange(-25, 26) / 50.0  # offsets of clocks that are tried, seconds
# Errors of rough poses of frames: rotation, rad, and position, metres; and their growth by motion, per second.
ROUGH_TURN, ROUGH_PLACE, MOVING = 0.1, 0.15, 1.0


def with_motion(joint: Adjustment, motion: Motion) -> Adjustment:
    """Copy of the adjustment `joint` with the motion model `motion`. The model links the pairs of frames that were
    linked before.
    """
    assert joint.links is not None
    other, first = copy(joint), joint.links.first
    information = motion.information(joint.seen[first], joint.seen[first + 1])
    other.prior, other.links = replace(joint.prior, motion=motion), replace(joint.links, information=information)
    return other


def spread_motion(joint: Adjustment, poses: Poses, floor: float) -> Motion:
    """Motion model of the adjustment `joint` with the noise level (spread) that maximises the evidence. `floor`,
    pixels, is the standard deviation of corners in addition to the detector's own.
    """
    motion, links = joint.prior.motion, joint.links
    assert motion is not None
    assert links is not None
    if not len(links.first):
        return motion
    error, size = links.at(poses.frames[joint.seen]).error, links.size

    def evidence(motion: Motion) -> FloatArray:
        """Three terms of the evidence for a motion model, `(3,)`: chi^2 of the links between frames, log |Q| and log
        |H|. Q is the covariance of the links' errors, and H the normal matrix of the adjustment.
        """
        tried = joint if motion is joint.prior.motion else with_motion(joint, motion)
        assert tried.links is not None
        squares = tried.links.squares(error)
        volume = -float(np.linalg.slogdet(tried.links.information)[1].sum())
        fit = tried.system(poses, floor, 0.0, 1.0).log_determinant
        return np.array([float((tried.links.weights(squares) * squares).sum()), volume, fit])

    assumed, count = STEADY if motion.odometry is None else DRIFT, ASSUMED_LINKS * size / 2.0
    for _ in range(SPREAD_STEPS):
        here, growths = evidence(motion), np.ones(2)
        for which, own in enumerate(motion.spread):
            turn, place = (s * (1.0 + CHANGE) ** (0.5 * (k == which)) for k, s in enumerate(motion.spread))
            square, volume, fit = (evidence(replace(motion, spread=(turn, place))) - here) / np.log1p(CHANGE)
            most = volume + fit + count  # degrees of freedom of the errors after the fit
            growths[which] = (count * (assumed[which] / own) ** 2 - square) / max(most, count)
        growths = np.clip(growths, 1.0 / MOST_CHANGE, MOST_CHANGE)
        turn, place = motion.spread * np.sqrt(growths)
        motion = replace(motion, spread=(float(turn), float(place)))
        if np.abs(growths - 1.0).max() < SETTLED:
            break
    return motion


def measured_motion(joint: Adjustment, poses: Poses, floor: float) -> Motion:
    """Motion model of the adjustment `joint` with the noise level (spread) that maximises the evidence. A
    constant-velocity model also gets its measured errors across gaps between frames (`Motion.gaps`).

    Raises:
        InputError: odometry contradicts the images.
    """
    assert joint.links is not None
    joint.links.check(poses.frames[joint.seen])
    motion = spread_motion(joint, poses, floor)
    if motion.odometry is not None:
        return motion
    part = motion.of(joint.seen, np.zeros(len(joint.seen), dtype=np.int64))
    return replace(motion, gaps=bridged_gaps(part, poses.frames[joint.seen]))


def with_rough_clock(motion: Motion, frames: IntArray, part: IntArray, poses: FloatArray) -> Motion:
    """Copy of `motion` with the offset of the odometry's clock at which the odometry fits rough poses best. `motion`
    itself is returned if it has no odometry, or if the best offset is not significant.

    Args:
        motion: motion between all frames.
        frames: indices of n frames, `(n,)`.
        part: index of the group of tags (part) that each of these frames shows, `(n,)`; frames with equal indices share
            a world frame.
        poses: rough poses of these frames, `(n, 4, 4)`.
    """
    if motion.odometry is None:
        return motion
    own, odometry = motion.of(frames, part), motion.odometry
    links = own.links(np.arange(len(frames)))
    i, j = links.first, links.first + 1

    def loss(offset: float) -> float:
        before, after = (odometry.at(np.clip(own.times[k] + offset, *odometry.time[[0, -1]])) for k in (i, j))
        return replace(links, steps=inverse(before) @ after).loss(poses)

    best = min(ROUGH_OFFSETS.tolist(), key=loss)
    # The noise of the poses is unknown, so its variance is that of the best fit.
    is_sure = loss(0.0) > loss(best) * np.exp(SURE**2 / (6.0 * max(len(i), 1)))
    return motion.shifted(best) if is_sure else motion


def bridged_gaps(motion: Motion, poses: FloatArray) -> FloatArray:
    """Measure the noise level (spread) of the constant-velocity model across gaps, for several lengths of gap.

    Args:
        motion: motion model of constant velocity; `Motion.piece` has the index of the piece of the drive to which each
            frame belongs.
        poses: poses of the frames, `(F, 4, 4)`; frames of one piece are contiguous and share a world frame.

    Returns:
        one row for each length, `(n, 3)`: length of the gap, seconds; spread of rotation; spread of translation; see
        `Motion.gaps`.
    """
    assert motion.piece is not None
    rows, clock = [], motion.times - np.nanmin(motion.times)
    clock = clock + motion.piece * (np.nanmax(clock) + 10.0 * LONGEST_GAP)

    def nearest(seconds: FloatArray) -> IntArray:
        """For each of the times `seconds`, index of the frame with the nearest time. Times are those of `clock`:
        seconds, with a long pause added after each piece of the drive.
        """
        after = np.clip(np.searchsorted(clock, seconds), 1, len(clock) - 1)
        return np.asarray(after - (seconds - clock[after - 1] < clock[after] - seconds))

    pace = max(LEAST_PACE, float(np.median(np.diff(clock))))
    for gap in np.geomspace(SHORTEST_GAP, LONGEST_GAP, GAPS):
        ends = np.stack([nearest(clock + by) for by in (-pace, 0.0, gap, gap + pace)])
        before, lasts, after = np.diff(clock[ends], axis=0)
        fits = (np.abs(lasts - gap) < 0.13 * gap) & (np.abs(before - pace) < 0.5 * pace)
        fits &= np.abs(after - pace) < 0.5 * pace
        if len(np.unique((clock[ends[1][fits]] / gap).astype(np.int64))) < FEWEST_GAPS:
            continue
        first, i, j, last = poses[ends[:, fits]]
        before, lasts, after = (each[fits, None] for each in (before, lasts, after))
        into, out = log(inverse(first) @ i)[:, :3] / before, log(inverse(j) @ last)[:, :3] / after
        moving = (i - first)[:, :3, 3] / before + (last - j)[:, :3, 3] / after
        turn = log(exp(-turn_twist(lasts / 2.0 * (into + out))) @ inverse(i) @ j)[:, :3]
        place = (j - i)[:, :3, 3] - lasts / 2.0 * moving
        squares = [float((off**2).sum(axis=1).mean()) for off in (turn, place)]
        rows.append([gap, *np.sqrt(12.0 * np.array(squares) / gap**3)])
    return np.array(rows).reshape(-1, 3)


@dataclass(frozen=True)
class Nodes:
    """Nodes, sorted by part, then by time. A part is a group of tags, see `lmd.survey.groups`. A node is a pair of a
    frame and a part; the frame shows tags of this part.
    """

    sightings: Sightings
    """Sightings whose `frame` is the index of a node instead of a frame."""
    frame: IntArray
    """`(n,)` index of each node's frame."""
    part: IntArray
    """`(n,)` index of each node's part."""
    motion: Motion
    """Motion between the nodes of each part."""

    @classmethod
    def of(cls, sightings: Sightings, part: IntArray, motion: Motion) -> "Nodes":
        """Make the nodes of all sightings. `part` `(K,)` is the index of the part (group of tags) to which each tag
        belongs.
        """
        key, node = np.unique(part[sightings.tag] * sightings.frames + sightings.frame, return_inverse=True)
        order = np.argsort(node, kind="stable")
        own, frame = np.divmod(key, sightings.frames)
        some = replace(sightings.of(order), frame=node[order], frames=len(key))
        return cls(some, frame, own, motion.of(frame, own))

    def following(self, count: int) -> tuple[IntArray, IntArray]:
        """Pair each node with each of the `count` nodes that follow it in time, in any part. Returns the indices of the
        first node of each pair, and those of the second.
        """
        order = np.lexsort((self.part, self.frame))
        ends = [np.stack([order[:-k], order[k:]]) for k in range(1, min(count, len(order) - 1) + 1)]
        first, second = np.hstack([np.empty((2, 0), dtype=np.int64), *ends])
        return first, second


def smoothest(nodes: Nodes, poses: Poses) -> Poses:
    """Copy of `poses` in which poses of nodes replace those of frames. A node is a pair of a frame and a part (a group
    of tags); its pose is in the world frame of the part.

    A node keeps its rough pose if several of its sightings agree with that pose. Otherwise the sighting that is largest
    in the image proposes two poses. Of these, the pose that makes the sequence of nodes smoothest is taken.
    """
    some, motion, placed = nodes.sightings, nodes.motion, poses.frames[nodes.frame]
    order = np.lexsort((-some.sizes, some.frame))
    best = order[np.searchsorted(some.frame[order], np.arange(len(placed)))]
    single = single_poses(some.of(best))
    views = poses.tags[some.tag[best]][:, None] @ inverse(poses.mounts[some.camera[best]][:, None] @ single.poses)
    costs = np.stack([np.zeros(len(placed)), single.odds], axis=1)
    agree = agreeing(some, squared_errors(some, replace(poses, frames=placed)))
    several = np.bincount(some.frame[agree], minlength=len(placed)) >= 2
    views[several] = placed[several, None]
    follows = np.flatnonzero(motion.follows(np.arange(len(placed))))
    between = np.zeros((len(placed), 2, 2))  # cost of each pose for each pose of the previous node
    seconds = motion.times[follows + 1] - motion.times[follows]
    moving = 0.0 if motion.odometry else MOVING * seconds[:, None, None]
    expected = views[follows] @ motion.steps(follows, follows + 1)[:, None]
    off = inverse(expected)[:, None] @ views[follows + 1][:, :, None]
    turn = angle_between(off, np.eye(4)) / np.hypot(ROUGH_TURN, moving)
    place = np.linalg.norm(off[..., :3, 3], axis=-1) / np.hypot(ROUGH_PLACE, moving)
    between[follows + 1] = np.log1p(turn**2 + place**2)
    which = best_sequence(costs, between)
    return replace(poses, frames=views[np.arange(len(placed)), which])


def best_sequence(costs: FloatArray, between: FloatArray) -> IntArray:
    """Choose one of two poses for each of n sightings in a sequence, at the least total cost (Viterbi).

    Args:
        costs: cost of each pose, `(n, 2)`.
        between: `between[k, a, b]` is the cost of pose a of sighting k after pose b of sighting k - 1, `(n, 2, 2)`;
            `between[0]` is ignored.

    Returns:
        index of the chosen pose of each sighting, 0 or 1, `(n,)`.
    """
    chosen, total = np.zeros(costs.shape, dtype=np.int64), costs[0]
    for k in range(1, len(costs)):
        ways = between[k] + total
        chosen[k] = np.argmin(ways, axis=1)
        total = costs[k] + ways.min(axis=1)
        total = total - total.min()
    which = np.full(len(costs), np.argmin(total))
    for k in range(len(costs) - 1, 0, -1):
        which[k - 1] = chosen[k, which[k]]
    return which
