"""The pinhole images that an image is made of: itself, or those that a lens bends.

A lens that shows little more than a pinhole bends one image. A wider one takes those of a cube around the camera, as
many of its faces as it shows.
"""

import math
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from lmd.core.checks import BoolArray, FloatArray
from lmd.core.optional import optional
from lmd.geometry.camera import Camera
from lmd.geometry.projection import bearings, image_size, intrinsics, slope
from lmd.render.imaging import Float32Array

# A lens that shows nothing farther from its axis bends one image.
ONE_FACE = math.radians(60.0)
# From the camera's frame to that of a face, whose axis is the last row: ahead, right, left, down, up, back.
CUBE = np.array(
    [
        [[1, 0, 0], [0, 1, 0], [0, 0, 1]],
        [[0, 0, -1], [0, 1, 0], [1, 0, 0]],
        [[0, 0, 1], [0, 1, 0], [-1, 0, 0]],
        [[1, 0, 0], [0, 0, -1], [0, 1, 0]],
        [[1, 0, 0], [0, 0, 1], [0, -1, 0]],
        [[-1, 0, 0], [0, 1, 0], [0, 0, -1]],
    ],
    dtype=np.float64,
)
MARGIN = 2.0  # pixels around what is taken of a face, for the interpolation between them
SMALLEST_SCALE = 0.2  # where a lens folds it shrinks one direction to nothing, and the blur would be without limit
NEVER_FLATTER = 0.5  # cosine of the angle from a face's axis beyond which a tag is blurred no less


class Face(NamedTuple):
    """A pinhole image, of which a part of the camera's image is made.

    Args:
        turn: from the camera's frame to that of the pinhole, `(3, 3)`.
        matrix: its K, pixels from its border, `(3, 3)`.
        size: its width and height, pixels.
        at: for `cv2.remap`: which of its pixels is under each pixel of the camera's image, `(h, w)` each; None where it
            is that image.
        taken: which pixels of the camera's image are made of it, `(h, w)`.
    """

    turn: FloatArray
    matrix: FloatArray
    size: tuple[int, int]
    at: tuple[Float32Array, Float32Array] | None
    taken: BoolArray | None

    def scale(self, camera: Camera, point: FloatArray) -> float:
        """Pixels of the camera's image for one of this image around a point `(3,)` in the camera's frame."""
        if camera.lens is None:
            return 1.0
        ahead, angle = point / np.linalg.norm(point), math.atan2(math.hypot(point[0], point[1]), point[2])
        if angle > camera.widest_angle:  # it is drawn for the part of it that is in the image
            around = math.sin(camera.widest_angle) / math.sin(angle)
            ahead = np.array([around * ahead[0], around * ahead[1], math.cos(camera.widest_angle)])
        cosine = max(float(self.turn[2] @ ahead), NEVER_FLATTER)
        here = self.matrix[0, 0] * self.matrix[1, 1] / cosine**3
        return max(SMALLEST_SCALE, math.sqrt(np.linalg.norm(np.cross(*slope(camera, ahead))) / here))


@lru_cache(maxsize=2)
def faces_of(camera: Camera) -> tuple[Face, ...]:
    """The faces of a camera's image. They are kept here: a renderer goes to another process without them."""
    width, height = image_size(camera)
    if camera.lens is None:
        return (Face(CUBE[0], intrinsics(camera), (width, height), None, None),)
    pixels = np.stack(np.meshgrid(np.arange(width) + 0.5, np.arange(height) + 0.5), axis=-1)
    seen = bearings(camera, pixels)
    imaged = np.isfinite(seen[..., 0])
    if camera.widest_angle <= ONE_FACE:
        return (_face(CUBE[0], camera.focal_pixels, seen, imaged),)
    nearest = np.argmax(np.nan_to_num(seen) @ CUBE[:, 2].T, axis=-1)
    density = np.linalg.norm(np.cross(*np.moveaxis(slope(camera, seen), -2, 0)), axis=-1)  # pixels a solid angle
    faces = []
    for number, turn in enumerate(CUBE):
        taken = imaged & (nearest == number)
        if taken.any():
            # Nowhere has the face fewer pixels than the image.
            focal = math.sqrt((density[taken] * (seen[taken] @ turn[2]) ** 3).max())
            faces.append(_face(turn, np.array([focal, focal]), seen, taken))
    return tuple(faces)


def _face(turn: FloatArray, focal: FloatArray, seen: FloatArray, taken: BoolArray) -> Face:
    """The face that just shows the directions `seen` `(h, w, 3)` of the pixels `taken`."""
    x, y, z = np.moveaxis(seen @ turn.T, -1, 0)
    with np.errstate(all="ignore"):
        at = np.stack([focal[0] * x / z, focal[1] * y / z], axis=-1)
    low, high = np.floor(at[taken].min(axis=0)) - MARGIN, np.ceil(at[taken].max(axis=0)) + MARGIN
    matrix = np.diag([*focal, 1.0])
    matrix[:2, 2] = -low
    under = np.where(taken[..., None], at - low - 0.5, 0.0).astype(np.float32)
    maps = np.ascontiguousarray(under[..., 0]), np.ascontiguousarray(under[..., 1])
    return Face(turn, matrix, (int(high[0] - low[0]), int(high[1] - low[1])), maps, taken)


def assembled(faces: tuple[Face, ...], lights: list[Float32Array]) -> Float32Array:
    """The camera's image of the images of its faces; black where the lens shows nothing."""
    cv2, whole = optional("cv2", "detection"), lights[0]
    for number, (face, light) in enumerate(zip(faces, lights, strict=True)):
        if face.at is not None and face.taken is not None:
            bent = cv2.remap(light, *face.at, cv2.INTER_CUBIC)
            whole = np.where(face.taken, bent, np.float32(0.0) if number == 0 else whole)
    return whole
