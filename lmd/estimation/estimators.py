"""The interface of all estimators that localise the same camera from the same recording, and their bound."""

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from lmd.core.checks import FloatArray
from lmd.estimation.cramer_rao import cramer_rao_bound, moment_information
from lmd.estimation.errors import Errors
from lmd.estimation.recording import Recording


class Estimator(Protocol):
    """Something that localises a camera."""

    def errors(self, recording: Recording, start: FloatArray) -> Errors:
        """Its errors in every frame of every run, NaN where it has no estimate.

        Args:
            recording: S runs.
            start: initial estimate of the pose, `(S, 4, 4)`; what needs none ignores it.

        Raises:
            InputError: it cannot work with this recording, or a package it needs is missing.
        """


@dataclass(frozen=True)
class CramerRaoBound:
    """The least root-mean-square error of any unbiased estimate from a single frame, given the pixel noise.

    The image of a tag are its corners, that of a landmark that is a point is its centre. An estimator that remembers
    earlier frames may do better. Er is the expected one, tr S_vv + 2 tr S_ww.
    """

    def errors(self, recording: Recording, start: FloatArray) -> Errors:
        """See `Estimator.errors`."""
        largest = float(recording.noise.max(initial=0.0))
        relative = recording.noise / largest if largest > 0.0 else np.ones_like(recording.noise)
        runs, corners = [], 1 if recording.tags is None else 4
        cameras, count = recording.seen_by.shape[2:]
        body = recording.camera.cameras, recording.camera.extrinsics
        for s, poses in enumerate(recording.poses):
            points = (recording.landmarks if recording.tags is None else recording.tags)[s, :count].reshape(-1, 3)
            seen = np.moveaxis(recording.seen_by[s], 1, 0).repeat(corners, axis=-1)
            camera = np.nonzero(recording.seen[s])[1] // count  # that made each detection
            its = relative[recording.detections(s)]
            noise = [its[camera == c].repeat(corners) for c in range(cameras)]
            bounds = cramer_rao_bound(moment_information(*body, poses, points, seen, noise))
            runs.append([np.where(np.isfinite(bound), bound, np.nan) for bound in bounds])
        position, attitude = largest * np.array(runs).transpose(1, 0, 2)
        return Errors(position**2 + 2.0 * attitude**2, position, attitude)
