"""Sets of orientations of a rig's body with which its cameras cover each landmark, by position.

Sets are bit sets; the set of a rig is the union over its cameras.
"""

import math
from typing import Any

import numpy as np

from lmd.core.bits import ALL, BITS, LANES, ONE, ZERO, Integer, WordArray, lowest
from lmd.core.checks import FloatArray
from lmd.core.compiled import for_kernels, inlined, inner, kernel
from lmd.scene.criteria import covers, frame_of, from_position, sized
from lmd.sight.mount_occlusion import find_suspects, hidden_bits, list_occluders
from lmd.sight.mounts import (
    ANY,
    MountGroup,
    blocked_bits,
    bounds_from,
    covered_bits,
    places_around,
    split_by_certainty,
    table_row,
)
from lmd.sight.obstacles import find_ends, is_clear, new_ends, obstacles_at
from lmd.sight.viewpoint import gather_near, viewpoint_for
from lmd.space.blockers import Blockers
from lmd.space.triangles import Triangles


@inlined
def _fill_viewpoint_around(
    group: Any, c: Integer, view: Any, count: Integer, px: float, py: float, pz: float, start: Any
) -> None:
    """Fill `view` for its first `count` landmarks, as seen from centre c of a body at (px, py, pz)."""
    near, x, y, z, squared, high, sure_depth, reached = (
        view.near_poses, view.x, view.y, view.z, view.squared, view.high, view.sure_depth, view.reached
    )  # fmt: skip
    u, v, w, close = view.u, view.v, view.w, view.close
    cx, cy, cz, radius = px + group.centres[c, 0], py + group.centres[c, 1], pz + group.centres[c, 2], group.radius[c]
    for k in range(count):
        xk, yk, zk = near[0, k] - cx, near[1, k] - cy, near[2, k] - cz
        in_reach, most, begin, sure = bounds_from(
            group, c, view.near_index[k], xk, yk, zk, near[3, k], near[4, k], near[5, k]
        )  # fmt: skip
        x[k], y[k], z[k], squared[k] = xk, yk, zk, xk * xk + yk * yk + zk * zk
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


@inlined
def _pose(poses: FloatArray, k: Integer) -> Any:
    """Position and unit normal of landmark k of `poses` `(6, K)`, six numbers."""
    return poses[0, k], poses[1, k], poses[2, k], poses[3, k], poses[4, k], poses[5, k]


@kernel
def _add_covered(
    positions: FloatArray, group: Any, landmarks: FloatArray, normals: FloatArray, slack: FloatArray, n: Integer,
    keep: bool, seen: WordArray,
) -> None:  # fmt: skip
    """Add the orientations with which the cameras of a group cover each landmark to `seen`.

    Args:
        positions: positions of the body, in blocks of neighbours, `(P, 3)`, metres.
        group: mounts; if their model is `unhidden`, occlusion by landmarks is ignored.
        landmarks, normals: positions, metres, and unit normals, `(1, 3, K)`.
        slack: see `criteria.from_position`, `(K,)`, metres; obstacles are ignored for a landmark with a slack.
        n: number of covered landmarks that suffices.
        keep: False to stop at n covered landmarks for each position and orientation.
        seen: sets of orientations, `(1, P, K, W)`; or `(M, P, K, W)` by mount, which requires `keep`.
    """
    sight, words, total = group.sight, np.uint64(seen.shape[3]), landmarks.shape[2]
    poses, indices, order = np.empty((6, total)), np.arange(total), np.arange(len(positions))
    obstacles = group.obstacles
    clear, ends, view = is_clear(obstacles), new_ends(obstacles, total), viewpoint_for(total)
    for k in range(total):
        for i in range(3):
            poses[i, k], poses[3 + i, k] = landmarks[0, i, k], normals[0, i, k]
        if not clear:
            lx, ly, lz, nx, ny, nz = _pose(poses, k)
            find_ends(obstacles, sized(sight, k), lx, ly, lz, nx, ny, nz, ends, k)
    near, x, y, z, reached, index, shown = (
        view.near_poses,
        view.x,
        view.y,
        view.z,
        view.reached,
        view.near_index,
        view.shown,
    )
    high, sure_depth = view.high, view.sure_depth
    start, row, suspects = np.empty(total), np.empty(total, np.uint64), np.empty(total + 1, np.int64)
    close = np.zeros((total, total // LANES + 1), np.uint32)
    at_least, doubtful = np.empty((n, words), dtype=np.uint64), np.empty(total, dtype=np.bool_)
    mounts, each = len(group.axes), len(seen) > 1
    undecided, sure = np.empty((total, mounts, words), np.uint64), np.empty((total, mounts, words), np.uint64)
    loose, width = slack.max() > 0.0, math.sqrt(max(sight.reach, 0.0))
    many = count = 0
    for p in range(len(positions)):
        many, count = gather_near(p, 0, len(order), order, positions, group.horizon, many, count, poses, indices, view)
        px, py, pz = positions[p, 0], positions[p, 1], positions[p, 2]
        at_least[:] = ZERO
        if loose:
            for k in range(count):
                _add_within_slack(group, px, py, pz, near, k, index[k], slack[index[k]], seen[0, p, index[k]])
        for c in range(len(group.centres)):
            _fill_viewpoint_around(group, c, view, count, px, py, pz, start)
            radius = group.radius[c]
            begin, end, listed, blocks = group.mounts[c], group.mounts[c + 1], 0, (count + LANES - 1) // LANES
            for k in range(count):
                if reached[k] and not (loose and slack[index[k]] > 0.0):
                    shown[listed], row[k] = k, table_row(group, c, x[k], y[k], z[k])
                    listed += 1
            found, listed = listed, 0
            for e in range(found):
                k = shown[e]
                some_left, index_of_k = ZERO, index[k]
                for m in range(begin, end):
                    for w in range(words):
                        sure[k, m, w], undecided[k, m, w] = split_by_certainty(
                            group, m, w, ALL, words, x[k], y[k], z[k], high[k], start[k], sure_depth[k], row[k]
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
                        _count_set(at_least, w, seen[0, p, index_of_k, w])
            for e in range(listed):
                k = shown[e]
                index_of_k, occluders = index[k], -1
                lx, ly, lz, nx, ny, nz = _pose(near, k)
                frame = frame_of(sized(sight, index_of_k), nx, ny, nz)
                for m in range(begin, end):
                    for w in range(words):
                        s = m if each else 0
                        mine, left, visible = seen[s, p, index_of_k, w], undecided[k, m, w], ZERO
                        if doubtful[k]:
                            left |= sure[k, m, w]
                        left &= ~mine if keep else ~(mine | at_least[n - 1, w])
                        visible, left = left & sure[k, m, w], left & undecided[k, m, w]
                        visible |= covered_bits(
                            group, m, w, left, index_of_k, px, py, pz, lx, ly, lz, nx, ny, nz, frame
                        )
                        if visible and occluders < 0:
                            occluders = 0
                            if doubtful[k] and sight.reach >= 0.0:
                                occluders = list_occluders(k, view, radius, width, close[k], blocks, suspects)
                        if visible and not clear:
                            visible &= ~blocked_bits(group, m, w, visible, index_of_k, np.uint64(p), ends, index_of_k)
                        for i in range(occluders if visible else 0):
                            one, other = _pose(near, suspects[i]), (lx, ly, lz, nx, ny, nz)
                            visible &= ~hidden_bits(
                                group, m, w, visible, index[suspects[i]], index_of_k, px, py, pz, one, other
                            )
                        if visible:
                            seen[s, p, index_of_k, w] = mine | visible
                            if not keep:
                                _count_set(at_least, w, visible)
            if not keep:
                at_least[:] = ZERO


@inlined
def _count_set(at_least: WordArray, w: Integer, visible: Any) -> None:
    """Count a set of orientations of word w; `at_least[j]` of `(n, W)` has the orientations counted more than j
    times.
    """
    for j in range(len(at_least) - 1, 0, -1):
        at_least[j, w] |= at_least[j - 1, w] & visible
    at_least[0, w] |= visible


@inner
def _add_within_slack(
    group: Any, px: float, py: float, pz: float, near: FloatArray, k: Integer, index_of_k: Any, slack: Any, seen: Any
) -> None:
    """Add the orientations that cover some landmark within `slack` metres of landmark k to `seen` `(W,)`.

    `near` `(6, K)` has the poses of the landmarks; `index_of_k` is the index of k in the deployment.
    """
    sight = sized(group.sight, index_of_k)
    lx, ly, lz, nx, ny, nz = near[0, k], near[1, k], near[2, k], near[3, k], near[4, k], near[5, k]
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
                x = lx - (px + group.offsets[m, 0, a])
                y = ly - (py + group.offsets[m, 1, a])
                z = lz - (pz + group.offsets[m, 2, a])
                reached, low, _, _ = from_position(sight, x, y, z, nx, ny, nz, slack)
                if reached and covers(sight, x, y, z, nx, ny, nz, low, slack, axes, a):
                    seen[w] |= ONE << bit


def covered_sets(
    groups: tuple[MountGroup, ...],
    blockers: Blockers | Triangles | None,
    positions: FloatArray,
    landmarks: FloatArray,
    normals: FloatArray,
    slack: FloatArray,
    n: int = 0,
) -> np.ndarray:
    """Sets of the orientations with which some camera covers each landmark, `(P, K, W)`.

    Args:
        groups: the mounts of the rig.
        blockers: bodies of the room that block lines of sight; None for none.
        positions: positions of the body, `(P, 3)`, metres.
        landmarks, normals: positions, metres, and unit normals, `(K, 3)`.
        slack: see `_add_covered`, `(K,)`, metres.
        n: number of covered landmarks that suffices for each position and orientation; 0 to test all landmarks.
    """
    seen = _empty_sets(1, groups[0], positions, landmarks)
    for group in groups:
        _add_group(group, blockers, positions, landmarks, normals, slack, n, seen)
    return np.asarray(seen[0])


def covered_sets_by_mount(
    group: MountGroup,
    blockers: Blockers | Triangles | None,
    positions: FloatArray,
    landmarks: FloatArray,
    normals: FloatArray,
) -> np.ndarray:
    """Sets of the orientations with which each mount of a group covers each landmark, `(M, P, K, W)`."""
    seen = _empty_sets(len(group.axes), group, positions, landmarks)
    _add_group(group, blockers, positions, landmarks, normals, np.zeros(len(landmarks)), 0, seen)
    return seen


def _empty_sets(count: int, group: MountGroup, positions: FloatArray, landmarks: FloatArray) -> np.ndarray:
    """Empty sets of orientations, `(count, P, K, W)`."""
    return np.zeros((count, len(positions), len(landmarks), group.axes.shape[2] // BITS), dtype=np.uint64)


def _add_group(
    group: MountGroup,
    blockers: Blockers | Triangles | None,
    positions: FloatArray,
    landmarks: FloatArray,
    normals: FloatArray,
    slack: FloatArray,
    n: int,
    seen: np.ndarray,
) -> None:
    """Call `_add_covered` for a group; other arguments as in `covered_sets`."""
    points, directions = (for_kernels(v.T[None]) for v in (landmarks, normals))
    obstacles = obstacles_at(blockers, places_around(positions, group) if blockers is not None else positions)
    group = group._replace(horizon=group.horizon + float(slack.max(initial=0.0)), obstacles=obstacles)
    _add_covered(positions, group, points, directions, slack, max(n, 1), n == 0, seen)
