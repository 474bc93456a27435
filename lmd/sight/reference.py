"""The coverage model of the paper on top of the criteria: the oracle every faster path must agree with.

float64 NumPy, one function per definition; the criteria themselves are the `covered` of the scene's visibility model.
Only tests, pictures and what stands in for a compiled half (`by_reference`) import this.

Shapes: A orientations, K landmarks, P positions.
Source: Lei et al., "Optimization of Directional Landmark Deployment for Visual Observer on SE(3)", Sec. III-IV.
"""

import numpy as np

from lmd.core.checks import BoolArray, FloatArray, IntArray
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
