"""Incremental fields: values of positions that are updated as single landmarks move, and what they are worth.

`annealing` climbs any objective with a field. A field is a named tuple of arrays that does not change while landmarks
move; what does is in its state, and a move that is only tried leaves its traces in a scratch. A move goes through

    bound -> settle -> accept (-> undo),

and may be dropped after each of the first two. A field of another class registers plain Python, and kernels run as such
for it (`runner`). The value of each position is a probability in whole units, of which
`PROBABILITY_ONE` are 1: sums of integers are exact, so updating ends at the same values as computing anew.
"""

from collections.abc import Callable
from typing import Any, NamedTuple, Protocol, runtime_checkable

import numpy as np

from lmd.core.bits import Integer
from lmd.core.checks import FloatArray, IntArray
from lmd.core.compiled import borrowing, inner, kernel
from lmd.core.dispatch import dispatched, dispatched_call, overridable
from lmd.core.layers import layer
from lmd.scene.deployment import Deployment


class Field(Protocol):
    """The fields and methods of such a named tuple; its class registers `bound`, `settle`, `accept` and `undo`.

    A state has `poses` `(6, K)`, positions and normals, `surfaces` `(K,)` and `units` `(Q,)` int64, the values. A
    scratch has `units`, those of the move tried last.
    """

    @property
    def size(self) -> int:
        """Q, at least P: some positions may be there twice."""

    @property
    def index_of(self) -> Any:
        """Where each position of the evaluator is among the Q of the field, `(P,)`."""

    def state(self, deployment: Deployment) -> Any:
        """The values of a deployment, ready for moves."""

    def scratch(self, state: Any) -> Any:
        """Working memory for moves of a state."""


@runtime_checkable
class Stacking(Protocol):
    """What a field has beside that if landmarks on one point, none hiding another, serve as one: a stack."""

    @property
    def stack(self) -> int:
        """How many landmarks are in a stack."""

    def stacked(self, fixed: Deployment | None) -> Field:
        """The field of stacks, moved as if they were single landmarks, beside those that are fixed."""

    def shrunk(self, size: float) -> Field:
        """The field of landmarks whose bodies are `size` times as large, for stacks that are pulled apart."""


def stack_of(field: Field) -> int:
    """How many landmarks are in a stack; 0 if the field has none."""
    return field.stack if isinstance(field, Stacking) else 0


def runner(field: Field, function: Any) -> Callable[..., Any]:
    """A kernel that takes a field, or the plain Python of it for one that is no named tuple."""
    chosen: Callable[..., Any] = function if isinstance(field, tuple) else getattr(function, "py_func", function)
    return chosen


BOUND, SETTLE, ACCEPT, UNDO = range(4)  # the steps of a move
NO_UNITS = np.empty((0, 0), dtype=np.int64)


class Places(NamedTuple):
    """The poses and surfaces of K landmarks."""

    poses: np.ndarray
    """`(6, K)` positions, metres, and unit normals."""
    surfaces: np.ndarray
    """`(K,)` that they hang on."""

    def deployment(self) -> Deployment:
        """The landmarks."""
        return Deployment(self.poses[:3].T.copy(), self.poses[3:].T.copy(), self.surfaces.copy())


def places_of(deployment: Deployment) -> Places:
    """The places of its landmarks."""
    poses = np.ascontiguousarray(np.hstack([deployment.positions, deployment.normals]).T)
    return Places(poses, deployment.surfaces.copy())


class Target(Protocol):
    """The fields of a named tuple that says what values are worth; its class registers `smoothed` and `worth`."""

    @property
    def relevance(self) -> FloatArray:
        """The weight of each position of the field, `(Q,)`, with sum 1."""


@dispatched_call
def bound(field: Any, k: Integer, pose: Any, surface: Integer, state: Any, scratch: Any) -> None:
    """Find values no lower than those with landmark k at `pose` `(6,)`, position and normal, on a surface.

    They go to `scratch.units`. Cheap, so that most moves can be dropped before they are settled.
    """


@dispatched_call
def settle(field: Any, k: Integer, state: Any, scratch: Any) -> None:
    """Make the values in `scratch.units` exact."""


@dispatched_call
def accept(field: Any, k: Integer, state: Any, scratch: Any) -> None:
    """Carry out the settled move; no other may have been tried or carried out since."""


@dispatched_call
def undo(field: Any, k: Integer, state: Any, scratch: Any) -> None:
    """Take back the last accepted move with this scratch, all later ones being taken back."""


@dispatched
def smoothed(target: Any, p: Integer, units: Any, margin: Any, width: float, share: float) -> Any:
    """What `units` at position p are worth, smoothed over `width` in value, plus `share` of the value itself.

    It never falls as the units rise, and is at most (1 + share) times the position's relevance.
    """


@dispatched
def worth(target: Any, p: Integer, units: Integer) -> Any:
    """What `units` at position p are worth: summed over the positions, the fitness."""


@overridable
def placed(state: Any) -> Any:
    """The part of a state that has `poses` and `surfaces`: the state itself, unless its class registers another."""
    return state


@kernel
def total_worth(target: Any, units: Any) -> Any:
    """The fitness of a deployment with the values `units`."""
    total = 0.0
    for p in range(len(units)):
        total += worth(target, p, units[p])
    return total


@inner
def move(field: Any, k: Integer, pose: Any, surface: Integer, state: Any, scratch: Any) -> None:
    """Move landmark k, whatever that is worth: `bound`, `settle` and `accept`."""
    bound(field, k, pose, surface, state, scratch)
    settle(field, k, state, scratch)
    accept(field, k, state, scratch)


@inner
def lead(places: Any, field: Any, state: Any, scratches: Any, pose: Any) -> None:
    """Move the landmarks of `state` that are elsewhere than at `places`, with the first of the `scratches`.

    `pose` `(6,)` is working memory.
    """
    scratch, known = layer(scratches, 0), placed(state)
    for k in range(len(places.surfaces)):
        elsewhere = known.surfaces[k] != places.surfaces[k]
        for i in range(6):
            pose[i] = places.poses[i, k]
            elsewhere |= pose[i] != known.poses[i, k]
        if elsewhere:
            move(field, k, pose, places.surfaces[k], state, scratch)


@borrowing
def perform(steps: Any, poses: FloatArray, field: Any, state: Any, scratches: Any, units: Any) -> None:
    """Do the steps of moves one after the other.

    All that Python asks of a field goes through this kernel, as one is compiled for each kind of field, and for long.

    Args:
        steps: `(S, 4)` int64: which of `BOUND`, `SETTLE`, `ACCEPT`, `UNDO`; landmark; surface; which of the scratches.
        poses: `(S, 6)`, position and normal to be bounded.
        field, state: whose landmarks move.
        scratches: `layers` of one.
        units: `(S, Q)` int64, receives after each step the values tried or, once they are accepted or undone, of the
            state; or `(0, 0)`.
    """
    for s in range(len(steps)):
        which, k, surface, scratch = steps[s, 0], steps[s, 1], steps[s, 2], layer(scratches, steps[s, 3])
        tried = which <= SETTLE
        if which == BOUND:
            bound(field, k, poses[s], surface, state, scratch)
        elif which == SETTLE:
            settle(field, k, state, scratch)
        elif which == ACCEPT:
            accept(field, k, state, scratch)
        else:
            undo(field, k, state, scratch)
        if len(units):
            for p in range(len(state.units)):
                units[s, p] = scratch.units[p] if tried else state.units[p]


def moved(places: Places, state: Any) -> tuple[IntArray, FloatArray]:
    """The steps, and their poses, for `perform` to move what in `state` is elsewhere than at `places`."""
    known = placed(state)
    elsewhere = (places.poses != known.poses).any(axis=0) | (places.surfaces != known.surfaces)
    which = np.flatnonzero(elsewhere)
    steps = np.zeros((len(which), 3, 4), dtype=np.int64)
    steps[:, :, 0] = BOUND, SETTLE, ACCEPT
    steps[:, :, 1], steps[:, :, 2] = which[:, None], places.surfaces[which][:, None]
    return steps.reshape(-1, 4), np.repeat(places.poses.T[which], 3, axis=0)


def in_order(field: Field, relevance: FloatArray) -> FloatArray:
    """The weights `(P,)` of an evaluator's positions, normalised, in the order of the field, `(Q,)`."""
    ordered = np.zeros(field.size)
    ordered[field.index_of] = relevance / relevance.sum()
    return ordered
