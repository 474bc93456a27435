"""Information of a rig's views (orientations of the body at a position), summed over the landmarks that are seen.

Each pair of a landmark and a view in which a camera sees the landmark is listed first, because a loop over listed pairs
vectorises. A pair has `WORK` numbers, such as the landmark's offset: number j of pair e is `work[AT[j] + e]`. A word is
64 consecutive orientations, stored as the bits of an integer.
"""

from typing import Any, NamedTuple

import numpy as np
from numba import literal_unroll

from lmd.core.bits import BITS, ONE, ZERO, Integer, WordArray, lowest, prefetch
from lmd.core.checks import FloatArray
from lmd.core.compiled import inlined, inner
from lmd.geometry.squares import upright
from lmd.geometry.vectors import Vector, column3, minus3, plus3, read3, row3, write3
from lmd.objectives.localisation.ambiguity import MIRRORED, least_residual, mirrored_numbers, resolves_ambiguity
from lmd.objectives.localisation.information import (
    BODY_NUMBERS,
    Precision,
    Square,
    about_body,
    gain_of,
    moments,
    share_of,
)
from lmd.objectives.localisation.views import NUMBER, ORIENTATION, TAKEN, VIEW, WHOSE, WORK, BodyViews, whole
from lmd.scene.criteria import pixel_density
from lmd.scene.deployment import Deployment
from lmd.sight.evaluator import Evaluator
from lmd.sight.mounts import MountGroup
from lmd.sight.rig_sets import covered_sets_by_mount

# First index of each group of numbers: offset, weight, offset of the camera, sides of the tag, moments.
AT = tuple(np.uint64(BITS * i) for i in range(WORK))
FIRST_MOMENT = np.uint64(13)


class Mounts(NamedTuple):
    """Data of a `MountGroup` (mounts of a rig with equal cameras) that localisation needs.

    Other data of the group are left out, because the tuple is copied in many calls.
    """

    number: int
    """Index of the mount group in the rig."""
    sight: Any
    """See `MountGroup`."""
    offsets: FloatArray
    """See `MountGroup`."""
    axes: FloatArray
    """See `MountGroup`."""
    gain: float
    """Ratio of the information per pixel of these cameras to that of the rig's first camera, see `gain_of`."""


class GroupCoverage(NamedTuple):
    """Coverage of K landmarks by the M equal cameras of a mount group from P positions of the rig's body."""

    mounts: Mounts
    """Mounts of the cameras."""
    sets: WordArray
    """`(M, P, K, W)` sets of orientations with which each camera covers each landmark."""


def coverage_by_group(
    evaluator: Evaluator, groups: tuple[MountGroup, ...], positions: FloatArray, deployment: Deployment
) -> tuple[GroupCoverage, ...]:
    """Coverage of a deployment by a rig at `positions` `(P, 3)` of its body, for each mount group (equal cameras).

    `groups` are the evaluator's mount groups, or changed copies of these.
    """
    blockers, slack = evaluator.scene.room.blockers(), np.zeros(len(deployment))
    poses = deployment.positions, deployment.normals, slack
    sets = [covered_sets_by_mount(group, blockers, positions, poses) for group in groups]
    return tuple(map(GroupCoverage, mounts_of(evaluator, groups), sets))


def mounts_of(evaluator: Evaluator, groups: tuple[MountGroup, ...]) -> tuple[Mounts, ...]:
    """`Mounts` for each mount group (equal cameras) of a rig.

    `groups` are the evaluator's mount groups, or changed copies of these.
    """
    cameras = evaluator.scene.cameras
    each = enumerate(zip(groups, dict.fromkeys(cameras), strict=True))
    return tuple(Mounts(j, p.sight, p.offsets, p.axes, gain_of(kind, cameras[0])) for j, (p, kind) in each)


@inlined
def numbers_of(precision: Precision) -> np.uint64:
    """Number of sums over landmarks that decide if a view of a rig is localised.

    21 sums are the information about the body's pose. Another 5 are needed if the two poses of a single tag must be
    distinguished.
    """
    return np.uint64(BODY_NUMBERS + MIRRORED if resolves_ambiguity(precision) else BODY_NUMBERS)


@inner
def fill_views(left: np.uint64, precision: Precision, views: BodyViews) -> np.uint64:
    """Set up a view for each orientation in the bit set `left` of a word (64 orientations), with zero information.

    Returns:
        number of views.
    """
    bits, number, rows, count = views.lists[ORIENTATION], views.lists[NUMBER], views.rows, ZERO
    views.lists[TAKEN, 0], views.lists[TAKEN, 1] = left, ZERO
    while left:
        bit = lowest(left)
        bits[count], number[bit] = bit, count
        left &= left - ONE
        count += ONE
    for j in range(numbers_of(precision)):
        for v in range(whole(count)):
            rows[j * VIEW + v] = 0.0
    return count


@inner
def prefetch_sums(sums: FloatArray, first: Integer, views: BodyViews, count: Integer) -> None:
    """Prefetch the rows of `sums` `(V, width)` that `load_sums` reads for the first `count` views.

    Row `first` belongs to the first orientation of the views' word (64 orientations).
    """
    width, bits = np.uint64(sums.shape[1]), views.lists[ORIENTATION]
    for v in range(count):
        at = (first + bits[v]) * width
        prefetch(sums, at)
        prefetch(sums, at + width // np.uint64(2))


@inner
def load_sums(sums: FloatArray, first: Integer, precision: Precision, views: BodyViews, count: Integer) -> None:
    """Add the stored information of the first `count` views to the information in the working memory.

    The views are orientations of one word (64 orientations). Row `first + b` of `sums` `(V, width)` is the stored
    information of the view with orientation b of the word.
    """
    bits, rows = views.lists[ORIENTATION], views.rows
    for v in range(count):
        for j in range(numbers_of(precision)):
            rows[j * VIEW + v] += sums[first + bits[v], j]


@inner
def store_sums(sums: FloatArray, first: Integer, precision: Precision, views: BodyViews, count: Integer) -> None:
    """Add the information of the first `count` views in the working memory to the stored information.

    The views are orientations of one word (64 orientations). Row `first + b` of `sums` `(V, width)` is the stored
    information of the view with orientation b of the word.
    """
    bits, rows = views.lists[ORIENTATION], views.rows
    for v in range(count):
        for j in range(numbers_of(precision)):
            sums[first + bits[v], j] += rows[j * VIEW + v]


def tags_of(precision: Precision, positions: FloatArray, normals: FloatArray) -> FloatArray:
    """Tags as rows `(K, 9)`: centre, and vectors from the centre to the midpoints of the right and of the upper edge,
    metres.
    """
    return np.hstack([positions, *(precision.halves[:, None] * side for side in upright(normals))])


@inlined
def tag_of(tags: FloatArray, k: Integer) -> Square:
    """Three vectors of tag k from the result of `tags_of`: its centre, and the vectors from the centre to the midpoints
    of the right and of the upper edge, metres.
    """
    return row3(tags, k), (tags[k, 3], tags[k, 4], tags[k, 5]), (tags[k, 6], tags[k, 7], tags[k, 8])


@inner
def add_to_body(
    mounts: Mounts, m: Integer, w: Integer, seen: np.uint64, place: Vector, tag: Square, sign: float,
    precision: Precision, views: BodyViews,
) -> None:  # fmt: skip
    """List each pair of a landmark and a view in which one camera of a rig sees this landmark.

    `add_up` adds the information of the listed pairs to the information of the views. `add_up` is also called here when
    the list is full.

    Args:
        mounts, m: the camera, mount m of the mount group `mounts`.
        w, seen: index w of a word (64 orientations of the body), and bit set of its orientations with which the camera
            sees the landmark. Orientations without a view are ignored.
        place: position of the body, metres.
        tag: centre and sides of the landmark, result of `tag_of`.
        sign: 1 to add the information, -1 to subtract it.
        precision: limits of a localised view, with the weight of each corner.
        views: working memory with the views of word w, their information and the list of pairs.
    """
    taken = views.lists[TAKEN]
    left, filled = seen & taken[0], taken[1]
    if left == ZERO:
        return
    number, whose, work = views.lists[NUMBER], views.lists[WHOSE], views.work
    sight, axes, offsets, value = mounts.sight, mounts.axes[m], mounts.offsets[m], sign * mounts.gain
    centre, right, up = tag
    while left:
        bit = lowest(left)
        left &= left - ONE
        a, i = w * VIEW + bit, filled
        arm = column3(offsets, a)
        offset = minus3(centre, plus3(place, arm))
        whose[i] = number[bit]
        write3(work, i, VIEW, offset)
        work[AT[3] + i] = value * pixel_density(sight, offset, axes, a)
        write3(work, AT[4] + i, VIEW, arm)
        write3(work, AT[7] + i, VIEW, right)
        write3(work, AT[10] + i, VIEW, up)
        filled += ONE
        if filled == VIEW:
            taken[1] = filled
            add_up(precision, views)
            filled = ZERO
    taken[1] = filled


@inner
def add_up(precision: Precision, views: BodyViews) -> None:
    """Add the information of the listed pairs of a landmark and a view to the views, and clear the list."""
    rows, work, whose, filled = views.rows, views.work, views.lists[WHOSE], views.lists[TAKEN, 1]
    _find_moments(work, precision.share, filled)
    if resolves_ambiguity(precision):
        _find_mirrored(work, least_residual(precision.residual), filled)
    for i in range(filled):
        v = whose[i]
        for j in range(numbers_of(precision)):
            rows[j * VIEW + v] += work[(FIRST_MOMENT + j) * VIEW + i]
    views.lists[TAKEN, 1] = ZERO


@inner
def _find_moments(work: FloatArray, share: float, filled: Integer) -> None:
    """Compute the information about the body's pose (21 numbers) for the first `filled` pairs in `work`."""
    for i in range(whole(filled)):
        weight, numbers = work[AT[3] + i], moments(_square(work, i), share)
        found = about_body(numbers, read3(work, AT[4] + i, VIEW))
        write3(work, AT[13] + i, VIEW, _shares(found[0:3], weight))
        write3(work, AT[16] + i, VIEW, _shares(found[3:6], weight))
        write3(work, AT[19] + i, VIEW, _shares(found[6:9], weight))
        write3(work, AT[22] + i, VIEW, _shares(found[9:12], weight))
        write3(work, AT[25] + i, VIEW, _shares(found[12:15], weight))
        write3(work, AT[28] + i, VIEW, _shares(found[15:18], weight))
        write3(work, AT[31] + i, VIEW, _shares(found[18:21], weight))


@inlined
def _square(work: FloatArray, i: Integer) -> Square:
    """Tag of pair i: three vectors, metres.

    The first is the offset of the tag's centre from the camera. The others are the vectors from the centre to the
    midpoints of the right and of the upper edge.
    """
    return read3(work, i, VIEW), read3(work, AT[7] + i, VIEW), read3(work, AT[10] + i, VIEW)


@inlined
def _shares(found: Any, weight: float) -> Vector:
    """Results of `share_of` for the three numbers in `found`: each number times `weight`, rounded."""
    return share_of(found[0], weight), share_of(found[1], weight), share_of(found[2], weight)


@inner
def _find_mirrored(work: FloatArray, least: float, filled: Integer) -> None:
    """Compute the `mirrored_numbers` for the first `filled` pairs in `work`.

    The numbers tell if a tag's two poses can be distinguished.
    """
    for i in range(whole(filled)):
        weight = work[AT[3] + i]
        found = mirrored_numbers(_square(work, i), least)
        work[AT[34] + i], work[AT[35] + i] = share_of(found[0], weight), share_of(found[1], weight)
        write3(work, AT[36] + i, VIEW, _shares(found[2:5], weight))


@inner
def _seen_by_group(shown: GroupCoverage, p: Integer, k: Integer, w: Integer) -> np.uint64:
    """Bit set of the orientations with which at least one of a group of equal cameras covers landmark k.

    The set is limited to word w (64 orientations), with the body at position p.
    """
    seen = ZERO
    for m in range(len(shown.sets)):
        seen |= shown.sets[m, p, k, w]
    return seen


@inner
def _add_of_group(
    shown: GroupCoverage, p: Integer, which: np.ndarray, w: Integer, place: Vector, tags: FloatArray,
    precision: Precision, views: BodyViews,
) -> None:  # fmt: skip
    """List the pairs of the landmarks `which` (indices) and the views in which cameras of one mount group see them.

    The views have orientations of word w (64 orientations); see `add_of_all`.
    """
    for k in which:
        tag = tag_of(tags, k)
        for m in range(len(shown.sets)):
            add_to_body(shown.mounts, m, w, shown.sets[m, p, k, w], place, tag, 1.0, precision, views)


@inner
def seen_by_any(every: tuple[GroupCoverage, ...], p: Integer, k: Integer, w: Integer) -> np.uint64:
    """Bit set of the orientations with which at least one camera of a rig covers landmark k.

    The set is limited to word w (64 orientations), with the body at position p.
    """
    seen = ZERO
    for shown in literal_unroll(every):
        seen |= _seen_by_group(shown, p, k, w)
    return seen


@inner
def add_of_all(
    every: tuple[GroupCoverage, ...], p: Integer, which: np.ndarray, w: Integer, place: Vector, tags: FloatArray,
    precision: Precision, views: BodyViews,
) -> None:  # fmt: skip
    """Add the information of the landmarks `which` (indices) to the views in which a rig's cameras see them.

    The body is at position p, with the coordinates `place`, metres, and has the orientations of word w (64
    orientations). `every` has the coverage for each mount group (equal cameras), `tags` is the result of `tags_of`.
    """
    for shown in literal_unroll(every):
        _add_of_group(shown, p, which, w, place, tags, precision, views)
    add_up(precision, views)
