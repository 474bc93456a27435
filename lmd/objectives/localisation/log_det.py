"""Expected log determinant of the information about the pose: the surrogate of localisation for greedy selection.

The accuracy of localisation is not submodular in the landmarks, because the first landmark by itself has no value. The
log determinant of the sum of prior and information is submodular if no landmark hides another: each further landmark
adds less. The surrogate is the mean over positions and orientations. The prior is the information about the pose before
the image. With a prior standard deviation of a few tolerances, the selected landmarks spread over the room. With a wide
prior, the first view of one place would gain more than any improvement of another place.
"""

import math
from collections.abc import Callable
from typing import Any, TypeAlias

import numpy as np

from lmd.core.bits import ZERO, Integer
from lmd.core.checks import FloatArray
from lmd.core.compiled import kernel
from lmd.core.threads import in_parts
from lmd.geometry.vectors import row3
from lmd.objectives.localisation.information import (
    BODY_WIDTH,
    NUMBERS,
    WIDTH,
    Precision,
    body_log_det,
    log_det,
    share_of,
)
from lmd.objectives.localisation.pairs import (
    GroupCoverage,
    add_of_all,
    coverage_by_group,
    fill_views,
    load_sums,
    seen_by_any,
    store_sums,
    tags_of,
)
from lmd.objectives.localisation.reference import information_of, log_det_of
from lmd.objectives.localisation.views import ORIENTATION, VIEW, BodyViews, body_views, landmark_moments
from lmd.scene.criteria import covers, pixel_density
from lmd.scene.deployment import Deployment
from lmd.scene.scene import Scene
from lmd.sight.evaluator import Evaluator
from lmd.sight.mounts import with_sight
from lmd.sight.obstacles import find_ends, new_ends
from lmd.sight.poses import by_edge, shared
from lmd.sight.viewpoint import see_alone

# Greatest number of poses per thread for which the views of a rig are in memory at a time.
AT_A_TIME = 64
Prior: TypeAlias = tuple[float, float]
# Indices of the numbers of a view on the diagonal of the information: position, rotation.
OF_CAMERA, OF_BODY = ([9, 12, 14], [0, 3, 5]), ([0, 3, 5], [15, 18, 20])


def log_det_selection(
    evaluator: Evaluator, relevance: FloatArray, precision: Callable[[Scene], Precision], prior: Prior
) -> "LogDeterminant":
    """Surrogate for greedy selection (a `Selection`): the mean of log det(prior + information) over positions and
    orientations.

    Args:
        evaluator: scene and positions.
        relevance: weights of the positions, `(P,)`.
        precision: function that returns the `information.Precision` for a scene, which includes the size of the scene's
            tags.
        prior: information before the image, along each axis: a number for the position and a number for the rotation.
            Each number is the square of `information.deviation_per_variance`, divided by a variance (m^2 or rad^2).
    """
    kind: type[LogDeterminant] = RigLogDeterminant if evaluator.groups else CameraLogDeterminant
    if evaluator.by_reference:
        kind = ReferenceLogDeterminant
    return kind(evaluator, relevance, precision, prior)


class LogDeterminant:
    """Base of the surrogates that `log_det_selection` returns.

    A subclass implements `log_det_of`, `gains_of` and `choose`.
    """

    label = "mean log det of the information"
    width = WIDTH
    of_camera = True

    def __init__(
        self, evaluator: Evaluator, relevance: FloatArray, precision: Callable[[Scene], Precision], known: Prior
    ) -> None:
        evaluator.check_memory(8 * (self.width + 2))
        self.evaluator, self.precision = evaluator, precision
        self.prices = relevance[:, None] / relevance.sum() * evaluator.probability
        prior, (of_position, of_rotation) = np.zeros(self.width), OF_CAMERA if self.of_camera else OF_BODY
        prior[of_position], prior[of_rotation] = known
        self.sums = np.tile(prior, (*self.prices.shape, 1))
        self.known = np.full(self.prices.shape, self.log_det_of(prior))

    def gains(self, poses: Deployment) -> FloatArray:
        """See `Selection.gains`."""
        gained = np.empty(len(poses))
        for e, index in by_edge(self.evaluator, poses):
            gained[index] = self.gains_of(e, poses[index])
        return gained

    def add(self, pose: Deployment) -> None:
        """See `Selection.add`."""
        for e, _ in by_edge(self.evaluator, pose):
            self.choose(e, pose)

    def log_det_of(self, numbers: FloatArray) -> Any:
        """Log determinant of the information in one view.

        `numbers` `(width,)` are the information, in the order of the module `information`.
        """
        raise NotImplementedError

    def gains_of(self, e: Evaluator, poses: Deployment) -> FloatArray:
        """Gains of N poses, `(N,)`: the increase of the mean log determinant by a tag at each pose.

        All tags have the size of evaluator `e`.
        """
        raise NotImplementedError

    def choose(self, e: Evaluator, pose: Deployment) -> None:
        """Add a landmark at `pose` to the chosen landmarks; the tags of evaluator `e` have the landmark's size.

        The landmark's information is added to the information of each view, `sums`, and the log determinant of each
        view, `known`, is updated.
        """
        raise NotImplementedError


@kernel
def _log_det_of(row: FloatArray) -> Any:
    return log_det(row, 0, 1)


@kernel
def _gains(
    start: Integer, stop: Integer, points: FloatArray, normals: FloatArray, prices: FloatArray, parts: Any,
    out: FloatArray,
) -> None:  # fmt: skip
    """Write the gains of the poses `start` to `stop - 1` into `out` `(N,)`.

    The gain of a pose is the increase of the mean log determinant by a landmark at this pose.

    Args:
        start, stop: range of the poses.
        points, normals: positions, metres, and unit normals of the poses, `(N, 3)`.
        prices: weight of each view (position and axis) in the mean, relevance times probability, `(P, D)`.
        parts: tuple of eight values, which the next entries (`positions` to `known`) describe in this order.
        positions: positions of the camera, metres, `(P, 3)`.
        sight, obstacles, axes, bands: see `kernels.evaluate_range`.
        precision: size of the tags, and weight of their corners.
        sums: information of each view, from the prior and the chosen landmarks, `(P, D, WIDTH)`.
        known: `log_det` of each view, `(P, D)`.
        out: receives the gains.
    """
    positions, sight, obstacles, axes, bands, precision, sums, known = parts
    ends, moment, row = new_ends(obstacles, 1), np.zeros(WIDTH), np.zeros(WIDTH)
    for j in range(start, stop):
        place, normal, gain = row3(points, j), row3(normals, j), 0.0
        find_ends(obstacles, sight, place, normal, ends, 0)
        for p in range(len(positions)):
            offset, low, first, last = see_alone((place, normal), positions, p, sight, obstacles, ends, bands)
            if first == last:
                continue
            landmark_moments(offset, normal, precision, 0, moment)
            for a in range(np.uint64(first), np.uint64(last)):
                if covers(sight, offset, normal, low, 0.0, axes, a):
                    weight = pixel_density(sight, offset, axes, a)
                    for i in range(NUMBERS):
                        row[i] = sums[p, a, i] + share_of(moment[i], weight)
                    gain += prices[p, a] * (log_det(row, 0, 1) - known[p, a])
        out[j] = gain


@kernel
def _add(start: Integer, stop: Integer, points: FloatArray, normals: FloatArray, parts: Any) -> None:
    """Add the information of a landmark to the views that cover the landmark, and update their log determinants.

    The landmark is row 0 of `points` and `normals`, `(1, 3)`: position (metres) and unit normal. Only views from the
    camera positions `start` to `stop - 1` are updated.

    `parts` is the tuple that `_gains` describes. Two of its arrays are updated: `sums` `(P, D, WIDTH)`, the information
    of each view, and `known` `(P, D)`, the log determinant of this information.
    """
    positions, sight, obstacles, axes, bands, precision, sums, known = parts
    place, normal = row3(points, 0), row3(normals, 0)
    ends, moment = new_ends(obstacles, 1), np.zeros(WIDTH)
    find_ends(obstacles, sight, place, normal, ends, 0)
    for p in range(start, stop):
        offset, low, first, last = see_alone((place, normal), positions, p, sight, obstacles, ends, bands)
        if first == last:
            continue
        landmark_moments(offset, normal, precision, 0, moment)
        for a in range(np.uint64(first), np.uint64(last)):
            if covers(sight, offset, normal, low, 0.0, axes, a):
                weight = pixel_density(sight, offset, axes, a)
                for i in range(NUMBERS):
                    sums[p, a, i] += share_of(moment[i], weight)
                known[p, a] = log_det(sums[p, a], 0, 1)


class CameraLogDeterminant(LogDeterminant):
    """Surrogate for greedy selection: the mean log determinant of the information about the pose of a single camera."""

    def log_det_of(self, numbers: FloatArray) -> Any:
        """See `LogDeterminant.log_det_of`."""
        return _log_det_of(numbers)

    def gains_of(self, e: Evaluator, poses: Deployment) -> FloatArray:
        """See `LogDeterminant.gains_of`."""
        out = np.empty(len(poses))
        shared(_gains, len(poses), e.threads, (poses.positions, poses.normals, self.prices, self._parts(e), out))
        return out

    def choose(self, e: Evaluator, pose: Deployment) -> None:
        """See `LogDeterminant.choose`."""
        shared(_add, len(e.positions), e.threads, (pose.positions, pose.normals, self._parts(e)))

    def _parts(self, e: Evaluator) -> tuple[Any, ...]:
        """Tuple `parts` for the kernels `_gains` and `_add`; the last two values are the arrays `sums` and `known`."""
        return e.positions, e.sight, e.obstacles, e.axes, e.bands, self.precision(e.scene), self.sums, self.known


@kernel
def _rig_gains(
    every: tuple[GroupCoverage, ...], tags: FloatArray, prices: FloatArray, positions: FloatArray, precision: Precision,
    sums: FloatArray, known: FloatArray, views: BodyViews, out: FloatArray,
) -> None:  # fmt: skip
    """Write the gains of N poses for a rig into `out` `(N,)`.

    The gain of a pose is the increase of the mean log determinant by a tag at this pose.

    Args:
        every: orientations of the body with which each mount group (equal cameras) covers a tag at each pose.
        tags: centres and sides of the tags at the poses, see `tags_of`.
        prices: weight of each view (position and orientation) in the mean, relevance times probability, `(P, D)`.
        positions: positions of the body, `(P, 3)`, metres.
        precision: size of the tags, and weight of their corners.
        sums: information of each view, from the prior and the chosen tags, `(P D, BODY_WIDTH)`.
        known: `body_log_det` of each view, `(P, D)`.
        views: working memory.
        out: receives the gains.
    """
    words, which, bits = np.uint64(known.shape[1]) // VIEW, np.zeros(1, dtype=np.int64), views.lists[ORIENTATION]
    for j in range(len(out)):
        which[0], out[j] = j, 0.0
        for p in range(np.uint64(len(positions))):
            place = row3(positions, p)
            for w in range(words):
                seen, first = seen_by_any(every, p, j, w), (p * words + w) * VIEW
                if seen == ZERO:
                    continue
                count = fill_views(seen, precision, views)
                load_sums(sums, first, precision, views, count)
                add_of_all(every, p, which, w, place, tags, precision, views)
                for v in range(count):
                    a = w * VIEW + bits[v]
                    out[j] += prices[p, a] * (body_log_det(views.rows, v, VIEW) - known[p, a])


@kernel
def _rig_add(
    every: tuple[GroupCoverage, ...], tags: FloatArray, positions: FloatArray, precision: Precision, sums: FloatArray,
    known: FloatArray, views: BodyViews,
) -> None:  # fmt: skip
    """Add the information of a tag to the views of a rig that show the tag, and update their log determinants.

    The updated arrays are `sums`, the information of each view, and `known`, the log determinant of this information.
    The tag is the only one in `every` and `tags`; the other arguments are as in `_rig_gains`.
    """
    words, which, bits = np.uint64(known.shape[1]) // VIEW, np.zeros(1, dtype=np.int64), views.lists[ORIENTATION]
    for p in range(np.uint64(len(positions))):
        place = row3(positions, p)
        for w in range(words):
            seen, first = seen_by_any(every, p, 0, w), (p * words + w) * VIEW
            if seen == ZERO:
                continue
            count = fill_views(seen, precision, views)
            add_of_all(every, p, which, w, place, tags, precision, views)
            store_sums(sums, first, precision, views, count)
            for v in range(count):
                known[p, w * VIEW + bits[v]] = body_log_det(sums[first + bits[v]], 0, 1)


class RigLogDeterminant(LogDeterminant):
    """Surrogate for greedy selection: the mean log determinant of the information about the pose of a rig's body."""

    width, of_camera = BODY_WIDTH, False

    def log_det_of(self, numbers: FloatArray) -> Any:
        """See `LogDeterminant.log_det_of`."""
        return body_log_det(numbers, 0, 1)

    def gains_of(self, e: Evaluator, poses: Deployment) -> FloatArray:
        """See `LogDeterminant.gains_of`."""
        out, precision = np.empty(len(poses)), self.precision(e.scene)

        def work(first: int, last: int) -> None:
            these = poses[first:last]
            tags = tags_of(precision, these.positions, these.normals)
            known = self.prices, e.positions, precision, self._rows, self.known, body_views()
            _rig_gains(self._shown(e, these), tags, *known, out[first:last])

        in_parts(e.threads, work, len(poses), math.ceil(len(poses) / AT_A_TIME))
        return out

    def choose(self, e: Evaluator, pose: Deployment) -> None:
        """See `LogDeterminant.choose`."""
        precision = self.precision(e.scene)
        tags = tags_of(precision, pose.positions, pose.normals)
        _rig_add(self._shown(e, pose), tags, e.positions, precision, self._rows, self.known, body_views())

    @property
    def _rows(self) -> FloatArray:
        return self.sums.reshape(-1, self.width)

    def _shown(self, e: Evaluator, poses: Deployment) -> tuple[GroupCoverage, ...]:
        """Orientations of the body with which each mount group (equal cameras) covers a tag at each of the poses.

        Landmarks do not hide each other here.
        """
        groups = tuple(with_sight(group, group.sight.unhidden()) for group in e.groups)
        return coverage_by_group(e, groups, e.positions, poses)


class ReferenceLogDeterminant(LogDeterminant):
    """The surrogate for greedy selection computed with NumPy, for visibility models that kernels cannot use."""

    def __init__(self, evaluator: Evaluator, *prior: Any) -> None:
        self.of_camera = evaluator.scene.rig is None
        self.width = WIDTH if self.of_camera else BODY_WIDTH
        self._scene, self._axes = evaluator.scene, evaluator.scene.orientations.axes
        super().__init__(evaluator, *prior)

    def log_det_of(self, numbers: FloatArray) -> Any:
        """See `LogDeterminant.log_det_of`."""
        return log_det_of(self._scene, np.repeat(numbers[:, None], len(self._axes), axis=1))[0]

    def gains_of(self, e: Evaluator, poses: Deployment) -> FloatArray:
        """See `LogDeterminant.gains_of`."""
        gained, size = np.zeros(len(poses)), len(self._axes)
        for j in range(len(poses)):
            for p in range(len(e.positions)):
                more = log_det_of(e.scene, self._with(e, poses[j : j + 1], p))
                gained[j] += self.prices[p, :size] @ (more - self.known[p, :size])
        return gained

    def choose(self, e: Evaluator, pose: Deployment) -> None:
        """See `LogDeterminant.choose`."""
        size = len(self._axes)
        for p in range(len(e.positions)):
            sums = self._with(e, pose, p)
            self.sums[p, :size], self.known[p, :size] = sums.T, log_det_of(e.scene, sums)

    def _with(self, e: Evaluator, pose: Deployment, p: int) -> FloatArray:
        """Information of the views from position p, with an additional landmark at `pose`, `(width, D)`."""
        sums, _ = information_of(e.scene_at(p), pose, self.precision(e.scene), e.positions[p], self._axes)
        return np.asarray(self.sums[p, : len(self._axes)].T + sums)
