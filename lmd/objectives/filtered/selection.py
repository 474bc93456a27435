"""Surrogate of filtered poses for greedy selection: how often each frame of the drives sees a tag."""

import numpy as np

from lmd.core.checks import BoolArray, FloatArray
from lmd.objectives.filtered.drives import Drives
from lmd.scene.deployment import Deployment
from lmd.sight.blocks import SINGLE_ERROR
from lmd.sight.evaluator import Evaluator
from lmd.sight.views import visible


class SeenFrames:
    """Weighted sum of log(1 + tags in view) over the frames, a `Selection`.

    A further tag gains the more in a frame the fewer tags the frame has, so chosen tags spread over the drives. The sum
    is submodular if no tag hides another.

    Args:
        evaluator: scene with the frames as positions.
        drives: the drives.
        relevance: weights of the frames, `(F,)`.
    """

    label = "log of the tags in view along the drives"

    def __init__(self, evaluator: Evaluator, drives: Drives, relevance: FloatArray) -> None:
        self._evaluator, self._drives, self._relevance = evaluator, drives, relevance
        self._seen = np.zeros(len(relevance))

    def gains(self, poses: Deployment) -> FloatArray:
        """See `Selection.gains`."""
        prices = self._relevance * np.log1p(1.0 / (1.0 + self._seen))
        return np.array([prices[self._views(poses[k : k + 1])].sum() for k in range(len(poses))])

    def add(self, pose: Deployment) -> None:
        """See `Selection.add`."""
        self._seen += self._views(pose)

    def _views(self, pose: Deployment) -> BoolArray:
        """Mask of the frames that see a single tag, `(F,)`."""
        drives, evaluator = self._drives, self._evaluator
        frames = np.arange(len(self._seen))
        if evaluator.scene.rig is None:  # most frames look elsewhere
            away = pose.positions[0] - drives.positions
            ahead = (away * drives.axes[:, :3]).sum(axis=1)
            cosine = float(evaluator.sight.outer_cosine) - SINGLE_ERROR
            frames = np.flatnonzero(ahead >= cosine * np.linalg.norm(away, axis=1))
        seen = np.zeros(len(self._seen), dtype=np.bool_)
        seen[frames] = visible(evaluator, pose, drives.positions[frames], drives.axes[frames])[:, 0]
        return seen
