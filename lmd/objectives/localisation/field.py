"""The incremental field of localisation: L at every position as single landmarks move."""

from typing import Any, NamedTuple

import numpy as np

from lmd.incremental.coverage_field import CoverageField
from lmd.incremental.field import accept, bound, settle, undo
from lmd.incremental.move import take_back
from lmd.objectives.localisation.move import change_sums, exchange, localisation_state
from lmd.objectives.localisation.state import LocalisationScratch, LocalisationState, localisation_scratch
from lmd.objectives.localisation.trial import bound_move, finish_move
from lmd.scene.deployment import Deployment


class LocalisationField(NamedTuple):
    """What does not change while landmarks move; a `lmd.incremental.field.Field`.

    It has no stacks: landmarks on one point do not tell where the camera is.

    coverage: the field of P_n; precision, asks: see `kernels.localise_range`; weight: of P_n beside L.
    """

    coverage: CoverageField
    precision: Any
    asks: bool
    weight: float

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
        return localisation_state(self, self.coverage.state(deployment))

    def scratch(self, state: LocalisationState) -> LocalisationScratch:
        """See `Field.scratch`."""
        return localisation_scratch(state)


bound.register(LocalisationField)(bound_move)
settle.register(LocalisationField)(finish_move)


@accept.register(LocalisationField)
def _accept(field, k, state, scratch):  # type: ignore[no-untyped-def]
    change_sums(k, 1.0, field, state, scratch)
    take_back(field.coverage, k, state.coverage, scratch.coverage)  # the trial found the cap
    exchange(state, scratch)


@undo.register(LocalisationField)
def _undo(field, k, state, scratch):  # type: ignore[no-untyped-def]
    take_back(field.coverage, k, state.coverage, scratch.coverage)
    change_sums(k, -1.0, field, state, scratch)
    exchange(state, scratch)
