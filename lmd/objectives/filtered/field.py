"""Field (incremental evaluator) of filtered poses for a single camera. When single landmarks move, the field updates
which frames have a pose that is known to the tolerance.
"""

from typing import Any, NamedTuple

import numpy as np

from lmd.core.bits import BITS
from lmd.core.bits import LANES as OTHERS_AT_ONCE
from lmd.core.compiled import for_kernels
from lmd.core.memory import check_memory
from lmd.incremental.field import accept, bound, places_of, settle, undo
from lmd.objectives.filtered.drives import Drives
from lmd.objectives.filtered.lanes import NUMBERS, Lanes, Tolerance, lanes
from lmd.objectives.filtered.sightings import SPOTS
from lmd.objectives.filtered.trial import bound_move, exchange_move, fill_state, settle_move
from lmd.objectives.localisation.information import NUMBERS as SUMS
from lmd.objectives.localisation.information import WIDTH, Precision
from lmd.scene.criteria import horizon_of
from lmd.scene.deployment import Deployment
from lmd.sight.blocks import BLOCK, SINGLE_ERROR, boxes_around
from lmd.sight.evaluator import Evaluator
from lmd.sight.obstacles import new_ends

STATE_BYTES = 700  # memory of a frame in a state and a scratch, without landmarks
LANDMARK_BYTES = 30  # memory of a landmark in a frame


class FilteredState(NamedTuple):
    """State of `FilteredField` for K landmarks: coverage, information and filtered poses in F frames."""

    poses: np.ndarray
    """`(6, K)` positions, metres, and unit normals."""
    surfaces: np.ndarray
    """`(K,)` indices of the surfaces that carry the landmarks."""
    units: np.ndarray
    """`(F,)` quantised value of each frame, 0 or `PROBABILITY_ONE`."""
    covered: np.ndarray
    """`(F, W)` uint64 bit sets of the landmarks that the camera covers in each frame if no landmark hides another one.
    """
    hidden: np.ndarray
    """`(F, K)` int16: for a covered landmark, the number of landmarks that hide it; 0 for landmarks that are not
    covered.
    """
    counts: np.ndarray
    """`(F,)` int16 number of landmarks in view."""
    sums: np.ndarray
    """`(F, 15)` sums of the landmarks' information, see `lmd.objectives.localisation.information`."""
    covariances: np.ndarray
    """`(F, 21)` covariance of the filtered pose in each frame."""


class FilteredScratch(NamedTuple):
    """Working memory with the results of the move tried last.

    After this move is carried out, the memory has the data of the reverse move, which undoes it.
    """

    units: np.ndarray
    """`(F,)` quantised value of each frame after the move."""
    pose: np.ndarray
    """`(6,)` position (metres) and unit normal of the place tried."""
    surface: np.ndarray
    """`(1,)` index of the surface of the place tried."""
    covered: np.ndarray
    """`(F,)` uint8, 1 for frames in which the camera covers the landmark at the place tried."""
    hidden: np.ndarray
    """`(F,)` int16 number of landmarks that hide the moving landmark at the place tried."""
    counts: np.ndarray
    """`(F,)` int16 number of landmarks in view after the move; only entries of changed frames are valid."""
    sums: np.ndarray
    """`(F, 15)` sums of the landmarks' information after the move; only rows of changed frames are valid."""
    covariances: np.ndarray
    """`(F, 21)` covariances after the move; only rows of frames that are filtered again are valid."""
    changed: np.ndarray
    """`(F,)` uint8, 1 for changed frames: frames in which the move changes the landmarks in view."""
    starts: np.ndarray
    """`(D,)` int64 index of the first changed frame of each drive, from which the drive is filtered again; the end of
    the drive if no frame changes.
    """
    pairs: np.ndarray
    """`(3, F K)` int32 list of pairs, with the rows: frame, another landmark, and change of the number of landmarks
    that hide this other landmark in this frame.
    """
    numbers: np.ndarray
    """`(1,)` int64: number of entries of `pairs` that are in use."""
    others: np.ndarray
    """`(2, K)` int64 indices of the landmarks near the old place and near the place tried."""
    offsets: np.ndarray
    """`(2, 4, L)` float32, see `lmd.incremental.state.Scratch.offsets`."""
    near: np.ndarray
    """`(2, W)` uint64 sets of landmarks, for the old place and for the place tried. A set has the landmarks that may
    hide the moving landmark, or be hidden by it, as seen from a block of frames.
    """
    ends: Any
    """Working memory of obstacles, see `lmd.sight.obstacles.find_ends`."""
    spots: np.ndarray
    """`(2, 4 SPOTS)` buffer ("spots") of frames that show the moving landmark, at the old place and at the place tried:
    the landmark's offset from the camera, metres, and its `pixel_density`.
    """
    spotted: np.ndarray
    """`(2, SPOTS)` int64 index of the frame of each of the `spots`."""
    shares: np.ndarray
    """`(15 SPOTS,)` information that the moving landmark adds in each of the `spots`."""
    moment: np.ndarray
    """`(16,)` moments of a landmark (sums over its corners), see `lmd.objectives.localisation.information.moments`."""
    lanes: Lanes
    """Working memory of the Kalman filters, which run along several drives in parallel."""


class FilteredField(NamedTuple):
    """Constant data of the incremental evaluator (field) of filtered poses; a `lmd.incremental.field.Field`.

    Each frame of the drives is a position of the field.
    """

    positions: np.ndarray
    """`(3, L)` positions of the frames, metres; L >= F is a multiple of `BLOCK`, the last frame is repeated."""
    axes: np.ndarray
    """`(6, L)` unit vectors along the optical axis and to the right in the image, for each frame."""
    cosine: float
    """Lower bound on the cosine of the angle between the optical axis and the direction of a covered landmark."""
    boxes: np.ndarray
    """`(6, B)` centre and half sides of the box around each block of frames, metres."""
    sight: Any
    """Compiled model of sight."""
    horizon: float
    """Distance from the camera beyond which a landmark has no effect, metres, see `lmd.scene.criteria.horizon_of`."""
    obstacles: Any
    """Obstacles of the room seen from the frames."""
    precision: Precision
    """Edge lengths of the landmarks, and weight of each corner in the information."""
    n: int
    """Least number of landmarks in view; the information of a frame with fewer landmarks is not used."""
    tolerance: Tolerance
    """Limits of the covariance up to which a pose counts as known."""
    first: np.ndarray
    """`(D + 1,)` index of the first frame of each drive, followed by F."""
    moves: np.ndarray
    """`(F, 5)`, see `Drives.moves`."""
    start: np.ndarray
    """`(21,)` covariance of the initial pose."""

    @property
    def size(self) -> int:
        """See `Field.size`."""
        return len(self.moves)

    @property
    def index_of(self) -> np.ndarray:
        """See `Field.index_of`."""
        return np.arange(self.size)

    def state(self, deployment: Deployment) -> FilteredState:
        """See `Field.state`."""
        places, size, count = places_of(deployment), self.size, len(deployment)
        check_memory(size * (STATE_BYTES + LANDMARK_BYTES * count), f"{size} frames x {count} landmarks")
        state = FilteredState(
            poses=places.poses,
            surfaces=places.surfaces,
            units=np.zeros(size, dtype=np.int64),
            covered=np.zeros((size, -(-count // BITS)), dtype=np.uint64),
            hidden=np.zeros((size, count), dtype=np.int16),
            counts=np.zeros(size, dtype=np.int16),
            sums=np.zeros((size, SUMS)),
            covariances=np.zeros((size, NUMBERS)),
        )
        fill_state(self, state, self.scratch(state))
        return state

    def scratch(self, state: FilteredState) -> FilteredScratch:
        """See `Field.scratch`."""
        size, count = state.hidden.shape
        return FilteredScratch(
            units=state.units.copy(),
            pose=np.zeros(6),
            surface=np.zeros(1, dtype=np.int64),
            covered=np.zeros(size, dtype=np.uint8),
            hidden=np.zeros(size, dtype=np.int16),
            counts=np.zeros(size, dtype=np.int16),
            sums=np.zeros((size, SUMS)),
            covariances=np.zeros((size, NUMBERS)),
            changed=np.zeros(size, dtype=np.uint8),
            starts=np.zeros(len(self.first) - 1, dtype=np.int64),
            pairs=np.zeros((3, size * count), dtype=np.int32),
            numbers=np.zeros(1, dtype=np.int64),
            others=np.zeros((2, count), dtype=np.int64),
            offsets=np.zeros((2, 4, (count // OTHERS_AT_ONCE + 1) * OTHERS_AT_ONCE), dtype=np.float32),
            near=np.zeros((2, state.covered.shape[1]), dtype=np.uint64),
            ends=new_ends(self.obstacles, 1),
            spots=np.ones((2, 4 * SPOTS)),
            spotted=np.zeros((2, SPOTS), dtype=np.int64),
            shares=np.zeros(SUMS * SPOTS),
            moment=np.zeros(WIDTH),
            lanes=lanes(),
        )


bound.register(FilteredField)(bound_move)
settle.register(FilteredField)(settle_move)
accept.register(FilteredField)(exchange_move)
undo.register(FilteredField)(exchange_move)


def filtered_field(
    evaluator: Evaluator, drives: Drives, precision: Precision, n: int, tolerance: Tolerance
) -> FilteredField:
    """Make the field (incremental evaluator) of filtered poses along drives. The positions of the evaluator must be the
    positions of the frames.

    Args:
        evaluator: evaluator of a single camera at the positions of the frames.
        drives: the drives.
        precision: edge lengths of the landmarks, and weight of each corner in the information.
        n: least number of landmarks in view; the information of a frame with fewer landmarks is not used.
        tolerance: limits of the covariance up to which a pose counts as known.
    """
    padded = np.pad(np.hstack([drives.positions, drives.axes]), [(0, -len(drives.positions) % BLOCK), (0, 0)], "edge")
    return FilteredField(
        positions=for_kernels(padded[:, :3].T),
        axes=for_kernels(padded[:, 3:].T),
        cosine=float(evaluator.sight.outer_cosine) - SINGLE_ERROR,
        boxes=np.concatenate([box.astype(np.float64) for box in boxes_around(padded[:, :3])]),
        sight=evaluator.sight,
        horizon=horizon_of(evaluator.sight),
        obstacles=evaluator.obstacles,
        precision=precision,
        n=n,
        tolerance=tolerance,
        first=for_kernels(drives.first),
        moves=for_kernels(drives.moves),
        start=for_kernels(drives.start),
    )
