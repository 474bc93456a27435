"""Reference of localisation in NumPy, one function per formula; compiled code must equal the reference bit for bit.

The reference also evaluates scenes that compiled code cannot evaluate, because their visibility model has NumPy
functions only (`reference_views`, `log_det.ReferenceLogDeterminant`).

Shapes: A orientations, K landmarks.
"""

from statistics import NormalDist
from typing import Any

import numpy as np

from lmd.core.checks import BoolArray, FloatArray, IntArray
from lmd.geometry.lens_models import area_per_solid_angle
from lmd.geometry.se3 import axis_and_right, cross
from lmd.geometry.squares import upright
from lmd.objectives.localisation.ambiguity import (
    CONFIDENCE,
    body_has_one_pose,
    camera_residual,
    has_one_pose,
    mirrored_numbers,
    resolves_ambiguity,
    rig_ratio,
    width_of,
)
from lmd.objectives.localisation.information import (
    Precision,
    about_body,
    body_log_det,
    body_meets,
    body_variance,
    gain_of,
    log_det,
    meets,
    moments,
    share_of,
    variance,
)
from lmd.scene.deployment import Deployment
from lmd.scene.scene import Scene
from lmd.sight.evaluator import Evaluator
from lmd.sight.models.paper import dot
from lmd.sight.reference import cap_count, coverage_caps, n_ple_cap, station_caps


def view_information(
    scene: Scene, deployment: Deployment, asked: Precision, position: FloatArray, axes: FloatArray
) -> tuple[FloatArray, BoolArray]:
    """Sums of the landmarks' information in each view, `(16, A)`, and mask `(A, K)` of the covered landmarks.

    The 16 sums are the 15 numbers A, g and C of `information`, then the residual ratio of `ambiguity`. A camera at
    `position` `(3,)`, metres, has the orientations `axes` `(A, 6)`; `asked` has the size of the tags.
    """
    offset, (right, up) = deployment.positions - position, upright(deployment.normals)
    tag: Any = offset.T, (asked.halves[:, None] * right).T, (asked.halves[:, None] * up).T
    caps = coverage_caps(scene, deployment, position, axes)
    with np.errstate(all="ignore"):  # the depth of a landmark that is not covered is arbitrary
        weight = density(getattr(scene.sight, "lens", None), axes[:, None], offset)
        numbers = *moments(tag, asked.share), camera_residual(asked.residual, tag)
        shares = [share_of(each, weight) for each in numbers]
    return np.stack([np.where(caps, share, 0.0).sum(axis=1) for share in shares]), caps


def body_information(
    scene: Scene, deployment: Deployment, asked: Precision, position: FloatArray, axes: FloatArray
) -> tuple[FloatArray, BoolArray]:
    """Fisher information about the pose of a rig's body in each view, and mask `(A, K)` of the covered landmarks.

    The information `(width_of(asked), A)` is summed over the cameras. A column has the 21 numbers of `information` for
    one view, the five numbers of `ambiguity` if `asked` has a limit on the residual, and padding. The body is at
    `position` `(3,)`, metres, and has the orientations `axes` `(A, 6)`.
    """
    sums, covered = np.zeros((len(axes), width_of(asked))), np.zeros((len(axes), len(deployment)), dtype=np.bool_)
    sides = [(asked.halves[:, None] * side).T for side in upright(deployment.normals)]
    for station in scene.stations(axes):
        camera, arm, there, turned = station
        caps = station_caps(scene, deployment, position, station)
        covered[there] |= caps
        offset = deployment.positions - (position + arm)
        with np.errstate(all="ignore"):
            tag: Any = offset.T, sides[0], sides[1]
            numbers = about_body(moments(tag, asked.share), tuple(arm))
            if resolves_ambiguity(asked):
                numbers += mirrored_numbers(tag, asked.residual)
            lens = getattr(scene.visibility.sight(camera), "lens", None)
            weight = gain_of(camera, scene.cameras[0]) * density(lens, turned[:, None], offset)
            shares = [np.where(caps, share_of(each, weight), 0.0).sum(axis=1) for each in numbers]
        sums[there, : len(shares)] += np.stack(shares, axis=1)
    return sums.T, covered


def information_of(
    scene: Scene, deployment: Deployment, asked: Precision, position: FloatArray, axes: FloatArray
) -> tuple[FloatArray, BoolArray]:
    """Result of `body_information` for a rig, and of `view_information` for a single camera: information in each view
    and mask of the covered landmarks.
    """
    of = body_information if scene.rig is not None else view_information
    return of(scene, deployment, asked, position, axes)


def mirrored_probabilities(
    scene: Scene, poses: FloatArray, centres: FloatArray, sides: FloatArray, seen: BoolArray, sigma: FloatArray
) -> FloatArray:
    """Probability P, `(N,)`, that the mirrored pose of the only tag in view fits the image better than the true pose,
    see `ambiguity`.

    Args:
        scene: camera or rig.
        poses: pose of the camera or of the rig's body in each view, as a matrix from its axes to the axes of the world,
            `(N, 4, 4)`.
        centres: centre of the tag in each view, metres, `(N, 3)`.
        sides: vectors from the centre to the midpoints of the right and of the upper edge, metres, `(2, N, 3)`.
        seen: mask of the cameras that see the tag, `(C, N)`.
        sigma: standard deviation of each coordinate of a corner, pixels, `(N,)`.
    """
    from scipy.special import ndtr  # slow to load

    first, quantile = scene.cameras[0], NormalDist().inv_cdf(CONFIDENCE)
    least: Any = (2.0 * quantile * sigma) ** 2 / np.prod(first.focal_pixels)
    sums = np.zeros((5, len(poses)))
    for camera, mounted, mask in zip(scene.cameras, scene.extrinsics, seen, strict=True):
        at = poses @ mounted
        offset = centres - at[:, :3, 3]
        lens = getattr(scene.visibility.sight(camera), "lens", None)
        with np.errstate(all="ignore"):  # the depth of a tag that is not seen is arbitrary
            weight = gain_of(camera, first) * density(lens, axis_and_right(at), offset)
            tag: Any = offset.T, sides[0].T, sides[1].T
            sums += np.where(mask, weight * np.stack(mirrored_numbers(tag, least)), 0.0)
    numbers: Any = *sums, least
    ratio = rig_ratio(*numbers)
    return np.asarray(ndtr(-quantile * np.sqrt(np.maximum(ratio, 0.0))))


def density(lens: Any, axes: FloatArray, offset: FloatArray) -> FloatArray:
    """Pixel density (`lmd.scene.criteria.pixel_density`) of landmarks at offsets `(..., 3)`, metres, for a camera with
    `axes` `(..., 6)`. `lens` is None for a pinhole.
    """
    axis, right = axes[..., :3], axes[..., 3:]
    if lens is None:
        depth = dot(axis, offset)
        return np.asarray(1.0 / (depth * depth * depth))
    return np.asarray(area_per_solid_angle(lens, *(dot(side, offset) for side in (right, cross(axis, right), axis))))


def decided(
    scene: Scene, deployment: Deployment, n: int, asked: Precision, position: FloatArray, axes: FloatArray
) -> tuple[BoolArray, BoolArray, FloatArray]:
    """Three arrays `(A,)`: mask of the views that cover n landmarks, mask of the localised views, and variance of the
    camera's position.

    The variance is infinite in views that cover fewer than n landmarks or do not determine the pose. The A views are
    those from `position`, metres, with the orientations `axes` `(A, 6)`; `asked` are the limits of a localised view.
    """
    enough = n_ple_cap(cap_count(coverage_caps(scene, deployment, position, axes)), n)
    found, variances = enough.copy(), np.full(len(axes), np.inf)
    if enough.any():
        met, variances[enough] = _judged(scene, deployment, asked, position, axes[enough])
        if asked.asks:
            found[enough] = met
    return enough, found, variances


def _judged(
    scene: Scene, deployment: Deployment, asked: Precision, position: FloatArray, axes: FloatArray
) -> tuple[BoolArray, FloatArray]:
    """Mask `(A,)` of the views within the limits `asked`, and variance of the camera's position in each."""
    has_precision, one, trace = meets, has_one_pose, variance
    if scene.rig is not None:
        has_precision, one, trace = body_meets, body_has_one_pose, body_variance
    with np.errstate(all="ignore"):
        sums, covered = information_of(scene, deployment, asked, position, axes)
        one_pose = n_ple_cap(cap_count(covered), 2) | one(asked.residual, sums, 0, 1)
        (value, fixed), met = trace(sums, 0, 1), has_precision(asked, sums, 0, 1)
    return np.asarray(met & one_pose), np.where(fixed & one_pose, value, np.inf)


def localised(
    scene: Scene, deployment: Deployment, n: int, asked: Precision, position: FloatArray, axes: FloatArray
) -> BoolArray:
    """Mask `(A,)` of the localised views, which cover n landmarks and satisfy the limits `asked`. The A views are those
    from `position`, metres, with the orientations `axes` `(A, 6)`.
    """
    return decided(scene, deployment, n, asked, position, axes)[1]


def log_det_of(scene: Scene, sums: FloatArray) -> FloatArray:
    """Logarithm of the determinant of each view's information, `(A,)`; `sums` `(width, A)` is a result of
    `information_of`.
    """
    return np.asarray((body_log_det if scene.rig is not None else log_det)(sums, 0, 1))


def reference_views(
    evaluator: Evaluator, positions: FloatArray, normals: FloatArray, n: int, precision: Precision, keep: bool
) -> tuple[IntArray, IntArray, FloatArray]:
    """Compute P_n, L and the variance of each view, the fields of `ViewValues`, with the NumPy reference.

    Arguments as in `evaluation.localised_views`.
    """
    scene, axes, places = evaluator.scene, evaluator.scene.orientations.axes, evaluator.positions
    weights = np.broadcast_to(evaluator.weights[:, : len(axes)], (len(places), len(axes)))
    covered, localised = np.empty((2, len(positions), len(places)), dtype=np.int64)
    kept = np.full((len(positions), len(places), evaluator.axes.shape[1]) if keep else (0, 0, 0), np.inf)
    scene.check_count(positions.shape[1])
    for b, landmarks in enumerate(map(Deployment, positions, normals)):
        for p, place in enumerate(places):
            enough, met, variances = decided(evaluator.scene_at(p), landmarks, n, precision, place, axes)
            covered[b, p], localised[b, p] = weights[p, enough].sum(), weights[p, met].sum()
            if keep:
                kept[b, p, : len(axes)] = variances
    return covered, localised, kept
