"""Frames of a camera in a room with tags.

A frame is assembled from its *faces*: pinhole images, each of which fills a part of the camera's image. Without
distortion, a single face fills the frame. For a distorting lens, faces are remapped to the frame: one face up to a
`Camera.widest_angle` of `ONE_FACE`, otherwise the visible faces of a cube around the camera.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from lmd.core.checks import BoolArray, FloatArray
from lmd.core.optional import optional
from lmd.geometry import projection
from lmd.geometry.camera import Camera
from lmd.geometry.projection import blur_sigma, depth_in_focus, image_size, project, to_camera
from lmd.geometry.se3 import exp
from lmd.render.canvas import NEAR_PLANE, Canvas, covering
from lmd.render.imaging import Float32Array, Imaging, UInt8Array
from lmd.render.room import TaggedRoom
from lmd.space.surface import Surface

# Largest angle from the optical axis in the image of a distorting lens with a single face, rad.
ONE_FACE = math.radians(60.0)
X, Y, Z = np.eye(3)
# Rotations from the camera's frame to the frames of the cube's faces; the last row is the axis of the face: ahead,
# right, left, down, up, back.
CUBE = np.array([(X, Y, Z), (-Z, Y, X), (Z, Y, -X), (X, -Z, Y), (X, Z, -Y), (-X, Y, -Z)]) + 0.0
# Width of the border around the visible part of a face, for interpolation, pixels.
MARGIN = 2.0
# Lower bound on the scale of a face in the image. Without it, the blur in the face would be infinite at the fold of a
# lens, where the scale is 0.
SMALLEST_SCALE = 0.2
# Lower bound on the cosine of the angle from a face's axis, used to correct the blur of a tag.
LEAST_COSINE = 0.5
# Maximum number of images that motion blur averages.
MOST_STEPS = 64
# Ratio of the grey level of people to the grey level of a wall.
PEOPLE_SHADE = 0.6
# Largest distance of a tag behind its surface, metres; a surface hides tags that are farther behind it.
FLUSH = 1e-3


class Face(NamedTuple):
    """Pinhole image that fills a part of the camera's image."""

    turn: FloatArray
    """Rotation matrix from the camera's frame to the frame of the face's pinhole camera, `(3, 3)`."""
    matrix: FloatArray
    """Intrinsic matrix K of the face's pinhole camera, pixels from the outer corner of the top left pixel, `(3, 3)`."""
    size: tuple[int, int]
    """Width and height, pixels."""
    at: tuple[Float32Array, Float32Array] | None
    """Maps for `cv2.remap`, `(h, w)` each; None if the face is the camera's image.

    The maps give the coordinates in the face of each pixel of the camera's image.
    """
    taken: BoolArray | None
    """Mask of the pixels of the camera's image that show the face, `(h, w)`."""

    def scale(self, camera: Camera, point: FloatArray) -> float:
        """Scale of the camera's image relative to the face: pixels of the camera's image per pixel of the face.

        The result is the scale near the image of `point` `(3,)`, a point in the camera's frame.
        """
        if camera.lens is None:
            return 1.0
        ahead, angle = point / np.linalg.norm(point), math.atan2(math.hypot(point[0], point[1]), point[2])
        if angle > camera.widest_angle:  # a part of the tag may still be imaged
            around = math.sin(camera.widest_angle) / math.sin(angle)
            ahead = np.array([around * ahead[0], around * ahead[1], math.cos(camera.widest_angle)])
        cosine = max(float(self.turn[2] @ ahead), LEAST_COSINE)
        here = self.matrix[0, 0] * self.matrix[1, 1] / cosine**3
        density = np.linalg.norm(np.cross(*projection.slope(camera, ahead)))
        return max(SMALLEST_SCALE, math.sqrt(density / here))


@dataclass(frozen=True)
class Renderer:
    """Renderer of a camera in a room with tags."""

    camera: Camera
    """Intrinsics."""
    room: TaggedRoom
    """Tags and surfaces."""
    imaging: Imaging = field(default_factory=Imaging)
    """Light, lens and noise."""

    def frame(self, pose: FloatArray, rng: np.random.Generator, motion: FloatArray | None = None) -> UInt8Array:
        """Render the image from a pose.

        Args:
            pose: pose of the camera, camera to world, in the middle of the exposure, `(4, 4)`.
            rng: random generator for the noise, and for the direction of the motion.
            motion: body twist (w, v) of the camera times the exposure time, rad and metres, `(6,)`; None for a rotation
                in a random direction that blurs the image centre by `Imaging.motion_blur` pixels.

        Returns:
            grey levels of the image, 8 bits, `(h, w)`.
        """
        if motion is None and self.imaging.motion_blur > 0.0:
            motion = self._turn(rng)
        lights = self._lights(pose) if motion is None else self._moving(pose, np.asarray(motion, dtype=np.float64))
        return self.imaging.develop(_assembled(faces_of(self.camera), lights), rng)

    def corners(self, pose: FloatArray) -> FloatArray:
        """Exact image points of the corners of the K tags, for each of the camera poses, `(..., K, 4, 2)`.

        Points are in pixels from the outer corner of the image's top left pixel. Tags outside the image, facing away or
        occluded are included. Points are NaN behind the camera, and beyond the lens's `widest_angle`. `pose`
        `(..., 4, 4)` is camera to world.
        """
        return self._images(pose, self.room.corners)

    def picture_corners(self, pose: FloatArray) -> FloatArray:
        """Exact image points of the corners of the tags' whole pictures, pixels, `(..., K, 4, 2)`.

        In some families the picture is larger than the black square. Argument and result are as in `corners`.
        """
        return self._images(pose, self.room.picture_corners)

    def _images(self, pose: FloatArray, squares: FloatArray) -> FloatArray:
        flat = project(self.camera, pose, squares.reshape(-1, 3))
        return flat.reshape(*flat.shape[:-2], -1, 4, 2)

    def inside(self, pose: FloatArray, margin: float = 0.0) -> BoolArray:
        """Mask of the tags that face the camera with the whole picture in the image, `(..., K)`.

        Args:
            pose: poses of the camera, camera to world, `(..., 4, 4)`.
            margin: least distance of the corners from the border of the image, pixels.
        """
        room, size = self.room, np.array(image_size(self.camera))
        image = self.picture_corners(pose)
        within = ((image >= margin) & (image <= size - margin)).all(axis=(-2, -1))
        towards = pose[..., None, :3, 3] - room.centres
        return np.asarray(within & ((towards * room.normals).sum(axis=-1) > 0.0))

    def _lights(self, pose: FloatArray) -> list[Float32Array]:
        """Light on each face (pinhole image) of the camera's image, rendered from one pose."""
        return [self._light(pose, face) for face in faces_of(self.camera)]

    def _light(self, from_camera: FloatArray, face: Face) -> Float32Array:
        """Light on one face (pinhole image), rendered from the pose `from_camera`, camera to world, `(4, 4)`.

        Surfaces are drawn first, then people, each from far to near, and both are blurred. Then tags are drawn from far
        to near.
        """
        pose = from_camera.copy()
        pose[:3, :3] = from_camera[:3, :3] @ face.turn.T
        canvas = Canvas(face.matrix, face.size, self.imaging)
        position, room = pose[:3, 3], self.room
        seen, people = (_from_afar(surfaces, position) for surfaces in (room.surfaces, room.people_faces))
        outlines = []
        for i, (s, part) in enumerate(seen := seen + people):
            plane = (np.stack([s.u, s.v, s.origin - position]) @ pose[:3, :3]).T
            grey = float(self.imaging.shade(s.normal)) * (PEOPLE_SHADE if i >= len(seen) - len(people) else 1.0)
            outlines.append(canvas.surface(plane, part, grey, self._pattern))
        if seen:
            canvas.blur(self.imaging.psf_sigma)
        squares = to_camera(pose, room.corners.reshape(-1, 3)).reshape(-1, 4, 3)
        offset = position - room.centres
        front = ((offset * room.normals).sum(axis=1) > 0.0) & (squares[..., 2] > NEAR_PLANE).any(axis=1)
        for k in sorted(np.flatnonzero(front), key=lambda k: -float(np.linalg.norm(offset[k]))):
            depth = np.array([(room.centres[k] - s.origin) @ s.normal for s, _ in seen])
            hidden_by = [outlines[i] for i in np.flatnonzero(depth < -FLUSH)]
            canvas.tag(room.tag, int(room.ids[k]), squares[k], self._sigma(squares[k], face), hidden_by)
        return canvas.light

    def _sigma(self, square: FloatArray, face: Face) -> float:
        """Standard deviation of the blur of a tag in one face (pinhole image) of the frame, pixels of the face.

        The result is the blur of the camera's image at the depth of the tag's centre, divided by `Face.scale` at the
        centre. `square` `(4, 3)` has the corners of the tag in the frame of the face, metres.
        """
        centre, sigma, camera = face.turn.T @ square.mean(axis=0), self.imaging.psf_sigma, self.camera
        if self.imaging.defocus:
            sigma = float(blur_sigma(camera, max(float(depth_in_focus(camera, centre)), NEAR_PLANE), sigma))
        return sigma / face.scale(camera, centre)

    def _turn(self, rng: np.random.Generator) -> FloatArray:
        """Draw a rotation of the camera in a random direction that moves the image centre by `Imaging.motion_blur`.

        Return the rotation as a body twist `(6,)`, rad, with zero translation.
        """
        direction = rng.uniform(0.0, 2.0 * math.pi)
        shift = self.imaging.motion_blur * np.array([math.cos(direction), math.sin(direction)])
        right, down = shift / self.camera.focal_pixels
        return np.array([down, -right, 0.0, 0.0, 0.0, 0.0])

    def _moving(self, pose: FloatArray, motion: FloatArray) -> list[Float32Array]:
        """Light on each face, averaged over poses along a motion around `pose`, in steps of about a pixel.

        `motion` is the body twist times the exposure time, rad and metres, `(6,)`.
        """
        ends = [self.corners(pose @ exp(t * motion))[self.inside(pose)] for t in (-0.5, 0.5)]
        shift = np.linalg.norm(ends[1] - ends[0], axis=-1)
        longest = float(np.nanmax(shift)) if np.isfinite(shift).any() else 0.0
        steps = min(1 + math.ceil(longest), MOST_STEPS)
        lights = self._lights(pose @ exp((0.5 / steps - 0.5) * motion))
        for i in range(1, steps):
            for light, more in zip(lights, self._lights(pose @ exp(((i + 0.5) / steps - 0.5) * motion)), strict=True):
                light += more
        return [light / np.float32(steps) for light in lights]

    @property
    def _pattern(self) -> Float32Array | None:
        """Pattern of grey levels on all surfaces; None for plain surfaces."""
        if self.imaging.texture == 0.0:
            return None
        longest = max((float(surface.parts.max()) for surface in self.room.surfaces), default=0.0)
        return covering(self.imaging.texture, self.imaging.texture_seed, longest)


def _from_afar(surfaces: Sequence[Surface], position: FloatArray) -> list[tuple[Surface, FloatArray]]:
    """Trapezoids of the surfaces that face a position `(3,)`, the farthest trapezoid first.

    Returns:
        for each trapezoid, its surface, and its corners in the surface's coordinates (a, b), metres, `(4, 2)`.
    """
    seen = [(s, part) for s in surfaces if (position - s.origin) @ s.normal > 0.0 for part in s.parts]
    return sorted(seen, key=lambda one: -float(np.linalg.norm(_middle(*one) - position)))


def _middle(surface: Surface, part: FloatArray) -> FloatArray:
    """Centre of the bounding box of a part of a surface, world frame, metres, `(3,)`.

    `part` `(M, 2)` has the vertices of the part in the surface's coordinates (a, b), metres.
    """
    a, b = (part.min(axis=0) + part.max(axis=0)) / 2.0
    return np.asarray(surface.origin + a * surface.u + b * surface.v)


@lru_cache(maxsize=2)
def faces_of(camera: Camera) -> tuple[Face, ...]:
    """Faces: the pinhole images from which the image of a camera is assembled.

    The result is cached outside of `Renderer`, so that a pickled renderer is small.
    """
    width, height = image_size(camera)
    if camera.lens is None:
        return (Face(CUBE[0], projection.intrinsics(camera), (width, height), None, None),)
    pixels = np.stack(np.meshgrid(np.arange(width) + 0.5, np.arange(height) + 0.5), axis=-1)
    rays = projection.bearings(camera, pixels)
    imaged = np.isfinite(rays[..., 0])
    if camera.widest_angle <= ONE_FACE:
        return (_face(CUBE[0], camera.focal_pixels, rays, imaged),)
    nearest = np.argmax(np.nan_to_num(rays) @ CUBE[:, 2].T, axis=-1)
    density = np.linalg.norm(np.cross(*np.moveaxis(projection.slope(camera, rays), -2, 0)), axis=-1)  # pixels/sr
    faces = []
    for number, turn in enumerate(CUBE):
        taken = imaged & (nearest == number)
        if taken.any():
            # Everywhere the face has at least the pixel density of the image.
            focal = math.sqrt((density[taken] * (rays[taken] @ turn[2]) ** 3).max())
            faces.append(_face(turn, np.array([focal, focal]), rays, taken))
    return tuple(faces)


def _face(turn: FloatArray, focal: FloatArray, rays: FloatArray, taken: BoolArray) -> Face:
    """Make the smallest face (pinhole image) that contains the rays of the pixels in the mask `taken` `(h, w)`.

    Args:
        turn: rotation matrix from the camera's frame to the frame of the face, `(3, 3)`.
        focal: focal lengths of the face, pixels, `(2,)`.
        rays: rays of all pixels of the camera's image, in the camera's frame, `(h, w, 3)`.
        taken: mask of the pixels that show the face.
    """
    x, y, z = np.moveaxis(rays @ turn.T, -1, 0)
    with np.errstate(all="ignore"):
        at = np.stack([focal[0] * x / z, focal[1] * y / z], axis=-1)
    low, high = np.floor(at[taken].min(axis=0)) - MARGIN, np.ceil(at[taken].max(axis=0)) + MARGIN
    matrix = np.diag([*focal, 1.0])
    matrix[:2, 2] = -low
    under = np.where(taken[..., None], at - low - 0.5, 0.0).astype(np.float32)
    maps = np.ascontiguousarray(under[..., 0]), np.ascontiguousarray(under[..., 1])
    return Face(turn, matrix, (int(high[0] - low[0]), int(high[1] - low[1])), maps, taken)


def _assembled(faces: tuple[Face, ...], lights: list[Float32Array]) -> Float32Array:
    """Image of the camera, assembled from the light on each of its faces; black outside the view of the lens."""
    cv2, whole = optional("cv2", "detection"), lights[0]
    for number, (face, light) in enumerate(zip(faces, lights, strict=True)):
        if face.at is not None and face.taken is not None:
            bent = cv2.remap(light, *face.at, cv2.INTER_CUBIC)
            whole = np.where(face.taken, bent, np.float32(0.0) if number == 0 else whole)
    return whole
