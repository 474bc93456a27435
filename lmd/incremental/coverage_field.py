"""Field (incremental evaluator) of coverage, for a camera or a rig.

When single landmarks move, the field updates P_n, the probability that n landmarks are covered, at every position.
"""

from typing import Any, NamedTuple

import numpy as np

from lmd.core.bits import BITS, packed
from lmd.core.memory import check_views
from lmd.incremental import camera, rig, rig_occlusion  # noqa: F401 # they register their functions
from lmd.incremental.field import accept, bound, places_of, settle, undo
from lmd.incremental.state import (
    RigScratch,
    RigState,
    Scratch,
    State,
    counts_of,
    new_counts,
    rig_scratch_of,
    scratch_of,
)
from lmd.incremental.trial import bound_move, carry_out, exchange_place, fill, finish_move
from lmd.scene.criteria import horizon_of
from lmd.scene.deployment import Deployment
from lmd.sight.blocks import boxes_around
from lmd.sight.crowd import obstacles_of
from lmd.sight.evaluator import Evaluator
from lmd.sight.mounts import MountGroup, places_around, with_sight
from lmd.sight.obstacles import half_edge, obstacles_at

# Memory of a landmark per view of a camera, bytes: a bit for coverage, a bit for occlusion.
LANDMARK_BYTES = 0.25
# Memory of a landmark per position and centre of a rig, bytes: an entry of `GroupScratch.pairs`.
CENTRE_BYTES = 8
# Memory of a landmark per position, mount and orientation of a rig, bytes: bits of coverage, occlusion and its change.
CAMERA_BYTES = 3 / 8


class OneCamera(NamedTuple):
    """Data of a single camera for Q positions and all orientations of the scene's PDF."""

    sight: Any
    """Compiled model of sight."""
    horizon: float
    """Distance from the camera beyond which a landmark has no effect, metres, see `criteria.horizon_of`."""
    centres: np.ndarray
    """`(1, 3)` zeros: offset of the camera from a position, metres."""
    radius: np.ndarray
    """`(1,)` zero: distance of the camera from its centre in `centres`, metres."""
    obstacles: Any
    """Obstacles of the room seen from the positions, see `lmd.sight.obstacles`."""
    axes: np.ndarray
    """`(6, 64 W)` directions of the optical axis and of the image's right for each orientation, unit vectors, padded
    with zeros to whole words.
    """
    tables: np.ndarray
    """`(2, cells + 1, W)` tables `CERTAIN` and `POSSIBLE`, see `lmd.sight.directions`."""

    @property
    def sights(self) -> tuple[Any, ...]:
        """Models of sight, one for each kind of camera; here a single one."""
        return (self.sight,)

    def with_sights(self, change: Any) -> "OneCamera":
        """Copy of the camera with another model of sight: the result of the function `change` for the present model."""
        sight = change(self.sight)
        return self._replace(sight=sight, horizon=horizon_of(sight))

    def state(self, shared: dict[str, Any]) -> State:
        """New state (coverage of a deployment) whose landmarks are not counted yet.

        `shared` has the state's attributes that do not depend on the camera, keyed by name.
        """
        (size, words), count = shared["counts"].sets.shape[1:], len(shared["surfaces"])
        check_views(LANDMARK_BYTES, size, BITS * words, count)
        return State(
            **shared,
            covered=np.zeros((count, size, words), dtype=np.uint64),
            reachable=np.zeros((count, size), dtype=np.bool_),
            hides=np.zeros((2, count, size), dtype=np.int16),
        )

    def scratch(self, state: State) -> Scratch:
        """Working memory for moves of the landmarks of `state`."""
        return scratch_of(state)


class RigCameras(NamedTuple):
    """Data of a rig's cameras for Q positions of the rig's body and all orientations of the scene's PDF."""

    groups: tuple[MountGroup, ...]
    """Mounts, grouped by kind of camera. A group has G offsets `MountGroup.places`; the obstacles seen by the camera at
    offset g, with the body at position q, are in row q G + g of `MountGroup.obstacles`.
    """

    @property
    def horizon(self) -> float:
        """Distance from the body's origin beyond which a landmark has no effect, metres."""
        return max(group.horizon for group in self.groups)

    @property
    def sights(self) -> tuple[Any, ...]:
        """Models of sight, one for each kind of camera."""
        return tuple(group.sight for group in self.groups)

    def with_sights(self, change: Any) -> "RigCameras":
        """Copy of the rig with other models of sight: the results of the function `change` for the present models."""
        return RigCameras(tuple(with_sight(group, change(group.sight)) for group in self.groups))

    def state(self, shared: dict[str, Any]) -> RigState:
        """New state (coverage of a deployment) whose landmarks are not counted yet.

        `shared` has the state's attributes that do not depend on the cameras, keyed by name.
        """
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
        """Working memory for moves of the landmarks of `state`."""
        return rig_scratch_of(state, tuple(len(group.centres) for group in self.groups))


class CoverageField(NamedTuple):
    """Constant data of the incremental evaluator (field) of coverage; a `lmd.incremental.field.Field`."""

    positions: np.ndarray
    """`(3, Q)` positions in blocks of `BLOCK` neighbours, the last block padded with copies; metres."""
    index_of: np.ndarray
    """`(P,)` for each position of the evaluator, its index in `positions`."""
    boxes: np.ndarray
    """`(6, Q / BLOCK)` bounding boxes of the blocks: centres and half sides, metres."""
    horizon: float
    """Distance from a position beyond which a landmark has no effect, metres."""
    cameras: OneCamera | RigCameras
    """Single camera, or cameras of a rig."""
    counted_once: np.ndarray
    """`(Q, W)` bit sets of the orientations for which the count of covered landmarks begins at 1 instead of 0. With
    these orientations, the camera covers n landmarks outside the deployment; see `stacked`.
    """
    weights: np.ndarray
    """Quantised probability (an integer) of each axis, `(1, 64 W)`, or of each axis at each position, `(Q, 64 W)`; see
    `kernels.evaluate_range`.
    """
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
                "counts": new_counts(self.counted_once, len(deployment), self.n),
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
        """Number of landmarks in a stack (group of coincident landmarks); 0 for tags of several sizes, which form none.

        See `Stacking.stack`.
        """
        return self.n if all(np.ndim(half_edge(sight)) == 0 for sight in self.cameras.sights) else 0

    def stacked(self, fixed: Deployment | None) -> "CoverageField":
        """Field (incremental evaluator) in which each landmark represents a stack of n coincident landmarks.

        See `Stacking.stacked`. Stacked landmarks do not hide each other, so n becomes 1. An orientation that covers n
        of the `fixed` landmarks counts as an orientation that covers one stack.
        """
        counted_once = self.counted_once
        if fixed is not None:
            counted_once = packed(counts_of(self.state(fixed), counted_once.shape[1] * BITS) >= self.n)
        return self._with_sights(lambda sight: sight.unhidden())._replace(n=1, counted_once=counted_once)

    def shrunk(self, size: float) -> "CoverageField":
        """See `Stacking.shrunk`."""
        return self._with_sights(lambda sight: sight.shrunk(size))

    def _with_sights(self, change: Any) -> "CoverageField":
        cameras = self.cameras.with_sights(change)
        return self._replace(cameras=cameras, horizon=cameras.horizon)


bound.register(CoverageField)(bound_move)
settle.register(CoverageField)(finish_move)
accept.register(CoverageField)(carry_out)
undo.register(CoverageField)(exchange_place)


def coverage_field(evaluator: Evaluator, n: int) -> CoverageField:
    """Make the field (incremental evaluator) of P_n, the probability that n landmarks are covered, at the positions of
    an evaluator.
    """
    e, (order, index_of), blockers = evaluator, evaluator.blocks, evaluator.scene.room.blockers()
    ordered = e.positions[order]
    cameras: OneCamera | RigCameras
    if e.groups:
        places = (ordered if blockers is None else places_around(ordered, group) for group in e.groups)
        each = zip(e.groups, places, strict=True)
        cameras = RigCameras(tuple(group._replace(obstacles=obstacles_at(blockers, at)) for group, at in each))
    else:
        states = None if e.states is None else e.states[order]
        obstacles, tables = obstacles_of(e.scene, ordered, states), np.stack(e.tables)
        cameras = OneCamera(e.sight, horizon_of(e.sight), np.zeros((1, 3)), np.zeros(1), obstacles, e.axes, tables)
    counted_once = np.zeros((len(order), e.axes.shape[1] // BITS), dtype=np.uint64)
    weights = e.weights[order] if len(e.weights) > 1 else e.weights
    boxes, positions = np.vstack(boxes_around(ordered)), np.ascontiguousarray(ordered.T)
    return CoverageField(positions, index_of, boxes, cameras.horizon, cameras, counted_once, weights, n)
