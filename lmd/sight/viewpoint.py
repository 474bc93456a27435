"""Landmarks seen from one camera position: near, within reach, not blocked by the room, not hidden by other landmarks.

Every decision repeats the float64 operations of the reference in their order. Users: `lmd.sight.kernels` counts the
landmarks, `lmd.objectives.localisation` sums up their information, `lmd.sight.views` tests single orientations, and
`lmd.sight.poses` tests each landmark without the other landmarks.

Landmarks are dropped in stages, the cheapest first:

1. landmarks farther than the horizon (a distance) from a region, which is 16 blocks of positions, then from a block;
2. for each position, landmarks that are too near or too far, or that face away from the camera;
3. landmarks that the room blocks;
4. landmarks that other landmarks hide. An occluder lies in nearly the direction of the hidden landmark: a test in
   single precision finds the possible occluders, and the exact test decides.
"""

import math
from typing import Any, NamedTuple

import numpy as np

from lmd.core.bits import LANES, Integer
from lmd.core.checks import FloatArray
from lmd.core.compiled import allocating, inlined, inner
from lmd.geometry.vectors import Vector, dot3, minus3, pair3, row3
from lmd.scene.criteria import from_position, hide_between, sized
from lmd.sight.blocks import BLOCK, SINGLE_ERROR
from lmd.sight.directions import EMPTY_ROW, band_of, cell_of
from lmd.sight.obstacles import find_ends, is_blocked

REGION = 16 * BLOCK  # positions in a region; landmarks beyond its horizon are not tested for its blocks


class Viewpoint(NamedTuple):
    """Working memory for K landmarks as seen from one position; the next position overwrites it.

    `near_poses` lists the landmarks that may be seen. Entry k of the fields from `x` to `close` belongs to landmark k
    of this list.
    """

    region_poses: np.ndarray
    """`(6, K)` positions (metres) and unit normals of the landmarks that are at most the horizon away from the present
    region (16 blocks of positions).
    """
    region_index: np.ndarray
    """`(K,)` indices in the deployment of the landmarks in `region_poses`."""
    near_poses: np.ndarray
    """`(6, K)` positions (metres) and unit normals of the landmarks that are at most the horizon away from the present
    block of positions.
    """
    near_index: np.ndarray
    """`(K,)` indices in the deployment of the landmarks in `near_poses`."""
    x: np.ndarray
    """`(K,)` first coordinate of the landmark's offset from the camera position, world frame, metres."""
    y: np.ndarray
    """`(K,)` second coordinate of the landmark's offset, metres."""
    z: np.ndarray
    """`(K,)` third coordinate of the landmark's offset, metres."""
    squared: np.ndarray
    """`(K,)` squared length of the landmark's offset, m^2."""
    low: np.ndarray
    """`(K,)` least depth at which an orientation may cover the landmark, metres, see `criteria.from_position`."""
    high: np.ndarray
    """`(K,)` greatest depth at which an orientation may cover the landmark, metres."""
    sure_depth: np.ndarray
    """`(K,)` depth `sure`, up to which a certain axis covers the landmark, metres, see `criteria.from_position`."""
    bottom: np.ndarray
    """`(K,)` index. For a model without tables: first bin of height (z coordinate) of the axes that may cover the
    landmark, see `directions.band_of`. For a model with tables: row of the table `CERTAIN` with the axes that certainly
    cover the landmark.
    """
    top: np.ndarray
    """`(K,)` index. For a model without tables: last bin of height of the axes that may cover the landmark. For a model
    with tables: row of the table `POSSIBLE` with the axes that may cover the landmark.
    """
    reached: np.ndarray
    """`(K,)` True if some orientation may cover the landmark."""
    u: np.ndarray
    """`(K,)` first coordinate of the unit direction to the landmark; float32, padded to a multiple of `LANES`, as are
    `v`, `w` and `close`.
    """
    v: np.ndarray
    """`(K,)` second coordinate of the unit direction to the landmark."""
    w: np.ndarray
    """`(K,)` third coordinate of the unit direction to the landmark."""
    close: np.ndarray
    """`(K,)` limit on the angle at which the landmark may hide another: least squared cosine of the angle between the
    directions of both landmarks; for a rig, the sine `close` of `lmd.sight.mount_occlusion`.
    """
    shown: np.ndarray
    """`(K,)` list of the landmarks that some orientation sees; the caller stores the length of the list."""


@allocating
def viewpoint_for(count: Integer) -> Viewpoint:
    """Return a new `Viewpoint` for `count` landmarks, not yet filled."""
    whole = (count + LANES - 1) & -LANES
    return Viewpoint(
        np.empty((6, count)), np.empty(count, np.int64), np.empty((6, count)), np.empty(count, np.int64),
        np.empty(count), np.empty(count), np.empty(count), np.empty(count), np.empty(count), np.empty(count),
        np.empty(count), np.empty(count, np.int32), np.empty(count, np.int32), np.empty(count, np.bool_),
        np.zeros(whole, np.float32), np.zeros(whole, np.float32), np.zeros(whole, np.float32),
        np.full(whole, 2.0, np.float32), np.empty(count, np.uint64),
    )  # fmt: skip


@inner
def box_around(positions: FloatArray, among: np.ndarray) -> Any:
    """Bounding box of the positions with the indices `among`: lowest and highest corner, three numbers each."""
    low = high = positions[among[0], 0], positions[among[0], 1], positions[among[0], 2]
    for p in among[1:]:
        x, y, z = positions[p, 0], positions[p, 1], positions[p, 2]
        low = min(low[0], x), min(low[1], y), min(low[2], z)
        high = max(high[0], x), max(high[1], y), max(high[2], z)
    return low, high


@inner
def gather(
    low: Any, high: Any, horizon: float, count: Integer, poses: FloatArray, indices: np.ndarray, near: FloatArray,
    index: np.ndarray,
) -> Any:  # fmt: skip
    """Copy the landmarks that are at most `horizon` metres from a box; return their number.

    Args:
        low, high: corners of the box, three numbers each.
        horizon: distance beyond which a landmark has no effect, metres.
        count: number of landmarks to test.
        poses: positions and normals of the landmarks, `(6, K)`.
        indices: indices of the landmarks in the deployment, `(K,)`.
        near: receives positions and normals of the landmarks found, `(6, K)`.
        index: receives the indices, in the deployment, of the landmarks found, `(K,)`.
    """
    most, found = horizon * horizon, 0
    for k in range(count):
        x, y, z = poses[0, k], poses[1, k], poses[2, k]
        dx, dy = max(low[0] - x, x - high[0], 0.0), max(low[1] - y, y - high[1], 0.0)
        dz = max(low[2] - z, z - high[2], 0.0)
        near[0, found], near[1, found], near[2, found] = x, y, z
        near[3, found], near[4, found], near[5, found] = poses[3, k], poses[4, k], poses[5, k]
        index[found] = indices[k]
        found += dx * dx + dy * dy + dz * dz <= most
    return found


@inner
def load_deployment(
    b: Integer, landmarks: FloatArray, normals: FloatArray, sight: Any, room: Any, poses: FloatArray
) -> None:
    """Write the landmarks of one of B deployments into `poses` `(6, K)`: positions, metres, and unit normals.

    `landmarks` and `normals` `(B, 3, K)` are those of all deployments, and b is the index of the deployment. `room` is
    the tuple described in `is_shown`. If the room has obstacles, the required points of the landmarks are written into
    the last entry of this tuple, by `obstacles.find_ends`.
    """
    obstacles, clear, ends = room
    for k in range(landmarks.shape[2]):
        for i in range(3):
            poses[i, k], poses[3 + i, k] = landmarks[b, i, k], normals[b, i, k]
        if not clear:
            place, normal = pair3(poses, k)
            find_ends(obstacles, sized(sight, k), place, normal, ends, k)


@inlined
def gather_near(
    o: Integer, part: Any, horizon: float, many: Integer, count: Integer, poses: FloatArray, indices: np.ndarray,
    view: Viewpoint,
) -> Any:  # fmt: skip
    """List the landmarks near position `order[o]`, in two lists in `view`.

    The first list has the landmarks near the position's region (16 blocks of positions). The second list has the part
    of the first list that is near the position's block. Positions are visited in the order `order`. A list is updated
    only at the first position of its region or block, and is valid for the other positions there.

    Args:
        part: tuple of `first`, `last`, `order` and `positions`: the caller visits the positions `order[first:last]`.
        horizon: distance beyond which a landmark has no effect, metres.
        many, count: numbers of landmarks in the first and in the second list, for the previous position.
        poses, indices: positions and unit normals of all landmarks, `(6, K)`, and their indices, `(K,)`.
        view: working memory with both lists.

    Returns:
        many, count: numbers of landmarks in the first and in the second list, for position `order[o]`.
    """
    first, last, order, positions = part
    if o == first or o % REGION == 0:
        low, high = box_around(positions, order[o : min(o - o % REGION + REGION, last)])
        many = gather(low, high, horizon, len(indices), poses, indices, view.region_poses, view.region_index)
    if o == first or o % BLOCK == 0:
        low, high = box_around(positions, order[o : min(o - o % BLOCK + BLOCK, last)])
        count = gather(low, high, horizon, many, view.region_poses, view.region_index, view.near_poses, view.near_index)
        view.close[count : (count + BLOCK - 1) & -BLOCK] = 2.0  # padding: an unreachable threshold
    return many, count


@inlined
def fill_viewpoint(view: Viewpoint, count: Integer, camera: Vector, sight: Any, tables: Any) -> None:
    """Compute the fields of `view` for its first `count` landmarks, as seen from the position `camera`.

    The fields hold for all orientations. `tables` has the result of `directions.tables`; None for a model of sight
    without tables.
    """
    near, index, x, y, z, squared, low, high, sure_depth = (
        view.near_poses, view.near_index, view.x, view.y, view.z, view.squared, view.low, view.high, view.sure_depth
    )  # fmt: skip
    bottom, top, reached, u, v, w, close = view.bottom, view.top, view.reached, view.u, view.v, view.w, view.close
    for k in range(count):
        # Local variables, as reading back from the arrays would keep the loop from vectorising.
        place, normal = pair3(near, k)
        offset = minus3(place, camera)
        in_reach, least, most, sure = from_position(sized(sight, index[k]), offset, normal, 0.0)
        if tables is None:
            bottom[k], top[k] = band_of(offset, least, 0.0)
        else:
            cell = cell_of(offset)
            bottom[k], top[k] = EMPTY_ROW if sure < math.inf else cell, cell
        (x[k], y[k], z[k]), squared[k] = offset, dot3(offset, offset)
        reached[k], low[k], high[k], sure_depth[k] = in_reach, least, most, sure
    if sight.reach >= 0.0:
        for k in range(count):
            here = squared[k] == 0.0  # a landmark at the camera hides all others
            scale = 0.0 if here else 1.0 / math.sqrt(squared[k])
            u[k], v[k], w[k] = scale * x[k], scale * y[k], scale * z[k]
            close[k] = -1.0 if here else 1.0 - SINGLE_ERROR - sight.reach / squared[k]


@inner
def is_hidden(
    k: Integer, count: Integer, index: np.ndarray, x: FloatArray, y: FloatArray, z: FloatArray, squared: FloatArray,
    poses: FloatArray, sight: Any,
) -> bool:  # fmt: skip
    """True if one of the first `count` landmarks hides landmark k.

    Args:
        index: indices in the deployment, `(K,)`.
        x, y, z: offsets from the camera, `(K,)`, metres.
        squared: squared lengths of the offsets, `(K,)`, m^2.
        poses: positions and unit normals, `(6, K)`.
    """
    mine, offset, square, hiding = sized(sight, index[k]), (x[k], y[k], z[k]), squared[k], 0
    _, normal = pair3(poses, k)
    for j in range(count):
        other, (_, facing) = (x[j], y[j], z[j]), pair3(poses, j)
        hides, _ = hide_between(sized(sight, index[j]), mine, other, squared[j], offset, square, facing, normal)
        hiding += hides & (j != k)
    return hiding > 0


@inlined
def is_shown(k: Integer, view: Viewpoint, count: Integer, p: Integer, sight: Any, room: Any) -> Any:
    """True if some orientation sees landmark k from position p: within reach, not blocked by the room, not hidden.

    The first `count` landmarks may hide landmark k. `room` is a tuple: the obstacles, a flag that is True if the room
    has no obstacles, and the results of `obstacles.find_ends`.
    """
    obstacles, clear, ends = room
    if not view.reached[k] or (
        not clear and is_blocked(obstacles, sized(sight, view.near_index[k]), p, ends, view.near_index[k])
    ):
        return False
    if sight.reach < 0.0:
        return True
    u, v, w, close = view.u, view.v, view.w, view.close
    uk, vk, wk, suspects = u[k], v[k], w[k], np.int32(0)
    for j in range(np.uint64((count + BLOCK - 1) & -BLOCK)):
        cosine = u[j] * uk + v[j] * vk + w[j] * wk
        suspects += np.int32(cosine * cosine >= close[j])
    # `suspects` always includes landmark k itself.
    offsets = view.x, view.y, view.z
    return suspects <= 1 or not is_hidden(k, count, view.near_index, *offsets, view.squared, view.near_poses, sight)


@inlined
def list_shown(view: Viewpoint, count: Integer, p: Integer, sight: Any, room: Any) -> Any:
    """List the landmarks that some orientation sees from position p; return their number.

    The landmarks' indices are written into `view.shown`. The arguments are those of `is_shown`, which tests each
    landmark.
    """
    shown, found = view.shown, np.uint64(0)
    for k in range(count):
        if is_shown(k, view, count, p, sight, room):
            shown[found] = k
            found += np.uint64(1)
    return found


@inlined
def see_alone(
    pose: Any, positions: FloatArray, p: Integer, sight: Any, obstacles: Any, ends: Any, bands: np.ndarray
) -> Any:
    """Find the offset of a landmark from position p, and the axes (orientations) that may cover the landmark.

    Occlusion by other landmarks is ignored. The axes are sorted by the z component of the optical axis.

    Args:
        pose: position and unit normal of the landmark.
        positions: positions of the camera, `(P, 3)`, metres.
        ends: required points that `obstacles.find_ends` has written; its first row belongs to this landmark.
        bands: result of `directions.height_index`.

    Returns:
        offset: offset of the landmark, metres.
        low: least depth at which an axis may cover the landmark, metres.
        start, stop: the axes `start` to `stop - 1` may cover the landmark; equal if none does.
    """
    place, normal = pose
    offset = minus3(place, row3(positions, p))
    reached, low, _, _ = from_position(sight, offset, normal, 0.0)
    if not reached or is_blocked(obstacles, sight, p, ends, 0):
        return offset, low, np.int64(0), np.int64(0)
    bottom, top = band_of(offset, low, 0.0)
    return offset, low, bands[bottom], bands[top]
