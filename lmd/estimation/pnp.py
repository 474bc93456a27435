"""Estimator that solves the Perspective-n-Point problem of each frame."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from lmd.core.checks import FloatArray
from lmd.core.optional import optional
from lmd.estimation.estimators import Errors, errors_of
from lmd.estimation.recording import Recording
from lmd.geometry.pose import PointImage, Solution, body_solutions
from lmd.geometry.projection import project
from lmd.geometry.se3 import exp

# Minimum difference between the squared errors of two distinguishable poses, for a likelihood ratio of 100.
TOLD_APART = 2.0 * np.log(100.0)
# Lower bound on the noise, pixels.
LEAST_NOISE = 0.01


@dataclass(frozen=True)
class PerspectiveNPoint:
    """Estimator of each frame's pose from the images of this frame alone (PnP), see `lmd.geometry.pose`.

    For a rig, the images of all cameras are used. The estimator uses the corners of all tags in view, or the centres of
    at least four points. If several poses fit almost equally well, as for a distant tag, the estimator takes the pose
    nearest to an expected pose. Odometry predicts the expected pose from the last frame whose pose was unique.
    """

    def __post_init__(self) -> None:
        optional("cv2", "estimators")

    def errors(self, recording: Recording, start: FloatArray) -> Errors:
        """See `lmd.estimation.estimators.Estimator.errors`."""
        return errors_of(recording, recording.poses[:, 0], self.run)

    def run(self, recording: Recording, s: int, start: FloatArray) -> Iterator[tuple[FloatArray, FloatArray]]:
        """Iterate over the frames of run s. Yields the estimated pose, `(4, 4)`, and the covariance of its error as a
        body twist, `(6, 6)`; both are NaN for frames without an estimate.

        The covariance is the inverse of the Fisher information of the frame's images at the estimate.
        """
        motions = exp(np.diff(recording.time)[:, None] * recording.twists[s])
        expected: FloatArray | None = None  # prediction from the last unique pose
        for t in range(len(recording.time)):
            images, pose, covariance = images_of(recording, s, t), np.full((4, 4), np.nan), np.full((6, 6), np.nan)
            if expected is not None:
                expected = expected @ motions[t - 1]
            candidates = likely(body_solutions(images))
            if len(candidates) == 1:
                expected = pose = candidates[0]
            elif candidates and expected is not None:
                off = [float(((one - expected) ** 2).sum()) for one in candidates]
                pose = candidates[int(np.argmin(off))]
            if np.isfinite(pose).all():
                slopes = np.concatenate([image.scaled_slope(pose) for image in images])
                covariance = np.linalg.inv((np.swapaxes(slopes, 1, 2) @ slopes).sum(axis=0))
            yield pose, covariance


def likely(found: list[Solution]) -> list[FloatArray]:
    """Poses that fit the image almost as well as the best pose, including the best pose.

    `found` has the solutions of PnP in ascending order of the reprojection error.
    """
    return [solution.pose for solution in found if solution.square - found[0].square < TOLD_APART]


def images_of(recording: Recording, s: int, t: int) -> list[PointImage]:
    """Image points in frame t of run s, and the known points that they show; one `PointImage` for each camera."""
    images, first, count = [], recording.detections(s, t).start, recording.seen_by.shape[-1]
    for c, (camera, mounted) in enumerate(zip(recording.camera.cameras, recording.camera.extrinsics, strict=True)):
        seen = c * count + np.flatnonzero(recording.seen_by[s, t, c])
        its = slice(first, first := first + len(seen))
        noise = np.maximum(recording.noise[its], LEAST_NOISE)
        if recording.tags is not None and recording.corners is not None:
            points, pixels = recording.tags[s, seen].reshape(-1, 3), recording.corners[its].reshape(-1, 2)
            images.append(PointImage(camera, mounted, points, pixels, noise.repeat(4)))
        else:
            pixels = project(camera, mounted, recording.points[s, t, seen])
            images.append(PointImage(camera, mounted, recording.landmarks[s, seen], pixels, noise))
    return images
