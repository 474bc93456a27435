"""Reference of the coverage model of the paper in float64 NumPy; compiled code must give identical results.

There is one function per definition of the paper; the criteria are `Criteria.covered` of the scene's visibility model.
`ReferenceViews` evaluates scenes whose visibility model has no compiled model of sight.

Shapes: A orientations, K landmarks, P positions.
Source: Lei et al., "Optimization of Directional Landmark Deployment for Visual Observer on SE(3)", Sec. III-IV.
"""

import sys
from functools import cache
from typing import TypeAlias

import numpy as np

from lmd.core.bits import in_words
from lmd.core.checks import BoolArray, FloatArray, IntArray, returned
from lmd.geometry.camera import Camera
from lmd.scene.criteria import TOLERANCE
from lmd.scene.deployment import Deployment
from lmd.scene.pdf import OrientationPdf
from lmd.scene.rig import Station
from lmd.scene.scene import Scene
from lmd.sight.crowd import unhindered


def coverage_caps(scene: Scene, deployment: Deployment, position: FloatArray, axes: FloatArray) -> BoolArray:
    """Mask `(A, K)`: axis a lies in the coverage spherical cap S_k^C(p) of landmark k (Definition 1).

    A landmark that the room or a crowd blocks has an empty cap. For a rig, position and axes belong to the body, and
    the cap is the union of the caps for the cameras of the rig, each at the camera's own pose.

    Args:
        scene: criteria, room and cameras, with at most one crowd state.
        deployment: K landmarks.
        position: p, `(3,)`, world frame, metres.
        axes: optical axis and direction to the right in the image, `(A, 6)`, unit vectors, world frame.
    """
    covered = np.zeros((len(axes), len(deployment)), dtype=np.bool_)
    for station in scene.stations(axes):
        covered[station.there] |= station_caps(scene, deployment, position, station)
    return covered


def station_caps(scene: Scene, deployment: Deployment, position: FloatArray, station: Station) -> BoolArray:
    """Mask `(a, K)` of the landmarks that a rig's camera covers; column k is the coverage cap of landmark k.

    A station is one offset of the camera from the body, and the a orientations of the body that give this offset.
    `position` `(3,)` is the position of the body, metres.
    """
    landmarks, place = (deployment.positions, deployment.normals), position + station.offset
    seen = scene.visibility.covered(station.camera, place, station.axes, *landmarks)
    clear = unhindered(scene, station.camera, place, *landmarks)
    seen = returned(scene.visibility, "covered", seen, len(station.axes), len(deployment), truth=True)
    return np.asarray(seen & clear)


def cap_count(caps: BoolArray) -> IntArray:
    """Num(S_k^C(p)): number of caps that contain each axis, `(A,)` (Definition 2); `caps` is a mask `(A, K)`."""
    return np.asarray(caps.sum(axis=-1))


def n_ple_cap(counts: IntArray, n: int) -> BoolArray:
    """S^n(p): mask of the axes in at least n caps (Definition 2), shape of `counts`."""
    return np.asarray(counts >= n)


def coverage_probability(
    counts: IntArray, pdf: OrientationPdf, n: int, positions: FloatArray | None = None
) -> FloatArray:
    """P_n(p): probability, under the PDF, of the orientations that are in at least n caps (Eq. P_n), `(...)`.

    `counts` `(..., A)` has the number of caps that contain each orientation. For a PDF that depends on the position,
    `positions` `(P, 3)` must be given, and `counts` is `(P, A)`.
    """
    weight = pdf.weight if positions is None else pdf.at(positions)
    return np.asarray((n_ple_cap(counts, n) * weight).sum(axis=-1))


def qualified(probability: FloatArray, thold_p: float) -> BoolArray:
    """Qual: mask of the entries of `probability` with P_n(p) >= thold_p (Eq. Qual), in the shape of `probability`."""
    return np.asarray(probability >= thold_p - TOLERANCE)


def counts(scene: Scene, deployment: Deployment) -> IntArray:
    """Number of landmarks covered at each of P grid positions and A orientations of the scene's PDF, `(P, A)`.

    With a crowd, the positions are repeated for each crowd state.
    """
    axes, index_of, _ = scene.orientations  # orientations that are equal (poles, yaws of +-pi) are evaluated once
    states = [scene.in_state(s) for s in range(1 if scene.crowd is None else len(scene.crowd))]
    counted = [cap_count(coverage_caps(state, deployment, p, axes)) for state in states for p in scene.room.grid()]
    return np.stack(counted)[:, index_of]


@cache
def _warn_uncompiled(name: str) -> None:
    """Print once per process that the visibility model `name` has no compiled model of sight."""
    slow = "an evaluation takes about 100 times as long, a move of annealing about 1000 times"
    cure = 'see docs/extend.md, "Compile a criterion"'
    print(f"note: {name} is not compiled, so its NumPy code is used: {slow}; {cure}", file=sys.stderr)


class ReferenceViews:
    """Coverage, computed by the reference, from P positions and D orientations of a camera or of the body of a rig.

    Args:
        scene: scene; its visibility model may lack a compiled model of sight.
        positions: positions of the camera, or of the body of the rig, `(P, 3)`, metres.
        states: crowd state at each position, `(P,)`; None without a crowd.
    """

    def __init__(self, scene: Scene, positions: FloatArray, states: IntArray | None = None) -> None:
        self._scene, self._positions, self._axes = scene, positions, scene.orientations.axes
        self._states = np.zeros(len(positions), dtype=np.int64) if states is None else states
        self._in_state = {s: scene.in_state(s) for s in np.unique(self._states).tolist()}
        if not scene.is_compiled:
            _warn_uncompiled(type(scene.visibility).__name__)

    def scene_at(self, p: int) -> Scene:
        """Scene reduced to the crowd state of position p."""
        return self._in_state[int(self._states[p])]

    def caps(self, deployment: Deployment, p: int) -> BoolArray:
        """Mask of the landmarks that each orientation covers from position p, `(D, K)`."""
        return coverage_caps(self.scene_at(p), deployment, self._positions[p], self._axes)

    def evaluate(
        self, landmarks: FloatArray, normals: FloatArray, weights: np.ndarray, n: int, counts: np.ndarray
    ) -> np.ndarray:
        """Probability P_n that at least n landmarks of a deployment are covered, for each of P positions, `(P,)`.

        P_n is quantised: integers in units of 1 / `PROBABILITY_ONE`.

        Args:
            landmarks, normals: positions, metres, and unit normals, `(K, 3)`.
            weights: quantised probability of each orientation, padded with zeros to 64 W columns, `(1, 64 W)` or
                `(P, 64 W)`.
            n: number of landmarks that must be covered.
            counts: receives the number of landmarks that each orientation covers, `(P, 64 W)` zeros; empty to skip the
                counts.
        """
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
        """For each of N poses, sum of the prices (weights) of the views that cover a landmark there, see `poses.gains`.

        A view is a camera position and an orientation; `prices` is `(P, 64 W)`. The result is `(N,)`.

        `landmarks` and `normals` `(N, 3)` are positions and unit normals of the poses; `slack` must be 0.
        """
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
        """Mask `(P, D)` of the positions and orientations from which a single landmark is covered.

        `landmark`, the position, and `normal` are `(1, 3)`.
        """
        deployment = Deployment(landmark, normal)
        return np.stack([self.caps(deployment, p)[:, 0] for p in range(len(self._positions))])


Views: TypeAlias = tuple[FloatArray, FloatArray]  # positions `(N, 3)` and axes `(N, 6)` of N poses


def seen_from(
    scene: Scene, camera: Camera, deployment: Deployment, poses: Views, states: IntArray | None = None
) -> BoolArray:
    """Mask `(N, K)` of the landmarks that a camera covers from N poses.

    `poses` are positions, metres, `(N, 3)`, and axes `(N, 6)`: optical axis and direction to the right in the image.
    With a crowd, `states` `(N,)` has the index of the crowd state (arrangement of people) at each pose.
    """
    positions, axes = poses
    seen = np.empty((len(positions), len(deployment)), dtype=np.bool_)
    if states is not None:
        for s in np.unique(states):
            here = states == s
            seen[here] = seen_from(scene.in_state(s), camera, deployment, (positions[here], axes[here]))
        return seen
    places, place = np.unique(positions, axis=0, return_inverse=True)
    order = np.argsort(place.reshape(-1), kind="stable")
    for at, there in zip(places, np.split(order, np.cumsum(np.bincount(place.reshape(-1)))[:-1]), strict=True):
        seen[there] = station_caps(scene, deployment, at, Station(camera, np.zeros(3), there, axes[there]))
    return seen
