"""What photographs say of tags: the directions in which their corners were seen, and how well these are known.

A corner that was found at a pixel was seen in the direction b, a unit vector in the camera's frame. Around it the image
moves by J (2, 3) pixels per unit of the plane that touches the sphere of directions at b. A corner that is at p in
that frame would have been found e = J p / (b . p) pixels away. That is the reprojection error but for terms of second
order in e, and needs nothing of the lens but its inverse, once.

The four corners of a printed tag are not quite those of a flat square: paper bends, and printers stretch. But for its
motions and its size there are five ways in which a tag can be off it, `SHAPES`.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from lmd.core.checks import BoolArray, FloatArray, InputError, IntArray
from lmd.detection.corner_errors import CornerErrors
from lmd.formats.detections import DetectedTags
from lmd.geometry.camera import Camera
from lmd.geometry.projection import bearings, slope
from lmd.geometry.se3 import pose_of
from lmd.geometry.squares import CORNERS

# How a tag appears whose corners are numbered from its first, second, third and fourth one, `(4, 4, 4)`: turned
# clockwise by as many quarters as one looks at it.
QUARTERS = pose_of(
    np.array([[[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]] for c, s in ((1, 0), (0, 1), (-1, 0), (0, -1))]),
    np.zeros((4, 3)),
)


def _shapes() -> FloatArray:
    """See `SHAPES`."""
    square = np.hstack([CORNERS, np.zeros((4, 1))])
    others = [np.broadcast_to(axis, (4, 3)) for axis in np.eye(3)] + [np.cross(axis, square) for axis in np.eye(3)]
    basis, *_ = np.linalg.svd(np.stack([other.ravel() for other in (*others, square)], axis=1))
    return np.asarray(np.vstack([basis[:, 7:].T, np.zeros(12)]).reshape(6, 4, 3))


SMALL_PITCH = 2.0  # pixels a module
LEAST_ANGLE = 0.2  # sine of the angle at a corner; those of narrower ones hardly say where it is
# The ways in which the corners of a tag may be off a flat square but for its motions and its size, orthonormal: five,
# and a sixth that is none, as unknowns come in blocks of six, `(6, 4, 3)`.
SHAPES = _shapes()
WAYS = 5


@dataclass(frozen=True)
class Sightings:
    """N sightings of K tags in F frames of C cameras on one body, in the order of their frames.

    Args:
        ids: numbers of the tags, `(K,)`, ascending.
        edges: of their black squares, metres, `(K,)`.
        frames: F; what several cameras saw at the same time is one frame.
        cameras: C.
        frame, camera, tag: which of them each is of, `(N,)`.
        image: the four corners as they were found, pixels from the border, `(N, 4, 2)`.
        directions: b of them, `(N, 4, 3)`.
        tangents: J, `(N, 4, 2, 3)`, pixels.
        sizes: of the shortest side in the image, pixels, `(N,)`.
        pitch: of the modules along it, pixels, `(N,)`.
        noise: standard deviation of a coordinate of a corner that the detector alone accounts for, pixels, `(N,)`.
        lens: how e changes with what is not known of each camera, in units of what that may be off, `(N, 8, 6 L)`, see
            `lmd.survey.refining`; L is 0 where all is known.
        shapes: how far the corners of tags are off flat squares, along `SHAPES`, metres, `(K, 6)`.
        shape_sigma: standard deviation of these, metres; 0 where they are known.
        taken: how many degrees of freedom lenses and shapes have taken from the residuals.
    """

    ids: IntArray
    edges: FloatArray
    frames: int
    cameras: int
    frame: IntArray
    camera: IntArray
    tag: IntArray
    image: FloatArray
    directions: FloatArray
    tangents: FloatArray
    sizes: FloatArray
    pitch: FloatArray
    noise: FloatArray
    lens: FloatArray
    shapes: FloatArray
    shape_sigma: float
    taken: float

    def __len__(self) -> int:
        return len(self.frame)

    def of(self, chosen: IntArray | BoolArray | slice) -> "Sightings":
        """The sightings that `chosen` selects; tags and frames keep their numbers."""
        names = ("frame", "camera", "tag", "image", "directions", "tangents", "sizes", "pitch", "noise", "lens")
        rest = {name: getattr(self, name)[chosen] for name in names}
        return replace(self, **rest)

    def apart(self) -> "Sightings":
        """The sightings as if every camera were a body of its own: C F frames, those of the first camera first."""
        order = np.argsort(self.frame + self.camera * self.frames, kind="stable")
        some = self.of(order)
        frames = some.frame + some.camera * self.frames
        return replace(some, frame=frames, frames=self.frames * self.cameras, cameras=1, camera=0 * some.camera)

    @cached_property
    def corners(self) -> FloatArray:
        """The corners in the frames of their tags (x right, y up, z out), `(N, 4, 3)`, metres."""
        square = np.hstack([CORNERS, np.zeros((4, 1))])
        off = np.tensordot(self.shapes, SHAPES, axes=1)
        return np.asarray(self.edges[self.tag, None, None] / 2.0 * square + off[self.tag])


def inward(image: FloatArray) -> FloatArray:
    """The ways of corners `(N, 4, 2)` in an image when the edges are shifted by one pixel towards the middle."""
    (along, other) = (np.roll(image, way, axis=1) - image for way in (1, -1))
    along, other = (edge / np.linalg.norm(edge, axis=-1, keepdims=True) for edge in (along, other))
    across = np.abs(along[..., 0] * other[..., 1] - along[..., 1] * other[..., 0])
    return np.asarray((along + other) / np.maximum(across, LEAST_ANGLE)[..., None])


def shortest_side(image: FloatArray) -> FloatArray:
    """The length of the shortest side of tags with the corners `(N, 4, 2)`, pixels, `(N,)`."""
    return np.asarray(np.linalg.norm(image - np.roll(image, 1, axis=1), axis=-1).min(axis=1))


def shifted(pitch: FloatArray) -> FloatArray:
    """The parts of the shift of all tags, and of that of small ones, in the shift at each pitch, `(N, 2)`."""
    return np.stack([np.ones_like(pitch), (SMALL_PITCH / pitch) ** 2], axis=1)


def sightings_of(
    detected: DetectedTags,
    cameras: Sequence[Camera],
    ids: IntArray,
    edges: FloatArray,
    modules: int,
    errors: CornerErrors,
    shifts: FloatArray | None = None,
) -> Sightings:
    """The sightings of the tags with these `ids`.

    Detections of other tags, and those with a corner outside of the image or of what the lens images, are left out.

    Args:
        detected: as they were found.
        cameras: in the order of `detected.cameras`.
        ids, edges: see `Sightings`.
        modules: N of the tags' family.
        errors: what the detector's corners are off by.
        shifts: by how many pixels each camera's images have edges farther `inward` than `errors` says, `(C, 2)`: those
            of all tags, and of small ones besides, see `shifted`; None for 0.

    Raises:
        InputError: there is another number of cameras, or no sighting.
    """
    if len(cameras) != len(detected.cameras):
        raise InputError(
            f"cameras must be one for each of {', '.join(map(repr, detected.cameras))}, got {len(cameras)}.", "cameras"
        )
    known = np.flatnonzero(np.isin(detected.ids, ids))
    chosen = detected.of(known[np.lexsort((detected.ids[known], detected.camera[known], detected.frame[known]))])
    sides = shortest_side(chosen.corners)
    pitch = sides / modules
    off = errors.inward_at(pitch) + (0.0 if shifts is None else (shifted(pitch) * shifts[chosen.camera]).sum(axis=1))
    image = chosen.corners - off[:, None, None] * inward(chosen.corners)
    directions, tangents = np.empty((len(chosen), 4, 3)), np.empty((len(chosen), 4, 2, 3))
    whole = np.zeros(len(chosen), dtype=bool)
    for index, camera in enumerate(cameras):
        own = chosen.camera == index
        size = np.array([camera.image_width, camera.image_height])
        whole[own] = ((chosen.corners[own] >= 0.0) & (chosen.corners[own] <= size)).all(axis=(1, 2))
        directions[own] = bearings(camera, image[own])
        tangents[own] = slope(camera, directions[own])
    every = Sightings(
        ids=ids,
        edges=edges,
        frames=len(detected.times),
        cameras=len(cameras),
        frame=chosen.frame,
        camera=chosen.camera,
        tag=np.searchsorted(ids, chosen.ids),
        image=image,
        directions=directions,
        tangents=tangents,
        sizes=sides,
        pitch=pitch,
        noise=errors.sigma(pitch),
        lens=np.empty((len(chosen), 8, 0)),
        shapes=np.zeros((len(ids), 6)),
        shape_sigma=0.0,
        taken=0.0,
    )
    return every.of(np.flatnonzero(whole & np.isfinite(tangents).all(axis=(1, 2, 3))))
