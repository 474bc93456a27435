"""Position-dependent orientation PDF: kernel estimate from recorded poses.

The orientations of a camera that drives along aisles depend on its position. Record t has the position x_t, the
orientation R_t and the duration tau_t, seconds. The probability of the orientation R_a at the position p is

    w_a(p) = sum_t tau_t G(p - x_t) K_t(a) / sum_t tau_t G(p - x_t),
    G(d)   = exp(-|d|^2 / (2 h^2)),
    K_t(a) = A_a exp(kappa (cos theta_ta - 1)) / sum_b A_b exp(kappa (cos theta_tb - 1)),   kappa = 1 / g^2.

h is the bandwidth in position, g the bandwidth in direction, and theta_ta the angle of the rotation from R_t to R_a.
K_t is a von Mises-Fisher kernel of rotations. For turns about one axis it equals the kernel of directions and is close
to a normal distribution with the standard deviation g. The R_a form a grid of yaw, pitch and the recorded rolls; A_a is
the solid angle of a grid cell. Each K_t sums to 1 over the orientations. If g is much smaller than the grid step, K_t
is 1 at the nearest orientation.

Both kernels are cut off below `CUT` of their maximum. A position beyond the kernels of all records has the mean PDF of
the recording.
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

CUT_AT = 5.0  # distance at which kernels are cut off, bandwidths
CUT = math.exp(-(CUT_AT**2) / 2.0)
# Least probability of an orientation over the whole recording. Rarer orientations are dropped to save time.
NEGLIGIBLE = 1e-6
CHUNK = 1 << 20  # maximum number of record-orientation or position-record pairs per batch
ENTRY_BYTES = 20  # memory of a nonzero K_t(a): two copies of a probability and an index


def pdf_by_position(
    poses: FloatArray, seconds: FloatArray, bandwidth: float, direction_bandwidth: float, divisions: int
) -> OrientationPdf:
    """Estimate the PDF w_a(p) of this module.

    Args:
        poses: X of T records, camera to world, `(T, 4, 4)`.
        seconds: duration tau_t of each record, `(T,)`.
        bandwidth: h, metres.
        direction_bandwidth: g, radians.
        divisions: the step of the grid of orientations is pi / divisions.

    Returns:
        PDF with `by_position`; its `weight` is the mean over the recording.

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
    """Grid of yaw, pitch (poles included) and recorded rolls, and relative solid angle of the cells, `(A,)` each."""
    step = np.pi / divisions
    *_, rolled = angles_of(np.swapaxes(poses[:, :3, :3], 1, 2))
    rolls = np.unique(np.rint(rolled / step) % (2 * divisions)) * step
    yaws, pitches = np.arange(2 * divisions) * step - np.pi, np.linspace(-np.pi / 2, np.pi / 2, divisions + 1)
    yaw, pitch, roll = (angle.reshape(-1) for angle in np.meshgrid(yaws, pitches, rolls, indexing="ij"))
    low, high = np.maximum(pitch - step / 2, -np.pi / 2), np.minimum(pitch + step / 2, np.pi / 2)
    return yaw, pitch, roll, np.sin(high) - np.sin(low)


def _spread(poses: FloatArray, orientations: FloatArray, solid_angle: FloatArray, width: float) -> csr_array:
    """Kernels K_t(a), `(T, A)`.

    Args:
        poses: X, camera to world, `(T, 4, 4)`.
        orientations: rotations from the world to the camera, `(A, 3, 3)`.
        solid_angle: A_a, `(A,)`.
        width: g, radians.
    """
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
    """Kernel estimate w_a(p) of the PDF at a position.

    Args:
        positions: x_t, `(T, 3)`, metres.
        seconds: tau_t, `(T,)`.
        spread: K_t(a), `(T, A)`.
        everywhere: mean PDF of the recording, for positions beyond all kernels, `(A,)`.
        bandwidth: h, metres.
    """

    def __init__(
        self, positions: FloatArray, seconds: FloatArray, spread: csr_array, everywhere: FloatArray, bandwidth: float
    ) -> None:
        self._records, self._seconds, self._spread = cKDTree(positions), seconds, spread
        self._everywhere, self._bandwidth = everywhere, bandwidth

    def probabilities(self, positions: FloatArray) -> FloatArray:
        """Probabilities w_a(p) at positions p `(Q, 3)`, `(Q, A)`."""
        rows = max(CHUNK // self._records.n, 1)
        parts = [self._near(positions[start : start + rows]) for start in range(0, len(positions), rows)]
        found = np.concatenate(parts)
        total = found.sum(axis=1, keepdims=True)
        return np.where(total > 0.0, found / np.where(total > 0.0, total, 1.0), self._everywhere)

    def _near(self, positions: FloatArray) -> FloatArray:
        """Numerators of w_a(p), sum_t tau_t G(p - x_t) K_t(a), at positions p `(Q, 3)`, `(Q, A)`."""
        pairs = cKDTree(positions).sparse_distance_matrix(
            self._records, CUT_AT * self._bandwidth, output_type="ndarray"
        )
        weight = self._seconds[pairs["j"]] * np.exp(-((pairs["v"] / self._bandwidth) ** 2) / 2.0)
        shape = len(positions), self._records.n
        near = csr_array((weight, (pairs["i"], pairs["j"])), shape=shape)
        near.sort_indices()  # so that records are summed in order of time
        return np.asarray((near @ self._spread).toarray())
