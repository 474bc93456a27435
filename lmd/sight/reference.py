"""The coverage model of the paper, formula by formula: the oracle every faster path must agree with.

float64 NumPy, one function per equation. Decisions use closed inequalities with the shared `TOLERANCE`, and the
few sums behind them are written out term by term: a compiled path that repeats the same operations in the same
order reaches the same bits, hence identical counts, even for a landmark exactly on a boundary.

Shapes: A orientations, K landmarks, P positions. Lengths are metres, angles radians, frames world.
Source: Lei et al., "Optimization of Directional Landmark Deployment for Visual Observer on SE(3)", Sec. III-IV.
"""

import math

import numpy as np
from numpy.typing import NDArray

from lmd.camera import Camera
from lmd.checks import FloatArray
from lmd.deployment import Deployment
from lmd.pdf import OrientationPdf
from lmd.scene import Scene
from lmd.sight.visibility import TOLERANCE, Visibility

BoolArray = NDArray[np.bool_]
IntArray = NDArray[np.int64]


def dot(a: FloatArray, b: FloatArray) -> FloatArray:
    """Inner product over the last axis, summed from left to right."""
    return np.asarray(a[..., 0] * b[..., 0] + a[..., 1] * b[..., 1] + a[..., 2] * b[..., 2])


def resolution(camera: Camera, depth: FloatArray) -> FloatArray:
    """C^R = f d_s / ((d_s - f) z max(s_u, s_v)), pixel/mm (Eq. C_k^R).

    Args:
        depth: z^c, any shape, metres; what lies behind the camera has resolution 0.
    """
    positive = np.where(depth > 0.0, depth, np.inf)
    with np.errstate(over="ignore"):  # a depth too small to divide by has infinite resolution
        return np.asarray(camera.resolution_at_one_metre / positive)


def field_of_view(camera: Camera, depth: FloatArray, distance: FloatArray) -> BoolArray:
    """C^FOV: z > 0 and sqrt(x^2 + y^2) / z <= tan(min(phi)), as z >= |s| cos(min(phi)) (Eq. C_k^FOV).

    Both forms describe the same cone; this one needs no division and no roll.

    Args:
        depth: z^c, metres.
        distance: |s^c|, metres, same shape.
    """
    return np.asarray(depth >= distance * (math.cos(camera.cone_half_angle) - TOLERANCE)) & (depth > 0.0)


def focus(camera: Camera, circle_of_confusion: float, depth: FloatArray) -> BoolArray:
    """C^F: d_n <= z <= d_f (Eq. C_k^F)."""
    near, far = camera.depth_of_field(circle_of_confusion)
    return np.asarray((depth >= near * (1.0 - TOLERANCE)) & (depth <= far * (1.0 + TOLERANCE)))


def faces_away(offset: FloatArray, distance: FloatArray, normals: FloatArray) -> BoolArray:
    """zeta >= pi/2: the camera cannot see the front face (Eq. occlusion1).

    cos(zeta) = n . (p - s) / |p - s| is compared with 0.

    Args:
        offset: s_k - p, `(K, 3)`.
        distance: |s_k - p|, `(K,)`.
        normals: n_k, `(K, 3)`.
    """
    return np.asarray(-dot(normals, offset) <= TOLERANCE * distance)


def hidden_by_others(offset: FloatArray, visibility: Visibility) -> BoolArray:
    """Another landmark lies within nu of the line of sight (Eq. occlusion2), `(K,)`.

    The paper's |s_j - p| sqrt(1 - cos^2) is the distance from s_j to the line through p and s_k, that is
    |d_j x d_k| / |d_k|, which stays accurate for nearly collinear landmarks.

    Args:
        offset: d = s - p, `(K, 3)`.
    """
    count = len(offset)
    if not visibility.tests_other_landmarks:
        return np.zeros(count, dtype=bool)
    looked_at, other = offset[:, None, :], offset[None, :, :]
    cx = other[..., 1] * looked_at[..., 2] - other[..., 2] * looked_at[..., 1]
    cy = other[..., 2] * looked_at[..., 0] - other[..., 0] * looked_at[..., 2]
    cz = other[..., 0] * looked_at[..., 1] - other[..., 1] * looked_at[..., 0]
    squared = dot(offset, offset)
    reach = (visibility.nu * (1.0 + TOLERANCE)) ** 2
    hides = cx * cx + cy * cy + cz * cz <= reach * squared[:, None]
    if visibility.occlusion == "line_of_sight":
        hides &= dot(looked_at, other) > 0.0
        hides &= squared[None, :] <= squared[:, None] * (1.0 + TOLERANCE)
    hides[np.arange(count), np.arange(count)] = False
    return np.asarray(hides.any(axis=1))


def occlusion(offset: FloatArray, distance: FloatArray, normals: FloatArray, visibility: Visibility) -> BoolArray:
    """C^O: False where a landmark is occluded (Eq. C_k^O), `(K,)`. Args as in the two tests it joins."""
    return ~(faces_away(offset, distance, normals) | hidden_by_others(offset, visibility))


def coverage_strength(scene: Scene, deployment: Deployment, position: FloatArray, axes: FloatArray) -> FloatArray:
    """Cs = C^R C^FOV C^F C^O (Eq. Cs_k), pixel/mm.

    Args:
        position: p, `(3,)`.
        axes: optical axes, `(A, 3)`.

    Returns:
        `(A, K)`.
    """
    camera, visibility = scene.camera, scene.visibility
    offset = deployment.positions - position
    distance = np.sqrt(dot(offset, offset))
    depth = dot(axes[:, None, :], offset[None, :, :])
    seen = field_of_view(camera, depth, distance[None, :])
    seen &= focus(camera, visibility.circle_of_confusion, depth)
    seen &= occlusion(offset, distance, deployment.normals, visibility)[None, :]
    return np.where(seen, resolution(camera, depth), 0.0)


def coverage_caps(scene: Scene, deployment: Deployment, position: FloatArray, axes: FloatArray) -> BoolArray:
    """Which axes lie in the coverage spherical cap S_k^C(p) of each landmark (Definition 1), `(A, K)`."""
    strength = coverage_strength(scene, deployment, position, axes)
    return np.asarray(strength >= scene.visibility.thold * (1.0 - TOLERANCE))


def cap_count(caps: BoolArray) -> IntArray:
    """Num(S_k^C(p)): how many caps each axis passes through, `(A, K)` -> `(A,)` (Definition 2)."""
    return np.asarray(caps.sum(axis=-1))


def n_ple_cap(counts: IntArray, n: int) -> BoolArray:
    """S^n(p): the axes that pass through at least n caps (Definition 2), same shape as `counts`."""
    return np.asarray(counts >= n)


def coverage_probability(counts: IntArray, pdf: OrientationPdf, n: int) -> FloatArray:
    """P_n(p): the probability of the n-ple cap under the PDF (Eq. P_n), `(..., A)` -> `(...)`."""
    return np.asarray((n_ple_cap(counts, n) * pdf.weight).sum(axis=-1))


def qualified(probability: FloatArray, thold_p: float) -> BoolArray:
    """Qual: P_n(p) >= thold_p (Eq. Qual), same shape as `probability`."""
    return np.asarray(probability >= thold_p - TOLERANCE)


def cost(is_qualified: BoolArray, relevance: FloatArray) -> float:
    """H = sum over positions of Qual(p) Rel(p), the discrete cost (Eq. H2). Both `(P,)`."""
    return float((is_qualified * relevance).sum())


def counts(scene: Scene, deployment: Deployment) -> IntArray:
    """Landmarks covered at every grid position and orientation of the PDF, `(P, A)`."""
    # Orientations that share an axis (poles, the seam) use the same bits.
    axes = scene.pdf.axes[scene.pdf.axis_of]
    return np.stack([cap_count(coverage_caps(scene, deployment, p, axes)) for p in scene.room.grid()])
