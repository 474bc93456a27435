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

from lmd.core.bits import ALL, ONE, ZERO, add_set, at_least, lowest, prefetch
from lmd.core.compiled import inner
from lmd.incremental.counts import ENOUGH, enough_with
from lmd.incremental.nearby import pose_of, target_of
from lmd.incremental.occlusion import COMES
from lmd.incremental.state import FRESH, HIDDEN, LISTED, REACHED, TOUCHED, TOUCHED_COUNT, TOUCHED_LIST, X, Y, Z
from lmd.incremental.trial import begin_move, find_pairs, list_changing, see_whole
from lmd.objectives.localisation.ambiguity import tells
from lmd.objectives.localisation.changes import VIEW, add_shares, list_changes, mixed, moments_of, row_meets
from lmd.objectives.localisation.information import WIDTH, meets, share_of
from lmd.objectives.localisation.state import CHANGES, COMING, COVERED, LEAVING, LEFT, LOCALISED, OFFSETS, TRIED
from lmd.scene.criteria import pixel_density
from lmd.sight.kernels import sum_weights

GROUP = 8  # views decided at a time


@inner
def _find_moments(k, places, field, state, scratch):
    """Fill `LEFT` and `TRIED` at the positions `places`."""
    positions, precision, seen = field.coverage.positions, field.precision, scratch.coverage.seen
    reachable, reached = state.coverage.reachable, scratch.coverage.flags[REACHED]
    left, tried = scratch.told[LEFT], scratch.told[TRIED]
    ax, ay, az, mx, my, mz = pose_of(k, state.coverage)
    _, _, _, nx, ny, nz = target_of(scratch.coverage)
    for p in places:
        if reachable[k, p]:
            x, y, z = ax - positions[0, p], ay - positions[1, p], az - positions[2, p]
            moments_of(x, y, z, mx, my, mz, precision, k, left[p])
        if reached[p]:
            moments_of(seen[X, p], seen[Y, p], seen[Z, p], nx, ny, nz, precision, k, tried[p])


@inner
def _list_views(k, field, state, scratch):
    """List the views to be decided anew where landmark k comes or goes and no other appears; settle all others.

    Their sums are fetched into the cache meanwhile: they lie all over the memory, and waiting for them would take most
    of the time.
    """
    asks, camera, positions = field.asks, field.coverage.cameras, field.coverage.positions
    sight, axes = camera.sight, camera.axes
    caps, counts, enough = state.coverage.caps, state.coverage.counts, state.coverage.counts.sets[ENOUGH]
    reachable, hidden, cap = state.coverage.reachable, state.coverage.hides[HIDDEN], scratch.coverage.sets[FRESH]
    reached, flips = scratch.coverage.flags[REACHED], scratch.coverage.flags[TOUCHED]
    x, y, z = scratch.coverage.seen[X], scratch.coverage.seen[Y], scratch.coverage.seen[Z]
    ax, ay, az, _, _, _ = pose_of(k, state.coverage)
    after, known, localised, sums = scratch.sets[COVERED], state.localised, scratch.sets[LOCALISED], state.sums
    first, views, leaving, coming = scratch.first, scratch.views, scratch.densities[LEAVING], scratch.densities[COMING]
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
            has = enough_with(p, w, was, now, counts)
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
    precision, sums, old, new = field.precision, state.sums, scratch.told[LEFT], scratch.told[TRIED]
    first, views, leaving, coming = scratch.first, scratch.views, scratch.densities[LEAVING], scratch.densities[COMING]
    localised = scratch.sets[LOCALISED]
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
def _copy_values(state, scratch):
    """Copy all values."""
    units, located, covered, known = scratch.units, scratch.located, scratch.coverage.units, state.coverage.units
    for p in range(len(units)):
        units[p], located[p], covered[p] = state.units[p], state.located[p], known[p]


@inner
def _sum_up(places, field, state, scratch):
    """Find the values at `places` from the sets of axes."""
    weights, covered = field.coverage.weights, scratch.coverage.units
    known = state.coverage.units
    enough, was = state.coverage.counts.sets[ENOUGH], state.localised
    after, localised = scratch.sets[COVERED], scratch.sets[LOCALISED]
    for p in places:
        seen, located = known[p], state.located[p]
        for w in range(np.uint64(localised.shape[1])):
            seen += sum_weights(enough[p, w], after[p, w], weights, p, w)
            located += sum_weights(was[p, w], localised[p, w], weights, p, w)
        covered[p], scratch.located[p], scratch.units[p] = seen, located, mixed(located, seen, field.weight)


@inner
def _try_flips(k, places, field, state, scratch):
    """Find the values at the positions `places`, where other landmarks may appear or disappear."""
    counts, caps, n = state.coverage.counts.digits, scratch.caps, field.coverage.n
    sight, axes = field.coverage.cameras.sight, field.coverage.cameras.axes
    localised, enough, offsets, moments = (
        scratch.sets[LOCALISED], scratch.sets[COVERED], scratch.told[OFFSETS], scratch.told[CHANGES]
    )  # fmt: skip
    words, size, row = np.uint64(localised.shape[1]), np.uint64(counts.shape[2]), np.uint64(len(moments) - 1)
    for p in places:
        changes = list_changes(k, p, field, state, scratch)
        for w in range(words):
            changed = ZERO
            digits = scratch.coverage.digits[p, w]
            for j in range(size):
                digits[j] = counts[p, w, j]
            for e in range(changes):
                changed |= caps[e, w]
                add_set(digits, caps[e, w], caps[e, words])
            has = at_least(digits, n)
            good = state.localised[p, w] & has & ~changed if field.asks else has
            left = has & changed if field.asks else ZERO
            while left:
                bit = lowest(left)
                left &= left - ONE
                v = (p * words + w) * VIEW + bit
                for j in range(np.uint64(WIDTH)):
                    moments[row, j] = state.sums[v, j]
                for e in range(changes):
                    if caps[e, w] >> bit & ONE:
                        a, goes = w * VIEW + bit, caps[e, words]
                        add_shares(field.precision, moments, row, e, a, 1.0, sight, axes, offsets, moments, goes)
                good |= np.uint64(row_meets(field.precision, moments, row)) << bit
            enough[p, w], localised[p, w] = has, good
    _sum_up(places, field, state, scratch)


@inner
def bound_move(field, k, pose, surface, state, scratch):
    """Find what the values are at most with landmark k at `pose` `(6,)` on a surface: `scratch.units`."""
    cover, known, trial = field.coverage, state.coverage, scratch.coverage
    begin_move(np.uint64(k), pose, surface, cover, known, trial)
    see_whole(np.uint64(k), cover, known, trial)
    places = trial.lists[LISTED][: list_changing(known, np.uint64(k), trial)]
    if field.asks:
        _find_moments(np.uint64(k), places, field, state, scratch)
    _list_views(np.uint64(k), field, state, scratch)
    _decide_views(field, state, scratch)
    _copy_values(state, scratch)
    _sum_up(places, field, state, scratch)
    _try_flips(np.uint64(k), trial.lists[TOUCHED_LIST][: trial.numbers[TOUCHED_COUNT]], field, state, scratch)


@inner
def finish_move(field, k, state, scratch):
    """Make what `bound_move` found exact."""
    trial = scratch.coverage
    find_pairs(state.coverage, np.uint64(k), COMES, field.coverage, trial)
    _try_flips(np.uint64(k), trial.lists[TOUCHED_LIST][: trial.numbers[TOUCHED_COUNT]], field, state, scratch)
