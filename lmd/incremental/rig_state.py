"""What the moves of single landmarks work on where a rig looks for them: see `lmd.sight.stations` and `state`."""

from typing import Any, NamedTuple

import numpy as np

from lmd.incremental.state import Neighbours, Sighting, Turns, surroundings


class Stations(NamedTuple):
    """The stations of the cameras of a rig that are alike, around Q positions of its body.

    number of the part; positions `(3, S)` with S = G Q, station g of position q at g Q + q; centres, halves, horizon,
    sight, obstacles: as in `lmd.incremental.coverage_field.CoverageField`; the rest as in `lmd.sight.stations.Part`.
    """

    number: int
    positions: np.ndarray
    centres: np.ndarray
    halves: np.ndarray
    horizon: float
    sight: Any
    obstacles: Any
    mount: np.ndarray
    members: np.ndarray
    alone: np.ndarray
    axes: np.ndarray
    certain: np.ndarray
    possible: np.ndarray


class StationState(NamedTuple):
    """What the M cameras of a part have in view of K landmarks.

    landmarks, normals `(3, K)` those of the `RigState`; caps `(M, K, Q, W)` the orientations with which a camera covers
    a landmark nobody hides; veiled `(M, K, Q, W)` those of its stations from where another hides it;
    reachable, hidden, hiding `(K, S)` as in `State`, reachable where there is a cap.
    """

    landmarks: np.ndarray
    normals: np.ndarray
    caps: np.ndarray
    veiled: np.ndarray
    reachable: np.ndarray
    hidden: np.ndarray
    hiding: np.ndarray


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
    """The move tried last as one part sees it; fields that are not here as in `Scratch`.

    new: reached `(S,)` from which stations there is a cap; its other fields `(Q,)`, and may `(Q,)` whether a cap is
    possible, of the station looked at last; cap, veil `(M, Q, W)` what caps and veiled would be of the landmark;
    flipped `(M, K, Q, W)` what changes in veiled of the others, of the pairs listed in `RigScratch`.
    """

    target: np.ndarray
    new: Sighting
    before: Neighbours
    after: Neighbours
    turns: Turns
    flips: np.ndarray
    aimed: np.ndarray
    blocks: np.ndarray
    spans: np.ndarray
    near: np.ndarray
    wanted: np.ndarray
    others: np.ndarray
    ways: np.ndarray
    slot: np.ndarray
    listed: np.ndarray
    may: np.ndarray
    cap: np.ndarray
    veil: np.ndarray
    flipped: np.ndarray


class RigScratch(NamedTuple):
    """The move tried last: target `(6,)`, surface `(1,)` and units `(Q,)` as in `Scratch`; parts.

    fresh `(Q, W)` the orientations with which some camera would see the landmark, as far as they are `asked` `(Q, W)`;
    found `(2,)` how many pairs of another landmark and a position there are where it appears or disappears, and how
    many of these positions; who, where `(K Q,)` the pairs, known `(K, Q)` whether one is among them; places `(Q,)` the
    positions, touched `(Q,)` whether one is among them; digits `(Q, W, J)` the counts there. Once the move is carried
    out, target, surface, units, fresh, cap and veil are those of the place left.
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


def rig_scratch_of(state: RigState) -> RigScratch:
    """Working memory for moves of `state`."""
    count, size = state.shown.shape[:2]
    target = np.empty(6)
    parts = []
    for part in state.parts:
        around = surroundings(*part.reachable.shape)
        x, y, z, low, high, sure = np.empty((6, size))
        around["new"] = Sighting(x, y, z, low, high, sure, np.empty(0, dtype=np.int32), around["new"].reached)
        around["may"] = np.empty(size, dtype=np.bool_)
        cap, veil = np.zeros((2, *part.caps[:, 0].shape), dtype=np.uint64)
        parts.append(StationScratch(**around, target=target, cap=cap, veil=veil, flipped=np.zeros_like(part.caps)))
    fresh, asked = np.zeros((2, *state.shown.shape[1:]), dtype=np.uint64)
    who, where = np.empty((2, count * size), dtype=np.uint32)
    return RigScratch(
        target=target,
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
    )
