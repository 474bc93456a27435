"""What a model of sight must answer: whether a camera covers a landmark, in two stages, and who hides whom.

Most of what decides depends on the camera's position alone, little on its orientation. So each criterion is told twice:
once for all orientations from a position (`from_position`), once for one orientation (`in_image`): the optical axis and
the image's right, which a model that asks for a round cone ignores. Whether another landmark is in the way is a third
question (`hide`). The three functions are scalar, without a branch where it can be helped, and every kernel calls these
and no others.

A model has two sides:

- the thresholds that a user sets, a `Criteria`; its `covered` is the reference, NumPy, formula by formula;
- the same compiled for one camera, a named tuple of numbers with the fields and methods of `Sight`, which registers its
  functions with the three below. Both must decide alike, bit for bit.

What prunes (bands of axes, tables of directions) goes by cones only: one that holds every axis that covers a landmark
(`low`), one whose axes all do (`inner_cosine`), which may be empty.
"""

from typing import Any, Protocol

from numba import njit

from lmd.camera import Camera
from lmd.checks import BoolArray, FloatArray
from lmd.dispatch import dispatched

# One tolerance for every closed inequality, so that a landmark exactly on a boundary is on it whichever way the
# number was rounded. Relative for lengths, absolute for cosines and probabilities.
TOLERANCE = 1e-9


class Sight(Protocol):
    """The fields and methods of a compiled model of sight, a named tuple."""

    @property
    def outer_cosine(self) -> float:
        """No axis farther than the angle with this cosine from a landmark's direction covers it."""

    @property
    def inner_cosine(self) -> float:
        """Every axis within the angle with this cosine does, unless `from_position` says limited; above 1 for none."""

    @property
    def reach(self) -> float:
        """Squared distance from a line of sight beyond which a landmark hides nothing, m^2; negative: none does."""

    def unhidden(self) -> "Sight":
        """The same where no landmark hides another."""

    def among(self, low: FloatArray, high: FloatArray, landmarks: FloatArray, normals: FloatArray) -> "Sight":
        """The same for these landmarks: `unhidden` if that is easily known to make no difference.

        Args:
            low, high: corners of a box around all positions of the camera, `(3,)`, metres.
            landmarks, normals: of B deployments, `(B, 3, K)`.
        """

    def shrunk(self, size: float) -> "Sight":
        """The same with landmarks whose body, which hides others, is `size` times as large."""


class Criteria(Protocol):
    """When a landmark counts as covered: what `visibility` of a scene must be."""

    @property
    def needs_roll(self) -> bool:
        """Whether the camera's roll about its optical axis matters."""

    @property
    def spacing(self) -> float:
        """How far apart neighbouring landmarks had better be, so that none hides the other, metres."""

    def sight(self, camera: Camera) -> Any:
        """These criteria compiled for a camera, a `Sight`."""

    def covered(
        self, camera: Camera, position: FloatArray, axes: FloatArray, landmarks: FloatArray, normals: FloatArray
    ) -> BoolArray:
        """Which landmarks the camera covers, `(A, K)`: the reference.

        Args:
            camera: the camera.
            position: p, `(3,)`, world frame, metres.
            axes: its optical axes and the image's right, `(A, 6)`: two unit vectors.
            landmarks, normals: `(K, 3)` positions, metres, and unit normals.
        """


@dispatched
def from_position(sight, x, y, z, nx, ny, nz, slack):  # type: ignore[no-untyped-def]
    """What a landmark is like from a position, whatever the camera's orientation.

    Args:
        sight: the compiled model.
        x, y, z: offset of the landmark from the camera, world frame, metres.
        nx, ny, nz: its unit normal.
        slack: metres; the answer shall hold for every landmark that far away in the same plane (see `poses`).

    Returns:
        reached: False only if no orientation covers it; low: the least depth along the optical axis, metres, with which
        one may; limited: whether even axes of the inner cone may fail.
    """


@dispatched
def in_image(sight, x, y, z, nx, ny, nz, low, slack, ax, ay, az, rx, ry, rz):  # type: ignore[no-untyped-def]
    """Whether a landmark that is `reached` is covered with the optical axis (ax, ay, az), nobody hiding it.

    (rx, ry, rz) points to the right of the image, axis x right down.
    The other arguments are those and the answers of `from_position`; an infinite `low` is never covered.
    """


@dispatched
def hide(sight, ax, ay, az, a, bx, by, bz, b, ux, uy, uz, vx, vy, vz):  # type: ignore[no-untyped-def]
    """Whether landmark A hides B, and B hides A, from where the camera is.

    Args:
        sight: the compiled model.
        ax, ay, az, bx, by, bz: offsets of the two from the camera, metres.
        a, b: their squared lengths.
        ux, uy, uz, vx, vy, vz: unit normals of A and of B.
    """


@njit(inline="always")
def covers(sight, x, y, z, nx, ny, nz, low, slack, axes, a):  # type: ignore[no-untyped-def]
    """`in_image` with orientation a of `axes` `(6, D)`: axis and right."""
    ax, ay, az, rx, ry, rz = axes[0, a], axes[1, a], axes[2, a], axes[3, a], axes[4, a], axes[5, a]
    return in_image(sight, x, y, z, nx, ny, nz, low, slack, ax, ay, az, rx, ry, rz)
