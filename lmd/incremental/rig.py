"""Moves of landmarks before a rig: each camera is elsewhere for every orientation of the body.

Counted are orientations of the body: the sets of all cameras of a landmark become one, `RigState.shown`. With which
orientations another landmark hides one from a camera is a set, too. For blocks of positions the search is that of a
camera; from the centres of the cameras a bound decides (`stations.may_hide_around`); what is left is tested with each
orientation that covers the landmark.
"""

import math
from typing import Any, NamedTuple

import numpy as np
from numba import literal_unroll

from lmd.core.bits import BITS, ZERO, lowest
from lmd.core.compiled import allocating, inlined, inner
from lmd.core.memory import check_views
from lmd.incremental.counts import JUST, SHORT
from lmd.incremental.nearby import pose_of, target_of
from lmd.incremental.occlusion import ARRIVES, COMES, LEAVES, line_radius, note_neighbour, note_pair, search, touch
from lmd.incremental.state import (
    ASKED,
    CAPS,
    FIRST,
    FRESH,
    HIGH,
    LAST,
    LISTED,
    LOW,
    PAIR_COUNT,
    SPAN_COUNT,
    SURE,
    TOUCHED,
    TOUCHED_COUNT,
    TOUCHED_LIST,
    VEILED,
    WHERE,
    WHO,
    RigScratch,
    RigState,
    X,
    Y,
    Z,
    rig_scratch_of,
)
from lmd.incremental.trial import (
    bound_views,
    exchange_sets,
    exchange_views,
    find_pairs,
    forget_views,
    fresh_of,
    list_changing,
    see,
    shown_of,
    turned,
)
from lmd.scene.criteria import frame_of, sized
from lmd.sight.blocks import BLOCK
from lmd.sight.obstacles import find_ends, is_clear, no_ends
from lmd.sight.stations import (
    Part,
    blocked_bits,
    bounds_from,
    covered_bits,
    hidden_bits,
    line_room,
    may_hide_around,
    row_from,
    split,
    with_sight,
)

ROW, LEFT_OVER = 0, 1  # rows of `PartScratch.lists`
# Bytes of a landmark and a centre around a position: an entry of `PartScratch.pairs`.
CENTRE_BYTES = 8
# Bytes of a landmark with a camera and an orientation: bits of caps, of occlusion, and of its changes.
CAMERA_BYTES = 3 / 8


class RigCameras(NamedTuple):
    """The cameras of a rig, around Q positions of its body, with all its orientations."""

    parts: tuple[Part, ...]
    """Cameras that are alike, one part for each kind; place g of position q is q G + g of `Part.obstacles`."""

    @property
    def horizon(self) -> float:
        """Distance from the body's origin beyond which a landmark cannot matter, metres."""
        return max(part.horizon for part in self.parts)

    @property
    def sights(self) -> tuple[Any, ...]:
        """The model of sight of each kind of camera."""
        return tuple(part.sight for part in self.parts)

    def with_sights(self, change: Any) -> "RigCameras":
        """The rig with the models of sight that `change` makes of its own."""
        return RigCameras(tuple(with_sight(part, change(part.sight)) for part in self.parts))

    def state(self, shared: dict[str, Any]) -> RigState:
        """An empty state with the `shared` fields."""
        (size, words), count = shared["counts"].sets.shape[1:], len(shared["surfaces"])
        mounts = [len(part.axes) for part in self.parts]
        centres = sum(len(part.centres) for part in self.parts)
        check_views(CENTRE_BYTES * centres + CAMERA_BYTES * sum(mounts) * BITS * words, size, 1, count)
        return RigState(
            **shared,
            parts=tuple(np.zeros((2, count, size, each, words), dtype=np.uint64) for each in mounts),
            shown=np.zeros((count, size, words), dtype=np.uint64),
        )

    def scratch(self, state: RigState) -> RigScratch:
        """Working memory for moves of a state."""
        return rig_scratch_of(state, tuple(len(part.centres) for part in self.parts))


@shown_of.register(RigState)
def _shown_of(state, k, p, w):  # type: ignore[no-untyped-def]
    return state.shown[k, p, w]


@turned.register(RigState)
def _turned(state, i, q, w, scratch):  # type: ignore[no-untyped-def]
    shown = ZERO
    for j in range(len(state.parts)):
        caps, veiled, flipped = state.parts[j][CAPS], state.parts[j][VEILED], scratch.parts[j].flipped
        for m in range(caps.shape[2]):
            shown |= caps[i, q, m, w] & ~(veiled[i, q, m, w] ^ flipped[i, q, m, w])
    return state.shown[i, q, w], shown


@forget_views.register(RigScratch)
def _forget_views(scratch):  # type: ignore[no-untyped-def]
    who, where = scratch.pairs[WHO], scratch.pairs[WHERE]
    for j in range(len(scratch.parts)):
        part = scratch.parts[j]  # copied: outside of other loops
        flipped = part.flipped
        part.rivals[0] = 0
        for e in range(scratch.numbers[PAIR_COUNT]):
            i, q = who[e], where[e]
            for m in range(flipped.shape[2]):
                for w in range(flipped.shape[3]):
                    flipped[i, q, m, w] = ZERO


@inner
def _hidden_bits(part, m, w, left, i, k, px, py, pz, one, other):  # type: ignore[no-untyped-def]
    """`hidden_bits`, not inlined."""
    return hidden_bits(part, m, w, left, i, k, px, py, pz, one, other)


@inner
def _drop_hidden(part, c, i, k, q, px, py, pz, state, flipped):  # type: ignore[no-untyped-def]
    """Take out of what is `flipped` of landmark i from position q with what another one but k hides it."""
    other, width = pose_of(i, state), line_radius(part.sight)
    x, y, z = (
        other[0] - (px + part.centres[c, 0]), other[1] - (py + part.centres[c, 1]), other[2] - (pz + part.centres[c, 2])
    )  # fmt: skip
    for j in range(np.uint64(len(state.surfaces))):
        one = pose_of(j, state)
        ax, ay, az = x + (one[0] - other[0]), y + (one[1] - other[1]), z + (one[2] - other[2])
        if may_hide_around(ax, ay, az, x, y, z, part.radius[c], width) and j != i and j != k:
            for m in range(part.mounts[c], part.mounts[c + 1]):
                for w in range(np.uint64(flipped.shape[3])):
                    bits = flipped[i, q, m, w]
                    flipped[i, q, m, w] ^= _hidden_bits(part, m, w, bits, j, i, px, py, pz, one, other)


@inlined
def _find_pair(part, c, i, k, q, px, py, pz, place, how, mine, other, state, scratch):  # type: ignore[no-untyped-def]
    """Find what landmark k at a `place` hides of landmark i from position q, and note it down."""
    pose, changed, caps, veiled = pose_of(i, state), False, mine[CAPS], mine[VEILED]
    for m in range(part.mounts[c], part.mounts[c + 1]):
        for w in range(np.uint64(caps.shape[3])):
            # Little more is read than is needed: these sets are too many for the cache.
            bits = caps[i, q, m, w] if how == COMES else veiled[i, q, m, w]
            found = _hidden_bits(part, m, w, bits, k, i, px, py, pz, place, pose) if bits else ZERO
            if found == ZERO:
                continue
            was = flips = other.flipped[i, q, m, w]
            flips = found if how == LEAVES else (flips & ~found) | (found & ~veiled[i, q, m, w])
            changed |= flips != was
            other.flipped[i, q, m, w] = flips
    if changed and how == LEAVES:
        _drop_hidden(part, c, i, k, q, px, py, pz, state, other.flipped)
    if changed:
        touch(q, scratch)
        note_pair(i, q, scratch)


@note_neighbour.register(Part)
def _note_neighbour(part, c, b, i, k, how, place, mine, other, field, state, scratch):  # type: ignore[no-untyped-def]
    body, boxes, size, radius = field.positions, field.boxes, len(scratch.units), part.radius[c]
    cx, cy, cz = part.centres[c, 0], part.centres[c, 1], part.centres[c, 2]
    hx, hy, hz = (
        np.float32(boxes[3, b] + radius), np.float32(boxes[4, b] + radius), np.float32(boxes[5, b] + radius)
    )  # fmt: skip
    ax, ay, az, width = place[0], place[1], place[2], line_radius(part.sight)
    mx, my, mz = ax - boxes[0, b] - cx, ay - boxes[1, b] - cy, az - boxes[2, b] - cz
    ex, ey, ez, lanes = state.poses[0, i] - ax, state.poses[1, i] - ay, state.poses[2, i] - az, np.uint32(0)
    vx, vy, vz, apart = mx + ex, my + ey, mz + ez, math.sqrt(ex * ex + ey * ey + ez * ez)
    far = math.sqrt(max(mx * mx + my * my + mz * mz, vx * vx + vy * vy + vz * vz))
    most = line_room(far + math.sqrt(hx * hx + hy * hy + hz * hz), apart, radius, width)
    for lane in range(np.uint64(BLOCK)):
        q = b * np.uint64(BLOCK) + lane
        ux, uy, uz = ax - (body[0, q] + cx), ay - (body[1, q] + cy), az - (body[2, q] + cz)
        sx, sy, sz = uy * ez - uz * ey, uz * ex - ux * ez, ux * ey - uy * ex
        lanes |= np.uint32(sx * sx + sy * sy + sz * sz <= most) << np.uint32(lane)
    while lanes:
        q = b * np.uint64(BLOCK) + lowest(np.uint64(lanes))
        lanes &= lanes - np.uint32(1)
        if how != ARRIVES:
            _find_pair(part, c, i, k, q, body[0, q], body[1, q], body[2, q], place, how, mine, other, state, scratch)
        if how != LEAVES:
            other.pairs[WHO, other.rivals[0]], other.pairs[WHERE, other.rivals[0]] = i, np.uint64(c * size) + q
            other.rivals[0] += 1


@inner
def _find_veils(k, part, field, state, scratch):  # type: ignore[no-untyped-def]
    """Find in `VEILED` with which of the orientations of `CAPS` that are `ASKED` others hide the place tried."""
    other, size, body = scratch.parts[part.number], np.uint64(len(scratch.units)), field.positions
    place, asked, cap, veil = target_of(scratch), scratch.sets[ASKED], other.sets[CAPS], other.sets[VEILED]
    who, where = other.pairs[WHO], other.pairs[WHERE]
    for e in range(other.rivals[0]):
        i, c, q = np.uint64(who[e]), where[e] // size, where[e] % size
        for m in range(part.mounts[c], part.mounts[c + np.uint64(1)]):
            for w in range(np.uint64(cap.shape[2])):
                bits = cap[q, m, w] & asked[q, w] & ~veil[q, m, w]
                if bits:
                    px, py, pz = body[0, q], body[1, q], body[2, q]
                    found = _hidden_bits(part, m, w, bits, i, k, px, py, pz, pose_of(i, state), place)
                    if found:
                        veil[q, m, w] |= found
                        touch(q, scratch)


@inner
def _find_pairs_of(parts, k, how, field, state, scratch):  # type: ignore[no-untyped-def]
    """Find the pairs for all parts."""
    for part in literal_unroll(parts):
        if part.sight.reach >= 0.0:
            search(part, k, how, state.parts[part.number], scratch.parts[part.number], field, state, scratch)
            if how == COMES:
                _find_veils(k, part, field, state, scratch)


@find_pairs.register(RigState)
def _find_pairs(state, k, how, field, scratch):  # type: ignore[no-untyped-def]
    _find_pairs_of(field.cameras.parts, k, how, field, state, scratch)


@allocating
def _find_caps(k, part, positions, body, scratch, rig):  # type: ignore[no-untyped-def]
    """Find in `CAPS` with which orientations of those `ASKED` cameras cover the place tried; add them to `FRESH`.

    Clears `VEILED`.

    Args:
        k: landmark.
        part: cameras.
        positions: positions to look from.
        body: all positions of the body, `(3, Q)`, metres.
        scratch, rig: working memory of the part, and of the rig.
    """
    obstacles, asked, fresh = part.obstacles, rig.sets[ASKED], rig.sets[FRESH]
    cap, veil, seen = scratch.sets[CAPS], scratch.sets[VEILED], scratch.seen
    x, y, z, most, start, sure = seen[X], seen[Y], seen[Z], seen[HIGH], seen[LOW], seen[SURE]
    row, left_over, reached = scratch.lists[ROW], scratch.lists[LEFT_OVER], scratch.reached
    words, half = np.uint64(asked.shape[1]), np.uint64(part.tables.shape[1] // 2)
    tx, ty, tz, nx, ny, nz = target_of(rig)
    sight = sized(part.sight, k)
    clear, frame, ends = is_clear(obstacles), frame_of(sight, nx, ny, nz), no_ends(obstacles, 1)
    if not clear:
        find_ends(obstacles, sight, tx, ty, tz, nx, ny, nz, ends, 0)
    for q in positions:
        for m in range(cap.shape[1]):
            for w in range(words):
                cap[q, m, w] = veil[q, m, w] = ZERO
    for c in range(len(part.centres)):
        cx, cy, cz, count, kept = part.centres[c, 0], part.centres[c, 1], part.centres[c, 2], ZERO, ZERO
        for i in range(np.uint64(len(positions))):
            q = positions[i]
            xq, yq, zq = tx - (body[0, q] + cx), ty - (body[1, q] + cy), tz - (body[2, q] + cz)
            x[i], y[i], z[i] = xq, yq, zq
            reached[i], most[i], start[i], sure[i] = bounds_from(part, c, k, xq, yq, zq, nx, ny, nz)
        for i in range(np.uint64(len(positions))):
            left_over[count] = i
            count += np.uint64(reached[i])
        for i in left_over[:count]:
            row[i] = row_from(part, c, x[i], y[i], z[i])
        for i in left_over[:count]:
            q, some = positions[i], ZERO
            for m in range(part.mounts[c], part.mounts[c + 1]):
                for w in range(words):
                    left = part.tables[row[i], half + np.uint64(m) * words + w] & asked[q, w]
                    cap[q, m, w] = left
                    some |= left
            left_over[kept] = i
            kept += np.uint64(some != ZERO)
        for i in left_over[:kept]:
            q = positions[i]
            px, py, pz, bounds = body[0, q], body[1, q], body[2, q], (most[i], start[i], sure[i])
            for m in range(part.mounts[c], part.mounts[c + 1]):
                for w in range(words):
                    if cap[q, m, w] == ZERO:
                        continue
                    found, left = split(part, m, w, cap[q, m, w], words, x[i], y[i], z[i], *bounds, row[i])
                    found |= covered_bits(part, m, w, left, k, px, py, pz, tx, ty, tz, nx, ny, nz, frame)
                    if not clear:
                        found &= ~blocked_bits(part, m, w, found, k, q, ends, 0)
                    cap[q, m, w] = found
                    fresh[q, w] |= found


@inner
def _join(positions, scratch):  # type: ignore[no-untyped-def]
    """Find in `FRESH` what all cameras see of the place tried at `positions`, where others may be in the way."""
    fresh = scratch.sets[FRESH]
    for q in positions:
        for w in range(np.uint64(fresh.shape[1])):
            fresh[q, w] = ZERO
    for j in range(len(scratch.parts)):
        sets = scratch.parts[j].sets
        cap, veil = sets[CAPS], sets[VEILED]
        for q in positions:
            for m in range(cap.shape[1]):
                for w in range(np.uint64(fresh.shape[1])):
                    fresh[q, w] |= cap[q, m, w] & ~veil[q, m, w]


@inner
def _see_with(parts, k, positions, field, state, scratch):  # type: ignore[no-untyped-def]
    """Find what all parts see."""
    fresh = scratch.sets[FRESH]
    for q in positions:
        for w in range(np.uint64(fresh.shape[1])):
            fresh[q, w] = ZERO
    for part in literal_unroll(parts):
        _find_caps(k, part, positions, field.positions, scratch.parts[part.number], scratch)
        _find_veils(k, part, field, state, scratch)
    _join(scratch.lists[TOUCHED_LIST][: scratch.numbers[TOUCHED_COUNT]], scratch)


@see.register(RigState)
def _see(state, k, positions, field, scratch):  # type: ignore[no-untyped-def]
    _see_with(field.cameras.parts, k, positions, field, state, scratch)


@inner
def list_near(scratch, all_of_them):  # type: ignore[no-untyped-def]
    """List in `LISTED` the positions near the place left and the place tried, all or those asked or touched."""
    listed, first, last, count = scratch.lists[LISTED], scratch.lists[FIRST], scratch.lists[LAST], ZERO
    asked, touched = scratch.sets[ASKED], scratch.flags[TOUCHED]
    for s in range(scratch.numbers[SPAN_COUNT]):
        for q in range(first[s], last[s]):
            some = ZERO
            for w in range(np.uint64(asked.shape[1])):
                some |= asked[q, w]
            listed[count] = q
            count += np.uint64(all_of_them | (some != ZERO) | touched[q])
    return count


@bound_views.register(RigState)
def _bound_views(state, k, field, scratch):  # type: ignore[no-untyped-def]
    shown, asked, short, just = state.shown, scratch.sets[ASKED], state.counts.sets[SHORT], state.counts.sets[JUST]
    first, last, touched = scratch.lists[FIRST], scratch.lists[LAST], scratch.flags[TOUCHED]
    for s in range(scratch.numbers[SPAN_COUNT]):
        for q in range(first[s], last[s]):
            for w in range(np.uint64(0 if touched[q] else asked.shape[1])):
                mine = shown[k, q, w]
                asked[q, w] = (short[q, w] & ~mine) | (just[q, w] & mine)
    return list_near(scratch, False)


@list_changing.register(RigState)
def _list_changing(state, k, scratch):  # type: ignore[no-untyped-def]
    return list_near(scratch, True)


@fresh_of.register(RigScratch)
def _fresh_of(scratch, p, w):  # type: ignore[no-untyped-def]
    return scratch.sets[FRESH, p, w]


@exchange_sets.register(RigState)
def _exchange_sets(state, k, p, w, scratch):  # type: ignore[no-untyped-def]
    was, now = state.shown[k, p, w], scratch.sets[FRESH, p, w]
    state.shown[k, p, w], scratch.sets[FRESH, p, w] = now, was
    return was, now


@inner
def _exchange_part(k, positions, mine, other):  # type: ignore[no-untyped-def]
    """Exchange what a part has of landmark k, `mine`, at `positions` for what its scratch has, the `other`."""
    caps, veiled, cap, veil = mine[CAPS], mine[VEILED], other[CAPS], other[VEILED]
    for q in positions:
        for m in range(caps.shape[2]):
            for w in range(caps.shape[3]):
                caps[k, q, m, w], cap[q, m, w] = cap[q, m, w], caps[k, q, m, w]
                veiled[k, q, m, w], veil[q, m, w] = veil[q, m, w], veiled[k, q, m, w]


@exchange_views.register(RigState)
def _exchange_views(state, k, scratch):  # type: ignore[no-untyped-def]
    positions = scratch.lists[LISTED][: list_near(scratch, True)]
    for j in range(len(state.parts)):
        _exchange_part(k, positions, state.parts[j], scratch.parts[j].sets)  # copied: outside of other loops
    for e in range(scratch.numbers[PAIR_COUNT]):
        i, q = np.uint64(scratch.pairs[WHO, e]), np.uint64(scratch.pairs[WHERE, e])
        for w in range(np.uint64(state.shown.shape[2])):
            _, state.shown[i, q, w] = turned(state, i, q, w, scratch)
            for j in range(len(state.parts)):
                veiled, flipped = state.parts[j][VEILED], scratch.parts[j].flipped
                for m in range(veiled.shape[2]):
                    veiled[i, q, m, w] ^= flipped[i, q, m, w]
