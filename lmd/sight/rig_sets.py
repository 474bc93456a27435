"""Sets of the orientations of a rig's body with which the cameras cover each landmark, for each position of the body.

Sets are bit sets; the set of a rig is the union over its cameras.
"""

import math
from typing import Any, TypeAlias

import numpy as np

from lmd.core.bits import ALL, BITS, LANES, ONE, ZERO, Integer, WordArray, lowest
from lmd.core.checks import FloatArray
from lmd.core.compiled import for_kernels, inlined, inner, kernel
from lmd.geometry.vectors import Vector, dot3, minus3, pair3, plus3, row3
from lmd.scene.criteria import covers, frame_of, from_position, sized
from lmd.sight.kernels import count_set
from lmd.sight.mount_occlusion import find_suspects, hidden_bits, list_occluders
from lmd.sight.mounts import (
    ANY,
    MountGroup,
    blocked_bits,
    bounds_from,
    camera_at,
    covered_bits,
    places_around,
    split_by_certainty,
    table_row,
)
from lmd.sight.obstacles import find_ends, is_clear, new_ends, obstacles_at
from lmd.sight.viewpoint import gather_near, viewpoint_for
from lmd.space.blockers import Blockers
from lmd.space.triangles import Triangles

Blocking: TypeAlias = Blockers | Triangles | None
Poses: TypeAlias = tuple[FloatArray, FloatArray, FloatArray]  # see `covered_sets`


@inlined
def _fill_viewpoint_around(group: Any, c: Integer, view: Any, count: Integer, body: Vector, start: Any) -> None:
    """Compute the fields of `view` for its first `count` landmarks, as seen from centre c of a mount group.

    `body` is the position of the body, metres. `start` `(K,)` receives the least depth, metres, at which a landmark is
    certainly covered, if its image is far enough from the border of the field of view (`SightModel.inset`).
    """
    near, x, y, z, squared, high, sure_depth, reached = (
        view.near_poses, view.x, view.y, view.z, view.squared, view.high, view.sure_depth, view.reached
    )  # fmt: skip
    u, v, w, close = view.u, view.v, view.w, view.close
    centre, radius = plus3(body, row3(group.centres, c)), group.radius[c]
    for k in range(count):
        place, normal = pair3(near, k)
        offset = minus3(place, centre)
        in_reach, most, begin, sure = bounds_from(group, c, view.near_index[k], offset, normal)
        (x[k], y[k], z[k]), squared[k] = offset, dot3(offset, offset)
        reached[k], high[k], start[k], sure_depth[k] = in_reach, most, begin, sure
    if group.sight.reach >= 0.0:
        width = math.sqrt(group.sight.reach)
        for k in range(count):
            distance = math.sqrt(squared[k])
            scale = 0.0 if distance == 0.0 else 1.0 / distance
            u[k], v[k], w[k] = scale * x[k], scale * y[k], scale * z[k]
            # Upper bound on the sine of the angle between landmark k and a landmark that k may hide, see
            # `mount_occlusion`.
            close[k] = width / (distance - radius) + radius * scale if distance > radius + width else 2.0


@kernel
def _add_covered(
    positions: FloatArray, group: Any, landmarks: FloatArray, normals: FloatArray, slack: FloatArray, n: Integer,
    keep: bool, seen: WordArray,
) -> None:  # fmt: skip
    """Add to the sets `seen` the orientations at which the cameras of a mount group cover each landmark.

    Args:
        positions: positions of the body, in blocks of neighbours, `(P, 3)`, metres.
        group: mounts; if their model of sight is `unhidden`, occlusion by landmarks is ignored.
        landmarks, normals: positions, metres, and unit normals, `(1, 3, K)`.
        slack: distance by which each landmark may be moved in its plane, `(K,)`, metres. If it is positive, an
            orientation counts if it may cover the moved landmark, and all occlusion is ignored for this landmark.
        n: number of covered landmarks after which a position and orientation needs no further test.
        keep: True to ignore n and test all landmarks.
        seen: bit sets of orientations in W words, `(1, P, K, W)` for the group, or `(M, P, K, W)` for each of its M
            mounts. The latter requires `keep`.
    """
    sight, words, total = group.sight, np.uint64(seen.shape[3]), landmarks.shape[2]
    poses, indices, order = np.empty((6, total)), np.arange(total), np.arange(len(positions))
    obstacles = group.obstacles
    clear, ends, view = is_clear(obstacles), new_ends(obstacles, total), viewpoint_for(total)
    for k in range(total):
        for i in range(3):
            poses[i, k], poses[3 + i, k] = landmarks[0, i, k], normals[0, i, k]
        if not clear:
            place, normal = pair3(poses, k)
            find_ends(obstacles, sized(sight, k), place, normal, ends, k)
    near, x, y, z, index, shown = view.near_poses, view.x, view.y, view.z, view.near_index, view.shown
    reached, high, sure_depth = view.reached, view.high, view.sure_depth
    start, row, suspects = np.empty(total), np.empty(total, np.uint64), np.empty(total + 1, np.int64)
    close = np.zeros((total, total // LANES + 1), np.uint32)
    at_least, doubtful = np.empty((n, words), dtype=np.uint64), np.empty(total, dtype=np.bool_)
    mounts, each = len(group.axes), len(seen) > 1
    undecided, sure = np.empty((total, mounts, words), np.uint64), np.empty((total, mounts, words), np.uint64)
    loose, width = slack.max() > 0.0, math.sqrt(max(sight.reach, 0.0))
    many = count = 0
    for p in range(len(positions)):
        part, body = (0, len(order), order, positions), row3(positions, p)
        many, count = gather_near(p, part, group.horizon, many, count, poses, indices, view)
        at_least[:] = ZERO
        if loose:
            for k in range(count):
                _add_within_slack(group, body, pair3(near, k), index[k], slack[index[k]], seen[0, p, index[k]])
        for c in range(len(group.centres)):
            _fill_viewpoint_around(group, c, view, count, body, start)
            radius = group.radius[c]
            begin, end, listed, blocks = group.mounts[c], group.mounts[c + 1], 0, (count + LANES - 1) // LANES
            for k in range(count):
                if reached[k] and not (loose and slack[index[k]] > 0.0):
                    shown[listed], row[k] = k, table_row(group, c, (x[k], y[k], z[k]))
                    listed += 1
            found, listed = listed, 0
            for e in range(found):
                k = shown[e]
                some_left, index_of_k, offset = ZERO, index[k], (x[k], y[k], z[k])
                bounds = high[k], start[k], sure_depth[k]
                for m in range(begin, end):
                    for w in range(words):
                        sure[k, m, w], undecided[k, m, w] = split_by_certainty(
                            group, m, w, ALL, words, offset, bounds, row[k]
                        )
                        some_left |= sure[k, m, w] | undecided[k, m, w]
                if some_left == ZERO:
                    continue
                doubtful[k] = sight.reach >= 0.0 and find_suspects(k, view, count, radius, close[k])
                doubtful[k] |= not clear
                shown[listed] = k
                listed += 1
                for w in range(words):
                    for m in range(begin, end if not doubtful[k] else begin):
                        seen[m if each else 0, p, index_of_k, w] |= sure[k, m, w]
                    if not keep:
                        count_set(at_least, w, seen[0, p, index_of_k, w])
            for e in range(listed):
                k = shown[e]
                index_of_k, occluders = index[k], -1
                pose = pair3(near, k)
                frame = frame_of(sized(sight, index_of_k), pose[1])
                for m in range(begin, end):
                    for w in range(words):
                        s = m if each else 0
                        mine, left, visible = seen[s, p, index_of_k, w], undecided[k, m, w], ZERO
                        if doubtful[k]:
                            left |= sure[k, m, w]
                        left &= ~mine if keep else ~(mine | at_least[n - 1, w])
                        visible, left = left & sure[k, m, w], left & undecided[k, m, w]
                        visible |= covered_bits(group, m, w, left, index_of_k, body, pose, frame)
                        if visible and occluders < 0:
                            occluders = 0
                            if doubtful[k] and sight.reach >= 0.0:
                                occluders = list_occluders(k, view, radius, width, close[k], blocks, suspects)
                        if visible and not clear:
                            visible &= ~blocked_bits(group, m, w, visible, index_of_k, np.uint64(p), ends, index_of_k)
                        for i in range(occluders if visible else 0):
                            one, j = pair3(near, suspects[i]), index[suspects[i]]
                            visible &= ~hidden_bits(group, m, w, visible, j, index_of_k, body, one, pose)
                        if visible:
                            seen[s, p, index_of_k, w] = mine | visible
                            if not keep:
                                count_set(at_least, w, visible)
            if not keep:
                at_least[:] = ZERO


@inner
def _add_within_slack(group: Any, body: Vector, pose: Any, k: Integer, slack: Any, seen: Any) -> None:
    """Add to the set `seen` the orientations that may cover landmark k, moved by up to `slack` metres in its plane.

    `seen` is a bit set of words of 64 bits. `body` is the position of the body, metres; `pose` is the position and the
    unit normal of the landmark. Occlusion is ignored. Nothing is added if `slack` is 0.
    """
    sight, (place, normal) = sized(group.sight, k), pose
    if slack == 0.0:
        return
    for m in range(len(group.axes)):
        axes = group.axes[m]
        for w in range(np.uint64(len(seen))):
            left = group.tables[ANY, (len(group.axes) + m) * len(seen) + np.int64(w)]
            while left:
                bit = lowest(left)
                a = w * np.uint64(BITS) + bit
                left &= left - ONE
                offset = minus3(place, camera_at(group, m, a, body))
                reached, low, _, _ = from_position(sight, offset, normal, slack)
                if reached and covers(sight, offset, normal, low, slack, axes, a):
                    seen[w] |= ONE << bit


def covered_sets(
    groups: tuple[MountGroup, ...], blockers: Blocking, positions: FloatArray, poses: Poses, n: int = 0
) -> np.ndarray:
    """Sets of the orientations at which at least one camera of a rig covers each landmark, `(P, K, W)`.

    A set is a bit set of W words of 64 bits, for a position of the body and a landmark.

    Args:
        groups: the mounts of the rig.
        blockers: bodies of the room that block lines of sight; None without such bodies.
        positions: positions of the body, `(P, 3)`, metres.
        poses: positions, metres, and unit normals of the landmarks, `(K, 3)`, and their slack, `(K,)`, metres: the
            distance by which a landmark may be moved in its plane.
        n: number of covered landmarks after which a position and orientation needs no further test; 0 to test all
            landmarks.
    """
    seen = _empty_sets(1, groups[0], positions, poses)
    for group in groups:
        _add_group(group, blockers, positions, poses, n, seen)
    return np.asarray(seen[0])


def covered_sets_by_mount(group: MountGroup, blockers: Blocking, positions: FloatArray, poses: Poses) -> np.ndarray:
    """Sets of the orientations at which the camera on each mount of a group covers each landmark, `(M, P, K, W)`.

    Sets and arguments are as in `covered_sets`.
    """
    seen = _empty_sets(len(group.axes), group, positions, poses)
    _add_group(group, blockers, positions, poses, 0, seen)
    return seen


def _empty_sets(count: int, group: MountGroup, positions: FloatArray, poses: Poses) -> np.ndarray:
    """Empty bit sets of orientations for each of `count` mounts, each position and landmark, `(count, P, K, W)`."""
    return np.zeros((count, len(positions), len(poses[0]), group.axes.shape[2] // BITS), dtype=np.uint64)


def _add_group(
    group: MountGroup, blockers: Blocking, positions: FloatArray, poses: Poses, n: int, seen: np.ndarray
) -> None:
    """Add to `seen` the orientations with which the cameras of one group cover each landmark.

    `seen` is as in `_add_covered`; other arguments are as in `covered_sets`.
    """
    landmarks, normals, slack = poses
    points, directions = (for_kernels(v.T[None]) for v in (landmarks, normals))
    obstacles = obstacles_at(blockers, places_around(positions, group) if blockers is not None else positions)
    group = group._replace(horizon=group.horizon + float(slack.max(initial=0.0)), obstacles=obstacles)
    _add_covered(positions, group, points, directions, slack, max(n, 1), n == 0, seen)
