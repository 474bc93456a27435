"""Moving one landmark at a time: exact counts and probabilities, updated instead of recomputed.

A moved landmark changes the counts at a position in at most four ways: its old cap goes, caps it used to hide come
back, caps it now hides go, its new cap comes. Everything else at that position, and every position where none of
the four happens, stays as it is. The decisions are those of `kernels`, operation by operation, so after any sequence
of moves the counts equal a full evaluation's, bit for bit.

A *trial* works on a copy of the counts of one position at a time and changes nothing; *commit* repeats an accepted
move on the state itself. Both run the same code, in three passes:

1. `_caps`: the old and the new cap at all positions, without a branch, so that the loop vectorises.
2. `_neighbours`: who hides whom. Positions come in blocks of neighbours. Seen from a whole block, most landmarks are
   so far off the direction of the moved one that no position of the block needs the exact test: nine in ten in the
   paper's room.
3. `move`: the caps that come and go, axis by axis, in the bands that can hold them.
"""

import math

import numpy as np
from numba import njit

from lmd.coverage.kernels import BLOCK, OCCLUSION_CODES, cap_of, evaluate_range
from lmd.coverage.state import Fixed, State, scratch_of
from lmd.deployment import Deployment
from lmd.visibility import TOLERANCE

_LINE_OF_SIGHT = OCCLUSION_CODES["line_of_sight"]


@njit(nogil=True, cache=True, error_model="numpy")
def _caps(ax, ay, az, nx, ny, nz, positions, limits, caps):
    """Fill `caps` for a landmark at (ax, ay, az) with normal (nx, ny, nz)."""
    x, y, z, low, bottom, top, reached = caps
    min_cosine, min_depth, max_depth = limits[0], limits[1], limits[2]
    for p in range(positions.shape[1]):
        x[p], y[p], z[p] = ax - positions[0, p], ay - positions[1, p], az - positions[2, p]
        reached[p], low[p], bottom[p], top[p] = cap_of(
            x[p], y[p], z[p], nx, ny, nz, 0.0, min_cosine, min_depth, max_depth
        )


@njit(nogil=True, cache=True, error_model="numpy")
def _neighbours(k, ax, ay, az, caps, fixed, landmarks, wanted, apart, flags, neighbours):
    """Find which landmarks but k a landmark at (ax, ay, az) hides, and which hide it, in the `wanted` blocks.

    A landmark o hides a if |a x o| <= nu |a|, and is hidden if |a x o| <= nu |o| (offsets from the position). From a
    position delta away from the centre of the block, |delta| <= r, offsets are a - delta and o - delta. Their cross
    product, a x o - (a - o) x delta, is shorter by at most r |a - o|, and both are at most |a| + |a - o| + r long. So
    |a x o| > r |a - o| + nu (|a| + |a - o| + r), seen from the centre, settles the whole block.
    """
    positions, centres, radii, reach, mode = fixed.positions, fixed.centres, fixed.radii, fixed.reach, fixed.mode
    x, y, z = caps.x, caps.y, caps.z
    found, who, hides, hidden_by, count_hides, count_hidden = neighbours
    nu = math.sqrt(reach) + TOLERANCE  # the tolerance covers the rounding of what follows
    for i in range(landmarks.shape[1]):
        dx, dy, dz = landmarks[0, i] - ax, landmarks[1, i] - ay, landmarks[2, i] - az
        apart[i] = math.sqrt(dx * dx + dy * dy + dz * dz)
    for b in range(len(radii)):
        found[b] = 0
        if not wanted[b]:
            continue
        first = b * BLOCK
        px, py, pz, radius = centres[0, b], centres[1, b], centres[2, b], radii[b]
        mx, my, mz = ax - px, ay - py, az - pz
        shift = nu * (math.sqrt(mx * mx + my * my + mz * mz) + radius)
        for i in range(landmarks.shape[1]):
            ox, oy, oz = landmarks[0, i] - px, landmarks[1, i] - py, landmarks[2, i] - pz
            cx = my * oz - mz * oy
            cy = mz * ox - mx * oz
            cz = mx * oy - my * ox
            bound = (radius + nu) * apart[i] + shift
            flags[i] = cx * cx + cy * cy + cz * cz <= bound * bound
        flags[k] = False
        count = 0
        for i in range(landmarks.shape[1]):
            who[b, count] = i
            count += flags[i]
        found[b] = count
        for q in range(first, first + BLOCK):
            count_hides[q] = count_hidden[q] = 0
        for m in range(count):
            lx, ly, lz = landmarks[0, who[b, m]], landmarks[1, who[b, m]], landmarks[2, who[b, m]]
            for q in range(np.uint64(BLOCK)):
                p = np.uint64(first) + q
                ox, oy, oz = lx - positions[0, p], ly - positions[1, p], lz - positions[2, p]
                squared = x[p] * x[p] + y[p] * y[p] + z[p] * z[p]
                other = ox * ox + oy * oy + oz * oz
                cx = oy * z[p] - oz * y[p]
                cy = oz * x[p] - ox * z[p]
                cz = ox * y[p] - oy * x[p]
                cross = cx * cx + cy * cy + cz * cz
                one, two = cross <= reach * other, cross <= reach * squared
                if mode == _LINE_OF_SIGHT:
                    in_front = x[p] * ox + y[p] * oy + z[p] * oz > 0.0
                    one = one & in_front & (squared <= other * (1.0 + TOLERANCE))
                    two = two & in_front & (other <= squared * (1.0 + TOLERANCE))
                hides[b, m, q], hidden_by[b, m, q] = one, two
                count_hides[p] += one
                count_hidden[p] += two


@njit(nogil=True, cache=True, error_model="numpy")
def move(k, ax, ay, az, nx, ny, nz, fixed, state, scratch, units, commit):
    """Write P_n in units with landmark k at (ax, ay, az) and normal (nx, ny, nz) into `units` `(Q,)`.

    A trial leaves `state` as it is; with `commit` the landmark really moves.
    """
    # Unpacked once, and the loop body not split into functions: passing an array on costs an atomic reference count.
    axes, bands, weights, n, max_depth = fixed.axes, fixed.bands, fixed.weights, fixed.n, fixed.limits[2]
    landmarks, normals, counts, reachable, hidden, hiding, before = state
    row, difference, wanted = scratch.counts, scratch.difference, scratch.wanted
    caps, ranges, signs = scratch.caps, scratch.ranges, scratch.signs
    old_x, old_y, old_z, old_low, old_bottom, old_top, _ = scratch.old
    new_x, new_y, new_z, new_low, new_bottom, new_top, reached = scratch.new
    known, known_who, known_hides, known_hidden_by, _, known_hidden = scratch.before
    found, who, hides, hidden_by, count_hides, count_hidden = scratch.after
    x, y, z = landmarks[0, k], landmarks[1, k], landmarks[2, k]
    _caps(x, y, z, normals[0, k], normals[1, k], normals[2, k], fixed.positions, fixed.limits, scratch.old)
    _caps(ax, ay, az, nx, ny, nz, fixed.positions, fixed.limits, scratch.new)
    if fixed.mode:
        # Most landmarks hide nothing and are hidden by nothing: then there is nothing to find out again.
        for b in range(len(wanted)):
            some = np.int64(0)
            for q in range(b * BLOCK, (b + 1) * BLOCK):
                some += hiding[k, q] + (hidden[k, q] if commit else 0)
            wanted[b] = some > 0
        _neighbours(k, x, y, z, scratch.old, fixed, landmarks, wanted, scratch.apart, scratch.flags, scratch.before)
        wanted[:] = True
        _neighbours(k, ax, ay, az, scratch.new, fixed, landmarks, wanted, scratch.apart, scratch.flags, scratch.after)
    for p in range(len(units)):
        b, q = p // BLOCK, p % BLOCK
        count = 0
        blocked = count_hidden[p]
        comes = reached[p] and blocked == 0
        if reachable[k, p] and hidden[k, p] == 0:
            caps[0, 0], caps[0, 1], caps[0, 2], caps[0, 3] = old_x[p], old_y[p], old_z[p], old_low[p]
            ranges[0, 0], ranges[0, 1] = bands[old_bottom[p]] & -BLOCK, (bands[old_top[p]] + BLOCK - 1) & -BLOCK
            signs[0] = -1
            count = 1
        if hiding[k, p] > 0 or count_hides[p] > 0:
            for m in range(found[b]):
                difference[who[b, m]] += hides[b, m, q]
            for m in range(known[b]):
                difference[known_who[b, m]] -= known_hides[b, m, q]
            for m in range(found[b] + known[b]):
                i = who[b, m] if m < found[b] else known_who[b, m - found[b]]
                if difference[i] == 0:
                    continue
                was = hidden[i, p]
                now = was + difference[i]
                difference[i] = 0
                if reachable[i, p] and (was == 0 or now == 0):
                    ox = landmarks[0, i] - fixed.positions[0, p]
                    oy = landmarks[1, i] - fixed.positions[1, p]
                    oz = landmarks[2, i] - fixed.positions[2, p]
                    _, low, bottom, top = cap_of(
                        ox, oy, oz, 0.0, 0.0, 0.0, 0.0, fixed.limits[0], fixed.limits[1], max_depth
                    )
                    caps[count, 0], caps[count, 1], caps[count, 2], caps[count, 3] = ox, oy, oz, low
                    ranges[count, 0], ranges[count, 1] = bands[bottom] & -BLOCK, (bands[top] + BLOCK - 1) & -BLOCK
                    signs[count] = 1 if now == 0 else -1
                    count += 1
                if commit:
                    hidden[i, p] = now
        if comes:
            caps[count, 0], caps[count, 1], caps[count, 2], caps[count, 3] = new_x[p], new_y[p], new_z[p], new_low[p]
            ranges[count, 0], ranges[count, 1] = bands[new_bottom[p]] & -BLOCK, (bands[new_top[p]] + BLOCK - 1) & -BLOCK
            signs[count] = 1
            count += 1
        change = np.int64(0)
        if count:
            first, last = ranges[0, 0], ranges[0, 1]
            for j in range(1, count):
                first, last = min(first, ranges[j, 0]), max(last, ranges[j, 1])
            for a in range(np.uint64(first), np.uint64(last)):  # a slice assignment would take ten times as long
                row[a] = counts[p, a]
            for j in range(count):
                ox, oy, oz, low = caps[j, 0], caps[j, 1], caps[j, 2], caps[j, 3]
                sign = signs[j]
                crossing = np.int16(n - 1 if sign > 0 else n)
                gain = np.int64(0)
                for a in range(np.uint64(ranges[j, 0]), np.uint64(ranges[j, 1])):
                    depth = axes[0, a] * ox + axes[1, a] * oy + axes[2, a] * oz
                    inside = (depth >= low) & (depth <= max_depth)
                    covered = row[a]
                    gain += weights[a] if inside & (covered == crossing) else 0
                    row[a] = np.int16(covered + sign) if inside else covered
                change += sign * gain
            if commit:
                for a in range(np.uint64(first), np.uint64(last)):
                    counts[p, a] = row[a]
        units[p] = before[p] + change
        if commit:
            before[p] = units[p]
            hidden[k, p], reachable[k, p] = blocked, reached[p]
            if fixed.mode:
                # Nearly always nothing hid it and nothing does.
                if known[b] > 0 and known_hidden[p] > 0:
                    for m in range(known[b]):
                        hiding[known_who[b, m], p] -= known_hidden_by[b, m, q]
                if blocked > 0:
                    for m in range(found[b]):
                        hiding[who[b, m], p] += hidden_by[b, m, q]
                hiding[k, p] = count_hides[p]
    if commit:
        landmarks[0, k], landmarks[1, k], landmarks[2, k] = ax, ay, az
        normals[0, k], normals[1, k], normals[2, k] = nx, ny, nz


@njit(nogil=True, cache=True)
def _fill(fixed, state, scratch):
    """Compute `reachable`, `hidden` and `hiding` of `state` from its landmarks."""
    landmarks, normals, new, after = state.landmarks, state.normals, scratch.new, scratch.after
    scratch.wanted[:] = True
    for k in range(landmarks.shape[1]):
        x, y, z = landmarks[0, k], landmarks[1, k], landmarks[2, k]
        _caps(x, y, z, normals[0, k], normals[1, k], normals[2, k], fixed.positions, fixed.limits, new)
        state.reachable[k] = new.reached
        if fixed.mode:
            _neighbours(k, x, y, z, new, fixed, landmarks, scratch.wanted, scratch.apart, scratch.flags, after)
            state.hiding[k], state.hidden[k] = after.count_hides, after.count_hidden


def state_of(fixed: Fixed, deployment: Deployment) -> State:
    """The coverage of `deployment`, ready for moves."""
    positions, count, axes = fixed.positions.shape[1], len(deployment), fixed.axes.shape[1]
    state = State(
        landmarks=deployment.positions.T.copy(order="C"),
        normals=deployment.normals.T.copy(order="C"),
        counts=np.zeros((positions, axes), dtype=np.int16),
        reachable=np.zeros((count, positions), dtype=np.bool_),
        hidden=np.zeros((count, positions), dtype=np.int16),
        hiding=np.zeros((count, positions), dtype=np.int16),
        units=np.zeros(positions, dtype=np.int64),
    )
    evaluate_range(0, positions, np.ascontiguousarray(fixed.positions.T), state.landmarks[None], state.normals[None],
                   *fixed[4:], state.units[None], state.counts[None], True)  # fmt: skip
    _fill(fixed, state, scratch_of(state))
    return state
