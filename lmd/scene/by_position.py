"""An orientation PDF that depends on the position: a kernel estimate from recorded poses.

A camera that drives along aisles does not look everywhere alike. With records t at the positions x_t, orientations R_t
and lasting tau_t seconds, the probability of the orientation R_a at the position p is

    w_a(p) = sum_t tau_t G(p - x_t) K_t(a) / sum_t tau_t G(p - x_t),
    G(d)   = exp(-|d|^2 / (2 h^2)),
    K_t(a) = A_a exp(kappa (cos theta_ta - 1)) / sum_b A_b exp(kappa (cos theta_tb - 1)),   kappa = 1 / g^2.

h is the bandwidth in position, g that in direction, theta_ta the angle of the rotation from R_t to R_a. K_t is the von
Mises-Fisher kernel of rotations: for turns about one axis it is that of directions, and close to a normal distribution
with the standard deviation g. The R_a are the orientations of a grid of yaw, pitch and the rolls that occur, and A_a is
the solid angle of their cells. So each record spreads over orientations a probability of exactly one; where g is much
smaller than the step of the grid, all of it goes to the nearest.

Both kernels end where they are `CUT` of their greatest value. A position with no record so near has the PDF of all.
"""

import math

import numpy as np
from scipy.sparse import csr_array, vstack
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from lmd.core.checks import FloatArray
from lmd.core.memory import check_memory
from lmd.geometry.frames import angles_of, rotation
from lmd.scene.pdf import OrientationPdf

CUT_AT = 5.0  # bandwidths
CUT = math.exp(-(CUT_AT**2) / 2.0)
# Orientations with a smaller probability in all of the recording are left out: each costs time.
NEGLIGIBLE = 1e-6
CHUNK = 1 << 20  # records times orientations, or positions times records, that are looked at together
ENTRY_BYTES = 20  # of a record and an orientation within its kernel: twice a probability and an index


def pdf_by_position(
    poses: FloatArray, seconds: FloatArray, bandwidth: float, direction_bandwidth: float, divisions: int
) -> OrientationPdf:
    """The estimate of this module.

    Args:
        poses: X of T records, camera to world, `(T, 4, 4)`.
        seconds: that each of them lasted, `(T,)`.
        bandwidth: h, metres.
        direction_bandwidth: g, radians.
        divisions: the step of the grid of orientations is pi / divisions.

    Returns:
        its weights are those of all positions together, and `by_position` the estimate.

    Raises:
        InputError: the records and orientations would not fit into memory.
    """
    yaw, pitch, roll, solid_angle = _grid(poses, divisions)
    spread = _spread(poses, rotation(yaw, pitch, roll), solid_angle, direction_bandwidth)
    total = seconds @ spread / seconds.sum()
    kept = np.flatnonzero(total > NEGLIGIBLE)
    spread, total = spread[:, kept], total[kept]
    kernels = _Kernels(poses[:, :3, 3], seconds, spread, total / total.sum(), bandwidth)
    name = f"pdf recorded (bandwidths {bandwidth:g} m, {math.degrees(direction_bandwidth):g} degrees)"
    return OrientationPdf(
        yaw[kept], pitch[kept], total / total.sum(), name, roll=roll[kept], by_position=kernels.probabilities
    )


def _grid(poses: FloatArray, divisions: int) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """The grid of orientations, level ones among them: yaw, pitch, roll and solid angle, `(A,)` each."""
    step = np.pi / divisions
    *_, rolled = angles_of(np.swapaxes(poses[:, :3, :3], 1, 2))
    rolls = np.unique(np.rint(rolled / step) % (2 * divisions)) * step
    yaws, pitches = np.arange(2 * divisions) * step - np.pi, np.linspace(-np.pi / 2, np.pi / 2, divisions + 1)
    yaw, pitch, roll = (angle.reshape(-1) for angle in np.meshgrid(yaws, pitches, rolls, indexing="ij"))
    low, high = np.maximum(pitch - step / 2, -np.pi / 2), np.minimum(pitch + step / 2, np.pi / 2)
    return yaw, pitch, roll, np.sin(high) - np.sin(low)


def _spread(poses: FloatArray, orientations: FloatArray, solid_angle: FloatArray, width: float) -> csr_array:
    """K_t(a) `(T, A)`; orientations `(A, 3, 3)` world to camera."""
    nodes = Rotation.from_matrix(np.swapaxes(orientations, 1, 2)).as_quat()
    recorded = Rotation.from_matrix(poses[:, :3, :3]).as_quat()
    rows = max(CHUNK // len(nodes), 1)
    parts = []
    for start in range(0, len(recorded), rows):
        # cos theta = 2 (q . q')^2 - 1 for the unit quaternions q and q'.
        cosine = 2.0 * np.einsum("ti,ai->ta", recorded[start : start + rows], nodes) ** 2 - 1.0
        behind = np.exp((cosine - cosine.max(axis=1, keepdims=True)) / width**2)
        kernel = np.where(behind >= CUT, solid_angle * behind, 0.0)
        parts.append(csr_array(kernel / kernel.sum(axis=1, keepdims=True)))
        stored = sum(part.nnz for part in parts) / len(parts) * math.ceil(len(recorded) / rows)
        made = f"{len(recorded)} records spread over {len(nodes)} orientations, which"
        check_memory(ENTRY_BYTES * stored, made, "divisions")
    return csr_array(vstack(parts))


class _Kernels:
    """w_a(p) at any position.

    Args:
        positions: x_t, `(T, 3)`, metres.
        seconds: tau_t, `(T,)`.
        spread: K_t(a), `(T, A)`.
        everywhere: the probabilities of all positions together, `(A,)`.
        bandwidth: h, metres.
    """

    def __init__(
        self, positions: FloatArray, seconds: FloatArray, spread: csr_array, everywhere: FloatArray, bandwidth: float
    ) -> None:
        self._records, self._seconds, self._spread = cKDTree(positions), seconds, spread
        self._everywhere, self._bandwidth = everywhere, bandwidth

    def probabilities(self, positions: FloatArray) -> FloatArray:
        """w `(Q, A)` at positions `(Q, 3)`."""
        rows = max(CHUNK // self._records.n, 1)
        parts = [self._near(positions[start : start + rows]) for start in range(0, len(positions), rows)]
        found = np.concatenate(parts)
        total = found.sum(axis=1, keepdims=True)
        return np.where(total > 0.0, found / np.where(total > 0.0, total, 1.0), self._everywhere)

    def _near(self, positions: FloatArray) -> FloatArray:
        """The sums over records above the line, `(Q, A)`."""
        pairs = cKDTree(positions).sparse_distance_matrix(
            self._records, CUT_AT * self._bandwidth, output_type="ndarray"
        )
        weight = self._seconds[pairs["j"]] * np.exp(-((pairs["v"] / self._bandwidth) ** 2) / 2.0)
        shape = len(positions), self._records.n
        near = csr_array((weight, (pairs["i"], pairs["j"])), shape=shape)
        near.sort_indices()  # sums in the order of time
        return np.asarray((near @ self._spread).toarray())
