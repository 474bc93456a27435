"""Crowds: people and other robots as upright cylinders that stand on the floor and hide landmarks.

A crowd state is a set of cylinders. S states are drawn once, so all deployments are compared in identical crowds
(common random numbers), and one cylinder hides all landmarks behind it at the same time.

A cylinder is an open convex set. A line of sight from p to q is blocked if its part in the cylinder has a positive
length. Let d = q - p, and let d_h be the horizontal part of d. Let e be the horizontal vector from p to the axis of a
cylinder with the radius r. The point p + t d is horizontally inside the cylinder if |t d_h - e|^2 < r^2. So t lies
between (b - s) / a and (b + s) / a, where a = |d_h|^2, b = d_h . e, c = |e|^2 - r^2 and s = sqrt(b^2 - a c). The planes
of the cylinder's lower and upper end limit t further.

The camera is never inside a cylinder: a cylinder closer to the camera than the clearance is ignored for that camera
position.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from typing import Annotated, Any

import numpy as np

from lmd.core.checks import (
    BoolArray,
    Checked,
    Count,
    FloatArray,
    Index,
    InputError,
    IntArray,
    NotNegative,
    bounded,
    choice,
    real,
    span,
)
from lmd.core.memory import check_memory
from lmd.space.space import Space, floor_of

ROUNDING = 1e-9  # rounding tolerance of a share times a number, before it is rounded up


def worst_of(number: int, share: float) -> int:
    """Number of values that count as the worst among `number` values: the fraction `share` of `number`, rounded up."""
    return max(1, math.ceil(share * number - ROUNDING))


def worst_mean(values: FloatArray, count: int) -> FloatArray:
    """Mean of the `count` smallest values along the last axis."""
    return np.asarray(np.sort(values, axis=-1)[..., :count].sum(axis=-1) / count)


FITNESS = ("mean", "worst")
# Columns of a cylinder: axis, radius, lower and upper end, metres.
X, Y, RADIUS, BOTTOM, TOP = range(5)
COLUMNS = 5
# Greatest number of attempts to draw a place for each cylinder; more help only if there is next to no room.
ROUNDS = 2000
# Directions around a cylinder, and heights as shares of its height, at which free space is tested.
DIRECTIONS, HEIGHTS = 16, (0.01, 0.25, 0.5, 0.75, 0.99)
# Greatest number of states; a drive of an hour has one for each of its 72,000 frames.
MOST_STATES = 200_000


def number_or_span(name: str, value: Any) -> float | tuple[float, float]:
    """Return `value`, a positive length or a range [lowest, highest]; raise `InputError` for another value."""
    if not isinstance(value, Sequence) or isinstance(value, str):
        return real(name, value, above=0.0)
    return span(name, value, above=0.0)


@dataclass(frozen=True)
class Crowd(Checked):
    """Settings of a crowd: cylinders on the floor of a room.

    Raises:
        InputError: a value is out of range.
    """

    number: Count
    """Number of cylinders in each state."""
    radius: Annotated[float | tuple[float, float], number_or_span] = 0.25
    """Radius, metres: a number, or the lowest and the highest value of a uniform distribution."""
    height: Annotated[float | tuple[float, float], number_or_span] = 1.75
    """Height above the floor, metres: a number, or the lowest and the highest value of a uniform distribution."""
    clearance: NotNegative = 0.3
    """Least distance of a cylinder from the camera, metres; a cylinder closer to the camera is ignored."""
    states: Count = 20
    """Number S of states."""
    fitness: Annotated[str, partial(choice, options=FITNESS)] = "mean"
    """Fitness over the states: `mean` for the mean over all states, `worst` for the mean over the worst states (a
    fraction `worst` of all states).
    """
    worst: Annotated[float, partial(real, above=0.0, high=1.0)] = 0.05
    """Fraction of the states that count as the worst; the number of these states is rounded up."""
    seed: Index = 0
    """Random seed with which the states are drawn."""

    def _validate(self) -> None:
        bounded("states, which take 5 kB each", self.states, MOST_STATES, "crowd", "states")

    def drawn(self, room: Space, rng: np.random.Generator | None = None) -> "CrowdStates":
        """Draw the crowd states with the generator `rng` if it is given, else with a generator made from `seed`.

        Raises:
            InputError: there is no free place for a cylinder.
        """
        return CrowdStates(self, _draw(self, room, np.random.default_rng(self.seed) if rng is None else rng))


@dataclass(frozen=True, eq=False)
class CrowdStates:
    """S crowd states in a room; a crowd state is a set of cylinders, which stand for people and other robots."""

    crowd: Crowd
    """Settings from which the states were drawn."""
    people: FloatArray
    """Cylinders of each state, `(S, N, 5)`: x, y, radius, lower and upper z, metres."""

    def __len__(self) -> int:
        return len(self.people)

    def only(self, state: int) -> "CrowdStates":
        """Copy that contains only the crowd state with the index `state`."""
        return CrowdStates(self.crowd, self.people[[state]])

    @property
    def worst_count(self) -> int:
        """Number of crowd states that count as the worst; the fitness `worst` is the mean over these states."""
        return worst_of(len(self), self.crowd.worst)

    def present(self, positions: FloatArray, states: IntArray) -> BoolArray:
        """Mask of the cylinders that are at least the clearance away from the camera; others are ignored.

        The mask is `(P, N)` for the N cylinders of a crowd state.

        Args:
            positions: camera positions, `(P, 3)`, metres.
            states: index of the crowd state at each position, `(P,)`.
        """
        people, (x, y, z) = self.people[states], (positions[:, i, None] for i in range(3))
        away, clearance = people[..., RADIUS] + self.crowd.clearance, self.crowd.clearance
        ex, ey = people[..., X] - x, people[..., Y] - y
        beside = (z > people[..., BOTTOM] - clearance) & (z < people[..., TOP] + clearance)
        return np.asarray(~((ex * ex + ey * ey < away * away) & beside))

    def clear(self, position: FloatArray, points: FloatArray) -> BoolArray:
        """Mask of the lines from a camera position `(3,)` to points `(..., 3)` that no cylinder blocks, `(...)`.

        There must be exactly one crowd state in this object. Compiled kernels must give equal results.
        """
        assert len(self) == 1, "the reference is about one state"
        standing = self.people[0][self.present(position[None], np.zeros(1, dtype=np.int64))[0]]
        result = np.ones(points.shape[:-1], dtype=np.bool_)
        for cylinder in standing:
            result &= ~_crosses(cylinder, position, points)
        return result


def _crosses(cylinder: FloatArray, position: FloatArray, points: FloatArray) -> BoolArray:
    """Mask of the lines from a position `(3,)` to points `(..., 3)` that a given cylinder blocks, `(...)`.

    `cylinder` `(5,)` has x, y, radius, lower and upper z, metres.
    """
    dx, dy, dz = (points[..., i] - position[i] for i in range(3))
    ex, ey = cylinder[X] - position[0], cylinder[Y] - position[1]
    a, b, c = dx * dx + dy * dy, dx * ex + dy * ey, ex * ex + ey * ey - cylinder[RADIUS] * cylinder[RADIUS]
    square = b * b - a * c
    with np.errstate(all="ignore"):  # upright lines have no horizontal bound, level lines no vertical one
        root = np.sqrt(np.maximum(square, 0.0))
        upright, level = a == 0.0, dz == 0.0
        inside = np.where(upright, c < 0.0, square > 0.0)
        entered = np.where(upright, 0.0, np.maximum((b - root) / a, 0.0))
        left = np.where(upright, 1.0, np.minimum((b + root) / a, 1.0))
        below, above = (cylinder[BOTTOM] - position[2]) / dz, (cylinder[TOP] - position[2]) / dz
        inside &= ~level | ((cylinder[BOTTOM] < position[2]) & (position[2] < cylinder[TOP]))
        entered = np.where(level, entered, np.maximum(entered, np.minimum(below, above)))
        left = np.where(level, left, np.minimum(left, np.maximum(below, above)))
    return np.asarray(inside & (entered < left))


def _draw(crowd: Crowd, room: Space, rng: np.random.Generator) -> FloatArray:
    """Draw the N cylinders of each of S crowd states, `(S, N, 5)`: x, y, radius, lower and upper z, metres.

    Cylinders of a state overlap neither each other nor walls and obstacles.
    """
    shape = crowd.states, crowd.number
    check_memory(8.0 * COLUMNS * crowd.states * crowd.number, f"crowd of {shape[1]} in {shape[0]} states", "number")
    people, floor = np.empty((*shape, COLUMNS)), floor_of(room)
    spans = (np.broadcast_to(span, 2).tolist() for span in (crowd.radius, crowd.height))
    people[..., RADIUS], height = (rng.uniform(least, most, shape) for least, most in spans)
    people[..., BOTTOM], people[..., TOP] = floor, floor + height
    low, high = (corner[:2] for corner in room.bounds())
    for n in range(crowd.number):
        left = np.arange(crowd.states)
        for _ in range(ROUNDS):
            people[left, n, :2] = rng.uniform(low, high, (len(left), 2))
            away = people[left, n, None, :2] - people[left, :n, :2]
            apart = people[left, n, None, RADIUS] + people[left, :n, RADIUS]
            good = ((away**2).sum(axis=-1) >= apart**2).all(axis=-1)
            good[good] &= stands(room, people[left[good], n])
            left = left[~good]
            if not len(left):
                break
        else:
            raise InputError(
                f"number = {crowd.number} cylinders do not fit on the free floor; cylinder {n + 1} of state "
                f"{left[0] + 1} finds no place.",
                "number",
            )
    return people


def stands(room: Space, cylinders: FloatArray) -> BoolArray:
    """Mask of the M cylinders that are in the free space of a room, `(M,)`.

    A cylinder is tested on its axis and in `DIRECTIONS` directions around the axis, at each of `HEIGHTS` (fractions of
    the cylinder's height). A cylinder taller than the room ends at the room's ceiling. The columns of `cylinders`
    `(M, 5)` are x, y, radius, lower and upper z, metres.
    """
    angles = 2.0 * np.pi * np.arange(DIRECTIONS) / DIRECTIONS
    ring = np.concatenate([np.zeros((1, 2)), np.stack([np.cos(angles), np.sin(angles)], axis=-1)])
    top = np.minimum(cylinders[:, TOP], room.bounds()[1][2])
    z = cylinders[:, BOTTOM, None] + (top - cylinders[:, BOTTOM])[:, None] * np.array(HEIGHTS)
    points = np.empty((len(cylinders), len(HEIGHTS), len(ring), 3))
    points[..., :2] = (cylinders[:, None, :2] + cylinders[:, RADIUS, None, None] * ring)[:, None]
    points[..., 2] = z[..., None]
    free: BoolArray = np.array(room.contains(points).all(axis=(1, 2)))
    if free.any() and room.blockers() is not None:
        within = points[free]
        upwards = room.clear(within[:, 0], within[:, -1]).all(axis=1)
        outwards = room.clear(np.broadcast_to(within[:, :, :1], within[:, :, 1:].shape), within[:, :, 1:])
        free[free] = upwards & outwards.all(axis=(1, 2))
    return free
