"""Covariances of poses from single images: noise of corners, and errors that all images of a drive share.

The pose of an image is a weighted least squares fit, with the gain G = (J^T W J)^-1 J^T W of the residuals of its
sightings. Errors of the tags in the map, with the covariance S of all tags together, and of the camera, with the
covariance C, move the residuals by J_t and J_c. The pose has the covariance

    G R G^T / efficiency + G J_t S J_t^T G^T + G J_c C J_c^T G^T,

where R is the noise of corners. The weights W take the errors of tags as independent of each other.
"""

import numpy as np

from lmd.core.checks import BoolArray, FloatArray
from lmd.localise.image_noise import ImageNoise
from lmd.survey.residuals import Reprojection, sums_by
from lmd.survey.schur import LEAST_DAMPING
from lmd.survey.sightings import Sightings

PAIRS = 20000  # pairs of sightings of one image that are summed at once


def pose_covariances(
    some: Sightings,
    at: Reprojection,
    noise: ImageNoise,
    used: BoolArray,
    floor: float,
    efficiency: float,
    joint: FloatArray,
    lens: FloatArray | None,
) -> FloatArray:
    """Covariance of the right-hand twist of the pose of each frame, `(F, 6, 6)`; NaN for frames without sightings.

    Args:
        some: sightings.
        at: their residuals.
        noise: their noise.
        used: sightings that fit, `(N,)`.
        floor: standard deviation of corners beyond the detector's own, pixels.
        efficiency: see `ImageNoise.efficiency`.
        joint: covariance S of the tags, `(6 K, 6 K)`.
        lens: covariance C of each camera's values, `(C, 6 L, 6 L)`, in the units of `Sightings.lens`; None if exact.
    """
    index = np.flatnonzero(used)
    seen, owner = np.unique(some.frame[index], return_inverse=True)
    result = np.full((some.frames, 6, 6), np.nan)
    if not len(index):
        return result
    summed, own = sums_by(owner, len(seen)), noise.of_some(used)
    slope = at.by_frame[index]
    # J^T W, with W in the axes of `ImageNoise`.
    scale = 1.0 / (own.variance[:, None] + floor**2 + own.values)
    weighed = np.swapaxes(slope, 1, 2) @ (own.vectors * scale[:, None]) @ np.swapaxes(own.vectors, 1, 2)
    square = np.linalg.inv(summed(weighed @ slope) + LEAST_DAMPING * np.eye(6))
    gain = square[owner] @ weighed  # G, (n, 6, 8)
    half = gain * np.sqrt(own.variance + floor**2)[:, None, None]
    found = summed(half @ np.swapaxes(half, 1, 2)) / efficiency
    if lens is not None:
        for camera in range(some.cameras):
            of_camera = some.camera[index] == camera
            moved = summed((gain @ some.lens[index]) * of_camera[:, None, None])
            found += moved @ lens[camera] @ np.swapaxes(moved, 1, 2)
    moved, tag = gain @ at.by_tag[index], some.tag[index]
    blocks = joint.reshape(len(some.ids), 6, len(some.ids), 6).transpose(0, 2, 1, 3)
    counts = np.bincount(owner)
    one = np.repeat(np.arange(len(index)), counts[owner])
    first = np.repeat(np.cumsum(counts) - counts, counts**2)
    other = np.arange(len(one)) - np.repeat(np.cumsum(counts[owner]) - counts[owner], counts[owner]) + first
    for begin in range(0, len(one), PAIRS):
        i, j = one[begin : begin + PAIRS], other[begin : begin + PAIRS]
        both = moved[i] @ blocks[tag[i], tag[j]] @ np.swapaxes(moved[j], 1, 2)
        found += sums_by(owner[i], len(seen))(both)
    result[seen] = (found + np.swapaxes(found, 1, 2)) / 2.0
    return result
