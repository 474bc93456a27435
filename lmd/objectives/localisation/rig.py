"""The views of a rig that are localised: moments of all its cameras, whose information is summed (`body`).

A rig of one camera at the body's origin gets the figures of that camera alone.
"""

from itertools import pairwise
from typing import NamedTuple

import numpy as np

from lmd.core.checks import BoolArray, FloatArray, IntArray
from lmd.core.compiled import for_kernels, kernel
from lmd.core.threads import at_once
from lmd.objectives.localisation.body import BODY_WIDTH, add_share, body_meets, gain_of, position_variance
from lmd.objectives.localisation.information import PosePrecision, Precision
from lmd.scene.deployment import Deployment
from lmd.scene.rig import Rig
from lmd.sight.evaluator import Evaluator
from lmd.sight.views import visible_to_each

VIEWS_AT_ONCE = 1 << 14  # of which the landmarks seen are kept


def rig_views(
    evaluator: Evaluator,
    positions: FloatArray,
    normals: FloatArray,
    n: int,
    precision: Precision | PosePrecision,
    keep: bool,
) -> tuple[IntArray, IntArray, FloatArray]:
    """See `views.localised_views`; the precision is in the units of the first camera."""
    size, orientations = len(evaluator.positions), len(evaluator.scene.orientations.axes)
    step = max(VIEWS_AT_ONCE // orientations, 1)
    parts = list(pairwise([*range(0, size, step), size]))
    covered, localised = np.zeros((2, len(positions), size), dtype=np.int64)
    kept = np.full((len(positions), size, evaluator.axes.shape[1]) if keep else (0, 0, 0), np.inf)
    for b, landmarks in enumerate(map(Deployment, positions, normals)):

        def work(part: tuple[int, int], b: int = b, landmarks: Deployment = landmarks) -> None:
            here = slice(*part)
            deviations = kept[b, here] if keep else None
            covered[b, here], localised[b, here] = _worth(evaluator, landmarks, here, n, precision, deviations)

        at_once(evaluator.threads, work, parts)
    return covered, localised, kept


def _worth(
    evaluator: Evaluator,
    deployment: Deployment,
    here: slice,
    n: int,
    precision: Precision | PosePrecision,
    kept: FloatArray | None,
) -> tuple[IntArray, IntArray]:
    """P_n and L in units at some of the positions, `(p,)` each; `kept` `(p, D)` receives the variances."""
    moments = moments_of(evaluator, deployment, here)
    enough = covers(moments.seen, n)
    moments = moments.some(enough)

    def total(which: BoolArray) -> IntArray:
        units = np.zeros(len(evaluator.positions[here]), dtype=np.int64)
        np.add.at(units, moments.place[which], moments.weight[which])
        return units

    covered = localised = total(np.ones(len(moments.place), dtype=np.bool_))
    if precision.asks or kept is not None:
        sums = body_information(evaluator, deployment, moments, precision)
        if kept is not None:
            kept[moments.place, moments.orientation] = _variances(sums)
        if precision.asks:
            localised = total(_meet(precision, sums))
    return covered, localised


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


def located(
    evaluator: Evaluator, deployment: Deployment, moments: Moments, n: int, precision: Precision | PosePrecision
) -> BoolArray:
    """Whether the moments are localised, `(N,)`."""
    found = covers(moments.seen, n)
    if precision.asks:
        found[found] = _meet(precision, body_information(evaluator, deployment, moments.some(found), precision))
    return found


def body_information(
    evaluator: Evaluator, deployment: Deployment, moments: Moments, precision: Precision | PosePrecision
) -> FloatArray:
    """What all cameras tell of the body in the units of the first one, `(N, BODY_WIDTH)`.

    Args:
        evaluator: the scene.
        deployment: K landmarks.
        moments: N of them.
        precision: has the size of the tags.
    """
    scene, (positions, axes, seen) = evaluator.scene, moments[3:]
    assert isinstance(scene.camera, Rig)
    landmarks, normals = (for_kernels(v) for v in (deployment.positions, deployment.normals))
    sums = np.zeros((len(positions), BODY_WIDTH))
    for camera, offsets, turned, its in zip(scene.cameras, *scene.camera.views(axes), seen, strict=True):
        poses = for_kernels(positions), for_kernels(offsets), for_kernels(turned.T)
        gain, sight = gain_of(camera, scene.cameras[0]), scene.visibility.sight(camera)
        _add_up(*poses, landmarks, normals, sight, for_kernels(its), precision, gain, sums)
    return sums


def _meet(precision: Precision | PosePrecision, sums: FloatArray) -> BoolArray:
    """Whether moments with these sums `(N, BODY_WIDTH)` are what the precision asks for, `(N,)`."""
    met = np.empty(len(sums), dtype=np.bool_)
    _decide(precision, sums, met)
    return met


def _variances(sums: FloatArray) -> FloatArray:
    """Of the positions, `(N,)`; infinite where something is open."""
    found = np.empty(len(sums))
    _find_variances(sums, found)
    return found


@kernel
def _decide(precision, sums, met):  # type: ignore[no-untyped-def]
    for v in range(len(sums)):
        met[v] = body_meets(precision, sums, v)


@kernel
def _find_variances(sums, found):  # type: ignore[no-untyped-def]
    for v in range(len(sums)):
        value, fixed = position_variance(sums, v)
        found[v] = value if fixed else np.inf


@kernel
def _add_up(positions, offsets, axes, landmarks, normals, sight, seen, precision, gain, sums):  # type: ignore[no-untyped-def]
    """Add what the landmarks tell that a camera covers to `sums` `(N, BODY_WIDTH)`.

    Args:
        positions: of the body, `(N, 3)`.
        offsets, axes: of the camera, `(N, 3)` and `(6, N)`.
        landmarks, normals: `(K, 3)` each.
        sight: of the camera.
        seen: `(N, K)`.
        precision, gain: see `add_share`.
    """
    row = np.zeros(BODY_WIDTH)
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
                add_share(sight, axes, i, x, y, z, nx, ny, nz, ox, oy, oz, precision, k, gain, 1.0, sums, i, row)
