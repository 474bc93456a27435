"""The pose by odometry alone, from where the camera is thought to be first."""

import numpy as np

from lmd.core.checks import FloatArray
from lmd.estimation.estimators import Errors, pose_errors
from lmd.estimation.recording import Recording
from lmd.geometry.se3 import exp


class DeadReckoning:
    """Looks at no landmark, and so drifts."""

    def errors(self, recording: Recording, start: FloatArray) -> Errors:
        """Errors in every frame; `start` `(S, 4, 4)`."""
        motions = exp(np.diff(recording.time)[:, None] * recording.twists)
        poses = [start]
        for t in range(motions.shape[1]):
            poses.append(poses[-1] @ motions[:, t])
        return pose_errors(recording.poses, np.stack(poses, axis=1))
