"""Covariances of a map that do not depend on the choice of its world frame (the *gauge*), and alignment of maps."""

import numpy as np

from lmd.core.checks import BoolArray, FloatArray, IntArray
from lmd.geometry.se3 import adjoint_matrix, inverse, log, pose_of

ARM = 0.1  # distance of a point on a tag's normal from the centre, metres; the point represents the normal in fits
NO_TURN = 0.05**2  # points with a smaller sum of squared distances from a line, m^2, determine no rotation
PLACE_SCALE, NORMAL_SCALE = 0.05, 0.2  # scales of the robust loss of centres, metres, and of normals, rad
PAIRS = 600  # maximum number of pairs of tags that propose a motion
REFINING_STEPS = 8


def rows_of(tags: IntArray) -> IntArray:
    """Indices `(6 n,)` of the rows of the n tags with indices `tags` `(n,)` in a matrix with six rows for each tag."""
    return np.asarray((6 * tags[:, None] + np.arange(6)).ravel())


def diagonal_blocks(covariance: FloatArray, size: int = 6) -> FloatArray:
    """Square blocks on the diagonal of the matrix `covariance` `(n size, n size)`, as an array `(n, size, size)`."""
    count = len(covariance) // size
    each = np.arange(count)
    return np.asarray(covariance.reshape(count, size, count, size)[each, :, each])


def gauge_free(tags: FloatArray) -> FloatArray:
    """Matrix L `(6 n, 6 n)` that removes the common motion of all tags from the twists of n tags.

    Let x `(6 n,)` be the twists of all tags, and T `(6 n, 6)` their derivative with respect to a motion of the world.
    T_p and x_p are the rows of T and x that belong to the tags' centres. The motion that fits x best is g = T_p^+ x_p,
    with the pseudoinverse T_p^+, so L x = x - T g. If P is the covariance of the twists, L P L^T is the covariance of
    the tags relative to each other.

    Args:
        tags: poses of the tags, `(n, 4, 4)`.
    """
    motion = adjoint_matrix(inverse(tags)).reshape(-1, 6)
    centres = np.tile(np.arange(6) >= 3, len(tags))
    fit = np.zeros((6, len(motion)))
    fit[:, centres] = np.linalg.pinv(motion[centres])
    return np.asarray(np.eye(len(motion)) - motion @ fit)


def in_world(poses: FloatArray, covariances: FloatArray) -> FloatArray:
    """Covariances of position and rotation (p, r) in the world frame, m^2 and rad^2, `(n, 6, 6)`.

    Args:
        poses: poses, `(n, 4, 4)`.
        covariances: covariances of the twists of the poses, X -> X exp(twist), `(n, 6, 6)`; matrices that are not
            finite do not change.
    """
    known, found = np.isfinite(covariances).all(axis=(1, 2)), covariances.copy()
    whole = world_from_twists(poses[known])
    found[known] = whole @ found[known] @ np.swapaxes(whole, 1, 2)
    return found


def world_from_twists(poses: FloatArray) -> FloatArray:
    """Matrices `(n, 6, 6)` that convert twists of poses to shifts along, then rotations about, the axes of the world. A
    twist is in the frame of its pose: X -> X exp(twist).
    """
    whole = np.zeros((len(poses), 6, 6))
    whole[:, :3, 3:] = whole[:, 3:, :3] = poses[:, :3, :3]
    return whole


def worst_sigmas(covariances: FloatArray) -> FloatArray:
    """Standard deviations of shift, metres, and rotation, rad, each in its worst direction, `(n, 2)`. `covariances`
    `(n, 6, 6)` are those of twists. The result is NaN where a covariance is NaN.
    """
    found, known = np.full((len(covariances), 2), np.nan), np.isfinite(covariances).all(axis=(1, 2))
    for column, part in enumerate((slice(3, 6), slice(0, 3))):
        largest = np.linalg.eigvalsh(covariances[known][:, part, part])[:, -1]
        found[known, column] = np.sqrt(np.maximum(largest, 0.0))
    return found


def twists_between(here: FloatArray, there: FloatArray) -> FloatArray:
    """Twists log(here^-1 there) from the poses `here` to the poses `there`, `(n, 6)`; NaN where a pose is unknown."""
    twists, known = np.full((len(here), 6), np.nan), np.isfinite(here[:, 0, 0]) & np.isfinite(there[:, 0, 0])
    twists[known] = log(inverse(here[known]) @ there[known])
    return twists


def align_tags(here: FloatArray, there: FloatArray) -> FloatArray | None:
    """Rigid motion that moves tags from one world to another, by a robust fit of their centres and normals.

    Pairs of tags propose motions. The motion with the least loss is refined by reweighted least squares over all tags.

    Args:
        here, there: poses of K tags in the first and in the second world, `(K, 4, 4)`; rotations about the normals do
            not matter.

    Returns:
        rigid motion, `(4, 4)`; None if the tags determine no rotation.
    """
    points, others = (tags[:, None, :3, 3] + [[0.0], [ARM]] * tags[:, None, :3, 2] for tags in (here, there))
    one, other = np.triu_indices(len(here), 1)
    some = np.unique(np.linspace(0, len(one) - 1, PAIRS).astype(np.int64)) if len(one) else one
    pairs = np.stack([one[some], other[some]], axis=1)
    motions, fixed = _fitted(points[pairs].reshape(-1, 4, 3), others[pairs].reshape(-1, 4, 3), np.ones((1, 4)))
    if not fixed.any():
        return None

    def squares(motion: FloatArray) -> FloatArray:
        """Squared difference between each tag's pose in `here`, moved by `motion`, and its pose in `there`, `(K,)`.

        The difference is the sum of (distance of the centres / `PLACE_SCALE`)^2 and (angle between the normals /
        `NORMAL_SCALE`)^2.
        """
        moved = motion @ here
        away = np.linalg.norm(moved[:, :3, 3] - there[:, :3, 3], axis=1) / PLACE_SCALE
        return np.asarray(away**2 + (angle_between_normals(moved, there) / NORMAL_SCALE) ** 2)

    best: FloatArray = min(motions[fixed], key=lambda motion: float(np.log1p(squares(motion)).sum()))
    for _ in range(REFINING_STEPS):
        weights = np.repeat(1.0 / (1.0 + squares(best)), 2)[None]
        motions, fixed = _fitted(points.reshape(1, -1, 3), others.reshape(1, -1, 3), weights)
        if not fixed[0]:
            break
        best = motions[0]
    return best


def angle_between_normals(here: FloatArray, there: FloatArray) -> FloatArray:
    """Angle between the normals of the two poses, `here` and `there`, of each tag, rad, `(K,)`."""
    return np.asarray(np.arccos(np.clip((here[:, :3, 2] * there[:, :3, 2]).sum(axis=1), -1.0, 1.0)))


def _fitted(points: FloatArray, others: FloatArray, weights: FloatArray) -> tuple[FloatArray, BoolArray]:
    """Rigid motions that map points to other points in the weighted least-squares sense (Kabsch).

    Args:
        points, others: n sets of m corresponding points each, `(n, m, 3)`.
        weights: weights of the points, `(n, m)` or `(1, m)`.

    Returns:
        motions, `(n, 4, 4)`; mask of the motions whose rotation the points determine, `(n,)`.
    """
    share = weights / weights.sum(axis=1, keepdims=True)
    middles = [(share[..., None] * each).sum(axis=1, keepdims=True) for each in (points, others)]
    away, towards = points - middles[0], others - middles[1]
    left, spread, right = np.linalg.svd(np.swapaxes(weights[..., None] * away, 1, 2) @ towards)
    right[:, 2] *= np.sign(np.linalg.det(left @ right))[:, None]
    turns = np.swapaxes(left @ right, 1, 2)
    ways = middles[1][:, 0] - (turns @ middles[0][:, 0, :, None])[..., 0]
    return pose_of(turns, ways), spread[:, 1] > NO_TURN
