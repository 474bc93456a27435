"""The incremental field of localisation: L at every position as single landmarks move.

What covers what, and who hides whom, is the field of coverage's. To it come the sums of the 15 numbers of every view
(`information`), exact in any order, and which views are localised. A landmark that comes or goes changes the sums of
the views in its cap. Few of these have to be decided anew, as more information never makes a view worse:

- where the landmark only goes, those that are localised and still cover enough;
- where it only comes, those that are not and cover enough by then;
- where it both goes and comes, all that cover enough.

`bound_move` leaves out what the new place hides and what hides it, which only takes information away. `finish_move`
decides anew at the positions where either happens.
"""

from typing import Any, NamedTuple

import numpy as np
from numba import njit

from lmd.compiled import kernel
from lmd.deployment import Deployment
from lmd.objectives.coverage_field import CoverageField
from lmd.objectives.field import accept, bound, settle, undo
from lmd.objectives.information import WIDTH, meets, share_of
from lmd.objectives.localisation_kernels import landmark_moments, meets_row
from lmd.sight.criteria import covers
from lmd.sight.incremental.bits import ALL, BITS, ONE, ZERO, add_digit, at_least_so_far, lowest, prefetch
from lmd.sight.incremental.directions import NOWHERE
from lmd.sight.incremental.hiding import flips_with
from lmd.sight.incremental.move import carry_out, state_of, take_back, touched
from lmd.sight.incremental.state import Scratch, State, scratch_of
from lmd.sight.incremental.trial import begin_move, complete_move
from lmd.sight.kernels import BLOCK

GROUP = 8  # views decided at a time
VIEW = np.uint64(BITS)


class LocalisationField(NamedTuple):
    """What does not change while landmarks move; a `lmd.objectives.field.Field`.

    coverage: the field of P_n; precision, asks: see `localisation_kernels.localise_range`; weight: of P_n beside L.
    """

    coverage: CoverageField
    precision: Any
    asks: bool
    weight: float

    @property
    def size(self) -> int:
        """See `Field.size`."""
        return self.coverage.size

    @property
    def index_of(self) -> np.ndarray:
        """See `Field.index_of`."""
        return self.coverage.index_of

    def state(self, deployment: Deployment) -> "LocalisationState":
        """See `Field.state`."""
        return localisation_state(self, deployment)

    def scratch(self, state: "LocalisationState") -> "LocalisationScratch":
        """See `Field.scratch`."""
        return localisation_scratch(state)

    @property
    def stack(self) -> int:
        """See `Field.stack`: landmarks on one point do not tell where the camera is."""
        return 0

    def stacked(self) -> "LocalisationField":
        """See `Field.stacked`; never asked for, as `stack` is 0."""
        return self

    def shrunk(self, size: float) -> "LocalisationField":
        """See `Field.shrunk`."""
        return self._replace(coverage=self.coverage.shrunk(size))


class LocalisationState(NamedTuple):
    """Views localised by one deployment, positions in the order of the field.

    landmarks, normals `(3, K)` and surfaces `(K,)` are those of `coverage`, the state of coverage; units `(Q,)` the
    values; located `(Q,)` L in units; enough, localised `(Q, W)` sets of axes; sums `(64 Q W, WIDTH)` of all landmarks that
    cover a view, the views of a position in the order of the axes.
    """

    landmarks: np.ndarray
    normals: np.ndarray
    surfaces: np.ndarray
    units: np.ndarray
    located: np.ndarray
    enough: np.ndarray
    localised: np.ndarray
    sums: np.ndarray
    coverage: State


class LocalisationScratch(NamedTuple):
    """The move tried last, and working memory.

    units, located, enough, localised: as in the state, after the move; coverage: the scratch of coverage, whose `cap` is filled
    for all positions that reach the new place, and whose `units` are P_n; old, new `(Q, WIDTH)` moments of the landmark
    moved, where it is seen. Once the move is carried out, the first four are those of before.

    Working memory: views, leaving, coming `(64 Q W + 1,)` views to be decided, and 1 / z^3 of the old and the new place
    in them, 0 where it does not cover them; first `(Q + 1,)` of each position among them; the landmarks that come or go at a position, `(K + 2, ...)`: goes
    which of the two, as a set of all or of none, caps sets of axes, offsets from the camera, moments; row `(1, WIDTH)`.
    """

    units: np.ndarray
    located: np.ndarray
    enough: np.ndarray
    localised: np.ndarray
    coverage: Scratch
    old: np.ndarray
    new: np.ndarray
    first: np.ndarray
    views: np.ndarray
    leaving: np.ndarray
    coming: np.ndarray
    goes: np.ndarray
    caps: np.ndarray
    offsets: np.ndarray
    moments: np.ndarray
    row: np.ndarray


@njit(inline="always")
def mixed(located, covered, weight):  # type: ignore[no-untyped-def]
    """(1 - weight) L + weight P_n in whole units; never falls as either rises."""
    return located + np.int64(weight * (covered - located))


@kernel
def _moments_of(x, y, z, nx, ny, nz, precision, moments):  # type: ignore[no-untyped-def]
    """Write the moments of a landmark at an offset into `moments` `(WIDTH,)`."""
    (
        moments[0], moments[1], moments[2], moments[3], moments[4], moments[5], moments[6], moments[7], moments[8],
        moments[9], moments[10], moments[11], moments[12], moments[13], moments[14],
    ) = landmark_moments(x, y, z, nx, ny, nz, precision)  # fmt: skip


@kernel
def _row_meets(precision, row):  # type: ignore[no-untyped-def]
    """`meets_row` with `row` `(1, WIDTH)`, compiled once for all who ask for one row at a time."""
    return meets_row(precision, row, 0)


@kernel
def _look(k, field, state, scratch):  # type: ignore[no-untyped-def]
    """Fill `old` and `new`, and the cap of the new place at all positions that reach it."""
    cover, trial = field.coverage, scratch.coverage
    sight, axes, certain, possible, positions = cover.sight, cover.axes, cover.certain, cover.possible, cover.positions
    x, y, z, low, cell, limited, reached = trial.new
    reachable, cap, target = state.coverage.reachable, trial.cap, trial.target
    nx, ny, nz = target[3], target[4], target[5]
    ax, ay, az = state.landmarks[0, k], state.landmarks[1, k], state.landmarks[2, k]
    mx, my, mz = state.normals[0, k], state.normals[1, k], state.normals[2, k]
    for p in range(np.uint64(len(reached))):
        if reachable[k, p] and field.asks:
            ox, oy, oz = ax - positions[0, p], ay - positions[1, p], az - positions[2, p]
            _moments_of(ox, oy, oz, mx, my, mz, field.precision, scratch.old[p])
        if not reached[p]:
            continue
        px, py, pz, least = x[p], y[p], z[p], low[p]
        if field.asks:
            _moments_of(px, py, pz, nx, ny, nz, field.precision, scratch.new[p])
        inner, outer = np.uint64(NOWHERE if limited[p] else cell[p]), np.uint64(cell[p])
        for w in range(np.uint64(cap.shape[1])):
            covering = certain[inner, w]
            left = possible[outer, w] & ~covering
            while left:
                bit = lowest(left)
                a = w * VIEW + bit
                covering |= np.uint64(covers(sight, px, py, pz, nx, ny, nz, least, 0.0, axes, a)) << bit
                left &= left - ONE
            cap[p, w] = covering


@njit(inline="always")
def _weight(axes, a, x, y, z):  # type: ignore[no-untyped-def]
    """1 / z^3 for the depth z of a landmark at offset (x, y, z) along axis a."""
    depth = axes[0, a] * x + axes[1, a] * y + axes[2, a] * z
    return 1.0 / (depth * depth * depth)


@kernel
def _sum_weights(before, after, weights, w):  # type: ignore[no-untyped-def]
    """What the axes of word w weigh that are in the set `after`, less those in `before`."""
    change, left = np.int64(0), before ^ after
    while left:
        bit = lowest(left)
        weight = weights[w * VIEW + bit]
        change += weight if after >> bit & ONE else -weight
        left &= left - ONE
    return change


@kernel
def _list_views(k, field, state, scratch):  # type: ignore[no-untyped-def]
    """List the views to be decided anew where landmark k comes or goes and no other appears; settle all others.

    Their sums are fetched into the cache meanwhile: they lie all over the memory, and waiting for them would take most
    of the time.
    """
    asks, axes, positions, n = field.asks, field.coverage.axes, field.coverage.positions, field.coverage.n
    caps, short, just = state.coverage.caps, state.coverage.short, state.coverage.just
    reachable, hidden, flips = state.coverage.reachable, state.coverage.hidden, scratch.coverage.flips
    reached, cap = scratch.coverage.new.reached, scratch.coverage.cap
    x, y, z = scratch.coverage.new.x, scratch.coverage.new.y, scratch.coverage.new.z
    ax, ay, az = state.landmarks[0, k], state.landmarks[1, k], state.landmarks[2, k]
    enough, after, known, localised, sums = state.enough, scratch.enough, state.localised, scratch.localised, state.sums
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
                prefetch(sums, v)
                views[count] = v
                leaving[count] = _weight(axes, a, ox, oy, oz) if was >> bit & ONE else 0.0
                coming[count] = _weight(axes, a, px, py, pz) if now >> bit & ONE else 0.0
                count += ONE
        while count % np.uint64(GROUP):  # whole groups for each position
            views[count], leaving[count], coming[count] = views[first[p]], 0.0, 0.0
            count += ONE
    first[len(flips)] = count


@kernel
def _decide_views(field, state, scratch):  # type: ignore[no-untyped-def]
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
                good |= np.uint32(meeting & ((go != 0.0) | (come != 0.0))) << np.uint32(lane)
            while good:
                a = views[start + lowest(np.uint64(good))] - p * each
                good &= good - np.uint32(1)
                localised[p, a // VIEW] |= ONE << (a % VIEW)


@kernel
def _touched_places(k, state, scratch):  # type: ignore[no-untyped-def]
    """The positions that a move of landmark k may change; the values of the others are copied."""
    units, located, covered = scratch.units, scratch.located, scratch.coverage.units
    known = state.coverage.units
    for p in range(len(units)):
        units[p], located[p], covered[p] = state.units[p], state.located[p], known[p]
    return touched(k, state.coverage, scratch.coverage)


@kernel
def _sum_up(places, field, state, scratch):  # type: ignore[no-untyped-def]
    """Find the values at `places` from the sets of axes."""
    weights, covered = field.coverage.weights, scratch.coverage.units
    known = state.coverage.units
    enough, after, was, localised = state.enough, scratch.enough, state.localised, scratch.localised
    for p in places:
        seen, located = known[p], state.located[p]
        for w in range(np.uint64(localised.shape[1])):
            seen += _sum_weights(enough[p, w], after[p, w], weights, w)
            located += _sum_weights(was[p, w], localised[p, w], weights, w)
        covered[p], scratch.located[p], scratch.units[p] = seen, located, mixed(located, seen, field.weight)


@kernel
def _add(count, i, goes, p, field, state, scratch):  # type: ignore[no-untyped-def]
    """Write down that landmark i, where it is, comes or `goes` at position p; returns 1."""
    landmarks, normals, offset = state.landmarks, state.normals, scratch.offsets[count]
    for axis in range(3):
        offset[axis] = landmarks[axis, i] - field.coverage.positions[axis, p]
    nx, ny, nz = normals[0, i], normals[1, i], normals[2, i]
    _moments_of(offset[0], offset[1], offset[2], nx, ny, nz, field.precision, scratch.moments[count])
    scratch.goes[count], scratch.caps[count] = goes, state.coverage.caps[i, p]
    return ONE


@kernel
def _list_changes(k, p, field, state, scratch):  # type: ignore[no-untyped-def]
    """Write down which caps come or go at position p, and returns how many: of landmark k, and of those that flip."""
    trial, known, positions, precision = scratch.coverage, state.coverage, field.coverage.positions, field.precision
    count, b, q = ZERO, p // np.uint64(BLOCK), p % np.uint64(BLOCK)
    if known.reachable[k, p] & (known.hidden[k, p] == 0):
        count += _add(count, k, ALL, p, field, state, scratch)
    if trial.new.reached[p] & (trial.after.count_hidden[p] == 0):
        scratch.goes[count], offset = ZERO, scratch.offsets[count]
        offset[0], offset[1], offset[2] = trial.new.x[p], trial.new.y[p], trial.new.z[p]
        scratch.caps[count], scratch.moments[count] = trial.cap[p], scratch.new[p]
        count += ONE
    if trial.flips[p]:
        found, who, change = trial.turns
        for m in range(np.uint64(found[b])):
            i = np.uint64(who[b, m])
            was, now = known.hidden[i, p], known.hidden[i, p] + change[b, m, q]
            if flips_with(known.reachable[i, p], was, now):
                count += _add(count, i, ALL if was == 0 else ZERO, p, field, state, scratch)
    return count


@kernel
def _add_shares(row, e, a, sign, field, scratch):  # type: ignore[no-untyped-def]
    """Add what change e of a position's adds to axis a, or takes, to the sums `row` `(WIDTH,)`."""
    offset, moments = scratch.offsets[e], scratch.moments[e]
    weight = _weight(field.coverage.axes, a, offset[0], offset[1], offset[2])
    sign = -sign if scratch.goes[e] else sign
    for j in range(np.uint64(len(row))):
        row[j] += sign * share_of(moments[j], weight)


@kernel
def _try_flips(k, places, field, state, scratch):  # type: ignore[no-untyped-def]
    """Find the values at the positions `places`, where other landmarks may appear or disappear."""
    counts, digits, n = state.coverage.counts, scratch.coverage.digits, field.coverage.n
    caps, row, localised, enough = scratch.caps, scratch.row, scratch.localised, scratch.enough
    words, size = np.uint64(localised.shape[1]), np.uint64(len(digits))
    for p in places:
        changes = _list_changes(k, p, field, state, scratch)
        for w in range(words):
            has, changed = ALL, ZERO
            for j in range(size):
                digits[j] = counts[p, w, j]
            for e in range(changes):
                carry = caps[e, w]
                changed |= carry
                for j in range(size):
                    digits[j], carry = add_digit(digits[j], carry, scratch.goes[e])
            for j in range(size):
                has = at_least_so_far(has, digits[j], n, j)
            good = state.localised[p, w] & has & ~changed if field.asks else has
            left = has & changed if field.asks else ZERO
            while left:
                bit = lowest(left)
                left &= left - ONE
                row[ZERO] = state.sums[(p * words + w) * VIEW + bit]
                for e in range(changes):
                    if caps[e, w] >> bit & ONE:
                        _add_shares(row[ZERO], e, w * VIEW + bit, 1.0, field, scratch)
                good |= np.uint64(_row_meets(field.precision, row)) << bit
            enough[p, w], localised[p, w] = has, good
    _sum_up(places, field, state, scratch)


@kernel
def bound_move(k, pose, surface, field, state, scratch):  # type: ignore[no-untyped-def]
    """Find what the values are at most with landmark k at `pose` `(6,)` on a surface: `scratch.units`."""
    flips, listed = scratch.coverage.flips, scratch.coverage.listed
    begin_move(k, pose, surface, field.coverage, state.coverage, scratch.coverage)
    _look(k, field, state, scratch)
    _list_views(np.uint64(k), field, state, scratch)
    _decide_views(field, state, scratch)
    _sum_up(_touched_places(k, state, scratch), field, state, scratch)
    count = ZERO
    for p in range(np.uint64(len(flips))):
        listed[count] = p
        count += np.uint64(flips[p])
    _try_flips(np.uint64(k), listed[:count], field, state, scratch)


@kernel
def finish_move(k, field, state, scratch):
    """Make what `bound_move` found exact."""
    if field.coverage.sight.reach >= 0.0:
        places = complete_move(k, field.coverage, state.coverage, scratch.coverage)
        _try_flips(np.uint64(k), places, field, state, scratch)


@kernel
def _change_sums(k, sign, field, state, scratch):  # type: ignore[no-untyped-def]
    """Change the sums by the move tried last, or with a `sign` of -1 back; landmark k is still where it was."""
    if not field.asks:
        return
    sums, caps = state.sums, scratch.caps
    words = np.uint64(caps.shape[1])
    for p in touched(k, state.coverage, scratch.coverage):
        for e in range(_list_changes(np.uint64(k), p, field, state, scratch)):
            for w in range(words):
                left = caps[e, w]
                while left:
                    bit = lowest(left)
                    left &= left - ONE
                    _add_shares(sums[(p * words + w) * VIEW + bit], e, w * VIEW + bit, sign, field, scratch)


@kernel
def _exchange(state, scratch):  # type: ignore[no-untyped-def]
    """Exchange what state and scratch know of the values."""
    for p in range(len(state.units)):
        state.units[p], scratch.units[p] = scratch.units[p], state.units[p]
        state.located[p], scratch.located[p] = scratch.located[p], state.located[p]
        for w in range(state.localised.shape[1]):
            state.localised[p, w], scratch.localised[p, w] = scratch.localised[p, w], state.localised[p, w]
            state.enough[p, w], scratch.enough[p, w] = scratch.enough[p, w], state.enough[p, w]


@bound.register(LocalisationField)
def _bound(field, k, pose, surface, state, scratch):  # type: ignore[no-untyped-def]
    bound_move(k, pose, surface, field, state, scratch)


@settle.register(LocalisationField)
def _settle(field, k, state, scratch):  # type: ignore[no-untyped-def]
    finish_move(k, field, state, scratch)


@accept.register(LocalisationField)
def _accept(field, k, state, scratch):  # type: ignore[no-untyped-def]
    _change_sums(k, 1.0, field, state, scratch)
    carry_out(k, field.coverage, state.coverage, scratch.coverage)
    _exchange(state, scratch)


@undo.register(LocalisationField)
def _undo(field, k, state, scratch):  # type: ignore[no-untyped-def]
    take_back(k, field.coverage, state.coverage, scratch.coverage)
    _change_sums(k, -1.0, field, state, scratch)
    _exchange(state, scratch)


@kernel
def _fill(field, state, scratch):  # type: ignore[no-untyped-def]
    """Sum up what all landmarks tell, and find the values."""
    known, weights, n, row = state.coverage, field.coverage.weights, field.coverage.n, scratch.row
    words, size = np.uint64(state.localised.shape[1]), np.uint64(known.counts.shape[2])
    for p in range(np.uint64(len(state.units))):
        for i in range(np.uint64(known.caps.shape[0]) if field.asks else ZERO):
            if known.reachable[i, p] & (known.hidden[i, p] == 0):
                _add(ZERO, i, ZERO, p, field, state, scratch)
                for w in range(words):
                    left = known.caps[i, p, w]
                    while left:
                        bit = lowest(left)
                        left &= left - ONE
                        view = (p * words + w) * VIEW + bit
                        _add_shares(state.sums[view], ZERO, w * VIEW + bit, 1.0, field, scratch)
        for w in range(words):
            has = ALL
            for j in range(size):
                has = at_least_so_far(has, known.counts[p, w, j], n, j)
            left, good = has if field.asks else ZERO, ZERO if field.asks else has
            while left:
                bit = lowest(left)
                left &= left - ONE
                row[ZERO] = state.sums[(p * words + w) * VIEW + bit]
                good |= np.uint64(_row_meets(field.precision, row)) << bit
            state.enough[p, w], state.localised[p, w] = has, good
            state.located[p] += _sum_weights(ZERO, good, weights, w)
        state.units[p] = mixed(state.located[p], known.units[p], field.weight)


def localisation_state(field: LocalisationField, deployment: Deployment) -> LocalisationState:
    """The views that a deployment localises, ready for moves."""
    known = state_of(field.coverage, deployment)
    size, words = known.short.shape
    state = LocalisationState(
        landmarks=known.landmarks,
        normals=known.normals,
        surfaces=known.surfaces,
        units=np.zeros(size, dtype=np.int64),
        located=np.zeros(size, dtype=np.int64),
        enough=np.zeros((size, words), dtype=np.uint64),
        localised=np.zeros((size, words), dtype=np.uint64),
        sums=np.zeros((BITS * size * words if field.asks else 1, WIDTH)),
        coverage=known,
    )
    _fill(field, state, localisation_scratch(state))
    return state


def localisation_scratch(state: LocalisationState) -> LocalisationScratch:
    """Working memory for moves of `state`."""
    count, (size, words) = state.landmarks.shape[1], state.localised.shape
    leaving, coming = np.zeros((2, BITS * words * size + 1))
    return LocalisationScratch(
        units=state.units.copy(),
        located=state.located.copy(),
        enough=state.enough.copy(),
        localised=state.localised.copy(),
        coverage=scratch_of(state.coverage),
        old=np.zeros((size, WIDTH)),
        new=np.zeros((size, WIDTH)),
        first=np.zeros(size + 1, dtype=np.uint64),
        views=np.zeros(BITS * words * size + 1, dtype=np.uint64),
        leaving=leaving,
        coming=coming,
        goes=np.zeros(count + 2, dtype=np.uint64),
        caps=np.zeros((count + 2, words), dtype=np.uint64),
        offsets=np.zeros((count + 2, 3)),
        moments=np.zeros((count + 2, WIDTH)),
        row=np.zeros((1, WIDTH)),
    )
