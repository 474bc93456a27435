"""What a move changes in the views: the landmarks that come or go at a position, and what they tell."""

import numpy as np

from lmd.core.bits import ALL, BITS, ONE, ZERO, lowest
from lmd.core.compiled import inlined, inner
from lmd.incremental.camera_occlusion import list_turning
from lmd.incremental.nearby import pose_of
from lmd.incremental.state import FRESH, GOES, HIDDEN, NAMES, REACHED, TOUCHED, X, Y, Z
from lmd.objectives.localisation.ambiguity import count_tag, told_apart
from lmd.objectives.localisation.information import WIDTH, half_of, share_of
from lmd.objectives.localisation.kernels import landmark_moments, meets_row
from lmd.objectives.localisation.state import CHANGES, LEFT, OFFSETS, TRIED
from lmd.scene.criteria import pixel_density

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
def row_meets(precision, sums, v):
    """`meets_row`, not inlined."""
    return meets_row(precision, sums, v)


@inlined
def _note_change(count, goes, x, y, z, moments, cap, scratch):
    """Write down that a `cap` `(W,)` comes, or goes, of a landmark at an offset with these `moments` `(WIDTH,)`."""
    changes, offsets, caps = scratch.told[CHANGES], scratch.told[OFFSETS], scratch.caps
    offsets[count, 0], offsets[count, 1], offsets[count, 2] = x, y, z
    for j in range(np.uint64(WIDTH)):
        changes[count, j] = moments[j]
    for w in range(np.uint64(len(cap))):
        caps[count, w] = cap[w]
    caps[count, len(cap)] = goes


@inlined
def note_landmark(count, goes, i, p, field, state, scratch):
    """Write down that landmark i comes, or `goes`, at position p, as change `count` there."""
    (ax, ay, az, nx, ny, nz), positions = pose_of(i, state.coverage), field.coverage.positions
    moments = scratch.told[CHANGES][-1]
    x, y, z = ax - positions[0, p], ay - positions[1, p], az - positions[2, p]
    moments_of(x, y, z, nx, ny, nz, field.precision, i, moments)
    _note_change(count, goes, x, y, z, moments, state.coverage.caps[i, p], scratch)


@inlined
def list_changes(k, p, field, state, scratch):
    """Write down which caps come or go at position p, and return how many: of landmark k, and of those that flip."""
    known, trial, positions, count = state.coverage, scratch.coverage, field.coverage.positions, ZERO
    seen = trial.seen
    if known.reachable[k, p] & (known.hides[HIDDEN, k, p] == 0):
        ax, ay, az, _, _, _ = pose_of(k, known)
        x, y, z = ax - positions[0, p], ay - positions[1, p], az - positions[2, p]
        _note_change(count, ALL, x, y, z, scratch.told[LEFT, p], known.caps[k, p], scratch)
        count += ONE
    if trial.flags[REACHED, p] & (trial.hides[HIDDEN, p] == 0):
        _note_change(
            count, ZERO, seen[X, p], seen[Y, p], seen[Z, p], scratch.told[TRIED, p], trial.sets[FRESH, p], scratch
        )
        count += ONE
    if trial.flags[TOUCHED, p]:
        for m in range(list_turning(p, known, trial)):
            note_landmark(count, trial.lists[GOES, m], trial.lists[NAMES, m], p, field, state, scratch)
            count += ONE
    return count


@inlined
def add_change(e, p, sign, field, state, scratch):
    """Add to the sums what change e of position p adds to all views in its cap, or takes, times `sign`."""
    sight, axes, caps = field.coverage.cameras.sight, field.coverage.cameras.axes, scratch.caps
    offsets, moments, words = scratch.told[OFFSETS], scratch.told[CHANGES], np.uint64(state.localised.shape[1])
    goes = caps[e, words]
    for w in range(words):
        left = caps[e, w]
        while left:
            bit = lowest(left)
            left &= left - ONE
            view, a = (p * words + w) * VIEW + bit, w * VIEW + bit
            add_shares(field.precision, state.sums, view, e, a, sign, sight, axes, offsets, moments, goes)


@inlined
def add_shares(precision, sums, v, e, a, sign, sight, axes, offsets, moments, goes):
    """Add what change e of a position adds to axis a, or takes if it `goes`, to row v of `sums`.

    Inlined: to hand on field, state and scratch costs more than the work itself.
    """
    weight = pixel_density(sight, offsets[e, 0], offsets[e, 1], offsets[e, 2], axes, a)
    factor = -sign if goes else sign
    for j in range(np.uint64(sums.shape[1])):
        sums[v, j] += factor * share_of(moments[e, j], weight)
    count_tag(precision, sums, v, factor)
