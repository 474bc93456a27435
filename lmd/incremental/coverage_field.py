"""The incremental field of coverage: P_n at every position as single landmarks move, before a camera or a rig."""

from typing import Any, NamedTuple

import numpy as np

from lmd.core.bits import BITS, packed
from lmd.core.memory import check_views
from lmd.incremental import camera, camera_occlusion, rig, rig_occlusion  # noqa: F401 # they register their functions
from lmd.incremental.counts import counts_of, given_counts
from lmd.incremental.field import accept, bound, places_of, settle, undo
from lmd.incremental.move import carry_out, fill, take_back
from lmd.incremental.state import RigScratch, RigState, Scratch, State, rig_scratch_of, scratch_of
from lmd.incremental.trial import bound_move, finish_move
from lmd.scene.criteria import horizon_of
from lmd.scene.deployment import Deployment
from lmd.sight.blocks import boxes_around
from lmd.sight.evaluator import Evaluator
from lmd.sight.mounts import MountGroup, places_around, with_sight
from lmd.sight.obstacles import half_edge, obstacles_at

# Bytes of a landmark in a camera's view: a bit for the cap, and as much again for occlusion.
LANDMARK_BYTES = 0.25
# Bytes of a landmark and a centre around a position of a rig: an entry of `GroupScratch.pairs`.
CENTRE_BYTES = 8
# Bytes of a landmark with a camera and an orientation of a rig: bits of caps, of occlusion, and of its changes.
CAMERA_BYTES = 3 / 8


class OneCamera(NamedTuple):
    """A single camera, at Q positions with all orientations."""

    sight: Any
    """The compiled model of sight."""
    horizon: float
    """See `criteria.horizon_of`, metres."""
    centres: np.ndarray
    """`(1, 3)` zeros: offset of the camera from a position, metres."""
    radius: np.ndarray
    """`(1,)` zero: distance of the camera from the centre, metres."""
    obstacles: Any
    """Obstacles of the room before the positions, see `lmd.sight.obstacles`."""
    axes: np.ndarray
    """`(6, 64 W)` optical axis and right, filled up with zeros to whole words."""
    tables: np.ndarray
    """`(2, cells + 1, W)`: `CERTAIN`, `POSSIBLE` of `lmd.sight.directions`."""

    @property
    def sights(self) -> tuple[Any, ...]:
        """The model of sight of each kind of camera."""
        return (self.sight,)

    def with_sights(self, change: Any) -> "OneCamera":
        """The camera with the model of sight that `change` makes of its own."""
        sight = change(self.sight)
        return self._replace(sight=sight, horizon=horizon_of(sight))

    def state(self, shared: dict[str, Any]) -> State:
        """An empty state with the `shared` fields."""
        (size, words), count = shared["counts"].sets.shape[1:], len(shared["surfaces"])
        check_views(LANDMARK_BYTES, size, BITS * words, count)
        return State(
            **shared,
            caps=np.zeros((count, size, words), dtype=np.uint64),
            reachable=np.zeros((count, size), dtype=np.bool_),
            hides=np.zeros((2, count, size), dtype=np.int16),
        )

    def scratch(self, state: State) -> Scratch:
        """Working memory for moves of a state."""
        return scratch_of(state)


class RigCameras(NamedTuple):
    """The cameras of a rig, around Q positions of its body, with all its orientations."""

    groups: tuple[MountGroup, ...]
    """Cameras that are alike, one group for each kind; place g of position q is q G + g of `MountGroup.obstacles`."""

    @property
    def horizon(self) -> float:
        """Distance from the body's origin beyond which a landmark cannot matter, metres."""
        return max(group.horizon for group in self.groups)

    @property
    def sights(self) -> tuple[Any, ...]:
        """The model of sight of each kind of camera."""
        return tuple(group.sight for group in self.groups)

    def with_sights(self, change: Any) -> "RigCameras":
        """The rig with the models of sight that `change` makes of its own."""
        return RigCameras(tuple(with_sight(group, change(group.sight)) for group in self.groups))

    def state(self, shared: dict[str, Any]) -> RigState:
        """An empty state with the `shared` fields."""
        (size, words), count = shared["counts"].sets.shape[1:], len(shared["surfaces"])
        mounts = [len(group.axes) for group in self.groups]
        centres = sum(len(group.centres) for group in self.groups)
        check_views(CENTRE_BYTES * centres + CAMERA_BYTES * sum(mounts) * BITS * words, size, 1, count)
        return RigState(
            **shared,
            groups=tuple(np.zeros((2, count, size, each, words), dtype=np.uint64) for each in mounts),
            shown=np.zeros((count, size, words), dtype=np.uint64),
        )

    def scratch(self, state: RigState) -> RigScratch:
        """Working memory for moves of a state."""
        return rig_scratch_of(state, tuple(len(group.centres) for group in self.groups))


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
        return self.n if all(np.ndim(half_edge(sight)) == 0 for sight in self.cameras.sights) else 0

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
    if e.groups:
        places = (ordered if blockers is None else places_around(ordered, group) for group in e.groups)
        each = zip(e.groups, places, strict=True)
        cameras = RigCameras(tuple(group._replace(obstacles=obstacles_at(blockers, at)) for group, at in each))
    else:
        obstacles, tables = obstacles_at(blockers, ordered), np.stack(e.tables)
        cameras = OneCamera(e.sight, horizon_of(e.sight), np.zeros((1, 3)), np.zeros(1), obstacles, e.axes, tables)
    given = np.zeros((len(order), e.axes.shape[1] // BITS), dtype=np.uint64)
    weights = e.weights[order] if len(e.weights) > 1 else e.weights
    boxes, positions = np.vstack(boxes_around(ordered)), np.ascontiguousarray(ordered.T)
    return CoverageField(positions, index_of, boxes, cameras.horizon, cameras, given, weights, n)
