"""Covariances of parts of a map, and what is left of them once the map is laid where it belongs."""

import numpy as np

from lmd.core.checks import FloatArray
from lmd.geometry.se3 import adjoint, inverse


def blocks_of(covariance: FloatArray, count: int) -> FloatArray:
    """The covariances of `count` equal parts of the unknowns, each by itself, `(count, m, m)`."""
    size = len(covariance) // count
    return np.stack([covariance[size * k : size * (k + 1), size * k : size * (k + 1)] for k in range(count)])


def without_gauge(covariance: FloatArray, tags: FloatArray) -> FloatArray:
    """The covariance of tags once the map is laid over the true one: what each is off by beside the others.

    Args:
        covariance: of the twists of n tags, each in its own frame, `(6 n, 6 n)`.
        tags: their poses, `(n, 4, 4)`.
    """
    left = gauge_free(tags)
    return np.asarray(left @ covariance @ left.T)


def gauge_free(tags: FloatArray) -> FloatArray:
    """What is left of the twists of tags once the map is laid over the true one, as a matrix `(6 n, 6 n)`.

    With T the twists of all tags that one motion of the world leads to, `(6 n, 6)`, and T_p the rows of it that move
    their centres, the motion that fits best is g = T_p^+ x_p, and what is left of x is x - T g.

    Args:
        tags: their poses, `(n, 4, 4)`.
    """
    back = inverse(tags)
    motion = np.stack([adjoint(back, np.broadcast_to(axis, (len(tags), 6))) for axis in np.eye(6)], axis=-1)
    centres = np.tile(np.arange(6) >= 3, len(tags))
    motion = motion.reshape(-1, 6)
    fit = np.zeros((6, len(motion)))
    fit[:, centres] = np.linalg.pinv(motion[centres])
    return np.asarray(np.eye(len(motion)) - motion @ fit)
