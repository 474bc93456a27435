"""Covariances of the filtered poses for a whole deployment, computed by a Kalman filter along each drive. In each
frame, the filter uses the odometry and the Fisher information of the tags in view.

A reference in NumPy is included; the compiled code must equal the reference bit for bit.
"""

from typing import Any, NamedTuple

import numpy as np

from lmd.core.checks import BoolArray, FloatArray
from lmd.geometry.squares import upright
from lmd.objectives.filtered.drives import Drives
from lmd.objectives.filtered.lanes import (
    NUMBERS,
    Tolerance,
    filter_drives,
    is_known,
    lanes,
    predicted,
    update_beyond_rounding,
    updated,
)
from lmd.objectives.localisation.information import NUMBERS as CAMERA_NUMBERS
from lmd.objectives.localisation.information import Precision, about_body, gain_of, moments, share_of
from lmd.objectives.localisation.reference import density, information_of
from lmd.scene.deployment import Deployment
from lmd.scene.scene import Scene
from lmd.sight.evaluator import Evaluator
from lmd.sight.views import visible_to_each


class FrameInformation(NamedTuple):
    """Fisher information about the pose in each frame, from the tags in view."""

    sums: FloatArray
    """`(F, 21)` information, in the order of numbers described in `lmd.objectives.localisation.information`."""
    informed: BoolArray
    """`(F,)` mask of the frames with enough tags in view."""


class FilteredPoses(NamedTuple):
    """Covariance of the filtered pose in each frame, and frames whose pose is known to the tolerance."""

    known: BoolArray
    """`(F,)` mask of the poses that are known to the tolerance."""
    covariances: FloatArray
    """`(F, 21)` covariances in the axes of the world, in the order of numbers described in `lanes`."""


def frame_information(
    evaluator: Evaluator, deployment: Deployment, asked: Precision, n: int, drives: Drives
) -> FrameInformation:
    """Fisher information about the pose in each frame, from the tags of a deployment.

    Args:
        evaluator: scene and visibility.
        deployment: K landmarks.
        asked: edge lengths of the landmarks, and weight of each corner in the information.
        n: least number of landmarks in view; the information of a frame with fewer landmarks is not used.
        drives: drives with the F frames.
    """
    scene, axes, places = evaluator.scene, drives.axes, drives.positions
    seen = visible_to_each(evaluator, deployment, places, axes)
    sums = np.zeros((len(places), NUMBERS))
    for camera, offsets, turned, covered in zip(*_cameras(scene, axes), seen, strict=True):
        frames, tags = np.nonzero(covered)
        arms = offsets[frames]
        away = deployment.positions[tags] - (places[frames] + arms)
        halves = np.broadcast_to(asked.halves, len(deployment))[tags, None]
        right, up = (halves * side for side in upright(deployment.normals[tags]))
        lens = getattr(scene.visibility.sight(camera), "lens", None)
        weight = gain_of(camera, scene.cameras[0]) * density(lens, turned[frames], away)
        tag: Any = away.T, right.T, up.T
        numbers = about_body(moments(tag, asked.share), tuple(arms.T))
        for j, number in enumerate(numbers):
            share = np.broadcast_to(share_of(number, weight), weight.shape)
            sums[:, j] += np.bincount(frames, weights=share, minlength=len(places))
    return FrameInformation(sums, seen.any(axis=0).sum(axis=1) >= n)


def _cameras(scene: Scene, axes: FloatArray) -> tuple[Any, FloatArray, FloatArray]:
    """Cameras of the scene, with the offset and the axes of each camera in each frame, in the world frame.

    `axes` `(F, 6)` are the axes of the body.

    Returns:
        the C cameras; offsets from the body, `(C, F, 3)`, metres; optical axes and directions to the right, `(C, F,
            6)`.
    """
    if scene.rig is None:
        return scene.cameras, np.zeros((1, len(axes), 3)), axes[None]
    return scene.cameras, *scene.rig.views(axes)


def filtered_poses(drives: Drives, information: FrameInformation, tolerance: Tolerance) -> FilteredPoses:
    """Run a Kalman filter along each drive, in compiled code, and return the covariances of the filtered poses."""
    known, kept = np.zeros(len(information.sums), dtype=np.uint8), np.zeros((len(information.sums), NUMBERS))
    informed = information.informed.astype(np.uint8)
    filter_drives(drives.first, drives.moves, information.sums, informed, drives.start, tolerance, lanes(), known, kept)
    return FilteredPoses(known != 0, kept)


def reference_information(
    scene: Scene, deployment: Deployment, asked: Precision, n: int, drives: Drives
) -> FrameInformation:
    """Fisher information about the pose in each frame, computed frame by frame with the NumPy reference of
    localisation.

    Arguments as in `frame_information`, with `scene` in place of the evaluator.
    """
    sums, informed = np.zeros((len(drives.positions), NUMBERS)), np.zeros(len(drives.positions), dtype=np.bool_)
    for f, (position, axes) in enumerate(zip(drives.positions, drives.axes, strict=True)):
        numbers, covered = information_of(scene, deployment, asked, position, axes[None])
        if scene.rig is None:
            sums[f] = about_body(tuple(numbers[:CAMERA_NUMBERS, 0]), (0.0, 0.0, 0.0))
        else:
            sums[f] = numbers[:NUMBERS, 0]
        informed[f] = covered.sum() >= n
    return FrameInformation(sums, informed)


def reference_filter(drives: Drives, information: FrameInformation, tolerance: Tolerance) -> FilteredPoses:
    """Run a Kalman filter along each drive, in NumPy, and return the covariances of the filtered poses."""
    known, kept = np.zeros(len(information.sums), dtype=np.bool_), np.zeros_like(information.sums)
    p: FloatArray = np.repeat(drives.start[:, None], len(drives), axis=1)
    for step in range(int(np.diff(drives.first).max())):
        under_way = np.flatnonzero(drives.first[:-1] + step < drives.first[1:])
        frames = drives.first[under_way] + step
        x, y, z, *noise = drives.moves[frames].T
        before = np.stack(predicted(tuple(p[:, under_way]), (x, y, z), *noise))
        sums, after = np.ascontiguousarray(information.sums[frames].T), before.copy()
        if tolerance.least is None:
            after = np.stack(updated(tuple(before), tuple(sums), tolerance.scale))
        else:
            for d in range(len(frames)):
                flat, limits = (after.reshape(-1), sums.reshape(-1)), (tolerance.scale, tolerance.least)
                update_beyond_rounding(*flat, d, len(frames), *limits, np.empty((3, 6, 6)))
        p[:, under_way] = np.where(information.informed[frames], after, before)
        known[frames], kept[frames] = is_known(p[:, under_way], tolerance), p[:, under_way].T
    return FilteredPoses(known, kept)
