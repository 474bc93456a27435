"""Trying to move one landmark: L at every position if it stood elsewhere, first bounded, then exact.

What covers what, and who hides whom, is the field of coverage's. To it come the sums of the numbers of every view
(`information`, `ambiguity`), exact in any order, and which views are localised. A landmark that comes or goes changes
the sums of the views in its cap. Few of these have to be decided anew, as more information never makes a view worse:

- where the landmark only goes, those that are localised and still cover enough;
- where it only comes, those that are not and cover enough by then;
- where it both goes and comes, all that cover enough.

`bound_move` leaves out what the new place hides and what hides it, which only takes information away. `finish_move`
decides anew at the positions where either happens.
"""

import numpy as np

from lmd.core.bits import ALL, BITS, ONE, ZERO, add_set, at_least, lowest, prefetch
from lmd.core.compiled import inlined, inner
from lmd.incremental.hiding import flips_with
from lmd.incremental.move import list_touched
from lmd.incremental.trial import begin_move, complete_move
from lmd.objectives.localisation.ambiguity import count_tag, tells, told_apart
from lmd.objectives.localisation.information import WIDTH, half_of, meets, share_of
from lmd.objectives.localisation.kernels import landmark_moments, meets_row
from lmd.scene.criteria import covering, frame_of, pixel_density, sized
from lmd.sight.blocks import BLOCK
from lmd.sight.directions import NOWHERE
from lmd.sight.kernels import sum_weights

GROUP = 8  # views decided at a time
VIEW = np.uint64(BITS)


@inlined
def mixed(located, covered, weight):
    """(1 - weight) L + weight P_n in whole units; never falls as either rises."""
    return located + np.int64(weight * (covered - located))


@inner
def moments_of(x, y, z, nx, ny, nz, precision, k, moments):
    """Write the moments of landmark k at an offset into `moments` `(WIDTH,)`."""
    (
        moments[0], moments[1], moments[2], moments[3], moments[4], moments[5], moments[6], moments[7], moments[8],
        moments[9], moments[10], moments[11], moments[12], moments[13], moments[14],
    ) = landmark_moments(x, y, z, nx, ny, nz, precision, k)  # fmt: skip
    moments[15] = told_apart(precision, half_of(precision, k), x, y, z, nx, ny, nz)


@inner
def row_meets(precision, row):
    """`meets_row` with `row` `(1, WIDTH)`, not inlined."""
    return meets_row(precision, row, 0)


@inner
def _look(k, field, state, scratch):
    """Fill `old` and `new`, and the cap of the new place at all positions that reach it."""
    cover, trial = field.coverage, scratch.coverage
    sight, axes, positions = sized(cover.sight, k), cover.axes, cover.positions
    certain, possible = cover.certain, cover.possible
    x, y, z, low, high, sure, cell, reached = trial.new
    reachable, cap, target = state.coverage.reachable, trial.cap, trial.target
    nx, ny, nz = target[3], target[4], target[5]
    frame = frame_of(sight, nx, ny, nz)
    ax, ay, az = state.landmarks[0, k], state.landmarks[1, k], state.landmarks[2, k]
    mx, my, mz = state.normals[0, k], state.normals[1, k], state.normals[2, k]
    for p in range(np.uint64(len(reached))):
        if reachable[k, p] and field.asks:
            ox, oy, oz = ax - positions[0, p], ay - positions[1, p], az - positions[2, p]
            moments_of(ox, oy, oz, mx, my, mz, field.precision, k, scratch.old[p])
        if not reached[p]:
            continue
        px, py, pz = x[p], y[p], z[p]
        if field.asks:
            moments_of(px, py, pz, nx, ny, nz, field.precision, k, scratch.new[p])
        given, outer = np.uint64(cell[p] if sure[p] == np.inf else NOWHERE), np.uint64(cell[p])
        for w in range(np.uint64(cap.shape[1])):
            found, well = certain[given, w], certain[outer, w]
            left = possible[outer, w] & ~found
            if left:
                found |= covering(sight, left, w, px, py, pz, frame, low[p], high[p], sure[p], well, axes)
            cap[p, w] = found


@inner
def _list_views(k, field, state, scratch):
    """List the views to be decided anew where landmark k comes or goes and no other appears; settle all others.

    Their sums are fetched into the cache meanwhile: they lie all over the memory, and waiting for them would take most
    of the time.
    """
    asks, sight, axes, positions = field.asks, field.coverage.sight, field.coverage.axes, field.coverage.positions
    caps, counts = state.coverage.caps, state.coverage.counts
    enough, short, just = counts.enough, counts.short, counts.just
    reachable, hidden, flips = state.coverage.reachable, state.coverage.hidden, scratch.coverage.flips
    reached, cap = scratch.coverage.new.reached, scratch.coverage.cap
    x, y, z = scratch.coverage.new.x, scratch.coverage.new.y, scratch.coverage.new.z
    ax, ay, az = state.landmarks[0, k], state.landmarks[1, k], state.landmarks[2, k]
    after, known, localised, sums = scratch.enough, state.localised, scratch.localised, state.sums
    first, views, leaving, coming = scratch.first, scratch.views, scratch.leaving, scratch.coming
    words, count = np.uint64(caps.shape[2]), ZERO
    for p in range(np.uint64(len(flips))):
        first[p] = count
        for w in range(words):
            localised[p, w], after[p, w] = known[p, w], enough[p, w]
        shown, seen = ALL if reachable[k, p] & (hidden[k, p] == 0) else ZERO, ALL if reached[p] else ZERO
        if flips[p] or not shown | seen:
            continue
        px, py, pz = x[p], y[p], z[p]
        ox, oy, oz = ax - positions[0, p], ay - positions[1, p], az - positions[2, p]
        for w in range(words):
            was, now = caps[k, p, w] & shown, cap[p, w] & seen
            has = (enough[p, w] & ~(was & ~now & just[p, w])) | (now & ~was & short[p, w])
            good = known[p, w]
            left = has & ((was & now) | (was & good) | (now & ~good)) if asks else ZERO
            after[p, w], localised[p, w] = has, good & has & ~left if asks else has
            while left:
                bit = lowest(left)
                left &= left - ONE
                a, v = w * VIEW + bit, (p * words + w) * VIEW + bit
                prefetch(sums, v * np.uint64(WIDTH))
                views[count] = v
                leaving[count] = pixel_density(sight, ox, oy, oz, axes, a) if was >> bit & ONE else 0.0
                coming[count] = pixel_density(sight, px, py, pz, axes, a) if now >> bit & ONE else 0.0
                count += ONE
        while count % np.uint64(GROUP):  # whole groups for each position
            views[count], leaving[count], coming[count] = views[first[p]], 0.0, 0.0
            count += ONE
    first[len(flips)] = count


@inner
def _decide_views(field, state, scratch):
    """Decide the views listed."""
    precision, sums, old, new = field.precision, state.sums, scratch.old, scratch.new
    first, views, leaving, coming, localised = (
        scratch.first, scratch.views, scratch.leaving, scratch.coming, scratch.localised
    )  # fmt: skip
    each = np.uint64(localised.shape[1]) * VIEW
    for p in range(np.uint64(len(localised))):
        for start in range(first[p], first[p + ONE], np.uint64(GROUP)):
            good = np.uint32(0)
            for lane in range(np.uint64(GROUP)):
                m = start + lane
                v, go, come = views[m], leaving[m], coming[m]
                tags = np.float64(come != 0.0) - np.float64(go != 0.0)  # as by `count_tag`
                meeting = meets(
                    precision,
                    sums[v, 0] - share_of(old[p, 0], go) + share_of(new[p, 0], come),
                    sums[v, 1] - share_of(old[p, 1], go) + share_of(new[p, 1], come),
                    sums[v, 2] - share_of(old[p, 2], go) + share_of(new[p, 2], come),
                    sums[v, 3] - share_of(old[p, 3], go) + share_of(new[p, 3], come),
                    sums[v, 4] - share_of(old[p, 4], go) + share_of(new[p, 4], come),
                    sums[v, 5] - share_of(old[p, 5], go) + share_of(new[p, 5], come),
                    sums[v, 6] - share_of(old[p, 6], go) + share_of(new[p, 6], come),
                    sums[v, 7] - share_of(old[p, 7], go) + share_of(new[p, 7], come),
                    sums[v, 8] - share_of(old[p, 8], go) + share_of(new[p, 8], come),
                    sums[v, 9] - share_of(old[p, 9], go) + share_of(new[p, 9], come),
                    sums[v, 10] - share_of(old[p, 10], go) + share_of(new[p, 10], come),
                    sums[v, 11] - share_of(old[p, 11], go) + share_of(new[p, 11], come),
                    sums[v, 12] - share_of(old[p, 12], go) + share_of(new[p, 12], come),
                    sums[v, 13] - share_of(old[p, 13], go) + share_of(new[p, 13], come),
                    sums[v, 14] - share_of(old[p, 14], go) + share_of(new[p, 14], come),
                )
                meeting &= tells(
                    field.precision, sums[v, 15] - share_of(old[p, 15], go) + share_of(new[p, 15], come) + tags
                )
                good |= np.uint32(meeting & ((go != 0.0) | (come != 0.0))) << np.uint32(lane)
            while good:
                a = views[start + lowest(np.uint64(good))] - p * each
                good &= good - np.uint32(1)
                localised[p, a // VIEW] |= ONE << (a % VIEW)


@inner
def _list_places(k, state, scratch):
    """List the positions that a move of landmark k may change; the values of the others are copied."""
    units, located, covered = scratch.units, scratch.located, scratch.coverage.units
    known = state.coverage.units
    for p in range(len(units)):
        units[p], located[p], covered[p] = state.units[p], state.located[p], known[p]
    return list_touched(k, state.coverage, scratch.coverage)


@inner
def _sum_up(places, field, state, scratch):
    """Find the values at `places` from the sets of axes."""
    weights, covered = field.coverage.weights, scratch.coverage.units
    known = state.coverage.units
    enough, after, was, localised = state.coverage.counts.enough, scratch.enough, state.localised, scratch.localised
    for p in places:
        seen, located = known[p], state.located[p]
        for w in range(np.uint64(localised.shape[1])):
            seen += sum_weights(enough[p, w], after[p, w], weights, p, w)
            located += sum_weights(was[p, w], localised[p, w], weights, p, w)
        covered[p], scratch.located[p], scratch.units[p] = seen, located, mixed(located, seen, field.weight)


@inlined
def _note_change(count, gone, x, y, z, moments, m, caps, i, p, scratch):
    """Write down that the cap `caps[i, p]` `(W,)` comes, or is `gone`, with the moments in row m."""
    scratch.goes[count] = ALL if gone else ZERO
    scratch.offsets[count, 0], scratch.offsets[count, 1], scratch.offsets[count, 2] = x, y, z
    for j in range(np.uint64(WIDTH)):
        scratch.moments[count, j] = moments[m, j]
    for w in range(np.uint64(caps.shape[2])):
        scratch.caps[count, w] = caps[i, p, w]


@inlined
def list_changes(k, p, field, state, scratch):
    """Write down which caps come or go at position p, and return how many: of landmark k, and of those that flip."""
    landmarks, normals, positions = state.landmarks, state.normals, field.coverage.positions
    reachable, hidden, caps = state.coverage.reachable, state.coverage.hidden, state.coverage.caps
    reached, count_hidden, cap = scratch.coverage.new.reached, scratch.coverage.after.count_hidden, scratch.coverage.cap
    px, py, pz, count = positions[0, p], positions[1, p], positions[2, p], ZERO
    if reachable[k, p] & (hidden[k, p] == 0):
        x, y, z = landmarks[0, k] - px, landmarks[1, k] - py, landmarks[2, k] - pz
        _note_change(count, True, x, y, z, scratch.old, p, caps, k, p, scratch)
        count += ONE
    if reached[p] & (count_hidden[p] == 0):
        x, y, z = scratch.coverage.new.x[p], scratch.coverage.new.y[p], scratch.coverage.new.z[p]
        _note_change(count, False, x, y, z, scratch.new, p, cap.reshape((1, cap.shape[0], cap.shape[1])), 0, p, scratch)
        count += ONE
    if scratch.coverage.flips[p]:
        found, who, change = scratch.coverage.turns
        b, q = p // np.uint64(BLOCK), p % np.uint64(BLOCK)
        for m in range(np.uint64(found[b])):
            i = np.uint64(who[b, m])
            was, now = hidden[i, p], hidden[i, p] + change[b, m, q]
            if flips_with(reachable[i, p], was, now):
                x, y, z = landmarks[0, i] - px, landmarks[1, i] - py, landmarks[2, i] - pz
                moments_of(x, y, z, normals[0, i], normals[1, i], normals[2, i], field.precision, i, scratch.row[0])
                _note_change(count, was == 0, x, y, z, scratch.row, ZERO, caps, i, p, scratch)
                count += ONE
    return count


@inlined
def add_shares(precision, sums, v, e, a, sign, sight, axes, offsets, moments, goes):
    """Add what change e of a position adds to axis a, or takes, to row v of `sums`; the arrays are those of a scratch.

    Inlined: to hand on field, state and scratch costs more than the work itself.
    """
    weight = pixel_density(sight, offsets[e, 0], offsets[e, 1], offsets[e, 2], axes, a)
    factor = -sign if goes[e] else sign
    for j in range(np.uint64(sums.shape[1])):
        sums[v, j] += factor * share_of(moments[e, j], weight)
    count_tag(precision, sums, v, factor)


@inner
def _try_flips(k, places, field, state, scratch):
    """Find the values at the positions `places`, where other landmarks may appear or disappear."""
    counts, digits, n = state.coverage.counts.digits, scratch.coverage.digits, field.coverage.n
    caps, row, localised, enough = scratch.caps, scratch.row, scratch.localised, scratch.enough
    sight, axes = field.coverage.sight, field.coverage.axes
    offsets, moments, goes = scratch.offsets, scratch.moments, scratch.goes
    words, size = np.uint64(localised.shape[1]), np.uint64(len(digits))
    for p in places:
        changes = list_changes(k, p, field, state, scratch)
        for w in range(words):
            changed = ZERO
            for j in range(size):
                digits[j] = counts[p, w, j]
            for e in range(changes):
                changed |= caps[e, w]
                add_set(digits, caps[e, w], goes[e])
            has = at_least(digits, n)
            good = state.localised[p, w] & has & ~changed if field.asks else has
            left = has & changed if field.asks else ZERO
            while left:
                bit = lowest(left)
                left &= left - ONE
                v = (p * words + w) * VIEW + bit
                for j in range(np.uint64(WIDTH)):
                    row[ZERO, j] = state.sums[v, j]
                for e in range(changes):
                    if caps[e, w] >> bit & ONE:
                        add_shares(
                            field.precision, row, ZERO, e, w * VIEW + bit, 1.0, sight, axes, offsets, moments, goes
                        )
                good |= np.uint64(row_meets(field.precision, row)) << bit
            enough[p, w], localised[p, w] = has, good
    _sum_up(places, field, state, scratch)


@inner
def bound_move(field, k, pose, surface, state, scratch):
    """Find what the values are at most with landmark k at `pose` `(6,)` on a surface: `scratch.units`."""
    flips, listed = scratch.coverage.flips, scratch.coverage.listed
    begin_move(k, pose, surface, field.coverage, state.coverage, scratch.coverage)
    _look(k, field, state, scratch)
    _list_views(np.uint64(k), field, state, scratch)
    _decide_views(field, state, scratch)
    _sum_up(listed[: _list_places(k, state, scratch)], field, state, scratch)
    count = ZERO
    for p in range(np.uint64(len(flips))):
        listed[count] = p
        count += np.uint64(flips[p])
    _try_flips(np.uint64(k), listed[:count], field, state, scratch)


@inner
def finish_move(field, k, state, scratch):
    """Make what `bound_move` found exact."""
    if field.coverage.sight.reach >= 0.0:
        count = complete_move(k, field.coverage, state.coverage, scratch.coverage)
        _try_flips(np.uint64(k), scratch.coverage.listed[:count], field, state, scratch)
