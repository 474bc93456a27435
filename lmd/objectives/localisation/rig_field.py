"""The incremental field of localisation by a rig: L at every position of its body as single landmarks move."""

from typing import Any, NamedTuple

import numpy as np

from lmd.incremental.coverage_field import CoverageField, coverage_field
from lmd.incremental.field import accept, bound, settle, undo
from lmd.incremental.state import RigScratch
from lmd.objectives.localisation.looks import mounts_of
from lmd.objectives.localisation.rig_ambiguity import width_of
from lmd.objectives.localisation.rig_trial import (
    bound_localised_move,
    carry_out_localised,
    finish_localised_move,
    sum_up_anew,
    take_back_localised,
)
from lmd.objectives.localisation.slots import Mounts, Slots, new_slots
from lmd.objectives.localisation.state import LocalisationState, blank_state
from lmd.scene.deployment import Deployment
from lmd.sight.evaluator import Evaluator


class RigLocalisationScratch(NamedTuple):
    """The move tried last, and working memory.

    Once the move is carried out, `units`, `located`, `LOCALISED` and `coverage` are those of before.
    """

    units: np.ndarray
    """`(Q,)` as in the state, after the move; so is `located`."""
    located: np.ndarray
    sets: np.ndarray
    """`(3, Q, W)`: `LOCALISED`, `LOST`, `GAINED`."""
    coverage: RigScratch
    """The scratch of coverage."""
    slots: Slots
    """The views that are worked on."""


class RigLocalisationField(NamedTuple):
    """What does not change while landmarks move; a `lmd.incremental.field.Field`.

    precision, asks, weight: as in `LocalisationField`; mounts: of each part of the rig.
    """

    coverage: CoverageField
    precision: Any
    asks: bool
    weight: float
    mounts: tuple[Mounts, ...]

    @property
    def size(self) -> int:
        """See `Field.size`."""
        return self.coverage.size

    @property
    def index_of(self) -> np.ndarray:
        """See `Field.index_of`."""
        return self.coverage.index_of

    def state(self, deployment: Deployment) -> LocalisationState:
        """See `Field.state`."""
        width = width_of(self.precision)
        state = blank_state(self.coverage.state(deployment), width, 8.0 * width if self.asks else 0.0)
        sum_up_anew(self, state, self.scratch(state))
        return state

    def scratch(self, state: LocalisationState) -> RigLocalisationScratch:
        """See `Field.scratch`."""
        return RigLocalisationScratch(
            units=state.units.copy(),
            located=state.located.copy(),
            sets=np.stack([state.localised, *np.zeros((2, *state.localised.shape), dtype=np.uint64)]),
            coverage=self.coverage.scratch(state.coverage),
            slots=new_slots(),
        )


bound.register(RigLocalisationField)(bound_localised_move)
settle.register(RigLocalisationField)(finish_localised_move)
accept.register(RigLocalisationField)(carry_out_localised)
undo.register(RigLocalisationField)(take_back_localised)


def rig_localisation_field(evaluator: Evaluator, n: int, precision: Any, weight: float) -> RigLocalisationField:
    """The field of L at the positions of an evaluator whose scene has a rig."""
    mounts = mounts_of(evaluator, evaluator.parts)
    return RigLocalisationField(coverage_field(evaluator, n), precision, precision.asks, weight, mounts)
