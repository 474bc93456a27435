"""The coverage model of the paper on top of the criteria: the oracle every faster path must agree with.

float64 NumPy, one function per definition; the criteria themselves are the `covered` of the scene's visibility model.
`ReferenceViews` evaluates a scene by it, position by position, if the visibility model has no compiled half.

Shapes: A orientations, K landmarks, P positions.
Source: Lei et al., "Optimization of Directional Landmark Deployment for Visual Observer on SE(3)", Sec. III-IV.
"""

import sys
from functools import cache

import numpy as np

from lmd.core.bits import in_words
from lmd.core.checks import BoolArray, FloatArray, IntArray
from lmd.geometry.camera import Camera
from lmd.scene.criteria import TOLERANCE
from lmd.scene.deployment import Deployment
from lmd.scene.pdf import OrientationPdf
from lmd.scene.rig import Station
from lmd.scene.scene import Scene
from lmd.sight.obstacles import unobstructed


def coverage_caps(scene: Scene, deployment: Deployment, position: FloatArray, axes: FloatArray) -> BoolArray:
    """Which axes `(A, 6)` lie in the coverage spherical cap S_k^C(p) of each landmark (Definition 1), `(A, K)`.

    Empty for landmarks that something in the room blocks. For a rig, position and axes are those of its body: some
    camera covers the landmark, each from its own pose.
    """
    covered = np.zeros((len(axes), len(deployment)), dtype=np.bool_)
    for station in scene.stations(axes):
        covered[station.there] |= station_caps(scene, deployment, position, station)
    return covered


def station_caps(scene: Scene, deployment: Deployment, position: FloatArray, station: Station) -> BoolArray:
    """The same for the camera of a station, and the orientations with which it is there, `(a, K)`."""
    landmarks, place = (deployment.positions, deployment.normals), position + station.offset
    seen = scene.visibility.covered(station.camera, place, station.axes, *landmarks)
    clear = unobstructed(scene.room, scene.visibility.sight(station.camera), place, *landmarks)
    return np.asarray(seen & clear)


def cap_count(caps: BoolArray) -> IntArray:
    """Num(S_k^C(p)): how many caps each axis passes through, `(A, K)` -> `(A,)` (Definition 2)."""
    return np.asarray(caps.sum(axis=-1))


def n_ple_cap(counts: IntArray, n: int) -> BoolArray:
    """S^n(p): the axes that pass through at least n caps (Definition 2), same shape as `counts`."""
    return np.asarray(counts >= n)


def coverage_probability(
    counts: IntArray, pdf: OrientationPdf, n: int, positions: FloatArray | None = None
) -> FloatArray:
    """P_n(p): the probability of the n-ple cap under the PDF (Eq. P_n), `(..., A)` -> `(...)`.

    `positions` `(P, 3)` are those of the counts `(P, A)`, for a PDF that depends on them.
    """
    weight = pdf.weight if positions is None else pdf.at(positions)
    return np.asarray((n_ple_cap(counts, n) * weight).sum(axis=-1))


def qualified(probability: FloatArray, thold_p: float) -> BoolArray:
    """Qual: P_n(p) >= thold_p (Eq. Qual), same shape as `probability`."""
    return np.asarray(probability >= thold_p - TOLERANCE)


def cost(is_qualified: BoolArray, relevance: FloatArray) -> float:
    """H = sum over positions of Qual(p) Rel(p), the discrete cost (Eq. H2). Both `(P,)`."""
    return float((is_qualified * relevance).sum())


def counts(scene: Scene, deployment: Deployment) -> IntArray:
    """Landmarks covered at every grid position and orientation of the PDF, `(P, A)`."""
    axes, index_of, _ = scene.orientations  # those that are the same (poles, the seam) are asked once
    counted = [cap_count(coverage_caps(scene, deployment, p, axes)) for p in scene.room.grid()]
    return np.stack(counted)[:, index_of]


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
