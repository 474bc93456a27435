"""Localisation formula by formula: the oracle that every faster path must agree with.

Only tests import this, and `by_reference`.

Shapes: A orientations, K landmarks, P positions.
"""

from typing import Any

import numpy as np

from lmd.core.checks import BoolArray, FloatArray
from lmd.geometry.lens_models import density_of
from lmd.geometry.se3 import cross
from lmd.geometry.squares import upright
from lmd.objectives.localisation.ambiguity import ResolvedPrecision, asks_apart, telling, tells
from lmd.objectives.localisation.body import about_body, body_log_det, body_meets, gain_of, position_variance
from lmd.objectives.localisation.information import (
    PosePrecision,
    Precision,
    SizedPrecision,
    half_of,
    log_det,
    meets,
    moments,
    share_of,
    variance,
)
from lmd.objectives.localisation.rig_ambiguity import has_one_pose, mirrored_numbers, width_of
from lmd.scene.deployment import Deployment
from lmd.scene.scene import Scene
from lmd.sight.models.paper import dot
from lmd.sight.reference import cap_count, coverage_caps, n_ple_cap, station_caps


def view_information(
    scene: Scene,
    deployment: Deployment,
    asked: Precision | PosePrecision | ResolvedPrecision | SizedPrecision,
    position: FloatArray,
    axes: FloatArray,
) -> FloatArray:
    """A, g and C of each view, `(15, A)`, of the landmarks that it covers."""
    caps, (*args, weight) = _seen(scene, deployment, asked, position, axes)
    formulas: Any = moments
    with np.errstate(all="ignore"):  # of a landmark that is not covered the depth may be anything
        shares = [share_of(each, weight) for each in formulas(*args, asked.share)]
    return np.stack([np.where(caps, share, 0.0).sum(axis=1) for share in shares])


def told(
    scene: Scene,
    deployment: Deployment,
    asked: Any,
    position: FloatArray,
    axes: FloatArray,
) -> FloatArray:
    """What each view has to tell two poses apart, `(A,)`: see `ambiguity.ENOUGH`."""
    caps, (*args, weight) = _seen(scene, deployment, asked, position, axes)
    formula: Any = telling
    with np.errstate(all="ignore"):
        share = share_of(formula(*args, _each(asked).square), weight)
    return np.asarray(np.where(caps, 1.0 + share, 0.0).sum(axis=1))


def _each(asked: Any) -> Any:
    """What is asked of each size of tags."""
    return asked.of if isinstance(asked, SizedPrecision) else asked


def _seen(
    scene: Scene, deployment: Deployment, asked: Any, position: FloatArray, axes: FloatArray
) -> tuple[BoolArray, tuple[FloatArray, ...]]:
    """Which landmarks each view covers, `(A, K)`; offsets and sides as `moments` takes them, and `pixel_density`."""
    offset, (right, up) = deployment.positions - position, upright(deployment.normals)
    half = np.reshape(half_of(asked, slice(None)), (-1, 1))  # one, or each tag's
    with np.errstate(all="ignore"):
        weight = _density(getattr(scene.sight, "lens", None), axes, offset)
    caps = coverage_caps(scene, deployment, position, axes)
    return caps, (*offset.T, *(half * right).T, *(half * up).T, weight)


def body_information(
    scene: Scene,
    deployment: Deployment,
    asked: Any,
    position: FloatArray,
    axes: FloatArray,
) -> tuple[FloatArray, BoolArray]:
    """What all cameras of a rig tell of its body in each of its orientations, `(A, width_of(asked))`, and which
    landmarks they cover, `(A, K)`.
    """
    sums, covered = np.zeros((len(axes), width_of(asked))), np.zeros((len(axes), len(deployment)), dtype=np.bool_)
    right, up = upright(deployment.normals)
    half = np.reshape(half_of(asked, slice(None)), (-1, 1))
    sides = (half * right, half * up)
    formulas: tuple[Any, ...] = moments, about_body, share_of, mirrored_numbers
    for station in scene.stations(axes):
        camera, arm, there, turned = station
        caps = station_caps(scene, deployment, position, station)
        covered[there] |= caps
        offset = deployment.positions - (position + arm)
        with np.errstate(all="ignore"):
            tags = *offset.T, *sides[0].T, *sides[1].T
            moment = formulas[1](formulas[0](*tags, asked.share), *arm)
            if asks_apart(asked):
                moment += formulas[3](*tags, _each(asked).square)
            lens = getattr(scene.visibility.sight(camera), "lens", None)
            weight = gain_of(camera, scene.cameras[0]) * _density(lens, turned, offset)
            shares = [np.where(caps, formulas[2](each, weight), 0.0).sum(axis=1) for each in moment]
        sums[there, : len(shares)] += np.stack(shares, axis=1)
    return sums, covered


def _density(lens: Any, axes: FloatArray, offset: FloatArray) -> FloatArray:
    """See `lmd.scene.criteria.pixel_density`, `(A, K)`; `lens` is None for a pinhole."""
    axis, right = axes[:, None, :3], axes[:, None, 3:]
    if lens is None:
        depth = dot(axis, offset)
        return np.asarray(1.0 / (depth * depth * depth))
    return np.asarray(density_of(lens, *(dot(side, offset) for side in (right, cross(axis, right), axis))))


def decided(
    scene: Scene, deployment: Deployment, n: int, asked: Any, position: FloatArray, axes: FloatArray
) -> tuple[BoolArray, BoolArray, FloatArray]:
    """Views that cover n landmarks, and those of them that are localised, flags `(A,)` each.

    Also the variance of the position in each, in the units of `variance`, infinite where not enough is seen, `(A,)`.

    Args:
        asked: the precision, see `Localisation.precision`.
    """
    enough = n_ple_cap(cap_count(coverage_caps(scene, deployment, position, axes)), n)
    found, variances = enough.copy(), np.full(len(axes), np.inf)
    if enough.any():
        met, variances[enough] = _judged(scene, deployment, asked, position, axes[enough])
        if asked.asks:
            found[enough] = met
    return enough, found, variances


def _judged(
    scene: Scene, deployment: Deployment, asked: Any, position: FloatArray, axes: FloatArray
) -> tuple[BoolArray, FloatArray]:
    """Views that meet the precision `asked`, flags, and the variance of the position in each, `(A,)` each."""
    with np.errstate(all="ignore"):
        if scene.rig is not None:
            sums, covered = body_information(scene, deployment, asked, position, axes)
            one_pose = n_ple_cap(cap_count(covered), 2) | has_one_pose(asked, sums.T, 0, 1)
            (value, fixed), met = position_variance(sums.T, 0, 1), body_meets(asked, sums.T, 0, 1)
        else:
            sums = view_information(scene, deployment, asked, position, axes)
            one_pose = np.ones(len(axes), dtype=np.bool_)
            if asks_apart(asked):
                one_pose = np.asarray(tells(asked, told(scene, deployment, asked, position, axes)))
            (value, fixed), met = variance(*sums), meets(asked, *sums)
    return np.asarray(met & one_pose), np.where(fixed & one_pose, value, np.inf)


def localised(
    scene: Scene, deployment: Deployment, n: int, asked: Any, position: FloatArray, axes: FloatArray
) -> BoolArray:
    """Views that are localised, flags `(A,)`; arguments as in `decided`."""
    return decided(scene, deployment, n, asked, position, axes)[1]


def log_det_of(scene: Scene, sums: FloatArray) -> FloatArray:
    """The `log_det` of the information of views, `(A,)`, of sums `(width, A)` as in `information_of`."""
    return np.asarray(body_log_det(sums, 0, 1) if scene.rig is not None else log_det(*sums))


def information_of(
    scene: Scene, deployment: Deployment, asked: Any, position: FloatArray, axes: FloatArray
) -> FloatArray:
    """Fisher information of each view, `(width, A)`: `view_information` of a camera, `body_information` of a rig."""
    if scene.rig is not None:
        return body_information(scene, deployment, asked, position, axes)[0].T
    return view_information(scene, deployment, asked, position, axes)
