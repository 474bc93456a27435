"""Where the cameras of a rig are, and what they cover from there: the compiled side of `lmd.scene.rig`.

A *station* is a place of one camera relative to the body's origin. It belongs to those orientations of the body with
which the camera is there: to all of them where it sits in the origin, to a single one where the body turns it around.
From a station everything is as in `lmd.sight.kernels`: distance, incidence, obstacles and who hides whom are the same
for all its orientations, and only these need the test of the image. What several cameras cover is a union of bits.
"""

import math
from typing import Any, NamedTuple

import numpy as np

from lmd.core.bits import BITS, ONE, ZERO, in_words, lowest, packed
from lmd.core.checks import FloatArray
from lmd.core.compiled import for_kernels, kernel
from lmd.scene.criteria import covering, covers, frame_of, from_position
from lmd.scene.rig import Rig
from lmd.scene.scene import Scene
from lmd.sight.blocks import BLOCK, SINGLE_ERROR
from lmd.sight.directions import NOWHERE, cell_of, tables
from lmd.sight.obstacles import find_ends, is_blocked, no_ends, obstacles_at
from lmd.sight.viewpoint import is_hidden
from lmd.space.blockers import Blockers
from lmd.space.triangles import Triangles

SEVERAL = -1  # in place of a station's orientation where it has more than one


class Part(NamedTuple):
    """The cameras of a rig that are alike: M mounts with G stations and D orientations of the body.

    sight the model compiled for these cameras; offsets `(G, 3)` of the stations from the body's origin, world frame,
    metres; mount `(G,)` whose station it is; members `(G, W)` the orientations of the body that it belongs to;
    alone `(G,)` the only one, or `SEVERAL`; axes `(M, 6, 64 W)` optical axis and right of each mount with each
    orientation; certain, possible `(M, cells, W)` the `directions.tables` of those with stations for several, else
    empty.
    """

    sight: Any
    offsets: np.ndarray
    mount: np.ndarray
    members: np.ndarray
    alone: np.ndarray
    axes: np.ndarray
    certain: np.ndarray
    possible: np.ndarray


def parts_of(scene: Scene) -> tuple[Part, ...]:
    """The rig of a scene in parts, one for each kind of camera; none for a scene with a single camera."""
    if not isinstance(scene.camera, Rig):
        return ()
    cameras, (offsets, axes) = scene.camera.cameras, scene.camera.views(scene.orientations.axes)
    kinds = dict.fromkeys(cameras)
    return tuple(
        _part(scene.visibility.sight(kind), offsets[mounts], axes[mounts])
        for kind in kinds
        for mounts in [[m for m, camera in enumerate(cameras) if camera == kind]]
    )


def _part(sight: Any, offsets: FloatArray, axes: FloatArray) -> Part:
    """Mounts with the `offsets` `(M, D, 3)` and the `axes` `(M, D, 6)`."""
    places, mount, members = [], [], []
    for m, offset in enumerate(offsets):
        distinct, station = np.unique(offset, axis=0, return_inverse=True)
        places.append(distinct)
        mount += [m] * len(distinct)
        members.append(station.reshape(-1) == np.arange(len(distinct))[:, None])
    belongs = np.concatenate(members)
    alone = np.where(belongs.sum(axis=1) == 1, belongs.argmax(axis=1), SEVERAL)
    turned = in_words(np.swapaxes(axes, 1, 2))
    looked_up = [tables(sight, each) for each in turned] if (alone == SEVERAL).any() else []
    certain, possible = np.stack(looked_up, axis=1) if looked_up else np.zeros((2, len(axes), 0, 0), dtype=np.uint64)
    return Part(sight, np.concatenate(places), np.array(mount), packed(belongs), alone, turned, certain, possible)


@kernel
def _see(stations, part, obstacles, landmarks, normals, slack, seen):
    """Add to `seen` what the cameras of a part cover.

    Args:
        stations: `(P G, 3)`, those of a position one after the other, metres.
        part: where its sight says that none hides another, each landmark is seen on its own.
        obstacles: what of the room stands in the way of the stations, see `obstacles`.
        landmarks, normals: `(3, K)`.
        slack: see `criteria.from_position`, `(K,)` metres; what blocks a landmark with slack is not asked.
        seen: sets of orientations, `(P, K, W)`.
    """
    sight, members, alone, count = part.sight, part.members, part.alone, landmarks.shape[1]
    x, y, z, squared = np.empty(count), np.empty(count), np.empty(count), np.empty(count)
    low, high, deep = np.empty(count), np.empty(count), np.empty(count)
    # Directions in single precision, as in `kernels.evaluate_range`.
    padded = (count + BLOCK - 1) & -BLOCK
    u, v, t = np.zeros(padded, np.float32), np.zeros(padded, np.float32), np.zeros(padded, np.float32)
    close = np.full(padded, 2.0, np.float32)
    reached, listed = np.empty(count, dtype=np.bool_), np.empty(count + 1, dtype=np.uint64)
    words = np.uint64(members.shape[1])
    caps, ends = np.empty(words, dtype=np.uint64), no_ends(obstacles, count)
    for k in range(count):
        mx, my, mz = landmarks[0, k], landmarks[1, k], landmarks[2, k]
        find_ends(obstacles, sight, mx, my, mz, normals[0, k], normals[1, k], normals[2, k], ends, k)
    for s in range(len(stations)):
        p, g = s // len(members), s % len(members)
        m, only = part.mount[g], alone[g]
        axes, certain, possible = part.axes[m], part.certain[m], part.possible[m]
        px, py, pz, one = stations[s, 0], stations[s, 1], stations[s, 2], max(only, 0)
        ax, ay, az, several = axes[0, one], axes[1, one], axes[2, one], only == SEVERAL
        for k in range(count):
            # Kept in variables: to read back what was just written would keep the loop from vectorising.
            xk, yk, zk, near = landmarks[0, k] - px, landmarks[1, k] - py, landmarks[2, k] - pz, slack[k]
            nx, ny, nz = normals[0, k], normals[1, k], normals[2, k]
            in_reach, least, most, sure = from_position(sight, xk, yk, zk, nx, ny, nz, near)
            depth = ax * xk + ay * yk + az * zk
            x[k], y[k], z[k], squared[k] = xk, yk, zk, xk * xk + yk * yk + zk * zk
            reached[k] = in_reach & (several | ((depth >= least) & ((depth <= most) | (near > 0.0))))
            low[k], high[k], deep[k] = least, most, sure
        if several and sight.reach >= 0.0:
            for k in range(count):
                here = squared[k] == 0.0  # such a landmark hides all others
                scale = 0.0 if here else 1.0 / math.sqrt(squared[k])
                u[k], v[k], t[k] = scale * x[k], scale * y[k], scale * z[k]
                close[k] = -1.0 if here else 1.0 - SINGLE_ERROR - sight.reach / squared[k]
        found = ZERO
        for k in range(count):
            listed[found] = k
            found += np.uint64(reached[k])
        for i in range(found):
            k = listed[i]
            xk, yk, zk, nx, ny, nz = x[k], y[k], z[k], normals[0, k], normals[1, k], normals[2, k]
            some = ZERO
            if several and slack[k] == 0.0:
                frame, cell = frame_of(sight, nx, ny, nz), np.uint64(cell_of(xk, yk, zk))
                given = cell if deep[k] == np.inf else np.uint64(NOWHERE)
                for w in range(words):
                    cap = certain[given, w] & members[g, w]
                    left, well = possible[cell, w] & members[g, w] & ~cap, certain[cell, w]
                    if left:
                        cap |= covering(sight, left, w, xk, yk, zk, frame, low[k], high[k], deep[k], well, axes)
                    caps[w] = cap
                    some |= cap
            else:
                for w in range(words):
                    cap, left = ZERO, members[g, w]
                    while left:
                        bit = lowest(left)
                        a = w * np.uint64(BITS) + bit
                        cap |= np.uint64(covers(sight, xk, yk, zk, nx, ny, nz, low[k], slack[k], axes, a)) << bit
                        left &= left - ONE
                    caps[w] = cap
                    some |= cap
            if some == ZERO or (slack[k] == 0.0 and is_blocked(obstacles, sight, s, ends, k)):
                continue
            suspects = np.int32(2)
            if several and sight.reach >= 0.0:
                uk, vk, tk, suspects = u[k], v[k], t[k], np.int32(0)
                for j in range(np.uint64(padded)):
                    cosine = u[j] * uk + v[j] * vk + t[j] * tk
                    suspects += np.int32(cosine * cosine >= close[j])
            # The landmark itself is always one of the suspects.
            if sight.reach >= 0.0 and suspects > 1 and is_hidden(k, count, x, y, z, squared, normals, sight):
                continue
            for w in range(words):
                seen[p, k, w] |= caps[w]


def seen_by(
    parts: tuple[Part, ...],
    blockers: Blockers | Triangles | None,
    positions: FloatArray,
    landmarks: FloatArray,
    normals: FloatArray,
    slack: FloatArray,
) -> np.ndarray:
    """Sets of the orientations with which some camera covers each landmark, `(P, K, W)`.

    Args:
        parts: the rig.
        blockers: of the room.
        positions: of the body, `(P, 3)`, metres.
        landmarks, normals, slack: `(K, 3)` and `(K,)`, see `_see`.
    """
    points, directions = for_kernels(landmarks.T), for_kernels(normals.T)
    seen = np.zeros((len(positions), len(landmarks), parts[0].members.shape[1]), dtype=np.uint64)
    for part in parts:
        stations = (positions[:, None] + part.offsets).reshape(-1, 3)
        _see(stations, part, obstacles_at(blockers, stations), points, directions, slack, seen)
    return seen
