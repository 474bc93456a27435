"""Arrays for moves of single landmarks, in two kinds of named tuples.

A *state* has the coverage of one deployment. A *scratch* is working memory with the results of the move tried last.
Names in capitals, such as `FRESH`, are indices of rows of arrays. Sets of orientations (axes) are bit sets, whose word
w is a 64-bit integer for the orientations 64 w to 64 w + 63.

Attributes with equal names have equal meanings for a camera and for a rig. Arrays of equal type and shape are rows of
one array, because numba passes every n-dimensional array as 5 + 2n numbers to functions that are not inlined.
"""

from typing import Any, NamedTuple

import numpy as np

from lmd.core.bits import ALL, LANES, ZERO, Integer, add_digit, equal_so_far, unpacked
from lmd.core.compiled import inlined, inner
from lmd.sight.kernels import sum_weights

# Rows of `Counts.sets`.
SHORT = 0  # axes that cover n - 1 landmarks
JUST = 1  # axes that cover n landmarks
ENOUGH = 2  # axes that cover n landmarks or more


class Counts(NamedTuple):
    """Number of landmarks covered at each of Q positions with each orientation (axis), stored as bit sets.

    A bit set has one bit for each orientation, in W words of 64 bits.
    """

    digits: np.ndarray
    """`(Q, W, J)` bit sets: the J binary digits of the numbers of covered landmarks, the lowest digit first."""
    sets: np.ndarray
    """`(3, Q, W)` bit sets of the axes that cover n - 1 landmarks (row `SHORT`), n landmarks (row `JUST`), and n
    landmarks or more (row `ENOUGH`).
    """


def new_counts(counted_once: np.ndarray, count: int, n: int) -> Counts:
    """Counts of covered landmarks before the first landmark of a deployment is counted.

    Args:
        counted_once: bit sets `(Q, W)` of the orientations with which the counts begin at 1 instead of 0, see
            `CoverageField`.
        count: number K of landmarks that can be counted.
        n: number of landmarks that must be covered.
    """
    digits = np.zeros((*counted_once.shape, max(count + bool(counted_once.any()), n).bit_length()), dtype=np.uint64)
    digits[:, :, 0] = counted_once
    none = np.zeros_like(counted_once)
    just = counted_once if n == 1 else none
    return Counts(digits, np.stack([{1: ~counted_once, 2: counted_once}.get(n, none), just, just]))


@inlined
def enough_with(p: Integer, w: Integer, was: Any, now: Any, counts: Any) -> Any:
    """Bit set of the orientations that cover n landmarks or more at position p after one landmark moves.

    All sets are limited to word w (64 orientations). `was` and `now` are the orientations that cover the moving
    landmark before and after the move.
    """
    short, just, enough = counts.sets[SHORT], counts.sets[JUST], counts.sets[ENOUGH]
    return (enough[p, w] & ~(was & ~now & just[p, w])) | (now & ~was & short[p, w])


@inlined
def update_counts(p: Integer, w: Integer, changed: Any, decrement: Any, n: Integer, counts: Any) -> None:
    """Update the counts of covered landmarks at position p, for the orientations in the bit set `changed`.

    The count for an orientation decreases by 1 if the orientation is in the bit set `decrement`, otherwise it increases
    by 1. Both sets are limited to word w (64 orientations).
    """
    digits, one, two = counts.digits, ALL, ALL
    short, just, enough = counts.sets[SHORT], counts.sets[JUST], counts.sets[ENOUGH]
    enough[p, w] = enough_with(p, w, changed & decrement, changed & ~decrement, counts)
    for j in range(np.uint64(digits.shape[2])):
        digit, changed = add_digit(digits[p, w, j], changed, decrement)
        digits[p, w, j] = digit
        one, two = equal_so_far(one, digit, n - 1, j), equal_so_far(two, digit, n, j)
    short[p, w], just[p, w] = one, two


@inner
def sum_up(field: Any, state: Any) -> None:
    """Compute P_n, the probability that n landmarks are covered, at all positions from the counts.

    The quantised probabilities (integers) are written to `state.units`.
    """
    units, enough = state.units, state.counts.sets[ENOUGH]
    for p in range(np.uint64(len(units))):
        units[p] = 0
        for w in range(np.uint64(enough.shape[1])):
            units[p] += sum_weights(ZERO, enough[p, w], field.weights, p, w)


def counts_of(state: Any, axes: int) -> np.ndarray:
    """Number of landmarks covered at each position with each of the first `axes` orientations, `(Q, axes)` int16."""
    digits = unpacked(state.counts.digits.transpose(2, 0, 1), axes)
    counts = np.zeros(digits.shape[1:], dtype=np.int16)
    for digit in digits[::-1]:
        counts = 2 * counts + digit
    return counts


# Rows of `State.hides`, `Scratch.hides` and `Scratch.changes`.
HIDDEN = 0  # number of other landmarks that hide the landmark
HIDING = 1  # number of other landmarks that the landmark hides

# Rows of the arrays in `RigState.groups`, and of `GroupScratch.sets`.
COVERED = 0  # orientations with which a camera covers a landmark, occlusion ignored
OCCLUDED = 1  # orientations among `COVERED` with which another landmark hides the landmark

# Rows of `Scratch.numbers`.
BLOCK_COUNT = 0  # number of `BLOCKS`
SPAN_COUNT = 1  # number of spans in `FIRST` and `LAST`
SURFACE = 2  # surface of the place tried
PAIR_COUNT = 3  # number of `pairs`
TOUCHED_COUNT = 4  # number of positions in `TOUCHED_LIST`

# Rows of `Scratch.flags`.
AIMED = 0  # by block: True within the horizon of the place tried
WANTED = 1  # by block: True if the block is searched for neighbours of the old place
TOUCHED = 2  # by position: True if another landmark appears or disappears, or hides the place tried
REACHED = 3  # by position: True if some orientation covers the place tried, occlusion ignored; not for rigs

# Rows of `Scratch.lists`.
LISTED = 0  # positions to work on
BLOCKS = 1  # blocks of positions within the horizon of the old place or of the place tried
FIRST, LAST = 2, 3  # contiguous spans of positions of these blocks: first position, and one past the last
OTHERS = 4  # landmarks within the horizon of a place
TOUCHED_LIST = 5  # positions that are `TOUCHED`
VISIBLE = 6  # by position: a word with all bits set if the landmark is seen at its old place, else 0; not for rigs
UNSURE, PLACES = 7, 8  # sets of axes to be tested, and position and word of each, p << HALF | w; not for rigs

# Rows of `Scratch.sets`.
FRESH = 0  # orientations among `ASKED` that cover the place tried; for a camera, occlusion is ignored
ASKED = 1  # orientations that are tested

# Rows of `Scratch.pairs`.
LANDMARK, POSITION = (0, 1)  # a landmark, and a position; in `GroupScratch.pairs`, centre c and position q as c Q + q

# Rows of `seen`: the place tried as seen from a position, with the bounds of `criteria.from_position` or `from_around`.
X, Y, Z = 0, 1, 2  # offset of the place from the position, or from the centre, metres
LOW, HIGH = 3, 4  # least and greatest depth at which the place may be covered, metres
SURE = 5  # depth, metres: an axis with the place well in view, at a depth from `LOW` to `SURE`, covers the place


class State(NamedTuple):
    """Coverage of K landmarks by a camera from Q positions, in the order of the field (incremental evaluator).

    An orientation (axis) is one bit of W 64-bit words.
    """

    poses: np.ndarray
    """`(6, K)` positions, metres, and unit normals of the landmarks."""
    surfaces: np.ndarray
    """`(K,)` indices of the surfaces that carry the landmarks."""
    counts: Counts
    """Number of landmarks covered at each position, for each axis."""
    units: np.ndarray
    """`(Q,)` quantised P_n, the probability that n landmarks are covered, at each position."""
    covered: np.ndarray
    """`(K, Q, W)` bit sets of the axes that cover each landmark from each position, occlusion ignored."""
    reachable: np.ndarray
    """`(K, Q)` True if some axis covers the landmark from the position, occlusion ignored."""
    hides: np.ndarray
    """`(2, K, Q)` int16: for each landmark and position, number of landmarks that hide the landmark (row `HIDDEN`), and
    number of landmarks that it hides (row `HIDING`). Only positions at most the horizon away from the landmark have
    these numbers.
    """


class RigState(NamedTuple):
    """Coverage of K landmarks by the cameras of a rig, for each orientation of the rig's body."""

    poses: np.ndarray
    """See `State`."""
    surfaces: np.ndarray
    """See `State`."""
    counts: Counts
    """See `State`."""
    units: np.ndarray
    """See `State`."""
    groups: tuple[np.ndarray, ...]
    """For each group of M mounts, `(2, K, Q, M, W)` sets of orientations. Row `COVERED` has the orientations with which
    each camera covers each landmark, occlusion ignored. Row `OCCLUDED` has the orientations in row `COVERED` with which
    another landmark hides the landmark.
    """
    shown: np.ndarray
    """`(K, Q, W)` orientations of the body with which some camera sees a landmark, occlusion taken into account."""


class Scratch(NamedTuple):
    """Working memory for moves of one landmark seen by a camera, with the results of the move tried last.

    After the move is carried out, the scratch has the data of the reverse move, which undoes it, in `target`,
    `SURFACE`, `units`, `FRESH`, `REACHED`, `hides` and `changes`.
    """

    target: np.ndarray
    """`(6,)` position (metres) and unit normal of the place tried."""
    numbers: np.ndarray
    """`(5,)` int64 numbers: the lengths of those parts of `lists` and `pairs` that are in use, and the index of the
    surface of the place tried (entry `SURFACE`).
    """
    units: np.ndarray
    """`(Q,)` quantised P_n (the probability that n landmarks are covered) with the landmark at the place tried, or
    upper bounds on these values.
    """
    flags: np.ndarray
    """`(4, Q)` bool flags: rows `AIMED` and `WANTED` for each block of positions, rows `TOUCHED` and `REACHED` for each
    position.
    """
    lists: np.ndarray
    """`(9, max(Q W, K) + 1)` uint64: one list in each row, from `LISTED` to `PLACES`, see these constants."""
    offsets: np.ndarray
    """`(4, L)` float32, L > K a multiple of `LANES`: vectors from a place to the landmarks in `OTHERS`, and the lengths
    of the vectors, metres.
    """
    sets: np.ndarray
    """`(2, Q, W)` sets of orientations: those that are tested (row `ASKED`), and those of them that cover the place
    tried (row `FRESH`; for a single camera, occlusion is ignored).
    """
    digits: np.ndarray
    """`(Q, W, J)` binary digits of the numbers of covered landmarks without the moving landmark, at positions marked as
    `TOUCHED`.
    """
    pairs: np.ndarray
    """`(2, K Q)` uint32 pairs of another landmark and a position at which the move changes the landmark's occlusion,
    rows `LANDMARK` and `POSITION`.
    """
    known: np.ndarray
    """`(Q, K)` True if this position and this landmark are one of the `pairs`."""
    changes: np.ndarray
    """`(2, K, Q)` int8: for each of the `pairs`, the change that the move causes in the numbers of `State.hides`."""
    hides: np.ndarray
    """`(2, Q)` int16: for each position, number of landmarks that hide the moving landmark at the place tried (row
    `HIDDEN`), and number of landmarks that it hides there (row `HIDING`).
    """
    seen: np.ndarray
    """`(6, Q)`: for each position, the offset of the place tried from the position, and bounds on the depth of this
    place along the optical axis; rows `X` to `SURE`.
    """
    cell: np.ndarray
    """`(2, Q)` int32: two numbers for each position. The first is the cell of the direction tables that contains the
    direction of the place tried. The second is the row of `POSSIBLE` for this cell (`EMPTY_ROW` if the place is out of
    reach).
    """


class GroupScratch(NamedTuple):
    """Working memory for the equal cameras of a rig (a mount group), with the results of the move tried last."""

    sets: np.ndarray
    """`(2, Q, M, W)` sets of orientations, limited to those in `ASKED`. Row `COVERED` has the orientations with which
    each camera covers the place tried. Row `OCCLUDED` has the orientations in row `COVERED` with which another landmark
    hides the place.
    """
    flipped: np.ndarray
    """`(K, Q, M, W)` orientations that the move adds to or removes from the row `OCCLUDED` of the state, for the pairs
    in `RigScratch`.
    """
    occluders: np.ndarray
    """`(1,)` number of entries of `pairs` that are in use."""
    pairs: np.ndarray
    """`(2, K C Q)` uint32 list of pairs: a landmark that may hide the place tried (row `LANDMARK`), and the point from
    which it may do so (row `POSITION`). This point is given by the number c Q + q, for centre c of the cameras
    (`MountGroup.centres`) with the body at position q.
    """
    seen: np.ndarray
    """`(6, Q)`: the place tried relative to the centre of cameras (`MountGroup.centres`) that was evaluated last. Rows
    `X` to `SURE` are the offset of the place, and bounds on its depth. Column i belongs to the i-th evaluated position.
    """
    lists: np.ndarray
    """`(2, Q + 1)` uint64: a list of rows of the direction tables, and a list of the positions that need the exact
    test.
    """
    reached: np.ndarray
    """`(Q,)` True if some orientation may cover the place tried, as seen from the i-th evaluated position."""


class RigScratch(NamedTuple):
    """Working memory for moves of one landmark seen by a rig, with the results of the move tried last.

    After the move is carried out, `target`, `SURFACE`, `units`, `FRESH` and the `sets` of the groups have the data of
    the landmark's old place.
    """

    target: np.ndarray
    """See `Scratch`."""
    numbers: np.ndarray
    """See `Scratch`."""
    units: np.ndarray
    """See `Scratch`."""
    flags: np.ndarray
    """See `Scratch`."""
    lists: np.ndarray
    """See `Scratch`."""
    offsets: np.ndarray
    """See `Scratch`."""
    sets: np.ndarray
    """See `Scratch`."""
    digits: np.ndarray
    """See `Scratch`."""
    pairs: np.ndarray
    """See `Scratch`."""
    known: np.ndarray
    """See `Scratch`."""
    groups: tuple[GroupScratch, ...]
    """Working memory for each mount group."""


def _shared_fields(state: State | RigState) -> dict[str, Any]:
    """New arrays for the attributes that `Scratch` and `RigScratch` have in common, keyed by the attribute's name."""
    count, (size, words) = len(state.surfaces), state.counts.sets.shape[1:]
    return {
        "target": np.empty(6),
        "numbers": np.zeros(5, dtype=np.int64),
        "units": state.units.copy(),
        "flags": np.zeros((4, size), dtype=np.bool_),
        "lists": np.zeros((PLACES + 1, max(size * words, count) + 1), dtype=np.uint64),
        "offsets": np.zeros((4, (count // LANES + 1) * LANES), dtype=np.float32),
        "sets": np.zeros((2, size, words), dtype=np.uint64),
        "digits": np.empty_like(state.counts.digits),
        "pairs": np.empty((2, count * size), dtype=np.uint32),
        "known": np.zeros((size, count), dtype=np.bool_),
    }


def scratch_of(state: State) -> Scratch:
    """New scratch (working memory) for moves of the landmarks in the state of a camera."""
    count, size, _ = state.covered.shape
    return Scratch(
        **_shared_fields(state),
        changes=np.zeros((2, count, size), dtype=np.int8),
        hides=np.zeros((2, size), dtype=np.int16),
        seen=np.empty((6, size)),
        cell=np.empty((2, size), dtype=np.int32),
    )


def rig_scratch_of(state: RigState, centres: tuple[int, ...]) -> RigScratch:
    """New scratch (working memory) for moves of the landmarks in the state of a rig.

    `centres` has, for each mount group (equal cameras), the number of points around which these cameras lie: the length
    of `MountGroup.centres`.
    """
    count, size = state.shown.shape[:2]
    groups = tuple(
        GroupScratch(
            sets=np.zeros((2, *group.shape[2:]), dtype=np.uint64),
            flipped=np.zeros(group.shape[1:], dtype=np.uint64),
            occluders=np.zeros(1, dtype=np.int64),
            pairs=np.empty((2, count * around * size), dtype=np.uint32),
            seen=np.empty((6, size)),
            lists=np.empty((2, size + 1), dtype=np.uint64),
            reached=np.empty(size, dtype=np.bool_),
        )
        for group, around in zip(state.groups, centres, strict=True)
    )
    return RigScratch(**_shared_fields(state), groups=groups)
