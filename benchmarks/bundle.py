"""A plain bundle adjustment of tags, written with scipy alone, to set beside `lmd`'s survey.

Residuals are pixels, all equally weighted; a tag is a flat square of a known edge; the tag that is seen most often is
the world. It shares no code with `lmd`: `benchmarks/real.py` hands it corners as OpenCV counts them.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares
from scipy.sparse import csr_matrix

Array = NDArray[np.float64]
Indices = NDArray[np.int64]
CLEAR = 2.0  # a pose of one tag is believed if the error of the other solution is larger by this factor
FARTHEST = np.radians(80.0)  # from the axis, of corners that are used
OUTLIER = 4.0  # pixels off after the robust pass
POOR_START = 7.0  # pixels, of nine residuals in ten
STEP = 1e-6
SQUARE = np.array([[-0.5, 0.5, 0.0], [0.5, 0.5, 0.0], [0.5, -0.5, 0.0], [-0.5, -0.5, 0.0]])


@dataclass(frozen=True)
class Lens:
    """A camera of OpenCV: f_x, f_y, c_x, c_y and four coefficients, of the fisheye model or not."""

    numbers: Array
    fisheye: bool

    @property
    def matrix(self) -> Array:
        """K."""
        f_x, f_y, c_x, c_y = self.numbers[:4]
        return np.array([[f_x, 0.0, c_x], [0.0, f_y, c_y], [0.0, 0.0, 1.0]])

    def rays(self, corners: Array) -> Array:
        """x / z and y / z of what corners `(..., 2)` show."""
        flat = np.ascontiguousarray(corners.reshape(-1, 1, 2))
        undo = cv2.fisheye.undistortPoints if self.fisheye else cv2.undistortPoints
        return undo(flat, self.matrix, self.numbers[4:]).reshape(corners.shape)


def project(points: Array, numbers: Array, fisheye: bool) -> Array:
    """Pixels of points `(N, 4, 3)` in the camera, by numbers `(N, 8)` or `(8,)`."""
    f_x, f_y, c_x, c_y, *k = (number[..., None] for number in np.moveaxis(numbers, -1, 0))
    x, y = points[..., 0] / points[..., 2], points[..., 1] / points[..., 2]
    if fisheye:
        radius = np.hypot(x, y) + 1e-12
        angle = np.arctan(radius)
        square = angle**2
        bent = angle * (1.0 + square * (k[0] + square * (k[1] + square * (k[2] + square * k[3])))) / radius
        return np.stack([f_x * x * bent + c_x, f_y * y * bent + c_y], axis=-1)
    square = x**2 + y**2
    radial = 1.0 + square * (k[0] + square * k[1])
    u = x * radial + 2.0 * k[2] * x * y + k[3] * (square + 2.0 * x**2)
    v = y * radial + k[2] * (square + 2.0 * y**2) + 2.0 * k[3] * x * y
    return np.stack([f_x * u + c_x, f_y * v + c_y], axis=-1)


def moved(pose: Array, points: Array) -> Array:
    """Points `(N, K, 3)` by poses `(N, 6)`: a rotation vector, then a translation."""
    vector, angle = pose[:, None, :3], np.linalg.norm(pose[:, :3], axis=1)[:, None, None]
    safe = np.maximum(angle, 1e-12)
    cross = np.cross(np.broadcast_to(vector, points.shape), points)
    twice = np.cross(np.broadcast_to(vector, points.shape), cross)
    return points + np.sin(safe) / safe * cross + (1.0 - np.cos(safe)) / safe**2 * twice + pose[:, None, 3:]


def matrix_of(pose: Array) -> Array:
    """The 4 x 4 matrix of a pose `(6,)`."""
    result = np.eye(4)
    result[:3, :3], result[:3, 3] = cv2.Rodrigues(pose[:3])[0], pose[3:]
    return result


def pose_of(matrix: Array) -> Array:
    """The pose `(6,)` of a 4 x 4 matrix."""
    return np.concatenate([cv2.Rodrigues(matrix[:3, :3])[0][:, 0], matrix[:3, 3]])


@dataclass(frozen=True)
class Bundle:
    """The result.

    Args:
        ids: of the tags, `(K,)`.
        tags: tag to world, the world being one of the tags, `(K, 4, 4)`; NaN of those that were not placed.
        mounts: first camera to each camera, `(C, 4, 4)`.
        lenses: of the cameras, as given or as found.
        rms: of a coordinate of the residuals, pixels.
        used: sightings in it.
    """

    ids: Indices
    tags: Array
    mounts: Array
    lenses: tuple[Lens, ...]
    rms: float
    used: int


def _seen_alone(rays: Array, edge: float) -> tuple[Array, bool]:
    """Tag to camera by one sighting, and whether the mirrored pose is clearly worse."""
    _, turns, ways, errors = cv2.solvePnPGeneric(SQUARE * edge, rays, np.eye(3), None, flags=cv2.SOLVEPNP_IPPE_SQUARE)
    result = matrix_of(np.concatenate([turns[0][:, 0], ways[0][:, 0]]))
    return result, len(errors) < 2 or float(errors[1][0]) > CLEAR * float(errors[0][0])


def _start(
    frame: Indices, tag: Indices, rays: Array, edge: float, tags: int
) -> tuple[dict[int, Array], dict[int, Array]]:
    """World to camera of frames, and tag to world, chained from the tag that is seen most often."""
    alone = [_seen_alone(one, edge) for one in rays]
    by_frame = {int(one): np.flatnonzero(frame == one) for one in np.unique(frame)}
    placed, poses = {int(np.bincount(tag, minlength=tags).argmax()): np.eye(4)}, dict[int, Array]()
    while True:

        def known(own: Indices) -> int:
            return sum(int(tag[index]) in placed for index in own)

        waiting = [one for one in by_frame if one not in poses and known(by_frame[one])]
        if not waiting:
            return poses, placed
        first = max(waiting, key=lambda one: (known(by_frame[one]), len(by_frame[one])))
        some = [index for index in by_frame[first] if int(tag[index]) in placed]
        points = np.concatenate([_placed(placed[int(tag[index])], edge) for index in some])
        image = np.concatenate([rays[index] for index in some])
        if len(some) == 1:
            pose, clear = alone[some[0]]
            pose = pose @ np.linalg.inv(placed[int(tag[some[0]])])
            if not clear:
                del by_frame[first]
                continue
        else:
            _, turn, way = cv2.solvePnP(points, image, np.eye(3), None, flags=cv2.SOLVEPNP_SQPNP)
            pose = matrix_of(np.concatenate([turn[:, 0], way[:, 0]]))
        poses[first] = pose
        for index in by_frame[first]:
            if int(tag[index]) not in placed and alone[index][1]:
                placed[int(tag[index])] = np.linalg.inv(pose) @ alone[index][0]


def _placed(pose: Array, edge: float) -> Array:
    return SQUARE * edge @ pose[:3, :3].T + pose[:3, 3]


def adjust(
    frame: Indices,
    camera: Indices,
    ids: Indices,
    corners: Array,
    lenses: Sequence[Lens],
    edge: float,
    free: bool = False,
) -> Bundle:
    """Adjust all.

    Args:
        frame, camera, ids: of each sighting, `(N,)`.
        corners: OpenCV's pixels, clockwise from the tag's top left, `(N, 4, 2)`.
        lenses: of the cameras.
        edge: of the tags, metres.
        free: whether the intrinsics are parameters, too.
    """
    names, tag = np.unique(ids, return_inverse=True)
    rays = np.empty_like(corners)
    for index, lens in enumerate(lenses):
        rays[camera == index] = lens.rays(corners[camera == index])
    near = (np.linalg.norm(rays, axis=-1) < np.tan(FARTHEST)).all(axis=1) & np.isfinite(rays).all(axis=(1, 2))
    frame, camera, tag, corners, rays = (part[near] for part in (frame, camera, tag, corners, rays))
    # Each image has its own pose first; those of further cameras are put on mounts then.
    images = frame * len(lenses) + camera
    poses, placed = _start(images, tag, rays, edge, len(names))
    some = np.array([image in poses and int(one) in placed for image, one in zip(images, tag, strict=True)])
    frame, camera, tag, corners, images = (part[some] for part in (frame, camera, tag, corners, images))
    mounts = _mounts(poses, len(lenses))
    moments, at = np.unique(frame, return_inverse=True)
    bodies = np.array([_body(poses, int(moment), mounts) for moment in moments])
    world = int(np.bincount(tag, minlength=len(names)).argmax())
    hung = np.array([pose_of(placed[k]) if k in placed else np.zeros(6) for k in range(len(names))])
    blocks = [hung, bodies, np.array([pose_of(one) for one in mounts]), np.array([lens.numbers for lens in lenses])]
    fixed = [np.zeros(block.shape, dtype=bool) for block in blocks]
    fixed[0][world], fixed[2][0], fixed[3][:] = True, True, not free
    fixed[0][[k not in placed for k in range(len(names))]] = True
    still = [number for number, one in enumerate(fixed) if one.all()]
    moving = np.flatnonzero(~np.concatenate([one.ravel() for one in fixed]))
    x = np.concatenate([block.ravel() for block in blocks])
    shapes, use = [block.shape for block in blocks], np.ones(len(tag), dtype=bool)
    # A start may be many pixels off; the last pass is plain least squares without outliers.
    off = _Problem(tag, at, camera, corners, lenses, edge, shapes, still).residuals(x)
    passes = [("soft_l1", 1.0), ("linear", 1.0)]
    if np.quantile(np.abs(off), 0.9) > POOR_START:
        passes.insert(0, ("soft_l1", 30.0))
    for loss, scale in passes:
        which = np.flatnonzero(use)
        problem = _Problem(tag[which], at[which], camera[which], corners[which], lenses, edge, shapes, still)

        def full(y: Array, x: Array = x) -> Array:
            result = x.copy()
            result[moving] = y
            return result

        fit = least_squares(
            lambda y, problem=problem: problem.residuals(full(y)),
            x[moving],
            lambda y, problem=problem: problem.jacobian(full(y))[:, moving],
            x_scale="jac",
            loss=loss,
            f_scale=scale,
            tr_solver="lsmr",
            max_nfev=40,
            ftol=1e-7,
        )
        x = full(fit.x)
        every = _Problem(tag, at, camera, corners, lenses, edge, shapes, still).residuals(x)
        if scale == 1.0:
            use = np.abs(every.reshape(-1, 8)).max(axis=1) < OUTLIER
    tags, _, found_mounts, numbers = problem.blocks(x)
    hung = np.array([matrix_of(one) for one in tags])
    hung[[k not in placed for k in range(len(names))]] = np.nan
    found = tuple(Lens(one, lens.fisheye) for one, lens in zip(numbers, lenses, strict=True))
    rms = float(np.sqrt(np.mean(problem.residuals(x) ** 2)))
    return Bundle(names, hung, np.array([matrix_of(one) for one in found_mounts]), found, rms, len(problem.tag))


def _mounts(poses: dict[int, Array], cameras: int) -> list[Array]:
    """First camera to each camera: of all moments with both, the one that lies in the middle."""
    mounts = [np.eye(4)]
    for other in range(1, cameras):
        pairs = [image - image % cameras for image in poses if image % cameras == other]
        every = np.array([poses[first + other] @ np.linalg.inv(poses[first]) for first in pairs if first in poses])
        middle = np.median(every, axis=0)
        mounts.append(every[np.abs(every - middle).sum(axis=(1, 2)).argmin()])
    return mounts


def _body(poses: dict[int, Array], moment: int, mounts: Sequence[Array]) -> Array:
    cameras = len(mounts)
    seen = next(k for k in range(cameras) if moment * cameras + k in poses)
    return pose_of(np.linalg.inv(mounts[seen]) @ poses[moment * cameras + seen])


class _Problem:
    """Residuals of sightings, and their derivatives by differences; those of blocks that stand `still` are zero."""

    def __init__(
        self,
        tag: Indices,
        at: Indices,
        camera: Indices,
        corners: Array,
        lenses: Sequence[Lens],
        edge: float,
        shapes: Sequence[tuple[int, ...]],
        still: Sequence[int],
    ) -> None:
        self.tag, self.corners, self.shapes, self.still = tag, corners, shapes, still
        self.of = (tag, at, camera, camera)
        self.square = np.broadcast_to(SQUARE * edge, (len(tag), 4, 3))
        self.fisheye = lenses[0].fisheye

    def blocks(self, x: Array) -> list[Array]:
        """Tags, bodies, mounts and lenses."""
        ends = np.cumsum([shape[0] * shape[1] for shape in self.shapes])
        return [part.reshape(shape) for part, shape in zip(np.split(x, ends[:-1]), self.shapes, strict=True)]

    def _image(self, own: Sequence[Array]) -> Array:
        tag, body, mount, numbers = own
        return project(moved(mount, moved(body, moved(tag, self.square))), numbers, self.fisheye)

    def residuals(self, x: Array) -> Array:
        """Pixels, `(8 N,)`."""
        own = [block[index] for block, index in zip(self.blocks(x), self.of, strict=True)]
        return (self._image(own) - self.corners).ravel()

    def jacobian(self, x: Array) -> csr_matrix:
        """Derivatives by central differences, `(8 N, P)`."""
        own = [block[index] for block, index in zip(self.blocks(x), self.of, strict=True)]
        values, columns, offset = [], [], 0
        for number, (block, index) in enumerate(zip(own, self.of, strict=True)):
            for entry in range(0 if number in self.still else block.shape[1]):
                step = STEP * np.maximum(1.0, np.abs(block[:, entry]))[:, None, None]
                sides = []
                for sign in (1.0, -1.0):
                    changed = block.copy()
                    changed[:, entry] += sign * step[:, 0, 0]
                    sides.append(self._image([*own[:number], changed, *own[number + 1 :]]))
                values.append(((sides[0] - sides[1]) / (2.0 * step)).reshape(-1))
                columns.append(np.repeat(offset + index * block.shape[1] + entry, 8))
            offset += self.shapes[number][0] * self.shapes[number][1]
        entries, size = len(values), len(self.tag) * 8
        data, places = np.stack(values, axis=1), np.stack(columns, axis=1)
        starts = np.arange(size + 1) * entries
        result = csr_matrix((data.ravel(), places.ravel(), starts), shape=(size, offset))
        result.sum_duplicates()
        return result
