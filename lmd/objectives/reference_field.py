"""Field (incremental evaluator) for visibility models with NumPy functions only: each move costs a full evaluation.

The field runs as plain Python (`lmd.incremental.field.runner`). The field has no stacks (groups of coincident
landmarks), because the visibility model cannot be evaluated without occlusion.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from lmd.core.checks import FloatArray, IntArray
from lmd.incremental.field import Field, accept, bound, places_of, settle, undo
from lmd.objectives.base import Objective, incremental
from lmd.scene.deployment import Deployment
from lmd.sight.evaluator import Evaluator
from lmd.sight.kernels import PROBABILITY_ONE


class ReferenceState(NamedTuple):
    """The poses and surfaces of K landmarks, and the values at Q positions."""

    poses: np.ndarray
    """`(6, K)` positions, metres, and unit normals."""
    surfaces: np.ndarray
    """`(K,)` indices of the surfaces that carry the landmarks."""
    units: np.ndarray
    """`(Q,)` quantised value of each position."""


class ReferenceScratch(NamedTuple):
    """Working memory with the results of the move tried last.

    After this move is carried out, the memory has the old place of the landmark and the old values of the positions.
    """

    pose: np.ndarray
    """`(6,)` position (metres) and unit normal of the place tried."""
    surface: np.ndarray
    """`(1,)` index of the surface of the place tried."""
    units: np.ndarray
    """`(Q,)` quantised value of each position after the move."""


@dataclass(frozen=True)
class ReferenceField:
    """Field (incremental evaluator) that evaluates all Q positions again for each move; a
    `lmd.incremental.field.Field`.

    Args:
        objective: objective that computes the values.
        evaluator: evaluator with the Q positions.
    """

    objective: Objective
    evaluator: Evaluator

    @property
    def size(self) -> int:
        """See `Field.size`."""
        return len(self.evaluator.positions)

    @property
    def index_of(self) -> IntArray:
        """See `Field.index_of`."""
        return np.arange(self.size)

    def state(self, deployment: Deployment) -> ReferenceState:
        """See `Field.state`."""
        places = places_of(deployment)
        return ReferenceState(*places, self.units(places.poses))

    def scratch(self, state: ReferenceState) -> ReferenceScratch:
        """See `Field.scratch`."""
        return ReferenceScratch(np.empty(6), np.empty(1, dtype=np.int64), state.units.copy())

    def units(self, poses: FloatArray) -> np.ndarray:
        """Quantised (integer) value of each position, `(Q,)`, for given landmarks.

        `poses` `(6, K)` has the positions of the landmarks, metres (rows 0 to 2), and their unit normals.
        """
        values = self.objective.values(self.evaluator, poses[:3].T[None], poses[3:].T[None])[0]
        return np.asarray(np.rint(values * PROBABILITY_ONE), dtype=np.int64)


def field_of(objective: Objective, evaluator: Evaluator) -> Field:
    """Field (incremental evaluator) of an objective.

    The field is a `ReferenceField` if the visibility model has NumPy functions only, which compiled code cannot use.

    Raises:
        InputError: the objective has no field.
    """
    with_field = incremental(objective)
    return ReferenceField(objective, evaluator) if evaluator.by_reference else with_field.field(evaluator)


@bound.register(ReferenceField)
def _try(field, k, pose, surface, state, scratch):  # type: ignore[no-untyped-def]
    poses = state.poses.copy()
    poses[:, k] = pose
    scratch.pose[:], scratch.surface[0], scratch.units[:] = pose, surface, field.units(poses)


@settle.register(ReferenceField)
def _leave(field, k, state, scratch):  # type: ignore[no-untyped-def]
    """Do nothing: `bound` has already written exact values."""


@accept.register(ReferenceField)
@undo.register(ReferenceField)
def _exchange(field, k, state, scratch):  # type: ignore[no-untyped-def] # noqa: ARG001
    """Carry out or undo a move: swap landmark k's place and all positions' values between state and scratch."""
    pairs = (
        (state.poses[:, k], scratch.pose),
        (state.surfaces[k : k + 1], scratch.surface),
        (state.units, scratch.units),
    )
    for one, other in pairs:
        one[:], other[:] = other.copy(), one.copy()
