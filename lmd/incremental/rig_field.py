"""The incremental field of coverage by a rig: P_n at every position of its body as single landmarks move."""

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from lmd.core.bits import BITS, packed
from lmd.incremental.counts import counts_of
from lmd.incremental.field import accept, bound, settle, undo
from lmd.incremental.rig_move import carry_out_rig, rig_state_of, take_back_rig
from lmd.incremental.rig_state import RigScratch, RigState, Stations, rig_scratch_of
from lmd.incremental.rig_trial import bound_rig_move, finish_rig_move
from lmd.scene.deployment import Deployment
from lmd.sight.blocks import boxes_around
from lmd.sight.evaluator import Evaluator
from lmd.sight.obstacles import half_edge, obstacles_at
from lmd.sight.stations import places_around, with_sight


class RigField(NamedTuple):
    """What does not change while landmarks move; a `lmd.incremental.field.Field`.

    What is not described is as in `CoverageField`, for Q positions and D orientations of the body.
    """

    positions: np.ndarray
    index_of: np.ndarray
    boxes: np.ndarray
    horizon: float
    """From the body's origin, of all parts of the rig, metres."""
    parts: tuple[Stations, ...]
    """The cameras that are alike, one part for each kind."""
    given: np.ndarray
    weights: np.ndarray
    n: int

    @property
    def size(self) -> int:
        """See `Field.size`."""
        return len(self.given)

    def state(self, deployment: Deployment) -> RigState:
        """See `Field.state`."""
        return rig_state_of(self, deployment)

    def scratch(self, state: RigState) -> RigScratch:
        """See `Field.scratch`."""
        return rig_scratch_of(state, tuple(len(stations.part.centres) for stations in self.parts))

    @property
    def stack(self) -> int:
        """See `Stacking.stack`: tags of several sizes have none."""
        return self.n if all(np.ndim(half_edge(each.part.sight)) == 0 for each in self.parts) else 0

    def stacked(self, fixed: Deployment | None) -> "RigField":
        """See `Stacking.stacked` and `CoverageField.stacked`."""
        field = self._seen_by(lambda sight: sight.unhidden())
        given = self.given
        if fixed is not None:
            given = packed(counts_of(self.state(fixed), given.shape[1] * BITS) >= self.n)
        return field._replace(n=1, given=given)

    def shrunk(self, size: float) -> "RigField":
        """See `Stacking.shrunk`."""
        return self._seen_by(lambda sight: sight.shrunk(size))

    def _seen_by(self, change: Callable[[Any], Any]) -> "RigField":
        """The same with another model of sight in place of each."""
        parts = tuple(each._replace(part=with_sight(each.part, change(each.part.sight))) for each in self.parts)
        return self._replace(parts=parts, horizon=max(each.part.horizon for each in parts))


bound.register(RigField)(bound_rig_move)
settle.register(RigField)(finish_rig_move)
accept.register(RigField)(carry_out_rig)
undo.register(RigField)(take_back_rig)


def rig_field(evaluator: Evaluator, n: int) -> RigField:
    """The field of P_n at the positions of an evaluator whose scene has a rig."""
    e, (order, index_of), blockers = evaluator, evaluator.blocks, evaluator.scene.room.blockers()
    ordered = e.positions[order]
    parts = tuple(
        Stations(number, part, obstacles_at(blockers, ordered if blockers is None else places_around(ordered, part)))
        for number, part in enumerate(e.parts)
    )
    given = np.zeros((len(order), e.axes.shape[1] // BITS), dtype=np.uint64)
    weights = e.weights[order] if len(e.weights) > 1 else e.weights
    horizon, boxes = max(part.horizon for part in e.parts), np.vstack(boxes_around(ordered))
    return RigField(np.ascontiguousarray(ordered.T), index_of, boxes, horizon, parts, given, weights, n)
