"""Groups of tags that only motion joins: how well they are known beside each other."""

from dataclasses import dataclass

import numpy as np

from lmd.core.checks import FloatArray, IntArray
from lmd.geometry.se3 import inverse, skew
from lmd.survey.estimate import Estimate

NEAREST = 6  # tags of other groups that a tag is set beside


@dataclass(frozen=True)
class Joined:
    """Groups that motion has joined.

    Args:
        group: of each tag, as images alone connect them, `(K,)`; -1 for tags that are not in the map.
        sigma: standard deviation of the place of each group beside the nearest of the others, along the worst
            direction, metres, `(G,)`.
    """

    group: IntArray
    sigma: FloatArray


def joined_by(found: Estimate, group: IntArray) -> Joined:
    """The groups of a map that only motion joins.

    Args:
        found: with a motion.
        group: of each tag as images alone connect them, -1 for tags that they connect with none, `(K,)`.
    """
    alone = group < 0
    own = np.where(alone, group.max(initial=-1) + 1 + np.cumsum(alone), group)
    mapped = np.isfinite(found.covariances).all(axis=(1, 2))
    own = np.where(mapped, own, -1)
    own[mapped] = np.unique(own[mapped], return_inverse=True)[1]
    covariance = found.covariance
    best = np.full(int(own.max(initial=-1)) + 1, np.inf)
    places = found.poses.tags[:, :3, 3]
    for k in np.flatnonzero(mapped).tolist():
        others = np.flatnonzero(mapped & (own != own[k]))
        near = others[np.argsort(np.linalg.norm(places[others] - places[k], axis=1))[:NEAREST]]
        for other in near.tolist():
            between = inverse(found.poses.tags[k]) @ found.poses.tags[other]
            by_one = np.hstack([skew(between[:3, 3]), -np.eye(3)])
            slope = np.hstack([by_one, np.zeros((3, 3)), between[:3, :3]])
            rows = np.r_[6 * k : 6 * k + 6, 6 * other : 6 * other + 6]
            square = slope @ covariance[np.ix_(rows, rows)] @ slope.T
            best[own[k]] = min(best[own[k]], float(np.sqrt(np.linalg.eigvalsh(square)[-1])))
    return Joined(own, best)
