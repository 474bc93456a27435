"""What a rig covers from positions of its body: the landmarks of a deployment seen by the cameras of `mounts`.

What several cameras cover are sets of orientations of the *body*, joined by OR.
"""

import math

import numpy as np

from lmd.core.bits import ALL, BITS, LANES, ONE, ZERO, lowest
from lmd.core.checks import FloatArray
from lmd.core.compiled import for_kernels, inlined, inner, kernel
from lmd.scene.criteria import covers, frame_of, from_position, sized
from lmd.sight.blocks import SINGLE_ERROR
from lmd.sight.mounts import (
    ANY,
    Part,
    blocked_bits,
    bounds_from,
    covered_bits,
    hidden_bits,
    may_hide_around,
    places_around,
    row_from,
    split,
)
from lmd.sight.obstacles import find_ends, is_clear, no_ends, obstacles_at
from lmd.sight.viewpoint import gather_near, viewpoint_for
from lmd.space.blockers import Blockers
from lmd.space.triangles import Triangles


@inlined
def _look_around(part, c, view, count, px, py, pz, start):
    """Find what the first `count` landmarks of `view` are like from centre c of a body at (px, py, pz)."""
    near, x, y, z, squared, high, deep, reached = (
        view.near, view.x, view.y, view.z, view.squared, view.high, view.deep, view.reached
    )  # fmt: skip
    u, v, w, close = view.u, view.v, view.w, view.close
    cx, cy, cz, radius = px + part.centres[c, 0], py + part.centres[c, 1], pz + part.centres[c, 2], part.radius[c]
    for k in range(count):
        xk, yk, zk = near[0, k] - cx, near[1, k] - cy, near[2, k] - cz
        in_reach, most, begin, sure = bounds_from(
            part, c, view.who[k], xk, yk, zk, near[3, k], near[4, k], near[5, k]
        )  # fmt: skip
        x[k], y[k], z[k], squared[k] = xk, yk, zk, xk * xk + yk * yk + zk * zk
        reached[k], high[k], start[k], deep[k] = in_reach, most, begin, sure
    if part.sight.reach >= 0.0:
        width = math.sqrt(part.sight.reach)
        for k in range(count):
            distance = math.sqrt(squared[k])
            scale = 0.0 if distance == 0.0 else 1.0 / distance
            u[k], v[k], w[k] = scale * x[k], scale * y[k], scale * z[k]
            # The sine of the angle to a landmark that it may hide, see `_is_suspect`.
            close[k] = width / (distance - radius) + radius * scale if distance > radius + width else 2.0


@inlined
def _is_suspect(j, k, mine, view):
    """Whether landmark j may hide landmark k from some camera, in single precision; so k itself.

    Seen from elsewhere within the radius, the direction of a landmark at the distance d turns by at most
    asin(radius / d), and it hides within asin(width / (d - radius)): the `sine` of the angle is at most the sum of both
    for the landmark that hides, and of the first, `mine`, for the other.
    """
    u, v, w = view.u, view.v, view.w
    cosine, sine = u[j] * u[k] + v[j] * v[k] + w[j] * w[k], view.close[j] + mine
    return cosine * cosine + sine * sine >= np.float32(1.0 - 2.0 * SINGLE_ERROR)


@inlined
def _turn(k, view, radius):
    """The sine of the angle by which the direction of landmark k may turn, single precision."""
    return np.float32(min(radius / math.sqrt(view.squared[k]), 1.0) if view.squared[k] > 0.0 else 1.0)


@inlined
def _find_suspects(k, view, count, radius, close):
    """Find the landmarks that may hide landmark k, as bits of `close` `(blocks, )`; returns whether there are any."""
    mine, some = _turn(k, view, radius), np.uint32(0)
    for b in range((count + LANES - 1) // LANES):
        found = np.uint32(0)
        for lane in range(np.uint64(LANES)):
            j = np.uint64(b * LANES) + lane
            found |= np.uint32(_is_suspect(j, k, mine, view)) << np.uint32(lane)
        if b == k // LANES:
            found &= ~(np.uint32(1) << np.uint32(k % LANES))
        if b == count // LANES:  # what fills up is none
            found &= (np.uint32(1) << np.uint32(count % LANES)) - np.uint32(1)
        close[b] = found
        some |= found
    return some != 0


@inlined
def _list_occluders(k, view, radius, width, close, blocks, occluders):
    """List those of so many blocks of suspects that may indeed hide landmark k; returns how many."""
    x, y, z, kept = view.x, view.y, view.z, 0
    for b in range(blocks):
        left = np.uint64(close[b])
        while left:
            j = b * LANES + np.int64(lowest(left))
            left &= left - ONE
            occluders[kept] = j
            kept += may_hide_around(x[j], y[j], z[j], x[k], y[k], z[k], radius, width)
    return kept


@inlined
def _pose(poses, k):
    """Position and normal of landmark k of `poses` `(6, K)`."""
    return poses[0, k], poses[1, k], poses[2, k], poses[3, k], poses[4, k], poses[5, k]


@kernel
def _see(positions, part, landmarks, normals, slack, n, keep, seen):
    """Add to `seen` what the cameras of a part cover.

    Args:
        positions: of the body, neighbours in blocks, `(P, 3)`, metres.
        part: where its sight says that none hides another, each landmark is seen on its own.
        landmarks, normals: `(1, 3, K)`.
        slack: see `criteria.from_position`, `(K,)` metres; what blocks a landmark with slack is not asked.
        n, keep: where n landmarks are covered, others are left out unless `keep` is set.
        seen: sets of orientations, `(1, P, K, W)`, or `(M, P, K, W)` of each mount by itself, which `keep` asks for.
    """
    sight, words, total = part.sight, np.uint64(seen.shape[3]), landmarks.shape[2]
    poses, names, order = np.empty((6, total)), np.arange(total), np.arange(len(positions))
    obstacles = part.obstacles
    clear, ends, view = is_clear(obstacles), no_ends(obstacles, total), viewpoint_for(total)
    for k in range(total):
        for i in range(3):
            poses[i, k], poses[3 + i, k] = landmarks[0, i, k], normals[0, i, k]
        if not clear:
            lx, ly, lz, nx, ny, nz = _pose(poses, k)
            find_ends(obstacles, sized(sight, k), lx, ly, lz, nx, ny, nz, ends, k)
    near, x, y, z, reached, who, shown = view.near, view.x, view.y, view.z, view.reached, view.who, view.shown
    high, deep = view.high, view.deep
    start, row, suspects = np.empty(total), np.empty(total, np.uint64), np.empty(total + 1, np.int64)
    close = np.zeros((total, total // LANES + 1), np.uint32)
    some, doubtful = np.empty((n, words), dtype=np.uint64), np.empty(total, dtype=np.bool_)
    mounts, each = len(part.axes), len(seen) > 1
    undecided, sure = np.empty((total, mounts, words), np.uint64), np.empty((total, mounts, words), np.uint64)
    loose, width = slack.max() > 0.0, math.sqrt(max(sight.reach, 0.0))
    many = count = 0
    for p in range(len(positions)):
        many, count = gather_near(p, 0, len(order), order, positions, part.horizon, many, count, poses, names, view)
        px, py, pz = positions[p, 0], positions[p, 1], positions[p, 2]
        some[:] = ZERO
        if loose:
            for k in range(count):
                _see_loosely(part, px, py, pz, near, k, who[k], slack[who[k]], seen[0, p, who[k]])
        for c in range(len(part.centres)):
            _look_around(part, c, view, count, px, py, pz, start)
            radius = part.radius[c]
            begin, end, listed, blocks = part.mounts[c], part.mounts[c + 1], 0, (count + LANES - 1) // LANES
            for k in range(count):
                if reached[k] and not (loose and slack[who[k]] > 0.0):
                    shown[listed], row[k] = k, row_from(part, c, x[k], y[k], z[k])
                    listed += 1
            found, listed = listed, 0
            for e in range(found):
                k = shown[e]
                some_left, name = ZERO, who[k]
                for m in range(begin, end):
                    for w in range(words):
                        sure[k, m, w], undecided[k, m, w] = split(
                            part, m, w, ALL, words, x[k], y[k], z[k], high[k], start[k], deep[k], row[k]
                        )
                        some_left |= sure[k, m, w] | undecided[k, m, w]
                if some_left == ZERO:
                    continue
                doubtful[k] = sight.reach >= 0.0 and _find_suspects(k, view, count, radius, close[k])
                doubtful[k] |= not clear
                shown[listed] = k
                listed += 1
                for w in range(words):
                    for m in range(begin, end if not doubtful[k] else begin):
                        seen[m if each else 0, p, name, w] |= sure[k, m, w]
                    if not keep:
                        _add_to(some, w, seen[0, p, name, w])
            for e in range(listed):
                k = shown[e]
                name, occluders = who[k], -1
                lx, ly, lz, nx, ny, nz = _pose(near, k)
                frame = frame_of(sized(sight, name), nx, ny, nz)
                for m in range(begin, end):
                    for w in range(words):
                        s = m if each else 0
                        mine, left, cap = seen[s, p, name, w], undecided[k, m, w], ZERO
                        if doubtful[k]:
                            left |= sure[k, m, w]
                        left &= ~mine if keep else ~(mine | some[n - 1, w])
                        cap, left = left & sure[k, m, w], left & undecided[k, m, w]
                        cap |= covered_bits(part, m, w, left, name, px, py, pz, lx, ly, lz, nx, ny, nz, frame)
                        if cap and occluders < 0:
                            occluders = 0
                            if doubtful[k] and sight.reach >= 0.0:
                                occluders = _list_occluders(k, view, radius, width, close[k], blocks, suspects)
                        if cap and not clear:
                            cap &= ~blocked_bits(part, m, w, cap, name, np.uint64(p), ends, name)
                        for i in range(occluders if cap else 0):
                            one, other = _pose(near, suspects[i]), (lx, ly, lz, nx, ny, nz)
                            cap &= ~hidden_bits(part, m, w, cap, who[suspects[i]], name, px, py, pz, one, other)
                        if cap:
                            seen[s, p, name, w] = mine | cap
                            if not keep:
                                _add_to(some, w, cap)
            if not keep:
                some[:] = ZERO


@inlined
def _add_to(some, w, cap):
    """Count the orientations of a set of word w in `some` `(n, W)`, of those that cover at least 1, 2, ... n."""
    for j in range(len(some) - 1, 0, -1):
        some[j, w] |= some[j - 1, w] & cap
    some[0, w] |= cap


@inner
def _see_loosely(part, px, py, pz, near, k, name, slack, seen):
    """Add to `seen` `(W,)` the orientations that cover some landmark within `slack` metres of landmark k of `near`.

    `name` is which that is in the deployment.
    """
    sight = sized(part.sight, name)
    lx, ly, lz, nx, ny, nz = near[0, k], near[1, k], near[2, k], near[3, k], near[4, k], near[5, k]
    if slack == 0.0:
        return
    for m in range(len(part.axes)):
        axes = part.axes[m]
        for w in range(np.uint64(len(seen))):
            left = part.tables[ANY, (len(part.axes) + m) * len(seen) + np.int64(w)]
            while left:
                bit = lowest(left)
                a = w * np.uint64(BITS) + bit
                left &= left - ONE
                x = lx - (px + part.offsets[m, 0, a])
                y = ly - (py + part.offsets[m, 1, a])
                z = lz - (pz + part.offsets[m, 2, a])
                reached, low, _, _ = from_position(sight, x, y, z, nx, ny, nz, slack)
                if reached and covers(sight, x, y, z, nx, ny, nz, low, slack, axes, a):
                    seen[w] |= ONE << bit


def seen_by(
    parts: tuple[Part, ...],
    blockers: Blockers | Triangles | None,
    positions: FloatArray,
    landmarks: FloatArray,
    normals: FloatArray,
    slack: FloatArray,
    n: int = 0,
) -> np.ndarray:
    """Sets of the orientations with which some camera covers each landmark, `(P, K, W)`.

    Args:
        positions: of the body, `(P, 3)`, metres.
        landmarks, normals, slack: `(K, 3)` and `(K,)`, see `_see`.
        n: if it is not 0, where n landmarks are in view, others are left out.
    """
    seen = _nothing(1, parts[0], positions, landmarks)
    for part in parts:
        _find(part, blockers, positions, landmarks, normals, slack, n, seen)
    return np.asarray(seen[0])


def seen_by_each(
    part: Part,
    blockers: Blockers | Triangles | None,
    positions: FloatArray,
    landmarks: FloatArray,
    normals: FloatArray,
) -> np.ndarray:
    """The same for each mount of a part by itself, `(M, P, K, W)`."""
    seen = _nothing(len(part.axes), part, positions, landmarks)
    _find(part, blockers, positions, landmarks, normals, np.zeros(len(landmarks)), 0, seen)
    return seen


def _nothing(count: int, part: Part, positions: FloatArray, landmarks: FloatArray) -> np.ndarray:
    """So many empty sets of orientations for each position and landmark."""
    return np.zeros((count, len(positions), len(landmarks), part.axes.shape[2] // BITS), dtype=np.uint64)


def _find(
    part: Part,
    blockers: Blockers | Triangles | None,
    positions: FloatArray,
    landmarks: FloatArray,
    normals: FloatArray,
    slack: FloatArray,
    n: int,
    seen: np.ndarray,
) -> None:
    """Add to `seen`, see `_see`, what a part covers; the others as in `seen_by`."""
    points, directions = (for_kernels(v.T[None]) for v in (landmarks, normals))
    obstacles = obstacles_at(blockers, places_around(positions, part) if blockers is not None else positions)
    part = part._replace(horizon=part.horizon + float(slack.max(initial=0.0)), obstacles=obstacles)
    _see(positions, part, points, directions, slack, max(n, 1), n == 0, seen)
