"""A room whose positions are those of a camera that a body carries, off the body's origin."""

from dataclasses import dataclass

import numpy as np
from typing_extensions import override

from lmd.core.checks import BoolArray, FloatArray, IntArray
from lmd.space.changed import Changed
from lmd.space.gridded import Gridded
from lmd.space.relevance import Weighing
from lmd.space.space import Space

GOLDEN = 0.6180339887498949  # its multiples, modulo 1, are spread evenly
ON_BORDER = 1e-9  # metres: a position so close to the border of where the body may be is in there


@dataclass(frozen=True)
class Offsets:
    """Where a camera is if its body is anywhere in a room, uniformly, and turned in one of A ways.

    If it is at c, the body may be turned in those ways o with which it then is where it may be: with the offset d_o of
    the camera from the body's origin, P(o | c) is P(o) if it may be at c - d_o, and else 0, divided by the sum of all.

    Args:
        room: where the body may be; of one that does not say whether it is at a place, anywhere.
        each: d_o, `(A, 3)`, world frame, metres.
        probability: P(o), `(A,)`.
    """

    room: Space
    each: FloatArray
    probability: FloatArray

    def __call__(self, positions: FloatArray) -> FloatArray:
        """P(o | c) at positions of the camera `(Q, 3)`, `(Q, A)`."""
        distinct, which = np.unique(self.each, axis=0, return_inverse=True)
        may = _may_be(self.room, positions[:, None] - distinct)[:, which.reshape(-1)] * self.probability
        total = may.sum(axis=1, keepdims=True)
        return np.asarray(np.where(total > 0.0, may, self.probability) / np.where(total > 0.0, total, 1.0))

    def spread(self, count: int) -> IntArray:
        """Numbers of offsets, evenly by their probability, `(count,)`."""
        return np.searchsorted(np.cumsum(self.probability)[:-1], (0.5 + GOLDEN * np.arange(count)) % 1.0)


@dataclass(frozen=True)
class CarriedWeighing:
    """How much positions of a camera matter: as much as those where its body may then be.

    Args:
        within: how much these matter.
        offsets: of the camera from the body.
    """

    within: Weighing
    offsets: Offsets

    def weights(self, points: FloatArray) -> FloatArray:
        """See `Weighing.weights`."""
        bodies = points[:, None] - self.offsets.each
        weights = self.within.weights(bodies.reshape(-1, 3)).reshape(bodies.shape[:2])
        return np.asarray((self.offsets(points) * weights).sum(axis=1))


class Carried(Changed):
    """A room with the positions of a camera in place of those of the body; a `lmd.space.space.Space`.

    Args:
        offsets: of the camera from the body, which has the room.
    """

    def __init__(self, offsets: Offsets) -> None:
        super().__init__(offsets.room)
        self._offsets = offsets

    def __repr__(self) -> str:
        return f"{self._room!r}, for a camera that is carried"

    @property
    @override
    def relevance(self) -> Weighing:
        return CarriedWeighing(self._room.relevance, self._offsets)

    @override
    def grid(self) -> FloatArray:
        """Beside each position of the body one of the camera."""
        grid = self._room.grid()
        return grid + self._offsets.each[self._offsets.spread(len(grid))]

    @override
    def finer(self) -> "Carried":
        return Carried(Offsets(self._room.finer(), self._offsets.each, self._offsets.probability))

    @override
    def jittered_grid(self, repeats: int, rng: np.random.Generator) -> FloatArray:
        return self._beside(self._room.jittered_grid(repeats, rng), rng)

    @override
    def sample(self, size: int, rng: np.random.Generator) -> FloatArray:
        """Uniform for the body."""
        return self._beside(self._room.sample(size, rng), rng)

    @override
    def sample_evenly(self, size: int, rng: np.random.Generator) -> FloatArray:
        return self._beside(self._room.sample_evenly(size, rng), rng)

    @override
    def passable(self, starts: FloatArray, ends: FloatArray) -> BoolArray:
        """By where the body is on average."""
        mean = self._offsets.probability @ self._offsets.each
        return self._room.passable(starts - mean, ends - mean)

    def _beside(self, bodies: FloatArray, rng: np.random.Generator) -> FloatArray:
        drawn = rng.choice(len(self._offsets.each), len(bodies), p=self._offsets.probability)
        return np.asarray(bodies + self._offsets.each[drawn])


def _may_be(room: Space, points: FloatArray) -> BoolArray:
    """Whether a body may be at points `(..., 3)`, `(...)`."""
    if not isinstance(room, Gridded):
        return np.ones(points.shape[:-1], dtype=np.bool_)
    low, high = room.box
    within = np.asarray(((points >= low - ON_BORDER) & (points <= high + ON_BORDER)).all(axis=-1))
    within[within] = room.reaches(points[within])
    return within
