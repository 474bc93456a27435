"""Localisation where the visibility model has no compiled half: by the `reference`, position by position."""

from collections.abc import Callable
from typing import Any

import numpy as np

from lmd.core.checks import FloatArray, IntArray
from lmd.objectives.localisation.reference import decided, information_of, log_det_of
from lmd.scene.deployment import Deployment
from lmd.scene.scene import Scene
from lmd.sight.evaluator import Evaluator
from lmd.sight.poses import by_edge

# Numbers of a view on the diagonals of the two halves of the information: position, rotation.
OF_CAMERA, OF_BODY = ([9, 12, 14], [0, 3, 5]), ([0, 3, 5], [15, 18, 20])
CAMERA_WIDTH, BODY_WIDTH = 15, 21


def reference_views(
    evaluator: Evaluator, positions: FloatArray, normals: FloatArray, n: int, precision: Any, keep: bool
) -> tuple[IntArray, IntArray, FloatArray]:
    """See `views.localised_views`."""
    scene, axes, places = evaluator.scene, evaluator.scene.orientations.axes, evaluator.positions
    weights = np.broadcast_to(evaluator.weights[:, : len(axes)], (len(places), len(axes)))
    covered, localised = np.empty((2, len(positions), len(places)), dtype=np.int64)
    kept = np.full((len(positions), len(places), evaluator.axes.shape[1]) if keep else (0, 0, 0), np.inf)
    scene.check_count(positions.shape[1])
    for b, landmarks in enumerate(map(Deployment, positions, normals)):
        for p, place in enumerate(places):
            enough, met, variances = decided(scene, landmarks, n, precision, place, axes)
            covered[b, p], localised[b, p] = weights[p, enough].sum(), weights[p, met].sum()
            if keep:
                kept[b, p, : len(axes)] = variances
    return covered, localised, kept


class ReferenceLogDeterminant:
    """See `log_det.LogDeterminant`; of a camera, or of a rig."""

    label = "mean log det of the information"

    def __init__(
        self,
        evaluator: Evaluator,
        relevance: FloatArray,
        precision: Callable[[Scene], Any],
        position: float,
        rotation: float,
    ) -> None:
        is_rig, axes = evaluator.scene.rig is not None, evaluator.scene.orientations.axes
        of, width = (OF_BODY, BODY_WIDTH) if is_rig else (OF_CAMERA, CAMERA_WIDTH)
        evaluator.check_memory(8 * (width + 2))
        self._evaluator, self._precision, self._width = evaluator, precision, width
        self._prices = relevance[:, None] / relevance.sum() * evaluator.probability[:, : len(axes)]
        start = np.zeros((width, len(axes)))
        start[of[0]], start[of[1]] = position, rotation
        self._sums = np.tile(start, (len(evaluator.positions), 1, 1))
        self._known = np.tile(log_det_of(evaluator.scene, start), (len(evaluator.positions), 1))

    def gains(self, poses: Deployment) -> FloatArray:
        """See `Selection.gains`."""
        gained = np.zeros(len(poses))
        for e, index in by_edge(self._evaluator, poses):
            for j in index:
                for p in range(len(e.positions)):
                    known = log_det_of(e.scene, self._with(e, poses[j : j + 1], p))
                    gained[j] += self._prices[p] @ (known - self._known[p])
        return gained

    def add(self, pose: Deployment) -> None:
        """See `Selection.add`."""
        for e, _ in by_edge(self._evaluator, pose):
            for p in range(len(e.positions)):
                self._sums[p] = self._with(e, pose, p)
                self._known[p] = log_det_of(e.scene, self._sums[p])

    def _with(self, e: Evaluator, pose: Deployment, p: int) -> FloatArray:
        """Information of the views from position p with one more pose, `(width, D)`."""
        axes = e.scene.orientations.axes
        told = information_of(e.scene, pose, self._precision(e.scene), e.positions[p], axes)
        return np.asarray(self._sums[p] + told[: self._width])
