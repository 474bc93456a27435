"""What a sighting says by itself: a single tag has two poses in front of a camera that look alike (IPPE)."""

from dataclasses import dataclass

import numpy as np

from lmd.core.checks import FloatArray, InputError
from lmd.core.optional import optional
from lmd.geometry.se3 import pose_of
from lmd.survey.residuals import in_cameras, residuals
from lmd.survey.sightings import Sightings

# What corners are off by, pixels, besides what the detector accounts for, when a pose is judged on its own.
ASSUMED_PIXELS = 0.3


@dataclass(frozen=True)
class Proposals:
    """The two poses of the tag of each sighting in its camera, the better first.

    Args:
        poses: `(N, 2, 4, 4)`.
        odds: by how many powers of e the first is likelier, `(N,)`.
    """

    poses: FloatArray
    odds: FloatArray


def proposals(sightings: Sightings) -> Proposals:
    """The poses that each sighting allows by itself.

    They are found in the image of a camera turned towards the tag, in which any direction has a place.

    Raises:
        InputError: corners are not in order.
    """
    cv2 = optional("cv2", "estimators")
    axis = sightings.directions.mean(axis=1)
    axis /= np.linalg.norm(axis, axis=1, keepdims=True)
    side = np.cross(np.where(np.abs(axis[:, 1:2]) < 0.9, [[0.0, 1.0, 0.0]], [[1.0, 0.0, 0.0]]), axis)
    side /= np.linalg.norm(side, axis=1, keepdims=True)
    turned = np.stack([side, np.cross(axis, side), axis], axis=1)  # camera to the turned one
    rays = sightings.directions @ np.swapaxes(turned, 1, 2)
    flat = rays[..., :2] / rays[..., 2:]
    found = np.empty((len(sightings), 2, 4, 4))
    for index, (corners, image) in enumerate(zip(sightings.corners, flat, strict=True)):
        _, turns, ways, _ = cv2.solvePnPGeneric(corners, image, np.eye(3), None, flags=cv2.SOLVEPNP_IPPE_SQUARE)
        if not turns:
            seen = f"tag {sightings.ids[sightings.tag[index]]}"
            text = f"detections: the corners of {seen} are those of no square in a frame; they go around the tag."
            raise InputError(text, "detections")
        for which in range(2):
            turn = cv2.Rodrigues(turns[which % len(turns)])[0]
            found[index, which] = pose_of(turn, np.ravel(ways[which % len(ways)]))
    back = pose_of(np.swapaxes(turned, 1, 2), np.zeros(3))
    poses = back[:, None] @ found
    error = np.stack([_relative_errors(sightings, poses[:, which]) for which in range(2)], axis=1)
    order = np.argsort(error, axis=1)
    poses = np.take_along_axis(poses, order[..., None, None], axis=1)
    gap = np.diff(np.sort(error, axis=1), axis=1)[:, 0]
    return Proposals(poses, gap / (2.0 * (sightings.noise**2 + ASSUMED_PIXELS**2)))


def _relative_errors(sightings: Sightings, poses: FloatArray) -> FloatArray:
    """|e|^2 of sightings whose tags have `poses` `(N, 4, 4)` in their cameras."""
    still = np.broadcast_to(np.eye(4), poses.shape)
    return np.asarray((residuals(sightings, in_cameras(sightings, poses, still, still)) ** 2).sum(axis=(1, 2)))
