"""The incremental field of coverage: P_n at every position as single landmarks move (`lmd.incremental`)."""

from typing import Any, NamedTuple

import numpy as np

from lmd.core.bits import BITS, packed
from lmd.incremental.counts import counts_of
from lmd.incremental.field import accept, bound, settle, undo
from lmd.incremental.move import carry_out, state_of, take_back
from lmd.incremental.state import Scratch, State, scratch_of
from lmd.incremental.trial import bound_move, finish_move
from lmd.scene.criteria import horizon_of
from lmd.scene.deployment import Deployment
from lmd.sight.blocks import boxes_around
from lmd.sight.evaluator import Evaluator
from lmd.sight.obstacles import half_edge, obstacles_at


class CoverageField(NamedTuple):
    """What does not change while landmarks move; a `lmd.incremental.field.Field`."""

    positions: np.ndarray
    """`(3, Q)` in blocks of `BLOCK` neighbours, the last block filled up with copies; metres."""
    index_of: np.ndarray
    """`(P,)` where each position of the evaluator is among them."""
    boxes: np.ndarray
    """`(6, Q / BLOCK)` around the blocks: centres, and half the sides, metres."""
    horizon: float
    """See `criteria.horizon_of`."""
    sight: Any
    """The compiled model."""
    obstacles: Any
    """What of the room stands in the way, or None."""
    axes: np.ndarray
    """`(6, 64 W)` optical axis and right, filled up with zeros to whole words."""
    tables: np.ndarray
    """`(2, cells + 1, W)`: `CERTAIN`, `POSSIBLE` of `lmd.sight.directions`."""
    given: np.ndarray
    """`(Q, W)` axes at which one landmark is covered beside those of a state."""
    weights: np.ndarray
    """As in `kernels.evaluate_range`; so is `n`."""
    n: int

    @property
    def size(self) -> int:
        """See `Field.size`."""
        return int(self.positions.shape[1])

    def state(self, deployment: Deployment) -> State:
        """See `Field.state`."""
        return state_of(self, deployment)

    def scratch(self, state: State) -> Scratch:
        """See `Field.scratch`."""
        return scratch_of(state)

    @property
    def stack(self) -> int:
        """See `Stacking.stack`: tags of several sizes have none."""
        return self.n if np.ndim(half_edge(self.sight)) == 0 else 0

    def stacked(self, fixed: Deployment | None) -> "CoverageField":
        """See `Stacking.stacked`: a stack of n that nothing hides is seen whenever one landmark in its place is.

        Where n fixed landmarks are covered, it is as if one stack were.
        """
        sight, given = self.sight.unhidden(), self.given
        if fixed is not None:
            given = packed(counts_of(self.state(fixed), given.shape[1] * BITS) >= self.n)
        return self._replace(n=1, sight=sight, horizon=horizon_of(sight), given=given)

    def shrunk(self, size: float) -> "CoverageField":
        """See `Stacking.shrunk`."""
        return self._replace(sight=self.sight.shrunk(size))


bound.register(CoverageField)(bound_move)
settle.register(CoverageField)(finish_move)
accept.register(CoverageField)(carry_out)
undo.register(CoverageField)(take_back)


def coverage_field(evaluator: Evaluator, n: int) -> CoverageField:
    """The field of P_n at the positions of an evaluator."""
    e, (order, index_of) = evaluator, evaluator.blocks
    boxes = np.vstack(boxes_around(e.positions[order]))
    positions = np.ascontiguousarray(e.positions[order].T)
    horizon, given = horizon_of(e.sight), np.zeros((len(order), e.tables[0].shape[1]), dtype=np.uint64)
    obstacles = obstacles_at(e.scene.room.blockers(), e.positions[order])
    weights = e.weights[order] if len(e.weights) > 1 else e.weights
    return CoverageField(
        positions, index_of, boxes, horizon, e.sight, obstacles, e.axes, np.stack(e.tables), given, weights, n
    )
