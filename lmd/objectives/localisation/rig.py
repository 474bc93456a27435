"""Localised views of a rig: a view has the images of all cameras, whose information about the body is summed.

A rig with one camera at the body's origin gives the results of the single camera.
"""

import math
from functools import partial
from typing import Any, NamedTuple

import numpy as np

from lmd.core.bits import ONE, ZERO, Integer
from lmd.core.checks import BoolArray, FloatArray, IntArray
from lmd.core.compiled import for_kernels, kernel
from lmd.core.threads import in_parts
from lmd.geometry.vectors import row3
from lmd.objectives.localisation.ambiguity import body_has_one_pose, width_of
from lmd.objectives.localisation.information import Precision, body_variance, gain_of
from lmd.objectives.localisation.pairs import (
    GroupCoverage,
    Mounts,
    add_of_all,
    add_to_body,
    add_up,
    coverage_by_group,
    fill_views,
    seen_by_any,
    store_sums,
    tag_of,
    tags_of,
)
from lmd.objectives.localisation.views import ORIENTATION, VIEW, BodyViews, body_views, is_met, met_views
from lmd.scene.deployment import Deployment
from lmd.sight.evaluator import Evaluator
from lmd.sight.kernels import sum_weights
from lmd.sight.mounts import MountGroup
from lmd.sight.rig_views import RigViews
from lmd.sight.views import visible_to_each

VIEWS_AT_ONCE = 1 << 16  # greatest number of views in memory, 8 bytes per landmark and 64 views


def rig_views(
    evaluator: Evaluator, positions: FloatArray, normals: FloatArray, n: int, precision: Precision, keep: bool
) -> tuple[IntArray, IntArray, FloatArray]:
    """Compute P_n, L and the variance of each view, the fields of `evaluation.ViewValues`, for a rig.

    Arguments as in `evaluation.localised_views`. The precision is in units of the first camera's
    `deviation_per_variance`.
    """
    size, orientations = len(evaluator.positions), evaluator.axes.shape[1]
    covered, localised = np.zeros((2, len(positions), size), dtype=np.int64)
    kept = np.full((len(positions), size, orientations) if keep else (0, 0, 0), np.inf)
    order, weights = evaluator.blocks[0][:size], evaluator.weights
    pieces = max(math.ceil(size * orientations / VIEWS_AT_ONCE), evaluator.threads)

    def work(
        b: int, groups: tuple[MountGroup, ...], landmarks: Deployment, tags: FloatArray, first: int, last: int
    ) -> None:
        here = order[first:last]
        places, kinds = evaluator.positions[here], weights[here] if len(weights) > 1 else weights
        every, found = coverage_by_group(evaluator, groups, places, landmarks), np.zeros((2, len(here)), dtype=np.int64)
        variances = np.full((len(here), orientations), np.inf) if keep else np.empty((0, 0))
        _localise(every, places, tags, kinds, n, precision, precision.asks, body_views(), (found, variances))
        covered[b, here], localised[b, here] = found
        if keep:
            kept[b, here] = variances

    assert isinstance(evaluator.views, RigViews)
    for b in range(len(positions)):
        groups = evaluator.views.groups_among(positions[b], normals[b])
        deployed = Deployment(positions[b], normals[b]), tags_of(precision, positions[b], normals[b])
        in_parts(evaluator.threads, partial(work, b, groups, *deployed), size, pieces)
    return covered, localised, kept


@kernel
def _localise(
    every: tuple[GroupCoverage, ...], positions: FloatArray, tags: FloatArray, weights: IntArray, n: Integer,
    precision: Precision, asks: bool, views: BodyViews, out: tuple[IntArray, FloatArray],
) -> None:  # fmt: skip
    """Compute P_n (n landmarks are covered) and L (the view is localised), both quantised, at each position of a rig's
    body.

    Args:
        every: coverage of the landmarks for each mount group.
        positions: positions of the body, `(P, 3)`, metres.
        tags: centres and sides of the landmarks, result of `tags_of`.
        weights: quantised probability of each orientation, `(1, D)` or `(P, D)`.
        n, precision: number of landmarks that must be covered, and limits that a localised view must satisfy.
        asks: value of `Precision.asks`: True if n covered landmarks do not suffice for a localised view.
        views: working memory.
        out: two arrays. P_n is added to row 0 and L to row 1 of the first array, `(2, P)`. The second array, `(P, D)`
            filled with infinity, receives the variance of the body's position in each view of n landmarks or more. The
            variance of a view without a unique pose stays infinite. An empty second array skips the variances.
    """
    some: Any = np.zeros(max(n, 2), dtype=np.uint64)
    found, variances = out
    words = np.uint64(weights.shape[1]) // VIEW
    shown, bits = np.empty(len(tags), dtype=np.int64), views.lists[ORIENTATION]
    for p in range(np.uint64(len(positions))):
        place = row3(positions, p)
        for w in range(words):
            some[:] = ZERO
            listed = 0
            for k in range(len(tags)):
                seen = seen_by_any(every, p, k, w)
                if seen == ZERO:
                    continue
                shown[listed] = k
                listed += 1
                for j in range(len(some) - 1, 0, -1):
                    some[j] |= some[j - 1] & seen
                some[0] |= seen
            good = has = some[n - 1]
            if has and (asks or len(variances)):
                count = fill_views(has, precision, views)
                add_of_all(every, p, shown[:listed], w, place, tags, precision, views)
                if asks:
                    good = has & met_views(precision, views, count, some[1])
                for v in range(count if len(variances) else ZERO):
                    value, fixed = body_variance(views.rows, v, VIEW)
                    one_pose = some[1] >> bits[v] & ONE != ZERO
                    one_pose |= body_has_one_pose(precision.residual, views.rows, v, VIEW)
                    variances[p, w * VIEW + bits[v]] = value if fixed & one_pose else np.inf
            found[0, p] += sum_weights(ZERO, has, weights, p, w)
            found[1, p] += sum_weights(ZERO, good, weights, p, w)


class RigImages(NamedTuple):
    """Images of the C cameras of a rig in the N views with a positive probability."""

    place: IntArray
    """`(N,)` index of the body's position in each view."""
    orientation: IntArray
    """`(N,)` index of the body's orientation in each view."""
    weight: IntArray
    """`(N,)` quantised probability of each view."""
    positions: FloatArray
    """`(N, 3)` position of the body, metres."""
    axes: FloatArray
    """`(N, 6)` directions of the x axis of the body and of the body's right, unit vectors."""
    seen: BoolArray
    """`(C, N, K)` mask of the landmarks that each camera covers."""

    def some(self, which: BoolArray) -> "RigImages":
        """Copy with only the views in the mask `which` `(N,)`."""
        rows: dict[str, Any] = {name: getattr(self, name)[which] for name in self._fields[:-1]}
        return RigImages(**rows, seen=self.seen[:, which])


def images_of(evaluator: Evaluator, deployment: Deployment, here: slice = slice(None)) -> RigImages:
    """Images that a rig takes of a deployment from the positions `evaluator.positions[here]`."""
    places, axes = evaluator.positions[here], evaluator.scene.orientations.axes
    weights = evaluator.weights if len(evaluator.weights) == 1 else evaluator.weights[here]
    weights = np.broadcast_to(weights[:, : len(axes)], (len(places), len(axes)))
    p, a = np.nonzero(weights)
    return RigImages(
        p, a, weights[p, a], places[p], axes[a], visible_to_each(evaluator, deployment, places[p], axes[a])
    )


def covers(seen: BoolArray, n: int) -> BoolArray:
    """Mask `(N,)` of the views of a rig with at least n landmarks, each covered by at least one camera. `seen` `(C, N,
    K)` is the mask of the landmarks that each camera covers in each view.
    """
    return np.asarray(seen.any(axis=0).sum(axis=1) >= n)


def located(evaluator: Evaluator, deployment: Deployment, images: RigImages, n: int, precision: Precision) -> BoolArray:
    """Mask `(N,)` of the localised views among the views of `images`."""
    found = covers(images.seen, n)
    if precision.asks:
        those = images.some(found)
        sums, met = body_sums(evaluator, deployment, those, precision), np.empty(len(those.place), np.bool_)
        _decide(precision, sums, covers(those.seen, 2), body_views(), met)
        found[found] = met
    return found


def body_sums(evaluator: Evaluator, deployment: Deployment, images: RigImages, precision: Precision) -> FloatArray:
    """Fisher information about the body's pose from all images of each view, `(N, width_of(precision))`.

    The information is divided by (f / sigma)^2, with the focal length f of the first camera and the noise sigma of a
    corner, pixels. The information from other cameras is weighted by `gain_of`.
    """
    scene, (positions, axes, seen) = evaluator.scene, images[3:]
    assert scene.rig is not None
    tags = tags_of(precision, deployment.positions, deployment.normals)
    sums = np.zeros((len(positions), width_of(precision)))
    for camera, offsets, turned, its in zip(scene.cameras, *scene.rig.views(axes), seen, strict=True):
        there = for_kernels(offsets.T[None]), for_kernels(turned.T[None]), gain_of(camera, scene.cameras[0])
        mounts = Mounts(0, scene.visibility.sight(camera), *there)
        _add_images(mounts, for_kernels(positions), tags, for_kernels(its), precision, body_views(), sums)
    return sums


@kernel
def _decide(precision: Precision, sums: FloatArray, several: BoolArray, views: BodyViews, met: BoolArray) -> None:
    """Write into `met` `(N,)` True for each view of a rig that is within the limits of `precision`.

    `sums` `(N, width)` is the information of the views; `several` `(N,)` is True for views of two or more landmarks.
    """
    for i in range(np.uint64(len(met))):
        for j in range(np.uint64(sums.shape[1])):
            views.rows[j * VIEW] = sums[i, j]
        met[i] = is_met(views, precision, ZERO, several[i])


@kernel
def _add_images(
    mounts: Mounts, positions: FloatArray, tags: FloatArray, seen: BoolArray, precision: Precision, views: BodyViews,
    sums: FloatArray,
) -> None:  # fmt: skip
    """Add to `sums` `(N, width)` the information about the body's pose that one camera of a rig contributes to N views.

    `seen` `(N, K)` is the mask of the landmarks that this camera covers in each view. `mounts` has the camera's offset
    from the body and its axes in each view, `positions` `(N, 3)` the position of the body. `tags` is the result of
    `tags_of`.
    """
    for i in range(np.uint64(len(positions))):
        bit = ONE << i % VIEW
        fill_views(bit, precision, views)
        for k in range(len(tags)):
            if seen[i, k]:
                add_to_body(mounts, 0, i // VIEW, bit, row3(positions, i), tag_of(tags, k), 1.0, precision, views)
        add_up(precision, views)
        store_sums(sums, i // VIEW * VIEW, precision, views, ONE)
