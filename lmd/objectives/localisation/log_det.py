"""The expected logarithm of the determinant of the information on the camera's pose: what greedy selection climbs.

How well a camera is localised is no submodular function of the landmarks: the first one alone is worth nothing. The
log det of the information is, if there is a prior to begin with and no landmark hides another: a further landmark adds
less the more is known. It is averaged over positions and orientations. The prior is what the camera knew before: a
standard deviation of some tolerances makes landmarks share the room, where a wide one would see the first view of a
place as a greater gain than the accuracy of another.
"""

from collections.abc import Callable
from typing import Any

import numpy as np

from lmd.core.checks import FloatArray
from lmd.core.compiled import inlined, kernel
from lmd.objectives.localisation.information import WIDTH, log_det, share_of
from lmd.objectives.localisation.kernels import landmark_moments
from lmd.scene.criteria import covers, pixel_density
from lmd.scene.deployment import Deployment
from lmd.scene.scene import Scene
from lmd.sight.evaluator import Evaluator
from lmd.sight.obstacles import find_ends, no_ends
from lmd.sight.poses import by_edge, shared
from lmd.sight.viewpoint import see_alone


@inlined
def _log_det_with(sums, p, a, moment, weight):
    """`log_det` of view (p, a) of `sums` `(P, D, WIDTH)` once a landmark with a `moment` is added."""
    return log_det(
        sums[p, a, 0] + share_of(moment[0], weight), sums[p, a, 1] + share_of(moment[1], weight),
        sums[p, a, 2] + share_of(moment[2], weight), sums[p, a, 3] + share_of(moment[3], weight),
        sums[p, a, 4] + share_of(moment[4], weight), sums[p, a, 5] + share_of(moment[5], weight),
        sums[p, a, 6] + share_of(moment[6], weight), sums[p, a, 7] + share_of(moment[7], weight),
        sums[p, a, 8] + share_of(moment[8], weight), sums[p, a, 9] + share_of(moment[9], weight),
        sums[p, a, 10] + share_of(moment[10], weight), sums[p, a, 11] + share_of(moment[11], weight),
        sums[p, a, 12] + share_of(moment[12], weight), sums[p, a, 13] + share_of(moment[13], weight),
        sums[p, a, 14] + share_of(moment[14], weight),
    )  # fmt: skip


@kernel
def _log_det_of(row):
    """`log_det` of `row` `(WIDTH,)`."""
    return log_det(
        row[0], row[1], row[2], row[3], row[4], row[5], row[6], row[7], row[8], row[9], row[10], row[11], row[12],
        row[13], row[14],
    )  # fmt: skip


@kernel
def _gains(start, stop, points, normals, prices, positions, sight, obstacles, axes, bands, precision, sums, known, out):
    """Write what poses `start` to `stop` gain into `out` `(N,)`.

    Args:
        points, normals: `(N, 3)`.
        prices: of positions and axes, `(P, D)`.
        positions: `(P, 3)`.
        sight, obstacles, axes, bands: see `kernels.evaluate_range`.
        precision: the size of a tag.
        sums: what is known of each view, `(P, D, WIDTH)`.
        known: their `log_det`, `(P, D)`.
    """
    ends = no_ends(obstacles, 1)
    for j in range(start, stop):
        nx, ny, nz, gain = normals[j, 0], normals[j, 1], normals[j, 2], 0.0
        pose = points[j, 0], points[j, 1], points[j, 2], nx, ny, nz
        find_ends(obstacles, sight, points[j, 0], points[j, 1], points[j, 2], nx, ny, nz, ends, 0)
        for p in range(len(positions)):
            x, y, z, low, first, last = see_alone(pose, positions, p, sight, obstacles, ends, bands)
            if first == last:
                continue
            moment = landmark_moments(x, y, z, nx, ny, nz, precision, 0)
            for a in range(np.uint64(first), np.uint64(last)):
                if covers(sight, x, y, z, nx, ny, nz, low, 0.0, axes, a):
                    more = _log_det_with(sums, p, a, moment, pixel_density(sight, x, y, z, axes, a))
                    gain += prices[p, a] * (more - known[p, a])
        out[j] = gain


@kernel
def _add(start, stop, point, normal, positions, sight, obstacles, axes, bands, precision, sums, known):
    """Add a landmark to `sums` and `known` at the positions `start` to `stop`; args as in `_gains`."""
    nx, ny, nz = normal[0], normal[1], normal[2]
    ends = no_ends(obstacles, 1)
    find_ends(obstacles, sight, point[0], point[1], point[2], nx, ny, nz, ends, 0)
    pose = point[0], point[1], point[2], nx, ny, nz
    for p in range(start, stop):
        x, y, z, low, first, last = see_alone(pose, positions, p, sight, obstacles, ends, bands)
        if first == last:
            continue
        moment = landmark_moments(x, y, z, nx, ny, nz, precision, 0)
        for a in range(np.uint64(first), np.uint64(last)):
            if covers(sight, x, y, z, nx, ny, nz, low, 0.0, axes, a):
                weight = pixel_density(sight, x, y, z, axes, a)
                known[p, a] = _log_det_with(sums, p, a, moment, weight)
                for i in range(len(moment)):
                    sums[p, a, i] += share_of(moment[i], weight)


class LogDeterminant:
    """The mean over positions and orientations of log det(prior + information), a `Selection`.

    Args:
        evaluator: the scene.
        relevance: weights of its positions, `(P,)`.
        precision: the size of the tags of a scene, see `information.precision`.
        position, rotation: information known beforehand, in the units of `information`: 1 / `variance`.
    """

    label = "mean log det of the information"

    def __init__(
        self,
        evaluator: Evaluator,
        relevance: FloatArray,
        precision: Callable[[Scene], Any],
        position: float,
        rotation: float,
    ) -> None:
        evaluator.check_memory(8 * (WIDTH + 2))
        self._evaluator, self._precision = evaluator, precision
        self._prices = relevance[:, None] / relevance.sum() * evaluator.probability
        start = np.zeros(WIDTH)
        start[[0, 3, 5]], start[[9, 12, 14]] = rotation, position
        self._sums = np.tile(start, (*self._prices.shape, 1))
        self._known = np.full(self._prices.shape, _log_det_of(start))

    def gains(self, poses: Deployment) -> FloatArray:
        """See `Selection.gains`."""
        gained = np.empty(len(poses))
        for e, index in by_edge(self._evaluator, poses):
            out = np.empty(len(index))
            fixed = (poses.positions[index], poses.normals[index], self._prices, *self._parts(e), out)
            shared(_gains, len(index), e.threads, fixed)
            gained[index] = out
        return gained

    def add(self, pose: Deployment) -> None:
        """See `Selection.add`."""
        for e, _ in by_edge(self._evaluator, pose):
            shared(_add, len(e.positions), e.threads, (pose.positions[0], pose.normals[0], *self._parts(e)))

    def _parts(self, e: Evaluator) -> tuple[Any, ...]:
        """What kernels take beside the poses, whose tags have the one size of an evaluator."""
        precision = self._precision(e.scene)
        return e.positions, e.sight, e.obstacles, e.axes, e.bands, precision, self._sums, self._known
