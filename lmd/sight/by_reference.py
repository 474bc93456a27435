"""Coverage by the reference, position by position, for visibility models without a compiled half.

`reference` says what is covered. Here it is summed up as `rig_views` does for rigs, in the same units.
"""

import sys
from functools import cache

import numpy as np

from lmd.core.bits import in_words
from lmd.core.checks import BoolArray, FloatArray
from lmd.geometry.camera import Camera
from lmd.scene.deployment import Deployment
from lmd.scene.rig import Station
from lmd.scene.scene import Scene
from lmd.sight.reference import cap_count, coverage_caps, n_ple_cap, station_caps


@cache
def _tell(name: str) -> None:
    """Say once in a process that the visibility model with this name has no compiled half."""
    slow = "an evaluation takes some 100 times as long, a move of annealing some 1000 times"
    cure = 'see CONTRIBUTING.md, "Compile a criterion"'
    print(f"note: {name} has no compiled half, so its NumPy decides: {slow}; {cure}", file=sys.stderr)


class ReferenceViews:
    """The views of a camera, or of a rig, from P positions, with D orientations.

    Args:
        scene: its visibility model need have no compiled half.
        positions: of the camera, or of the body of the rig, `(P, 3)`, metres.
    """

    def __init__(self, scene: Scene, positions: FloatArray) -> None:
        self._scene, self._positions, self._axes = scene, positions, scene.orientations.axes
        if not scene.is_compiled:
            _tell(type(scene.visibility).__name__)

    def caps(self, deployment: Deployment, p: int) -> BoolArray:
        """Landmarks that each orientation covers from position p, flags `(D, K)`."""
        return coverage_caps(self._scene, deployment, self._positions[p], self._axes)

    def evaluate(
        self, landmarks: FloatArray, normals: FloatArray, weights: np.ndarray, n: int, counts: np.ndarray
    ) -> np.ndarray:
        """P_n in integer units of one deployment, `(P,)`; arguments as in `rig_views.RigViews.evaluate`."""
        deployment, size = Deployment(landmarks, normals), len(self._axes)
        rows = np.broadcast_to(weights[:, :size], (len(self._positions), size))
        units = np.empty(len(rows), dtype=np.int64)
        for p, row in enumerate(rows):
            count = cap_count(self.caps(deployment, p))
            units[p] = row[n_ple_cap(count, n)].sum()
            if len(counts):
                counts[p, :size] = count
        return units

    def gains(self, landmarks: FloatArray, normals: FloatArray, prices: FloatArray, slack: FloatArray) -> FloatArray:
        """See `poses.gains`: of N poses with `landmarks` and `normals` `(N, 3)`, and no slack."""
        if slack.any():
            self._scene.check_compiled("a bound on what pieces of the walls earn")
        alone = (self._alone(landmarks[[j]], normals[[j]]) for j in range(len(landmarks)))
        return np.array([np.where(seen, prices[:, : len(self._axes)], 0.0).sum(axis=0).sum() for seen in alone])

    def covered_amounts(self, landmarks: FloatArray, normals: FloatArray, amounts: FloatArray) -> FloatArray:
        """See `poses.covered_amounts`."""
        out = np.zeros((len(self._positions), len(self._axes)))
        for j in np.flatnonzero(amounts):
            out += amounts[j] * self._alone(landmarks[[j]], normals[[j]])
        return in_words(out)

    def _alone(self, landmark: FloatArray, normal: FloatArray) -> BoolArray:
        """From where a single landmark `(1, 3)` is covered, `(P, D)`."""
        deployment = Deployment(landmark, normal)
        return np.stack([self.caps(deployment, p)[:, 0] for p in range(len(self._positions))])


def seen_from(
    scene: Scene, camera: Camera, deployment: Deployment, positions: FloatArray, axes: FloatArray
) -> BoolArray:
    """Landmarks that a camera covers, flags `(N, K)`, from poses with positions `(N, 3)` and axes `(N, 6)`."""
    seen = np.empty((len(positions), len(deployment)), dtype=np.bool_)
    places, place = np.unique(positions, axis=0, return_inverse=True)
    order = np.argsort(place.reshape(-1), kind="stable")
    for at, there in zip(places, np.split(order, np.cumsum(np.bincount(place.reshape(-1)))[:-1]), strict=True):
        seen[there] = station_caps(scene, deployment, at, Station(camera, np.zeros(3), there, axes[there]))
    return seen
