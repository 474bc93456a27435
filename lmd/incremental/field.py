"""Fields (incremental evaluators), which update the value of each position when a single landmark moves.

A field has constant data. The *state* of a field has the arrays that change with the landmarks, and the *scratch* is
working memory with the arrays of a move that is tried. A move has up to four steps:

- `bound` tries the move, and writes upper bounds on the new values to the scratch.
- `settle` replaces the bounds by the exact values.
- `accept` carries out the move in the state.
- `undo` takes back an accepted move.

A move may be dropped after `bound` or after `settle`, which leave the state unchanged. A `Target` computes the fitness
from the values. `annealing` optimises any objective with a field.

Most fields are named tuples of arrays, and the steps are compiled functions. Another field registers plain Python
functions, and kernels then run as plain Python (`runner`). Values are quantised probabilities: integers, of which
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
    """Interface of fields (incremental evaluators); a class must register `bound`, `settle`, `accept` and `undo`.

    A state has the values `units` `(Q,)`, quantised to int64. The object `placed(state)` has `poses` `(6, K)`
    (positions, metres, and unit normals) and `surfaces` `(K,)`, the index of each landmark's surface. A scratch has
    `units`, the quantised values after the move tried last.
    """

    @property
    def size(self) -> int:
        """Number Q of positions of the field (incremental evaluator). Q is at least the number P of the `Evaluator`'s
        positions, because the field may contain copies of positions.
        """

    @property
    def index_of(self) -> Any:
        """Index, in the field (incremental evaluator), of each of the `Evaluator`'s P positions, `(P,)`."""

    def state(self, deployment: Deployment) -> Any:
        """New state: the arrays that change with the landmarks, filled for a deployment."""

    def scratch(self, state: Any) -> Any:
        """New scratch: working memory for moves of the landmarks of a state."""


@runtime_checkable
class Stacking(Protocol):
    """Interface of fields (incremental evaluators) that can move stacks of landmarks.

    A stack is a group of coincident landmarks that move as one and do not hide each other.
    """

    @property
    def stack(self) -> int:
        """Number of landmarks in a stack, a group of coincident landmarks that move as one."""

    def stacked(self, fixed: Deployment | None) -> Field:
        """Field (incremental evaluator) that moves stacks: groups of coincident landmarks.

        Each landmark in a state of this field represents a stack. The attribute `stack` is the number of landmarks in a
        stack. The landmarks in `fixed`, which do not move, are seen in addition to the stacks.
        """

    def shrunk(self, size: float) -> Field:
        """Field (incremental evaluator) in which landmarks hide less than they really do.

        The part of a landmark that blocks the view is scaled by the factor `size`. Optimisers use this field to
        separate the landmarks of a stack (group of coincident landmarks).
        """


def stack_of(field: Field) -> int:
    """Number of landmarks in a stack (group of coincident landmarks that move as one); 0 if the field has no stacks.

    A field is the incremental evaluator of an objective.
    """
    return field.stack if isinstance(field, Stacking) else 0


def runner(field: Field, function: Any) -> Callable[..., Any]:
    """Return the version of a kernel (compiled function) to which Python code can pass the given field.

    A field is the incremental evaluator of an objective. If the field is a named tuple, the version is the kernel
    `function` itself. Otherwise the version is the plain Python code of `function`.
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
    """Interface of functions that compute the fitness from the values of all positions.

    A target is a named tuple. The target's class registers its own versions of `smoothed` and `contribution`.
    """

    @property
    def relevance(self) -> FloatArray:
        """Weights of the positions, with sum 1, `(Q,)`."""


@dispatched_call
def bound(field: Any, k: Integer, pose: Any, surface: Integer, state: Any, scratch: Any) -> None:
    """Try a move of landmark k: write upper bounds on the positions' values after the move into `scratch.units`.

    Bounds are cheap to compute, and suffice to reject most moves. `pose` `(6,)` is the new position (metres) and unit
    normal of the landmark.
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
    """Contribution of position p with the quantised (integer) value `units` to the smoothed fitness.

    If the fitness has a sharp step at a threshold of the value, the smoothed fitness has a smooth step of the given
    `width`. The middle of the step is `margin` above the threshold, and `share` times the value is added to the step.
    Here values are numbers in [0, 1]. The contribution increases monotonically with `units`, up to (1 + share) times
    the weight of the position.
    """


@dispatched
def contribution(target: Any, p: Integer, units: Integer) -> Any:
    """Contribution of position p with the quantised (integer) value `units` to the fitness, see `fitness_of`."""


@overridable
def placed(state: Any) -> Any:
    """Return the object with the attributes `poses` and `surfaces` of a state.

    By default the object is the state itself; the state's class may register another function.
    """
    return state


@overridable
def combined(target: Any, terms: FloatArray, total: Any) -> Any:  # noqa: ARG001 # for other targets
    """Smoothed fitness, from the positions' contributions `terms` `(Q,)` and their sum `total`.

    By default the result is `total`. The class of a target may register another function, which must increase
    monotonically with every term.
    """
    return total


@overridable
def fitness_of(target: Any, units: Any) -> Any:
    """Fitness of a deployment, from the quantised (integer) values `units` `(Q,)` of the positions.

    By default this is the sum of the positions' contributions. The class of a target may register another function.
    """
    total = 0.0
    for p in range(len(units)):
        total += contribution(target, p, units[p])
    return total


@kernel
def total_fitness(target: Any, units: Any) -> Any:
    """Result of `fitness_of`, as a kernel (compiled function) that Python can call."""
    return fitness_of(target, units)


@inner
def move(field: Any, k: Integer, pose: Any, surface: Integer, state: Any, scratch: Any) -> None:
    """Move landmark k to `pose` in three steps: `bound`, `settle` and `accept`."""
    bound(field, k, pose, surface, state, scratch)
    settle(field, k, state, scratch)
    accept(field, k, state, scratch)


@inner
def move_to(places: Any, field: Any, state: Any, scratches: Any, pose: Any) -> None:
    """Move all landmarks of `state` to `places`, without testing the fitness.

    Landmarks that are already at their place do not move. The first of the `scratches` and the array `pose` `(6,)` are
    working memory, which is overwritten.
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
    """Execute a list of steps of moves one after the other.

    Python code calls a field (incremental evaluator) only through this kernel. Each further kernel would be compiled
    for every class of field, which takes long.

    Args:
        steps: `(S, 4)` int64. The columns are the kind of step (`BOUND`, `SETTLE`, `ACCEPT` or `UNDO`), and the indices
            of the landmark, of the surface and of the scratch.
        poses: `(S, 6)` new position (metres) and unit normal of the landmark, used by `BOUND` only.
        field, state: incremental evaluator, and the arrays that change with the landmarks.
        scratches: several scratches as one array structure, made by `layers`.
        units: `(S, Q)` int64, receives the quantised values after each step: those of the scratch after `BOUND` and
            `SETTLE`, else those of the state. With the shape `(0, 0)`, no values are written.
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
    """Steps with which `perform` moves the landmarks of `state` to `places`: its arguments `steps` and `poses`."""
    known = placed(state)
    elsewhere = (places.poses != known.poses).any(axis=0) | (places.surfaces != known.surfaces)
    which = np.flatnonzero(elsewhere)
    steps = np.zeros((len(which), 3, 4), dtype=np.int64)
    steps[:, :, 0] = BOUND, SETTLE, ACCEPT
    steps[:, :, 1], steps[:, :, 2] = which[:, None], places.surfaces[which][:, None]
    return steps.reshape(-1, 4), np.repeat(places.poses.T[which], 3, axis=0)


def in_order(field: Field, relevance: FloatArray) -> FloatArray:
    """Convert the weights of the `Evaluator`'s P positions to weights of the Q positions of a field, `(Q,)`.

    A field is the incremental evaluator of an objective. `relevance` `(P,)` are the weights of the `Evaluator`'s
    positions. The result has the order of the field's positions and the sum 1.
    """
    ordered = np.zeros(field.size)
    ordered[field.index_of] = relevance / relevance.sum()
    return ordered
