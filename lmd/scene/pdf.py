"""Orientation PDFs: the probability of each camera orientation (yaw, pitch) on a discrete grid."""

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from pathlib import Path
from typing import NamedTuple

import numpy as np

from lmd.core.checks import FloatArray, InputError, integer, real
from lmd.core.memory import check_memory
from lmd.core.tables import radians, read_table, write_table
from lmd.geometry.frames import optical_axis, rotation

# Number of decimals to which the coordinates of equal axes agree.
SAME_AXIS_DECIMALS = 12
# Largest rounding error of a weight: weights printed with six decimals are accepted and normalised.
PRINTED_WEIGHT = 0.5e-6
# Memory of an orientation while duplicates are removed, bytes: rotation, axes and sort keys.
ORIENTATION_BYTES = 600

# Map from points `(S, 2)` of the unit square to yaw and pitch, radians, `(S,)` each: uniform points give angles that
# follow a continuous distribution.
Angles = Callable[[FloatArray], tuple[FloatArray, FloatArray]]
# Map from positions `(Q, 3)` to the probability of each orientation, `(Q, A)`.
ByPosition = Callable[[FloatArray], FloatArray]
# One roll, radians, or a list of pairs (roll, probability).
Roll = float | Sequence[Sequence[float]]


class Orientations(NamedTuple):
    """The D distinct orientations of a PDF, and their probabilities, ordered by the z component of the optical axis."""

    axes: FloatArray
    """Optical axis and direction to the right in the image, two unit vectors, world frame, `(D, 6)`.

    The cross product axis x right points down in the image.
    """
    index_of: np.ndarray
    """Index in `axes` of each of the A orientations of the PDF, `(A,)`."""
    weight: FloatArray
    """Probability of each orientation, `(D,)`."""


@dataclass(frozen=True)
class OrientationPdf:
    """Discrete orientation PDF D(alpha, beta) of the yaw alpha and the pitch beta.

    Args:
        yaw, pitch: angles of each orientation, radians, `(A,)`; pitch in [-pi/2, pi/2].
        weight: probability of each orientation, not negative, `(A,)`. The sum must be 1 within rounding; it is then
            normalised to 1.
        name: name of the source, for messages.
        refine: function that returns the PDF with half the grid step; None if there is no finer grid.
        continuous: continuous distribution of yaw and pitch that the grid discretises; None for a discrete
            distribution.
        roll: roll about the optical axis, radians, one for all or `(A,)`; independent of yaw and pitch if `continuous`
            is given.
        by_position: function that returns the probability of each orientation at each position; `weight` is then the
            mean of its results over the positions. None if the probabilities do not depend on the position.

    Raises:
        InputError: shapes differ, an angle or weight is not finite or out of range, or the sum of the weights is not 1.
    """

    yaw: FloatArray
    pitch: FloatArray
    weight: FloatArray
    name: str = "pdf"
    refine: "Callable[[], OrientationPdf] | None" = None
    continuous: Angles | None = None
    roll: FloatArray | float = 0.0
    by_position: ByPosition | None = None

    def __post_init__(self) -> None:
        yaw, roll = (np.asarray(v, dtype=np.float64) for v in (self.yaw, self.roll))
        rolls = np.full(yaw.shape, roll) if roll.ndim == 0 else roll
        arrays = [yaw, *(np.asarray(v, dtype=np.float64) for v in (self.pitch, self.weight)), rolls]
        if not yaw.size or any(a.shape != (yaw.size,) for a in arrays):
            raise InputError(f"{self.name}: yaw, pitch, weight and roll must be non-empty lists of equal length.")
        if not all(np.isfinite(a).all() for a in arrays):
            raise InputError(f"{self.name} has a value that is not finite.")
        _, pitch, weight, _ = arrays
        if (worst := np.abs(pitch).max()) > np.pi / 2 + 1e-9:
            raise InputError(f"{self.name}: pitch must be in [-pi/2, pi/2], got {worst:g} in magnitude.")
        if weight.min() < 0.0:
            raise InputError(f"{self.name} has a negative weight, {weight.min():g}.")
        if abs(weight.sum() - 1.0) > PRINTED_WEIGHT * len(weight) + 1e-9:
            raise InputError(f"{self.name}: the weights must sum to 1, they sum to {weight.sum():.9g}.")
        arrays[2] = weight / math.fsum(weight)
        for field, array in zip(("yaw", "pitch", "weight", "roll"), arrays, strict=True):
            array = array.copy()
            array.flags.writeable = False
            object.__setattr__(self, field, array)

    @cached_property
    def by_axis(self) -> Orientations:
        """Orientations of the PDF; those with equal optical axes are merged, and their probabilities are added.

        Axes are equal at each pole and for the yaws pi and -pi. For example, the 325 orientations of `grid_with_ends`
        have 266 distinct axes.
        """
        return self._distinct(3)

    @cached_property
    def by_axis_and_roll(self) -> Orientations:
        """Orientations of the PDF; those with equal optical axes and equal rolls of the image are merged.

        The comparison uses two vectors: the optical axis, and the direction to the right in the image. At a pitch of
        +-90 degrees, different yaws have equal optical axes but different directions to the right, so they are not
        merged.
        """
        return self._distinct(6)

    def _distinct(self, size: int) -> Orientations:
        """Orientations of the PDF; those with equal first `size` coordinates are merged.

        The six coordinates are the optical axis, then the direction to the right in the image.
        """
        # `optical_axis` and the last row of `rotation` may differ in the last bits; results depend on the former.
        right = rotation(self.yaw, self.pitch, self.roll)[:, 0]
        axes = np.hstack([optical_axis(self.yaw, self.pitch), right])
        rounded = np.round(axes[:, :size], SAME_AXIS_DECIMALS) + 0.0  # + 0.0 turns -0 into 0
        # Sorted by z first, as kernels test only axes within a band of z.
        keys = np.hstack([rounded[:, 2::-1], rounded[:, 3:]])
        _, first, inverse = np.unique(keys, axis=0, return_index=True, return_inverse=True)
        inverse = inverse.reshape(-1)
        weight = np.bincount(inverse, weights=self.weight)
        return Orientations(axes[first], inverse, np.asarray(weight, dtype=np.float64))

    @property
    def axes(self) -> FloatArray:
        """Distinct optical axes, `(D, 3)` unit vectors ordered by their z coordinate."""
        return self.by_axis.axes[:, :3]

    def finer(self) -> "OrientationPdf":
        """PDF with half the grid step; the PDF itself if it has no `refine`."""
        return self if self.refine is None else self.refine()

    def stratified(self, divisions: int, rng: np.random.Generator) -> "OrientationPdf":
        """PDF of equally weighted, stratified draws from `continuous`; the PDF itself if `continuous` is None.

        With m = `divisions`, yaw and pitch are divided into 2 m x m cells of equal probability. One orientation is
        drawn in each cell. Estimates are unbiased, as for independent draws, but more accurate. The error of P_n, the
        probability that at least n landmarks are covered, falls as m^-1.5; for independent draws it falls as m^-1. If
        only the yaw varies, there are about 2 m^1.5 cells, and the error also falls as m^-1.5.
        """
        if self.continuous is None:
            return self
        yaws, pitches = 2 * divisions, divisions
        along = self.continuous(np.array([[0.5, 0.0], [0.5, 1.0]]))
        if not np.ptp(along, axis=1).any() and not np.ptp(np.asarray(self.roll)):
            yaws, pitches = round(2.0 * divisions**1.5), 1
        cells = np.stack(np.meshgrid(np.arange(yaws), np.arange(pitches), indexing="ij"), axis=-1)
        points = (cells + rng.random(cells.shape)) / (yaws, pitches)
        yaw, pitch = self.continuous(points.reshape(-1, 2))
        weight = np.full(len(yaw), 1.0 / len(yaw))
        return OrientationPdf(yaw, pitch, weight, f"{self.name}, stratified", roll=self._draw_roll(len(yaw), rng))

    def at(self, positions: FloatArray) -> FloatArray:
        """Probability of each orientation at each position, `(Q, A)`: a row for each of the Q positions.

        The result has a single row, `(1, A)`, if the probabilities do not depend on the position. `positions` has the
        shape `(Q, 3)`, metres.
        """
        return self.weight[None] if self.by_position is None else self.by_position(positions)

    def draw_at(self, positions: FloatArray, rng: np.random.Generator) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Draw one orientation at each of Q positions; return yaw, pitch and roll, radians, `(Q,)` each.

        `positions` has the shape `(Q, 3)`, metres.

        Without `by_position`, the orientations are drawn as in `draw`.
        """
        if self.by_position is None:
            return self.draw(len(positions), rng)
        places, place = np.unique(positions, axis=0, return_inverse=True)
        below = np.cumsum(self.at(places), axis=1)[place.reshape(-1)]
        drawn = (below < rng.random((len(positions), 1)) * below[:, -1:]).sum(axis=1)
        return self.yaw[drawn], self.pitch[drawn], np.asarray(self.roll)[drawn]

    def draw(self, size: int, rng: np.random.Generator) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Draw yaw, pitch and roll, radians, `(size,)` each, from `continuous` if given, else from the discrete PDF."""
        if self.continuous is not None:
            return *self.continuous(rng.random((size, 2))), self._draw_roll(size, rng)
        drawn = rng.choice(len(self.weight), size, p=self.weight)
        return self.yaw[drawn], self.pitch[drawn], np.asarray(self.roll)[drawn]

    def _draw_roll(self, size: int, rng: np.random.Generator) -> FloatArray:
        """Draw `size` rolls, radians, `(size,)`."""
        roll = np.asarray(self.roll)
        return rng.choice(roll, size, p=self.weight) if np.ptp(roll) > 0.0 else np.full(size, roll[0])

    def to_csv(self, path: str | Path) -> None:
        """Write a CSV file for `from_csv`: the columns `yaw,pitch,weight`, and `roll` unless all rolls are 0.

        Numbers are written with all digits.
        """
        columns = {"yaw": self.yaw, "pitch": self.pitch, "weight": self.weight}
        write_table(path, columns | ({"roll": np.broadcast_to(self.roll, len(self.yaw))} if np.any(self.roll) else {}))


def divisions_of(value: int, pitches: int | None = None) -> int:
    """Check the setting `divisions` of a grid of orientations, and return it as an integer.

    The grid has 2 `divisions` yaws, and `divisions` pitches unless `pitches` is given.

    Args:
        value: value of the setting, given by a user.
        pitches: number of pitches of the grid; None for `divisions`.

    Raises:
        InputError: the value is not a positive whole number, or the orientations do not fit into memory.
    """
    count = integer("divisions", value, low=1)
    made = 2 * count * (pitches or count)
    check_memory(made * ORIENTATION_BYTES, f"divisions = {count} makes {made:.4g} orientations, which", "divisions")
    return count


def _rolls(roll: Roll) -> Sequence[tuple[float, float]]:
    """Convert a roll, one angle or pairs (roll, probability), to pairs; raise `InputError` if it is neither."""
    if not isinstance(roll, Iterable):
        return [(real("roll", roll), 1.0)]
    rows = list(roll)
    if not rows or not all(isinstance(row, Iterable) and len(list(row)) == 2 for row in rows):
        raise InputError(f"roll must be a number or a list of [angle, probability], got {roll!r}.", "roll")
    rolls = [(real("roll", angle), real("roll", share, low=0.0, high=1.0)) for angle, share in rows]
    if abs((total := math.fsum(share for _, share in rolls)) - 1.0) > PRINTED_WEIGHT * len(rolls):
        raise InputError(f"roll: the probabilities must sum to 1, they sum to {total:.9g}.", "roll")
    return rolls


def _product(
    yaw: FloatArray,
    pitch: FloatArray,
    weight: FloatArray,
    name: str,
    refine: Callable[[], OrientationPdf],
    continuous: Angles,
    rolls: Sequence[tuple[float, float]],
) -> OrientationPdf:
    """PDF on the grid of all combinations of yaws, pitches and rolls.

    Args:
        yaw, pitch: angles, radians, one-dimensional.
        weight: probability of a pair (yaw, pitch) for each pitch, equal for all yaws, `(len(pitch),)`.
        name, refine, continuous: as in `OrientationPdf`.
        rolls: pairs (roll, probability), radians.
    """
    roll, share = np.array(rolls).T
    grid = (angles.reshape(-1) for angles in np.meshgrid(yaw, pitch, roll, indexing="ij"))
    grid_yaw, grid_pitch, grid_roll = grid
    weights = np.tile(np.outer(weight, share).reshape(-1), len(yaw))
    return OrientationPdf(grid_yaw, grid_pitch, weights, name, refine, continuous, grid_roll)


def _uniform_angles(points: FloatArray) -> tuple[FloatArray, FloatArray]:
    return (2.0 * points[:, 0] - 1.0) * np.pi, (points[:, 1] - 0.5) * np.pi


def _uniform_directions(points: FloatArray) -> tuple[FloatArray, FloatArray]:
    return (2.0 * points[:, 0] - 1.0) * np.pi, np.arcsin(2.0 * points[:, 1] - 1.0)


def _uniform_yaw(points: FloatArray, pitch: float) -> tuple[FloatArray, FloatArray]:
    return (2.0 * points[:, 0] - 1.0) * np.pi, np.full(len(points), pitch)


def _cell_pitches(divisions: int) -> FloatArray:
    """Pitches at the middles of `divisions` equal bands between -pi/2 and pi/2, radians, `(divisions,)`."""
    return np.asarray((np.arange(divisions) + 0.5) * (np.pi / divisions) - np.pi / 2)


def _open_yaws(divisions: int) -> FloatArray:
    """Yaws from -pi to below pi in steps of pi / divisions, radians, `(2 divisions,)`."""
    return np.asarray(np.arange(2 * divisions) * (np.pi / divisions) - np.pi)


def grid_with_ends(divisions: int = 12, roll: Roll = 0.0) -> OrientationPdf:
    """PDF uniform over yaw and pitch, on a grid with both ends of the range of each angle.

    With 12 divisions the grid has 25 x 13 = 325 orientations (`grid_325`). The paper's tables must have used this grid,
    as all maxima printed there are multiples of 1/325.

    The PDF is uniform over the angles, not over the sphere. Each pole has as many orientations as there are yaws, and
    each other direction with a yaw of +-pi has two.

    Args:
        divisions: number of steps in pitch, each pi / divisions; half the number of steps in yaw.
        roll: roll of the camera about its optical axis, radians: one angle, or pairs (angle, probability).
    """
    n, roll = divisions_of(divisions), _rolls(roll)
    yaw, pitch = np.linspace(-np.pi, np.pi, 2 * n + 1), np.linspace(-np.pi / 2, np.pi / 2, n + 1)
    total = len(yaw) * len(pitch)
    refine = partial(grid_with_ends, 2 * n, roll)
    return _product(yaw, pitch, np.full(len(pitch), 1.0 / total), f"pdf grid_{total}", refine, _uniform_angles, roll)


def grid_of_cells(divisions: int = 12, roll: Roll = 0.0) -> OrientationPdf:
    """PDF uniform over yaw and pitch, on the grid that the paper's text describes.

    The yaws go from -pi to pi - step. The pitches are the middles of equal bands between -pi/2 and pi/2. With 12
    divisions the grid has 24 x 12 = 288 orientations (`grid_288`).

    Args:
        divisions: number of steps in pitch, each pi / divisions; half the number of steps in yaw.
        roll: roll of the camera about its optical axis, radians: one angle, or pairs (angle, probability).
    """
    n, roll = divisions_of(divisions), _rolls(roll)
    weight, refine = np.full(n, 1.0 / (2 * n * n)), partial(grid_of_cells, 2 * n, roll)
    return _product(_open_yaws(n), _cell_pitches(n), weight, f"pdf grid_{2 * n * n}", refine, _uniform_angles, roll)


def solid_angle(divisions: int = 12, roll: Roll = 0.0) -> OrientationPdf:
    """PDF uniform over the sphere: the weight of each cell of `grid_of_cells` is its solid angle divided by 4 pi.

    The arguments are those of `grid_of_cells`.
    """
    n, roll = divisions_of(divisions), _rolls(roll)
    weight = np.diff(np.sin(np.linspace(-np.pi / 2, np.pi / 2, n + 1))) / (4 * n)
    refine = partial(solid_angle, 2 * n, roll)
    return _product(_open_yaws(n), _cell_pitches(n), weight, "pdf sphere", refine, _uniform_directions, roll)


def level_flight(divisions: int = 12, pitch: float = 0.0, roll: Roll = 0.0) -> OrientationPdf:
    """PDF uniform in yaw at a fixed pitch (Eq. D_DJI, for the experiment's UAV).

    Args:
        divisions: the step in yaw is pi / divisions.
        pitch: fixed pitch, radians.
        roll: roll of the camera about its optical axis, radians: one angle, or pairs (angle, probability).
    """
    n, roll = divisions_of(divisions, pitches=1), _rolls(roll)
    fixed = real("pitch", pitch, low=-np.pi / 2, high=np.pi / 2)
    weight, refine = np.array([1.0 / (2 * n)]), partial(level_flight, 2 * n, fixed, roll)
    return _product(
        _open_yaws(n), np.array([fixed]), weight, "pdf yaw", refine, partial(_uniform_yaw, pitch=fixed), roll
    )


def from_csv(path: str | None) -> OrientationPdf:
    """Read an orientation PDF from a CSV file with the columns yaw, pitch, weight and optionally roll.

    Angles are in radians. The weights are the probabilities of the orientations; their sum is 1.

    Args:
        path: path of the file; None if the user gave none.

    Raises:
        InputError: `path` is None, the file cannot be read, or the weights are not probabilities.
    """
    if path is None:
        raise InputError("path is missing: a CSV with the columns yaw,pitch,weight is needed.", "path")
    table = read_table(path, name="path")
    yaw, pitch, weight, *roll = table.numbers(["yaw", "pitch", "weight"] + ["roll"] * ("roll" in table)).T
    radians(table.path, yaw=yaw, pitch=pitch)
    return OrientationPdf(yaw, pitch, weight, str(path), roll=roll[0] if roll else 0.0)
