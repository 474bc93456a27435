"""The incremental field of coverage by a rig: P_n at every position of its body as single landmarks move."""

from typing import NamedTuple

import numpy as np

from lmd.core.bits import BITS, packed
from lmd.incremental.field import accept, bound, settle, undo
from lmd.incremental.move import counts_of
from lmd.incremental.rig_move import carry_out_rig, rig_state_of, take_back_rig
from lmd.incremental.rig_state import RigScratch, RigState, Stations, rig_scratch_of
from lmd.incremental.rig_trial import bound_rig_move, finish_rig_move
from lmd.scene.criteria import horizon_of
from lmd.scene.deployment import Deployment
from lmd.sight.blocks import boxes_around
from lmd.sight.evaluator import Evaluator
from lmd.sight.obstacles import obstacles_at


class RigField(NamedTuple):
    """What does not change while landmarks move; a `lmd.incremental.field.Field`.

    index_of, given, weights, n: as in `CoverageField`, for Q positions and D orientations of the body; parts: the rig.
    """

    index_of: np.ndarray
    parts: tuple[Stations, ...]
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
        return rig_scratch_of(state)

    @property
    def stack(self) -> int:
        """See `Stacking.stack`."""
        return self.n

    def stacked(self, fixed: Deployment | None) -> "RigField":
        """See `Stacking.stacked` and `CoverageField.stacked`."""
        sights = [part.sight.unhidden() for part in self.parts]
        parts = [p._replace(sight=s, horizon=horizon_of(s)) for p, s in zip(self.parts, sights, strict=True)]
        given = self.given
        if fixed is not None:
            given = packed(counts_of(self.state(fixed), given.shape[1] * BITS) >= self.n)
        return self._replace(n=1, parts=tuple(parts), given=given)

    def shrunk(self, size: float) -> "RigField":
        """See `Stacking.shrunk`."""
        return self._replace(parts=tuple(part._replace(sight=part.sight.shrunk(size)) for part in self.parts))


bound.register(RigField)(bound_rig_move)
settle.register(RigField)(finish_rig_move)
accept.register(RigField)(carry_out_rig)
undo.register(RigField)(take_back_rig)


def rig_field(evaluator: Evaluator, n: int) -> RigField:
    """The field of P_n at the positions of an evaluator whose scene has a rig."""
    order, index_of = evaluator.blocks
    blockers, parts = evaluator.scene.room.blockers(), []
    for number, part in enumerate(evaluator.parts):
        stations = (part.offsets[:, None] + evaluator.positions[order]).reshape(-1, 3)
        centres, halves = boxes_around(stations)
        points, obstacles = np.ascontiguousarray(stations.T), obstacles_at(blockers, stations)
        parts.append(
            Stations(number, points, centres, halves, horizon_of(part.sight), part.sight, obstacles, *part[2:])
        )
    given = np.zeros((len(order), evaluator.axes.shape[1] // BITS), dtype=np.uint64)
    weights = evaluator.weights[order] if len(evaluator.weights) > 1 else evaluator.weights
    return RigField(index_of, tuple(parts), given, weights, n)
