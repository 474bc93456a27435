"""Sequences of frames: of two poses that look alike, those of the smoothest sequence (Viterbi)."""

from dataclasses import dataclass, replace

import numpy as np

from lmd.adjust.candidates import agreeing, best_sequence, single_poses
from lmd.adjust.corners import Poses, squared_errors
from lmd.adjust.motion import Motion
from lmd.adjust.sightings import Sightings
from lmd.core.checks import IntArray
from lmd.geometry.se3 import angle_between, inverse

# Errors of rough poses of frames: rotation, rad, and position, metres; and their growth by motion, per second.
ROUGH_TURN, ROUGH_PLACE, MOVING = 0.1, 0.15, 1.0


@dataclass(frozen=True)
class Nodes:
    """Nodes: pairs of a frame and a part that the frame shows, sorted by part, then by time."""

    sightings: Sightings
    """Sightings with nodes in place of frames."""
    frame: IntArray
    """`(n,)` frame of each node."""
    part: IntArray
    """`(n,)` part of each node."""
    motion: Motion
    """Motion between the nodes of each part."""

    @classmethod
    def of(cls, sightings: Sightings, part: IntArray, motion: Motion) -> "Nodes":
        """Nodes of all sightings of tags in parts `(K,)`."""
        key, node = np.unique(part[sightings.tag] * sightings.frames + sightings.frame, return_inverse=True)
        order = np.argsort(node, kind="stable")
        frame, own = key % sightings.frames, key // sightings.frames
        some = replace(sightings.of(order), frame=node[order], frames=len(key))
        return cls(some, frame, own, motion.of(frame, own))

    def following(self, count: int) -> tuple[IntArray, IntArray]:
        """Pairs of nodes, the second among the `count` nodes after the first in time."""
        order = np.lexsort((self.part, self.frame))
        ends = [(order[:-k], order[k:]) for k in range(1, min(count, len(order) - 1) + 1)]
        first, second = zip(*ends, strict=True) if ends else ((order[:0],), (order[:0],))
        return np.concatenate(first), np.concatenate(second)


def smoothest(nodes: Nodes, poses: Poses) -> Poses:
    """Poses of the nodes in the worlds of their parts: the smoothest sequence of poses from their largest sightings and
    from the rough poses of frames.
    """
    some, count = nodes.sightings, len(nodes.frame)
    order = np.lexsort((-some.sizes, some.frame))
    best = order[np.searchsorted(some.frame[order], np.arange(count))]
    single = single_poses(some.of(best))
    views = poses.tags[some.tag[best]][:, None] @ inverse(poses.mounts[some.camera[best]][:, None] @ single.poses)
    costs = np.stack([np.zeros(count), single.odds], axis=1)
    placed = poses.frames[nodes.frame]
    several = (
        np.bincount(some.frame[agreeing(some, squared_errors(some, replace(poses, frames=placed)))], minlength=count)
        >= 2
    )
    views[several] = placed[several, None]
    follows = np.flatnonzero(nodes.motion.follows(np.arange(count)))
    between = np.zeros((count, 2, 2))  # cost of each pose, given each pose of the previous node
    steps = nodes.motion.steps(follows, follows + 1)
    seconds = nodes.motion.times[follows + 1] - nodes.motion.times[follows]
    moving = 0.0 if nodes.motion.is_odometry else MOVING * seconds
    for here in range(2):
        for there in range(2):
            off = inverse(views[follows, here] @ steps) @ views[follows + 1, there]
            turn = angle_between(off, np.eye(4)) / np.hypot(ROUGH_TURN, moving)
            place = np.linalg.norm(off[:, :3, 3], axis=1) / np.hypot(ROUGH_PLACE, moving)
            between[follows + 1, there, here] = np.log1p(turn**2 + place**2)
    which = best_sequence(costs, between)
    return replace(poses, frames=views[np.arange(count), which])
