"""How well a moment of a rig fixes its body: the information of its cameras' images, summed in the body's frame.

A camera at the offset o from the body's origin, world frame, moves by v - o x w when the body moves by v and turns by
w. What `information` has of it, A, g and C, then tells of (v, w) of the body

    [ C       B           ]      B = -C [o]x - [g]x
    [ B^T     A'          ]      A' = A - [o]x C [o]x - [o]x [g]x - [g]x [o]x

times the square of its focal length. Cameras measure independently, so their information adds up, of a landmark that
two of them see, too; it counts once among the n that a view needs. A rig of one camera at the body's origin gets the
figures of that camera alone.
"""

from itertools import pairwise
from typing import NamedTuple

import numpy as np

from lmd.core.checks import BoolArray, FloatArray, IntArray
from lmd.core.compiled import for_kernels, kernel
from lmd.core.threads import at_once
from lmd.geometry.se3 import skew
from lmd.objectives.localisation.information import SINGULAR, WIDTH, PosePrecision, Precision, share_of
from lmd.objectives.localisation.kernels import landmark_moments
from lmd.scene.camera import Camera
from lmd.scene.criteria import pixel_density
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
        position, rotation = variances(*body_information(evaluator, deployment, moments, precision))
        if kept is not None:
            kept[moments.place, moments.orientation] = position
        if precision.asks:
            localised = total(_is_enough(position, rotation, precision))
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
        told = variances(*body_information(evaluator, deployment, moments.some(found), precision))
        found[found] = _is_enough(*told, precision)
    return found


def _is_enough(position: FloatArray, rotation: FloatArray, precision: Precision | PosePrecision) -> BoolArray:
    return (position <= precision.position) & (rotation <= getattr(precision, "rotation", np.inf))


def body_information(
    evaluator: Evaluator, deployment: Deployment, moments: Moments, precision: Precision | PosePrecision
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """The blocks C, B and A' of the sum over the cameras, `(N, 3, 3)` each, in the units of the first camera.

    Args:
        evaluator: the scene.
        deployment: K landmarks.
        moments: N of them.
        precision: has the edge of the tags.
    """
    scene, (positions, axes, seen) = evaluator.scene, moments[3:]
    assert isinstance(scene.camera, Rig)
    landmarks, normals = (for_kernels(v) for v in (deployment.positions, deployment.normals))
    blocks = np.zeros((3, len(positions), 3, 3))
    for camera, offsets, turned, its in zip(scene.cameras, *scene.camera.views(axes), seen, strict=True):
        sums = np.zeros((len(positions), WIDTH))
        at, look, sight = for_kernels(positions + offsets), for_kernels(turned.T), scene.visibility.sight(camera)
        gain = _worth_of_a_pixel(camera) / _worth_of_a_pixel(scene.cameras[0])
        _sum_moments(at, look, landmarks, normals, sight, for_kernels(its), precision, gain, sums)
        a, g, c, arm = _symmetric(sums[:, :6]), skew(sums[:, 6:9]), _symmetric(sums[:, 9:15]), skew(offsets)
        blocks += np.stack([c, -c @ arm - g, a - arm @ c @ arm - arm @ g - g @ arm])
    return blocks[0], blocks[1], blocks[2]


def _worth_of_a_pixel(camera: Camera) -> float:
    return float(np.prod(camera.focal_pixels))


def _symmetric(entries: FloatArray) -> FloatArray:
    """The matrices with the entries xx, xy, xz, yy, yz, zz, `(N, 6)` -> `(N, 3, 3)`."""
    return entries[:, [[0, 1, 2], [1, 3, 4], [2, 4, 5]]]


def variances(c: FloatArray, b: FloatArray, a: FloatArray) -> tuple[FloatArray, FloatArray]:
    """The traces of the covariances of position and rotation, `(N,)` each, infinite where something is open.

    Args:
        c, b, a: blocks of the information on (v, w), `(N, 3, 3)` each.
    """
    return _schur_trace(c, b, a), _schur_trace(a, np.swapaxes(b, 1, 2), c)


def _schur_trace(c: FloatArray, b: FloatArray, a: FloatArray) -> FloatArray:
    """tr (C - B A^-1 B^T)^-1."""
    with np.errstate(all="ignore"):
        around, det = _adjugate(a)
        rest, least = _adjugate(c - b @ around @ np.swapaxes(b, 1, 2) / det[:, None, None])
        value = np.trace(rest, axis1=1, axis2=2) / least
        fixed = (det > SINGULAR * np.trace(a, axis1=1, axis2=2) ** 3) & (least > 0.0) & (value > 0.0)
    return np.where(fixed, value, np.inf)


def _adjugate(matrix: FloatArray) -> tuple[FloatArray, FloatArray]:
    """det M M^-1 of symmetric matrices and det M, `(N, 3, 3)` and `(N,)`."""
    x, y, z = (matrix[:, i] for i in range(3))
    around = np.stack([np.cross(y, z), np.cross(z, x), np.cross(x, y)], axis=1)
    return around, (x * around[:, 0]).sum(axis=1)


@kernel
def _sum_moments(positions, axes, landmarks, normals, sight, seen, precision, gain, sums):  # type: ignore[no-untyped-def]
    """Add the 15 numbers of the landmarks that a camera covers to `sums` `(N, WIDTH)`, times `gain`.

    Args:
        positions, axes: of the camera, `(N, 3)` and `(6, N)`.
        landmarks, normals: `(K, 3)` each.
        sight: of the camera.
        seen: `(N, K)`.
        precision, gain, sums: see `body_information`.
    """
    moment = np.zeros(WIDTH)
    for i in range(len(positions)):
        for k in range(len(landmarks)):
            if seen[i, k]:
                x, y, z = (
                    landmarks[k, 0] - positions[i, 0],
                    landmarks[k, 1] - positions[i, 1],
                    landmarks[k, 2] - positions[i, 2],
                )
                (
                    moment[0], moment[1], moment[2], moment[3], moment[4], moment[5], moment[6], moment[7],
                    moment[8], moment[9], moment[10], moment[11], moment[12], moment[13], moment[14],
                ) = landmark_moments(
                    x, y, z, normals[k, 0], normals[k, 1], normals[k, 2], precision, k
                )  # fmt: skip
                weight = gain * pixel_density(sight, x, y, z, axes, i)
                for j in range(WIDTH):
                    sums[i, j] += share_of(moment[j], weight)
