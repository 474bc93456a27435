"""The views of a rig that are localised: moments of all its cameras, whose information is summed (`body`).

A rig of one camera at the body's origin gets the figures of that camera alone.
"""

import math
from functools import partial
from typing import Any, NamedTuple

import numpy as np

from lmd.core.bits import ONE, ZERO
from lmd.core.checks import BoolArray, FloatArray, IntArray
from lmd.core.compiled import for_kernels, kernel
from lmd.core.threads import in_parts
from lmd.objectives.localisation.body import body_meets, gain_of, position_variance
from lmd.objectives.localisation.looks import add_of_all, looks_of, seen_by_any
from lmd.objectives.localisation.rig_ambiguity import add_share, has_one_pose, width_of
from lmd.objectives.localisation.slots import ORIENTATION, VIEW, fill_slots, met_slots, new_slots, tags_of
from lmd.scene.deployment import Deployment
from lmd.sight.evaluator import Evaluator
from lmd.sight.kernels import sum_weights
from lmd.sight.rig_views import RigViews
from lmd.sight.stations import Part
from lmd.sight.views import visible_to_each

VIEWS_AT_ONCE = 1 << 16  # of which the landmarks seen are kept


def rig_views(
    evaluator: Evaluator,
    positions: FloatArray,
    normals: FloatArray,
    n: int,
    precision: Any,
    keep: bool,
) -> tuple[IntArray, IntArray, FloatArray]:
    """See `views.localised_views`; the precision is in the units of the first camera."""
    size, orientations = len(evaluator.positions), evaluator.axes.shape[1]
    covered, localised = np.zeros((2, len(positions), size), dtype=np.int64)
    kept = np.full((len(positions), size, orientations) if keep else (0, 0, 0), np.inf)
    order, weights = evaluator.blocks[0][:size], evaluator.weights
    pieces = max(math.ceil(size * orientations / VIEWS_AT_ONCE), evaluator.threads)

    def work(b: int, parts: tuple[Part, ...], landmarks: Deployment, tags: FloatArray, first: int, last: int) -> None:
        here = order[first:last]
        places, kinds = evaluator.positions[here], weights[here] if len(weights) > 1 else weights
        every, found = looks_of(evaluator, parts, places, landmarks), np.zeros((2, len(here)), dtype=np.int64)
        variances = np.full((len(here), orientations), np.inf) if keep else np.empty((0, 0))
        _localise(every, places, tags, kinds, n, precision, precision.asks, new_slots(), found, variances)
        covered[b, here], localised[b, here] = found
        if keep:
            kept[b, here] = variances

    assert isinstance(evaluator.views, RigViews)
    for b in range(len(positions)):
        parts = evaluator.views.parts_among(positions[b], normals[b])
        deployed = Deployment(positions[b], normals[b]), tags_of(precision, positions[b], normals[b])
        in_parts(evaluator.threads, partial(work, b, parts, *deployed), size, pieces)
    return covered, localised, kept


@kernel
def _localise(every, positions, tags, weights, n, precision, asks, slots, found, variances):  # type: ignore[no-untyped-def]
    """Find P_n and L in units, `found` `(2, P)`.

    Args:
        every: what the cameras cover, see `Looks`.
        positions: of the body, `(P, 3)`.
        tags: the landmarks, see `tags_of`.
        weights: of the orientations in units, `(1, D)` or `(P, D)`.
        n, precision, asks: see `kernels.localise_range`.
        slots: working memory.
        variances: `(P, D)` of infinity, receives those of the position where n are covered and one pose fits; empty if
            nobody asks.
    """
    some, words = np.zeros(max(n, 2), dtype=np.uint64), np.uint64(weights.shape[1]) // VIEW
    shown, bits = np.empty(len(tags), dtype=np.int64), slots.lists[ORIENTATION]
    for p in range(np.uint64(len(positions))):
        place = positions[p, 0], positions[p, 1], positions[p, 2]
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
                count = fill_slots(has, precision, slots)
                add_of_all(every, p, shown[:listed], w, place, tags, precision, slots)
                if asks:
                    good = has & met_slots(precision, slots, count, some[1])
                for v in range(count if len(variances) else ZERO):
                    value, fixed = position_variance(slots.rows, v, VIEW)
                    fixed &= (some[1] >> bits[v] & ONE != ZERO) | has_one_pose(precision, slots.rows, v, VIEW)
                    variances[p, w * VIEW + bits[v]] = value if fixed else np.inf
            found[0, p] += sum_weights(ZERO, has, weights, p, w)
            found[1, p] += sum_weights(ZERO, good, weights, p, w)


class Moments(NamedTuple):
    """N views of a body that occur.

    Args:
        place, orientation: which of the positions and of the orientations, `(N,)` each.
        weight: probability, in units, `(N,)`.
        positions, axes: of the body, `(N, 3)` and `(N, 6)`.
        seen: which landmarks each camera covers, `(C, N, K)`.
    """

    place: IntArray
    orientation: IntArray
    weight: IntArray
    positions: FloatArray
    axes: FloatArray
    seen: BoolArray

    def some(self, which: BoolArray) -> "Moments":
        """Those that `which` `(N,)` selects."""
        rows = {name: getattr(self, name)[which] for name in self._fields[:-1]}
        return self._replace(**rows, seen=self.seen[:, which])


def moments_of(evaluator: Evaluator, deployment: Deployment, here: slice = slice(None)) -> Moments:
    """What a rig sees of a deployment at some of an evaluator's positions."""
    places, axes = evaluator.positions[here], evaluator.scene.orientations.axes
    weights = evaluator.weights if len(evaluator.weights) == 1 else evaluator.weights[here]
    weights = np.broadcast_to(weights[:, : len(axes)], (len(places), len(axes)))
    p, a = np.nonzero(weights)
    return Moments(p, a, weights[p, a], places[p], axes[a], visible_to_each(evaluator, deployment, places[p], axes[a]))


def covers(seen: BoolArray, n: int) -> BoolArray:
    """Whether at least n landmarks are covered by any camera, `(C, N, K)` -> `(N,)`."""
    return np.asarray(seen.any(axis=0).sum(axis=1) >= n)


def located(evaluator: Evaluator, deployment: Deployment, moments: Moments, n: int, precision: Any) -> BoolArray:
    """Whether the moments are localised, `(N,)`."""
    found = covers(moments.seen, n)
    if precision.asks:
        those = moments.some(found)
        sums, met = body_information(evaluator, deployment, those, precision), np.empty(len(those.place), np.bool_)
        _decide(precision, sums.reshape(-1), covers(those.seen, 2), met)
        found[found] = met
    return found


def body_information(evaluator: Evaluator, deployment: Deployment, moments: Moments, precision: Any) -> FloatArray:
    """What all cameras tell of the body in the units of the first one, `(N, width_of(precision))`.

    Args:
        evaluator: the scene.
        deployment: K landmarks.
        moments: N of them.
        precision: has the size of the tags.
    """
    scene, (positions, axes, seen) = evaluator.scene, moments[3:]
    assert scene.rig is not None
    landmarks, normals = (for_kernels(v) for v in (deployment.positions, deployment.normals))
    sums = np.zeros((len(positions), width_of(precision)))
    for camera, offsets, turned, its in zip(scene.cameras, *scene.rig.views(axes), seen, strict=True):
        poses = for_kernels(positions), for_kernels(offsets), for_kernels(turned.T)
        gain, sight = gain_of(camera, scene.cameras[0]), scene.visibility.sight(camera)
        _add_up(*poses, landmarks, normals, sight, for_kernels(its), precision, gain, sums)
    return sums


@kernel
def _decide(precision, sums, several, met):  # type: ignore[no-untyped-def]
    """Find whether views with `several` landmarks and with the numbers `sums` are what the precision asks for."""
    width = len(sums) // max(len(met), 1)
    for i in range(len(met)):
        met[i] = body_meets(precision, sums, i * width, 1) & (several[i] | has_one_pose(precision, sums, i * width, 1))


@kernel
def _add_up(positions, offsets, axes, landmarks, normals, sight, seen, precision, gain, sums):  # type: ignore[no-untyped-def]
    """Add what the landmarks tell that a camera covers to `sums` `(N, width)`.

    Args:
        positions: of the body, `(N, 3)`.
        offsets, axes: of the camera, `(N, 3)` and `(6, N)`.
        landmarks, normals: `(K, 3)` each.
        sight: of the camera.
        seen: `(N, K)`.
        precision, gain: see `add_share`.
    """
    row = np.zeros(sums.shape[1])
    for i in range(len(positions)):
        ox, oy, oz = offsets[i, 0], offsets[i, 1], offsets[i, 2]
        for k in range(len(landmarks)):
            if seen[i, k]:
                x, y, z = (
                    landmarks[k, 0] - (positions[i, 0] + ox),
                    landmarks[k, 1] - (positions[i, 1] + oy),
                    landmarks[k, 2] - (positions[i, 2] + oz),
                )
                nx, ny, nz = normals[k, 0], normals[k, 1], normals[k, 2]
                add_share(sight, axes, i, x, y, z, nx, ny, nz, ox, oy, oz, precision, k, gain, sums, i, row)
