"""The incremental field of coverage: P_n at every position as single landmarks move, before a camera or a rig."""

from typing import Any, NamedTuple

import numpy as np

from lmd.core.bits import BITS, packed
from lmd.incremental.camera import OneCamera
from lmd.incremental.counts import counts_of, given_counts
from lmd.incremental.field import accept, bound, places_of, settle, undo
from lmd.incremental.move import carry_out, fill, take_back
from lmd.incremental.rig import RigCameras
from lmd.incremental.trial import bound_move, finish_move
from lmd.scene.criteria import horizon_of, largest
from lmd.scene.deployment import Deployment
from lmd.sight.blocks import boxes_around
from lmd.sight.evaluator import Evaluator
from lmd.sight.obstacles import obstacles_at
from lmd.sight.stations import places_around


class CoverageField(NamedTuple):
    """Everything that does not change while landmarks move; a `lmd.incremental.field.Field`."""

    positions: np.ndarray
    """`(3, Q)` positions in blocks of `BLOCK` neighbours, the last block filled up with copies; metres."""
    index_of: np.ndarray
    """`(P,)` index of each position of the evaluator among them."""
    boxes: np.ndarray
    """`(6, Q / BLOCK)` boxes around the blocks: centres, and half the sides, metres."""
    horizon: float
    """Distance from a position beyond which a landmark cannot matter, metres."""
    cameras: OneCamera | RigCameras
    """The cameras that look."""
    given: np.ndarray
    """`(Q, W)` axes at which one landmark is covered beside those of a state."""
    weights: np.ndarray
    """Weights of the axes, see `kernels.evaluate_range`."""
    n: int
    """Number of landmarks that must be covered."""

    @property
    def size(self) -> int:
        """See `Field.size`."""
        return int(self.positions.shape[1])

    def state(self, deployment: Deployment) -> Any:
        """See `Field.state`."""
        state = self.cameras.state(
            {
                **places_of(deployment)._asdict(),
                "counts": given_counts(self.given, len(deployment), self.n),
                "units": np.zeros(self.size, dtype=np.int64),
            }
        )
        fill(self, state, self.scratch(state))
        return state

    def scratch(self, state: Any) -> Any:
        """See `Field.scratch`."""
        return self.cameras.scratch(state)

    @property
    def stack(self) -> int:
        """See `Stacking.stack`: tags of several sizes have none."""
        return self.n if all(largest(sight) is sight for sight in self.cameras.sights) else 0

    def stacked(self, fixed: Deployment | None) -> "CoverageField":
        """See `Stacking.stacked`: a stack of n that nothing hides is seen whenever one landmark in its place is.

        Where n fixed landmarks are covered, it is as if one stack were.
        """
        given = self.given
        if fixed is not None:
            given = packed(counts_of(self.state(fixed), given.shape[1] * BITS) >= self.n)
        return self._seen_by(lambda sight: sight.unhidden())._replace(n=1, given=given)

    def shrunk(self, size: float) -> "CoverageField":
        """See `Stacking.shrunk`."""
        return self._seen_by(lambda sight: sight.shrunk(size))

    def _seen_by(self, change: Any) -> "CoverageField":
        cameras = self.cameras.with_sights(change)
        return self._replace(cameras=cameras, horizon=cameras.horizon)


bound.register(CoverageField)(bound_move)
settle.register(CoverageField)(finish_move)
accept.register(CoverageField)(carry_out)
undo.register(CoverageField)(take_back)


def coverage_field(evaluator: Evaluator, n: int) -> CoverageField:
    """The field of P_n at the positions of an evaluator."""
    e, (order, index_of), blockers = evaluator, evaluator.blocks, evaluator.scene.room.blockers()
    ordered = e.positions[order]
    cameras: OneCamera | RigCameras
    if e.parts:
        places = (ordered if blockers is None else places_around(ordered, part) for part in e.parts)
        each = zip(e.parts, places, strict=True)
        cameras = RigCameras(tuple(part._replace(obstacles=obstacles_at(blockers, at)) for part, at in each))
    else:
        obstacles, tables = obstacles_at(blockers, ordered), np.stack(e.tables)
        cameras = OneCamera(e.sight, horizon_of(e.sight), np.zeros((1, 3)), np.zeros(1), obstacles, e.axes, tables)
    given = np.zeros((len(order), e.axes.shape[1] // BITS), dtype=np.uint64)
    weights = e.weights[order] if len(e.weights) > 1 else e.weights
    boxes, positions = np.vstack(boxes_around(ordered)), np.ascontiguousarray(ordered.T)
    return CoverageField(positions, index_of, boxes, cameras.horizon, cameras, given, weights, n)
