"""Poses of a tag from a single sighting: two poses of a tag in front of a camera look alike (IPPE).

Source: Collins and Bartoli, "Infinitesimal Plane-Based Pose Estimation".
"""

from dataclasses import dataclass

import numpy as np

from lmd.core.checks import FloatArray, InputError, IntArray
from lmd.core.optional import optional
from lmd.geometry.se3 import pose_of
from lmd.survey.residuals import Reprojection
from lmd.survey.sightings import Sightings

ASSUMED_PIXELS = 0.3  # pixels, added in quadrature to the detector's standard deviation for the odds of the two poses


@dataclass(frozen=True)
class SinglePoses:
    """Two poses of the tag of each sighting, in the frame of the camera."""

    poses: FloatArray
    """`(N, 2, 4, 4)` poses, the better pose first."""
    odds: FloatArray
    """`(N,)` log-likelihood ratio of the better to the worse pose."""


def single_poses(sightings: Sightings) -> SinglePoses:
    """Poses of the tag of each sighting, by IPPE in a pinhole camera that is turned towards the tag.

    Raises:
        InputError: corners are not in order.
    """
    cv2 = optional("cv2", "estimators")
    axis = sightings.directions.mean(axis=1)
    axis /= np.linalg.norm(axis, axis=1, keepdims=True)
    side = np.cross(np.where(np.abs(axis[:, 1:2]) < 0.9, [[0.0, 1.0, 0.0]], [[1.0, 0.0, 0.0]]), axis)
    side /= np.linalg.norm(side, axis=1, keepdims=True)
    turned = np.stack([side, np.cross(axis, side), axis], axis=1)  # rotation from the camera to the turned camera
    rays = sightings.directions @ np.swapaxes(turned, 1, 2)
    flat = rays[..., :2] / rays[..., 2:]
    found = np.empty((len(sightings), 2, 4, 4))
    for index, (corners, image) in enumerate(zip(sightings.corners, flat, strict=True)):
        _, turns, ways, _ = cv2.solvePnPGeneric(corners, image, np.eye(3), None, flags=cv2.SOLVEPNP_IPPE_SQUARE)
        if not turns:
            seen = f"tag {sightings.ids[sightings.tag[index]]}"
            text = f"detections: the corners of {seen} form no square in a frame; list them around the tag."
            raise InputError(text, "detections")
        for which in range(2):
            turn = cv2.Rodrigues(turns[which % len(turns)])[0]
            found[index, which] = pose_of(turn, np.ravel(ways[which % len(ways)]))
    poses = pose_of(np.swapaxes(turned, 1, 2), np.zeros(3))[:, None] @ found
    still = np.broadcast_to(np.eye(4), (len(sightings), 4, 4))
    error = np.stack([Reprojection(sightings, poses[:, which], still, still).squared for which in range(2)], axis=1)
    order = np.argsort(error, axis=1)
    poses = np.take_along_axis(poses, order[..., None, None], axis=1)
    gap = np.diff(np.sort(error, axis=1), axis=1)[:, 0]
    return SinglePoses(poses, gap / (2.0 * sightings.variance(ASSUMED_PIXELS)))


def best_sequence(costs: FloatArray, between: FloatArray) -> IntArray:
    """Choose one of the two poses of each of n sightings in a sequence, at the least total cost (Viterbi).

    Args:
        costs: cost of each pose, `(n, 2)`.
        between: cost of pose a after pose b of the previous sighting, `(n, 2, 2)`.

    Returns:
        index of the chosen pose of each sighting, 0 or 1, `(n,)`.
    """
    chosen = np.zeros(costs.shape, dtype=np.int64)
    total = costs[0]
    for k in range(1, len(costs)):
        ways = between[k] + total
        chosen[k] = np.argmin(ways, axis=1)
        total = costs[k] + ways.min(axis=1)
        total = total - total.min()
    which = np.zeros(len(costs), dtype=np.int64)
    which[-1] = np.argmin(total)
    for k in range(len(costs) - 1, 0, -1):
        which[k - 1] = chosen[k, which[k]]
    return which
