"""Incremental fields: values of positions that are updated as single landmarks move, and what they are worth.

`annealing` climbs any objective with a field. A field is a named tuple of arrays that does not change while landmarks
move; what does is in its state, and a move that is only tried leaves its traces in a scratch. A move goes through

    bound -> settle -> accept (-> undo),

and may be dropped after each of the first two. The value of each position is a probability in whole units, of which
`PROBABILITY_ONE` are 1: sums of integers are exact, so updating ends at the same values as computing anew.
"""

from typing import Any, Protocol

import numpy as np

from lmd.checks import FloatArray
from lmd.compiled import inner, kernel
from lmd.deployment import Deployment
from lmd.dispatch import dispatched, dispatched_call


class Field(Protocol):
    """The fields and methods of such a named tuple; its class registers `bound`, `settle`, `accept` and `undo`.

    A state has `landmarks`, `normals` `(3, K)`, `surfaces` `(K,)` and `units` `(Q,)` int64, the values. A scratch has
    `units`, those of the move tried last.
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

    @property
    def stack(self) -> int:
        """How many landmarks on one point, none hiding another, serve as one; 0 where such stacks make no sense."""

    def stacked(self, fixed: Deployment | None) -> "Field":
        """The field of such stacks, moved as if they were single landmarks, beside those that are fixed."""

    def shrunk(self, size: float) -> "Field":
        """The field of landmarks whose bodies are `size` times as large."""


class Target(Protocol):
    """The fields of a named tuple that says what values are worth; its class registers `smoothed` and `worth`."""

    @property
    def relevance(self) -> FloatArray:
        """The weight of each position of the field, `(Q,)`, with sum 1."""


@dispatched_call
def bound(field, k, pose, surface, state, scratch):  # type: ignore[no-untyped-def]
    """Find values no lower than those with landmark k at `pose` `(6,)`, position and normal, on a surface.

    They go to `scratch.units`. Cheap, so that most moves can be dropped before they are settled.
    """


@dispatched_call
def settle(field, k, state, scratch):  # type: ignore[no-untyped-def]
    """Make the values in `scratch.units` exact."""


@dispatched_call
def accept(field, k, state, scratch):  # type: ignore[no-untyped-def]
    """Carry out the settled move; no other may have been tried or carried out since."""


@dispatched_call
def undo(field, k, state, scratch):  # type: ignore[no-untyped-def]
    """Take back the last accepted move with this scratch, all later ones being taken back."""


@dispatched
def smoothed(target, p, units, margin, width, share):  # type: ignore[no-untyped-def]
    """What `units` at position p are worth, smoothed over `width` in value, plus `share` of the value itself.

    It never falls as the units rise, and is at most (1 + share) times the position's relevance.
    """


@dispatched
def worth(target, p, units):  # type: ignore[no-untyped-def]
    """What `units` at position p are worth: summed over the positions, the fitness."""


@kernel
def total_worth(target, units):  # type: ignore[no-untyped-def]
    """The fitness of a deployment with the values `units`."""
    total = 0.0
    for p in range(len(units)):
        total += worth(target, p, units[p])
    return total


@inner
def move(field, k, pose, surface, state, scratch):  # type: ignore[no-untyped-def]
    """Move landmark k, whatever that is worth: `bound`, `settle` and `accept`."""
    bound(field, k, pose, surface, state, scratch)
    settle(field, k, state, scratch)
    accept(field, k, state, scratch)


@kernel
def follow(positions, normals, surfaces, field, state, scratch):  # type: ignore[no-untyped-def]
    """Move the landmarks of `state` that are elsewhere than at `positions`, `normals` `(K, 3)` on `surfaces` `(K,)`."""
    pose = np.empty(6)
    for k in range(len(positions)):
        elsewhere = state.surfaces[k] != surfaces[k]
        for i in range(3):
            pose[i], pose[3 + i] = positions[k, i], normals[k, i]
            elsewhere |= pose[i] != state.landmarks[i, k] or pose[3 + i] != state.normals[i, k]
        if elsewhere:
            move(field, k, pose, surfaces[k], state, scratch)


def in_order(field: Field, relevance: FloatArray) -> FloatArray:
    """The weights `(P,)` of an evaluator's positions, normalised, in the order of the field, `(Q,)`."""
    ordered = np.zeros(field.size)
    ordered[field.index_of] = relevance / relevance.sum()
    return ordered
