"""Fields, which are incremental evaluators: they update the value of each position when a single landmark moves. A
`Target` computes the fitness from the values.

`annealing` optimises any objective with a field. A field is a named tuple of constant arrays. A *state* has the arrays
that change with the landmarks, and a *scratch* is working memory with the arrays of a move that is tried. A move
consists of

    bound -> settle -> accept (-> undo),

and may be dropped after `bound` or after `settle`. A field that is not a named tuple registers plain Python functions,
and kernels then run as plain Python (`runner`). Values are quantised probabilities: integers, of which
`PROBABILITY_ONE` represents the probability 1. Sums of integers are exact, so updated values equal recomputed values.
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
    """Interface of fields (incremental evaluators); a class must register versions of `bound`, `settle`, `accept` and
    `undo`.

    A state has `poses` `(6, K)` (positions, metres, and unit normals), `surfaces` `(K,)` and the quantised values
    `units` `(Q,)` int64. A scratch has `units`, the quantised values after the move tried last.
    """

    @property
    def size(self) -> int:
        """Number Q of positions of the field. Q is at least the number P of the evaluator's positions, because the
        field may contain copies of positions.
        """

    @property
    def index_of(self) -> Any:
        """For each position of the evaluator, its index among the positions of the field, `(P,)`."""

    def state(self, deployment: Deployment) -> Any:
        """New state: the arrays that change with the landmarks, filled for a deployment."""

    def scratch(self, state: Any) -> Any:
        """New scratch: working memory for moves of the landmarks of a state."""


@runtime_checkable
class Stacking(Protocol):
    """Interface of fields with stacks: groups of coincident landmarks that move as one and do not hide each other."""

    @property
    def stack(self) -> int:
        """Number of landmarks in a stack."""

    def stacked(self, fixed: Deployment | None) -> Field:
        """Field in which each landmark of a state represents a stack of `stack` landmarks at one place. The landmarks
        in `fixed`, which do not move, are seen in addition to the stacks.
        """

    def shrunk(self, size: float) -> Field:
        """Field in which the body of each landmark that blocks the view is scaled by the factor `size`; used to
        separate the landmarks of a stack.
        """


def stack_of(field: Field) -> int:
    """Number of landmarks in a stack; 0 for a field without stacks."""
    return field.stack if isinstance(field, Stacking) else 0


def runner(field: Field, function: Any) -> Callable[..., Any]:
    """Return the kernel `function` (a compiled function) for a field, or its plain Python version if the field is not a
    named tuple.
    """
    chosen: Callable[..., Any] = function if isinstance(field, tuple) else getattr(function, "py_func", function)
    return chosen


BOUND, SETTLE, ACCEPT, UNDO = range(4)  # the steps of a move
NO_UNITS = np.empty((0, 0), dtype=np.int64)


class Places(NamedTuple):
    """The poses and surfaces of K landmarks."""

    poses: np.ndarray
    """`(6, K)` positions, metres, and unit normals."""
    surfaces: np.ndarray
    """`(K,)` indices of the surfaces that carry the landmarks."""

    def deployment(self) -> Deployment:
        """Deployment with these landmarks."""
        return Deployment(self.poses[:3].T.copy(), self.poses[3:].T.copy(), self.surfaces.copy())


def places_of(deployment: Deployment) -> Places:
    """Poses and surfaces of the landmarks of a deployment."""
    poses = np.ascontiguousarray(np.hstack([deployment.positions, deployment.normals]).T)
    return Places(poses, deployment.surfaces.copy())


class Target(Protocol):
    """Interface of functions that compute the fitness from the values of all positions. A target is a named tuple whose
    class registers versions of `smoothed` and `contribution`.
    """

    @property
    def relevance(self) -> FloatArray:
        """`(Q,)` weights of the positions, with sum 1."""


@dispatched_call
def bound(field: Any, k: Integer, pose: Any, surface: Integer, state: Any, scratch: Any) -> None:
    """Try a move of landmark k to `pose` on a surface: write upper bounds on the values after the move into
    `scratch.units`.

    `pose` `(6,)` is position (metres) and unit normal. Bounds are cheap to compute, and suffice to reject most moves.
    """


@dispatched_call
def settle(field: Any, k: Integer, state: Any, scratch: Any) -> None:
    """Replace the bounds in `scratch.units` by the exact values after the move."""


@dispatched_call
def accept(field: Any, k: Integer, state: Any, scratch: Any) -> None:
    """Carry out the settled move by updating `state`. No other move may have been tried or carried out since this move
    was settled.
    """


@dispatched_call
def undo(field: Any, k: Integer, state: Any, scratch: Any) -> None:
    """Undo the move that was accepted last with this `scratch`. Moves that were accepted later, with other scratches,
    must have been undone before.
    """


@dispatched
def smoothed(target: Any, p: Integer, units: Any, margin: Any, width: float, share: float) -> Any:
    """Contribution of the quantised value `units` at position p to the smoothed fitness.

    If the fitness has a sharp step at a threshold, the smoothed fitness has a smooth step of the given `width`. The
    middle of the smooth step is `margin` above the threshold, and `share` times the value is added. The contribution
    increases monotonically with `units`, up to (1 + share) times the weight of the position.
    """


@dispatched
def contribution(target: Any, p: Integer, units: Integer) -> Any:
    """Contribution of the quantised value `units` at position p to the fitness, see `fitness_of`."""


@overridable
def placed(state: Any) -> Any:
    """The part of a state that has the attributes `poses` and `surfaces`: the state itself, unless the state's class
    registers another function.
    """
    return state


@overridable
def combined(target: Any, terms: FloatArray, total: Any) -> Any:  # noqa: ARG001 # for other targets
    """Smoothed fitness, from the contributions `terms` `(Q,)` of the positions and their sum `total`. The fitness is
    `total`, unless the class of the target registers another function, which must increase monotonically with every
    term.
    """
    return total


@overridable
def fitness_of(target: Any, units: Any) -> Any:
    """Fitness of a deployment with the quantised values `units` `(Q,)`: the sum of the contributions, unless the class
    of the target registers another function.
    """
    total = 0.0
    for p in range(len(units)):
        total += contribution(target, p, units[p])
    return total


@kernel
def total_fitness(target: Any, units: Any) -> Any:
    """Fitness of a deployment with the quantised values `units` `(Q,)`."""
    return fitness_of(target, units)


@inner
def move(field: Any, k: Integer, pose: Any, surface: Integer, state: Any, scratch: Any) -> None:
    """Move landmark k unconditionally: `bound`, `settle` and `accept`."""
    bound(field, k, pose, surface, state, scratch)
    settle(field, k, state, scratch)
    accept(field, k, state, scratch)


@inner
def move_to(places: Any, field: Any, state: Any, scratches: Any, pose: Any) -> None:
    """Move the landmarks of `state` to `places`, with the first of the `scratches` as working memory.

    Landmarks that are already at their place do not move. `pose` `(6,)` is further working memory.
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
    """Execute steps of moves one after the other.

    Python calls a field through this kernel only, because each further kernel would be compiled for every class of
    field, which takes long.

    Args:
        steps: `(S, 4)` int64. The columns are the step (`BOUND`, `SETTLE`, `ACCEPT` or `UNDO`), and the indices of the
            landmark, of the surface and of the scratch.
        poses: `(S, 6)` position (metres) and unit normal, for `BOUND`.
        field, state: field and state of the landmarks.
        scratches: several scratches as one array structure, made by `layers`.
        units: receives the values after each step, `(S, Q)` int64: the scratch's values after `BOUND` and `SETTLE`,
            else the state's values; `(0, 0)` to skip the values.
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
    """Arguments `steps` and `poses` of `perform` for moving the landmarks of `state` to `places`."""
    known = placed(state)
    elsewhere = (places.poses != known.poses).any(axis=0) | (places.surfaces != known.surfaces)
    which = np.flatnonzero(elsewhere)
    steps = np.zeros((len(which), 3, 4), dtype=np.int64)
    steps[:, :, 0] = BOUND, SETTLE, ACCEPT
    steps[:, :, 1], steps[:, :, 2] = which[:, None], places.surfaces[which][:, None]
    return steps.reshape(-1, 4), np.repeat(places.poses.T[which], 3, axis=0)


def in_order(field: Field, relevance: FloatArray) -> FloatArray:
    """Weights of the field's positions, `(Q,)`: the weights `relevance` `(P,)` of the evaluator's positions, normalised
    and put into the field's order.
    """
    ordered = np.zeros(field.size)
    ordered[field.index_of] = relevance / relevance.sum()
    return ordered
