"""Alignment of a model of another program, which may have any scale, with a map of tags.

An image has a pose X from its localisation and a pose Y from the model, both from the camera to the world. A similarity
S (`lmd.formats.reconstructions`) moves Y to S Y. The residual is the twist log(X^-1 S Y), rad and metres. The
covariance of the residual is the sum of the covariances of both poses. Errors of the map and of the cameras cause a
part of X's covariance that is common to all images. The model's errors of position and of rotation are assumed to be
independent from image to image and along each axis. The variances of these errors are estimated from the residuals.
Images whose chi^2 exceeds `MOVED_CHI_SQUARE` are left out of the fit.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from lmd.adjust.corners import Poses, squared_errors, sums_by
from lmd.adjust.frames import SeparateFrames
from lmd.adjust.motion import seconds_of
from lmd.adjust.tables import AXES
from lmd.core.checks import BoolArray, FloatArray, InputError, IntArray
from lmd.core.words import few
from lmd.formats.detections import DetectedTags
from lmd.formats.reconstructions import Model, image_names, similar
from lmd.geometry.se3 import adjoint_matrix, exp, inverse, log, pose_of
from lmd.localise.changes import MOVED_CHI_SQUARE
from lmd.localise.localise import FEWEST_FRAMES, Localisation
from lmd.localise.results import NAMED

NEAREST = 0.02  # greatest difference between the times of an image and of a pose of a trajectory, seconds
ROUNDS = 30  # steps of the fit, each of which chooses images, variances and the similarity again
TURNED, UNSURE = 0.3, 0.3  # largest rotation of an image that fits, rad, and relative standard deviation of a scale
NORMAL_MEDIAN = 1.538  # median length of a vector of three normal variables with the variance 1
LEAST_UNIT = 1e-6  # smallest ratio of two lengths in the model and in the map
TAKEN = np.array([3.0, 4.0])  # unknowns of the similarity that orientations, and that positions determine


def align(model: Model, result: Localisation) -> tuple[dict[str, Any], dict[str, float], str]:
    """Find the similarity that maps a model to the map, from images that the model and the localisation have in common.

    Returns:
        Contents of files, keyed by name: the model in metres, and the tables of residuals.

        Metrics: `scale` and `scale_sigma`, metres per unit of the model. `model_place` and `model_turn` are standard
        deviations of the model's poses along and about each axis, metres and rad. `aligned` and `astray` are the
        numbers of images that fit and that do not.

        Text for a terminal.

    Raises:
        InputError: model and localisation share fewer than `FEWEST_FRAMES` images, most of these fit no similarity, or
            the scale is not known.
    """
    found, names = result.found, np.array(image_names(result.detected)).T
    rows = np.where(found.poses.known_frames, _rows(model, result.detected, names), -1).ravel()
    index = np.flatnonzero(rows >= 0)
    if len(index) < FEWEST_FRAMES:
        both = f"the model has {few(model.names, NAMED)}, the photographs are {few(names[0], NAMED)}"
        raise InputError(f"align: {both}: {len(index)} localised images in both, {FEWEST_FRAMES} needed.", "align")
    (camera, frame), joint = np.divmod(index, names.shape[1]), found.adjustment
    system = joint.fixed_system(found.poses, found.floor)
    assert isinstance(system.frames, SeparateFrames), "single images are not linked"
    apart, reach = np.linalg.inv(system.frames.block), system.reached(np.eye(6 * joint.kept).reshape(joint.kept, 6, -1))
    poses, place, own = model.poses[rows[index]], np.searchsorted(joint.seen, frame), apart / joint.inflation**2
    bodies, mounts = found.poses.frames[frame], found.poses.mounts[camera]
    similarity, chosen, squares, variances, gain = _fitted(poses, bodies, mounts, own[place])
    pull = sums_by(place, len(own))(gain)
    common = np.einsum("fi,fij,fjm->m", pull, apart, reach)
    square = np.einsum("fi,fij,fj", pull, own, pull) + common @ np.nan_to_num(system.covariance) @ common
    scale, sigma = np.cbrt(np.linalg.det(similarity[:3, :3])), np.sqrt(square + (gain**2 @ variances).sum())
    if sigma > UNSURE:
        text = f"the scale is known to {sigma:.0%} only: the camera hardly moves, or these are not its poses"
        raise InputError(f"align: {text}.", "align")

    some, views = found.sightings.with_separate_cameras(), np.full((len(rows), 4, 4), np.nan)
    views[index] = similar(similarity, poses)
    pixels = squared_errors(some, Poses(found.poses.tags, views, np.eye(4)[None])) / 4.0
    off = dict(zip(AXES, np.roll(log(inverse(bodies @ mounts) @ views[index]), 3, axis=1).T, strict=True))
    errors = {"chi_square": squares, "error": _rms(some.frame, pixels, len(rows))[index]}
    by_tag = _rms(some.tag, np.where(np.isin(some.frame, index[chosen]), pixels, np.nan), len(some.ids))
    files = {f"aligned/{name}": content for name, content in model.moved(similarity).items()}
    files["alignment.csv"] = {"image": names.flat[index], "fits": chosen, **off, **errors}
    files["alignment_tags.csv"] = {"id": some.ids, "error": by_tag}
    turn, shift = np.sqrt(variances[[0, 3]]).tolist()
    figures = {"scale": float(scale), "scale_sigma": float(scale * sigma), "model_turn": turn, "model_place": shift}
    figures |= {"aligned": float(chosen.sum()), "astray": float((~chosen).sum())}
    astray = names.flat[index[~chosen]].tolist()
    files["alignment.json"] = {"figures": figures, "similarity": similarity.tolist(), "astray": astray}
    text = f"aligned {chosen.sum()} of {len(index)} images; {scale:.6g} +- {scale * sigma:.2g} metres per unit; off by "
    text += f"{1e3 * shift:.2g} mm and {1e3 * turn:.2g} mrad along and about each axis"
    return files, figures, text + f"\nastray  {few(astray, NAMED)}" * bool(astray)


def _rows(model: Model, detected: DetectedTags, names: NDArray[np.str_]) -> IntArray:
    """Index in the model of each image of C cameras in F frames, `(C, F)`; -1 for images that the model lacks. `names`
    `(C, F)` has the names of the images.
    """
    if isinstance(model.names, list):
        parts = 1 + (len(names) > 1)  # folders count only if they are those of cameras
        index = {tuple(name.split("/")[-parts:]): row for row, name in enumerate(model.names)}
        return np.array([[index.get(tuple(name.split("/")[-parts:]), -1) for name in own] for own in names.tolist()])
    seconds = np.nan_to_num(seconds_of(detected.times), nan=-np.inf)
    near = np.rint(np.interp(seconds, model.names, np.arange(len(model.names)))).astype(int)
    own = np.where(np.abs(model.names[near] - seconds) <= NEAREST, near, -1)
    return np.pad(own[None], ((0, len(names) - 1), (0, 0)), constant_values=-1)


def _rms(owner: IntArray, squares: FloatArray, count: int) -> FloatArray:
    """Root mean square of each of `count` groups of values. `squares` `(n,)` has the squares of all values, and `owner`
    `(n,)` the index of each value's group. Values of NaN are left out; the result is NaN for a group without other
    values.
    """
    known = np.isfinite(squares)
    number = np.bincount(owner[known], minlength=count)
    return np.asarray(np.sqrt(np.bincount(owner[known], squares[known], count) / np.where(number, number, np.nan)))


def _rough(poses: FloatArray, there: FloatArray) -> FloatArray:
    """Rough similarity that maps the poses `poses` to the poses `there`, `(n, 4, 4)` each, from medians of their
    rotations, scales and centres.
    """
    turns = there[:, :3, :3] @ np.swapaxes(poses[:, :3, :3], 1, 2)
    turn = Rotation.align_vectors(np.median(turns, axis=0).T, np.eye(3))[0].as_matrix()
    here, centres = poses[:, :3, 3] @ turn.T, there[:, :3, 3]
    one, other = (np.linalg.norm(own - np.median(own, axis=0), axis=1) for own in (here, centres))
    scale = np.median((other / np.maximum(one, LEAST_UNIT * other))[other >= np.median(other)])
    return pose_of(scale * turn, np.median(centres - scale * here, axis=0))


def _fitted(
    poses: FloatArray, bodies: FloatArray, mounts: FloatArray, own: FloatArray
) -> tuple[FloatArray, BoolArray, FloatArray, FloatArray, FloatArray]:
    """Fit the similarity that maps poses of the model to the localised poses.

    Args:
        poses: poses of n images in the model, `(n, 4, 4)`.
        bodies, mounts: localised poses of the bodies, and poses of the cameras on them, `(n, 4, 4)` each.
        own: covariance of the twist of each localised body pose, without the part common to all images, `(n, 6, 6)`.

    Returns:
        the similarity, `(4, 4)`; mask of the images that fit, `(n,)`; chi^2 of each image's residual, `(n,)`. Then the
        variances of the error twists of the model's poses, `(6,)`; derivatives of the logarithm of the scale with
        respect to twists of the localised poses, `(n, 6)`.

    Raises:
        InputError: less than half of the images fit.
    """
    similarity, variances = _rough(poses, bodies @ mounts), np.zeros(2)
    back, unmounted = inverse(bodies), inverse(mounts)
    turn, known = adjoint_matrix(back), np.diagonal(own, axis1=1, axis2=2).reshape(-1, 2, 3).mean(axis=2)
    for number in range(ROUNDS):
        placed = similar(similarity, poses)
        off = log(back @ placed @ unmounted)
        lengths = np.linalg.norm(off.reshape(-1, 2, 3), axis=2)
        if number == 0:
            variances = (np.median(lengths, axis=0) / NORMAL_MEDIAN) ** 2
        information = np.linalg.inv(own + np.diag(np.repeat(variances, 3)))
        squares = np.einsum("ni,nij,nj->n", off, information, off)
        chosen = (squares <= MOVED_CHI_SQUARE) & (lengths[:, 0] < TURNED)
        slope = np.concatenate([turn, turn[:, :, 3:] @ placed[:, :3, 3:]], axis=2)
        pull = np.swapaxes(slope, 1, 2) @ information * chosen[:, None, None]
        count, total = int(chosen.sum()), (pull @ slope).sum(axis=0)
        if count < max(FEWEST_FRAMES, len(poses) / 2.0) or np.linalg.matrix_rank(total) < len(total):
            text = f"{count} of {len(poses)} images fit one similarity; the model must be of a moving camera"
            raise InputError(f"align: {text}.", "align")
        gain = np.linalg.solve(total, pull)
        step = -np.einsum("npi,ni->p", gain, off)
        similarity = exp(step[:6]) @ np.diag(np.exp([*3 * [step[6]], 0.0])) @ similarity
        weight = chosen[:, None] / (known + variances) ** 2
        excess = lengths**2 / (3.0 - TAKEN / count) - known
        variances = np.maximum((weight * excess).sum(axis=0) / weight.sum(axis=0), 0.0)
    return similarity, chosen, squares, np.repeat(variances, 3), gain[:, 6]
