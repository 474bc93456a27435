"""What is known of tags before they are photographed: a plan, tags that were measured, or the frame of one tag."""

from dataclasses import dataclass

import numpy as np

from lmd.core.checks import FloatArray, IntArray, boolean, real
from lmd.geometry.se3 import inverse, pose_of
from lmd.scene.deployment import Deployment
from lmd.survey.adjustment import Prior

# Standard deviations of what is taken for exact, metres and rad.
EXACT = 1e-6
# With which the likeliest of several worlds is told, see `aligned`.
FREEDOM = 4.0


@dataclass(frozen=True)
class Hanging:
    """How far tags may hang from their plan: standard deviations, along each axis of the tag.

    Args:
        place: in the plane of the wall, metres.
        turn: in the plane of the wall, rad.
        flush: whether tags lie flat on their walls, so that those below hold; else `place` and `turn` do for all axes.
        depth: off the wall, metres, if flush.
        tilt: out of the wall, rad, if flush.

    Raises:
        InputError: one of them is not positive.
    """

    place: float = 0.02
    turn: float = 0.05
    flush: bool = True
    depth: float = 0.005
    tilt: float = 0.02

    def __post_init__(self) -> None:
        for name in ("place", "turn", "depth", "tilt"):
            object.__setattr__(self, name, real(name, getattr(self, name), above=0.0))
        boolean("flush", self.flush)

    @property
    def deviations(self) -> FloatArray:
        """Of the turns about x, y and z of a tag, and of the ways along them, `(6,)`."""
        tilt, depth = (self.tilt, self.depth) if self.flush else (self.turn, self.place)
        return np.array([tilt, tilt, self.turn, self.place, self.place, depth])


def poses_of(deployment: Deployment) -> FloatArray:
    """The poses of tags, x to their right, y up and z out of them, to the world, `(K, 4, 4)`."""
    up, normal = deployment.ups, deployment.normals
    return pose_of(np.stack([np.cross(up, normal), up, normal], axis=-1), deployment.places)


def prior_of(ids: IntArray, plan: Deployment | None, hanging: Hanging, fixed: Deployment | None) -> Prior:
    """What a plan, and tags whose places are exact, say of the tags with these `ids` `(K,)`.

    Args:
        ids: ascending.
        plan: where tags should hang; None for none.
        hanging: how far from there they may.
        fixed: where some hang exactly; None for none.
    """
    tags, information = np.tile(np.eye(4), (len(ids), 1, 1)), np.zeros((len(ids), 6))
    for known, deviations in ((plan, hanging.deviations), (fixed, np.full(6, EXACT))):
        if known is not None:
            _, of, among = np.intersect1d(ids, known.ids, return_indices=True)
            tags[of], information[of] = poses_of(known)[among], deviations**-2.0
    return Prior(tags, information)


def aligned(tags: FloatArray, prior: Prior) -> FloatArray | None:
    """The motion from the world of `tags` `(K, 4, 4)` to that of the prior, `(4, 4)`; None if it knows none of them.

    Every tag that is known proposes a motion; the one with which most of the others are where they are expected is
    taken.
    """
    known = np.flatnonzero(prior.information.any(axis=1) & np.isfinite(tags[:, 0, 0]))
    if not known.size:
        return None
    motions = prior.tags[known] @ inverse(tags[known])
    some = Prior(prior.tags[known], prior.information[known])
    costs = [np.log1p(some.squares(motion @ tags[known]) / FREEDOM).sum() for motion in motions]
    return np.asarray(motions[int(np.argmin(costs))])
