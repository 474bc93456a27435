"""What the moves of single landmarks work on where a rig looks for them: see `lmd.sight.stations` and `state`."""

from typing import Any, NamedTuple

import numpy as np

from lmd.core.bits import LANES
from lmd.sight.blocks import BLOCK
from lmd.sight.stations import Part


class Stations(NamedTuple):
    """The cameras of a rig that are alike, around Q positions of its body."""

    number: int
    """Which part of the rig they are."""
    part: Part
    """The part."""
    obstacles: Any
    """What of the room stands in the way of their places, place g of position q at q G + g; see `obstacles`."""


class StationState(NamedTuple):
    """What the M cameras of a part have in view of K landmarks."""

    caps: np.ndarray
    """`(K, Q, M, W)` the orientations with which a camera covers a landmark nobody hides."""
    veiled: np.ndarray
    """`(K, Q, M, W)` those of them with which another landmark hides it."""


class RigState(NamedTuple):
    """Coverage of one deployment.

    landmarks, normals `(3, K)`; surfaces `(K,)`; parts; shown `(K, Q, W)` the orientations with which some camera sees
    a landmark; counts, short, just, units: as in `State`.
    """

    landmarks: np.ndarray
    normals: np.ndarray
    surfaces: np.ndarray
    parts: tuple[StationState, ...]
    shown: np.ndarray
    counts: np.ndarray
    short: np.ndarray
    just: np.ndarray
    units: np.ndarray


class StationScratch(NamedTuple):
    """The move tried last as one part sees it.

    cap, veil `(Q, M, W)` what caps and veiled would be of the landmark, of orientations that were asked for; flipped
    `(K, Q, M, W)` what changes in veiled of the others, of the pairs listed in `RigScratch`; rivals `(1,)` how many
    pairs there are of another landmark and a centre around a position, c Q + q, from where it may hide the place tried;
    who, where `(K C Q,)` the pairs. Working memory, `(Q,)` each, of the positions looked at last: what
    `stations.bounds_from` and `row_from` say, and the offset.
    """

    cap: np.ndarray
    veil: np.ndarray
    flipped: np.ndarray
    rivals: np.ndarray
    who: np.ndarray
    where: np.ndarray
    x: np.ndarray
    y: np.ndarray
    z: np.ndarray
    most: np.ndarray
    start: np.ndarray
    sure: np.ndarray
    row: np.ndarray
    reached: np.ndarray


class RigScratch(NamedTuple):
    """The move tried last; target, surface, units, and what `nearby` and `hiding` work on, as in `Scratch`.

    fresh `(Q, W)` the orientations with which some camera would see the landmark, as far as they are `asked` `(Q, W)`;
    found `(2,)` how many pairs of another landmark and a position there are where it appears or disappears, and how
    many positions where that, or a rival, is; who, where `(K Q,)` the pairs, known `(K, Q)` whether one is among them;
    places `(Q,)` the positions, touched `(Q,)` whether one is among them; digits `(Q, W, J)` the counts there. Once the
    move is carried out, target, surface, units, fresh, cap and veil are those of the place left.
    """

    target: np.ndarray
    surface: np.ndarray
    units: np.ndarray
    parts: tuple[StationScratch, ...]
    fresh: np.ndarray
    asked: np.ndarray
    found: np.ndarray
    who: np.ndarray
    where: np.ndarray
    known: np.ndarray
    places: np.ndarray
    touched: np.ndarray
    digits: np.ndarray
    aimed: np.ndarray
    blocks: np.ndarray
    spans: np.ndarray
    near: np.ndarray
    wanted: np.ndarray
    others: np.ndarray
    ways: np.ndarray
    listed: np.ndarray


def rig_scratch_of(state: RigState, centres: tuple[int, ...]) -> RigScratch:
    """Working memory for moves of `state`, of parts with so many centres."""
    count, size = state.shown.shape[:2]
    blocks, parts = size // BLOCK, []
    for part, around in zip(state.parts, centres, strict=True):
        cap, veil = np.zeros((2, *part.caps.shape[1:]), dtype=np.uint64)
        who, where = np.empty((2, count * around * size), dtype=np.uint32)
        rivals, row, reached = np.zeros(1, np.int64), np.empty(size, np.uint64), np.empty(size, np.bool_)
        seen = (*np.empty((6, size)), row, reached)
        parts.append(StationScratch(cap, veil, np.zeros_like(part.caps), rivals, who, where, *seen))
    fresh, asked = np.zeros((2, *state.shown.shape[1:]), dtype=np.uint64)
    who, where = np.empty((2, count * size), dtype=np.uint32)
    return RigScratch(
        target=np.empty(6),
        surface=np.empty(1, dtype=np.int64),
        units=state.units.copy(),
        parts=tuple(parts),
        fresh=fresh,
        asked=asked,
        found=np.zeros(2, dtype=np.int64),
        who=who,
        where=where,
        known=np.zeros((count, size), dtype=np.bool_),
        places=np.empty(size, dtype=np.uint64),
        touched=np.zeros(size, dtype=np.bool_),
        digits=np.empty_like(state.counts),
        aimed=np.empty(blocks, dtype=np.bool_),
        blocks=np.empty(blocks + 1, dtype=np.uint64),
        spans=np.empty((blocks, 2), dtype=np.uint64),
        near=np.zeros(2, dtype=np.int64),
        wanted=np.empty(blocks, dtype=np.bool_),
        others=np.empty(count + 1, dtype=np.uint64),
        ways=np.zeros((4, (count // LANES + 1) * LANES), dtype=np.float32),
        listed=np.empty(size + 1, dtype=np.uint64),
    )
