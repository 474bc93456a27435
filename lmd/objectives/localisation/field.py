"""Field (incremental evaluator) of localisation, for a camera or a rig: it updates L, the probability of a localised
view, at every position when single landmarks move.
"""

from typing import NamedTuple

import numpy as np

import lmd.objectives.localisation.camera_changes  # the two imports register functions
import lmd.objectives.localisation.rig_changes  # noqa: F401
from lmd.core.bits import BITS
from lmd.core.memory import check_views
from lmd.incremental.coverage_field import CoverageField, coverage_field
from lmd.incremental.field import accept, bound, placed, settle, undo
from lmd.incremental.state import RigScratch, RigState, Scratch, State
from lmd.objectives.localisation.ambiguity import width_of
from lmd.objectives.localisation.information import WIDTH, Precision
from lmd.objectives.localisation.pairs import Mounts, mounts_of
from lmd.objectives.localisation.trial import bound_move, carry_out, finish_move, sum_up_anew, undo_move
from lmd.objectives.localisation.views import BodyViews, CameraViews, body_views, camera_views
from lmd.scene.deployment import Deployment
from lmd.sight.evaluator import Evaluator


class LocalisationState(NamedTuple):
    """Information and localised views of a deployment, for Q positions in the order of the field.

    A view is an orientation at a position. An orientation is one bit of W 64-bit words.
    """

    units: np.ndarray
    """`(Q,)` quantised value of each position."""
    located: np.ndarray
    """`(Q,)` quantised L, the probability of a localised view, at each position."""
    localised: np.ndarray
    """`(Q, W)` uint64 sets of orientations with which the camera or the body is localised."""
    sums: np.ndarray
    """`(64 Q W, width)` sums of the information of the landmarks in each view, by position, then orientation.

    If n covered landmarks suffice to localise a view, no information is needed: the array is unused, and its shape is
    `(1, width)`.
    """
    coverage: State | RigState
    """State of the field of coverage."""


class LocalisationScratch(NamedTuple):
    """Working memory with the results of the move tried last.

    After the move is carried out, the scratch has the data of the reverse move, which undoes it, in `units`, `located`,
    the row `LOCALISED` of `sets`, and `coverage`.
    """

    units: np.ndarray
    """`(Q,)` quantised value of each position after the move, or upper bounds on the values."""
    located: np.ndarray
    """`(Q,)` quantised L, the probability of a localised view, at each position after the move, or upper bounds on L.
    """
    sets: np.ndarray
    """`(3, Q, W)` uint64 bit sets of orientations. Row `LOCALISED` has the localised views after the move; the rows
    `LOST` and `GAINED` have the views in which another landmark disappears or appears.
    """
    coverage: Scratch | RigScratch
    """Scratch (working memory) of the field of coverage. The `units` of the scratch are quantised P_n, the probability
    that n landmarks are covered.
    """
    views: CameraViews | BodyViews
    """Working memory for the views of one position."""


class LocalisationField(NamedTuple):
    """Constant data of the incremental evaluator (field) of localisation; a `lmd.incremental.field.Field`.

    The field has no stacks (groups of coincident landmarks), because landmarks at one point do not localise the camera.
    """

    coverage: CoverageField
    """Field of coverage, which updates P_n, the probability that n landmarks are covered."""
    precision: Precision
    """Limits that a localised view must satisfy."""
    asks: bool
    """True if n covered landmarks do not suffice for a localised view, see `Precision.asks`."""
    weight: float
    """Weight w in the value (1 - w) L + w P_n of a position: L is the probability of a localised view, P_n that of n
    covered landmarks.
    """
    mounts: tuple[Mounts, ...]
    """Mounts of each group of a rig; empty for a single camera."""

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
        return self.state_with(self.coverage.state(deployment))

    def state_with(self, known: State | RigState) -> LocalisationState:
        """New state of localisation for the deployment whose coverage is the state `known`."""
        size, words = known.counts.sets.shape[1:]
        width = width_of(self.precision) if self.mounts else WIDTH
        check_views(8.0 * width if self.asks else 0.0, size, BITS * words)
        state = LocalisationState(
            units=np.zeros(size, dtype=np.int64),
            located=np.zeros(size, dtype=np.int64),
            localised=np.zeros((size, words), dtype=np.uint64),
            sums=np.zeros((BITS * size * words if self.asks else 1, width)),
            coverage=known,
        )
        sum_up_anew(self, state, self.scratch(state))
        return state

    def scratch(self, state: LocalisationState) -> LocalisationScratch:
        """See `Field.scratch`."""
        return LocalisationScratch(
            units=state.units.copy(),
            located=state.located.copy(),
            sets=np.stack([state.localised, *np.zeros((2, *state.localised.shape), dtype=np.uint64)]),
            coverage=self.coverage.scratch(state.coverage),
            views=body_views() if self.mounts else camera_views(len(state.units)),
        )


@placed.register(LocalisationState)
def _placed(state: LocalisationState) -> State | RigState:
    return state.coverage


bound.register(LocalisationField)(bound_move)
settle.register(LocalisationField)(finish_move)
accept.register(LocalisationField)(carry_out)
undo.register(LocalisationField)(undo_move)


def localisation_field(evaluator: Evaluator, n: int, precision: Precision, weight: float) -> LocalisationField:
    """Make the field (incremental evaluator) of L, the probability of a localised view, at the positions of an
    evaluator.

    Args:
        evaluator: positions and cameras.
        n: number of landmarks that must be covered.
        precision: limits that a localised view must satisfy.
        weight: weight w in the values (1 - w) L + w P_n; P_n is the probability that n landmarks are covered.
    """
    mounts = mounts_of(evaluator, evaluator.groups) if evaluator.groups else ()
    return LocalisationField(coverage_field(evaluator, n), precision, precision.asks, weight, mounts)
