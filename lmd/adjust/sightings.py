"""Sightings: detections of tags as measurements of bundle adjustment.

Let b be the direction of a detected corner, a unit vector in the camera's frame. J `(2, 3)` is the Jacobian of the
projection, pixels, with respect to a displacement of b in the tangent plane of the unit sphere. A corner at p in the
camera's frame has the residual e = J p / (b . p), pixels. The residual equals the reprojection error up to terms of
second order in e. The inverse of the lens model is needed only once, for b.

Paper bends and printers change lengths, so the corners of a printed tag do not lie on an exact flat square. The four
corners have 12 coordinates. A rigid motion has six degrees of freedom, and a change of size, the tag's *growth*, has
one. The other five are the *modes* of deformation. `SHAPES` has six displacements of the corners: five modes, growth.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from lmd.adjust.intrinsics import Optics
from lmd.core.checks import BoolArray, FloatArray, InputError, IntArray
from lmd.detection.corner_errors import CornerErrors, inward, shortest_side
from lmd.formats.detections import DetectedTags
from lmd.geometry.camera import Camera
from lmd.geometry.projection import bearings, slope
from lmd.geometry.se3 import pose_of
from lmd.geometry.squares import CORNERS

RESIDUALS = 8  # residuals of a sighting: two for each corner
# Rotations of a tag for corners numbered from the first, second, third and fourth corner, `(4, 4, 4)`: clockwise by 0
# to 3 quarter turns, as seen by the viewer.
QUARTERS = pose_of(
    np.array([[[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]] for c, s in ((1, 0), (0, 1), (-1, 0), (0, -1))]),
    np.zeros((4, 3)),
)
SQUARE = np.hstack([CORNERS, np.zeros((4, 1))])  # corners of a tag with an edge of 2, in the tag's frame, `(4, 3)`
MODES = 5  # modes of deformation
MOST_OUTSIDE = 0.05  # A camera is doubted if more than this share of its detections is outside its image
SMALL_PITCH = 2.0  # pixels per module at which the shift of small tags counts in full


def _shapes() -> FloatArray:
    """Displacements of a tag's four corners by six shapes, `(6, 4, 3)`: five modes of deformation, and growth (change
    of size). As vectors of 12 numbers, the six displacements are orthonormal.
    """
    rigid = [np.broadcast_to(axis, (4, 3)) for axis in np.eye(3)] + [np.cross(axis, SQUARE) for axis in np.eye(3)]
    basis, *_ = np.linalg.svd(np.stack([other.ravel() for other in (*rigid, SQUARE)], axis=1))
    return np.asarray(np.vstack([basis[:, 7:].T, SQUARE.ravel() / np.linalg.norm(SQUARE)]).reshape(6, 4, 3))


# Orthonormal displacements of the corners, `(6, 4, 3)`: `MODES` modes of deformation, and growth.
SHAPES = _shapes()


@dataclass(frozen=True)
class Sightings:
    """N sightings of K tags in F frames of C cameras on one body, sorted by frame. A sighting is one tag detected in
    one image.
    """

    ids: IntArray
    """`(K,)` ids of the tags, ascending."""
    edges: FloatArray
    """`(K,)` edge lengths of the tags' black squares, metres."""
    frames: int
    """Number F of frames. Simultaneous images of all cameras are one frame."""
    cameras: int
    """Number C of cameras."""
    frame: IntArray
    """`(N,)` index of the frame of each sighting."""
    camera: IntArray
    """`(N,)` index of the camera of each sighting."""
    tag: IntArray
    """`(N,)` index of the tag of each sighting."""
    image: FloatArray
    """Corners as detected, `(N, 4, 2)`, pixels from the outer corner of the top left pixel."""
    directions: FloatArray
    """`(N, 4, 3)` directions b of the corners, unit vectors in the camera's frame."""
    tangents: FloatArray
    """Jacobians J of the projection at the corners, `(N, 4, 2, 3)`, pixels."""
    sizes: FloatArray
    """`(N,)` length of the tag's shortest side in the image, pixels."""
    pitch: FloatArray
    """`(N,)` pixels per module of the tag along its shortest side in the image."""
    noise: FloatArray
    """`(N,)` standard deviation of a coordinate of a corner according to the detector, pixels."""
    lens: FloatArray
    """`(N, 8, 6 L)` derivatives of e with respect to the camera's nuisance parameters, in units of their prior standard
    deviations, see `lmd.adjust.refinement`. Zeros are appended to the parameters to fill L blocks of six; L = 0 without
    nuisance parameters.
    """
    shapes: FloatArray
    """`(K, 6)` deformations of the tags along `SHAPES`, metres."""
    shape_sigma: float
    """Prior standard deviation of the modes of deformation, metres; 0 if tags are known to be flat squares."""
    size_sigmas: FloatArray
    """`(K,)` prior standard deviation of the growth of each tag, metres; NaN for tags whose growth has the standard
    deviation `shape_sigma` of the other modes.
    """
    taken: float
    """Number of degrees of freedom that the estimated nuisance parameters take from the residuals."""

    def __len__(self) -> int:
        return len(self.frame)

    def of(self, chosen: IntArray | BoolArray | slice) -> "Sightings":
        """Sightings selected by `chosen`; tags and frames keep their indices."""
        names = ("frame", "camera", "tag", "image", "directions", "tangents", "sizes", "pitch", "noise", "lens")
        return replace(self, **{name: getattr(self, name)[chosen] for name in names})

    def with_separate_cameras(self) -> "Sightings":
        """Copy in which every camera is a separate body, as if mounts were unknown. Each of F frames of C cameras
        becomes C frames of one camera; these C F frames are ordered by camera.
        """
        order = np.argsort(self.frame + self.camera * self.frames, kind="stable")
        some = self.of(order)
        frames = some.frame + some.camera * self.frames
        return replace(some, frame=frames, frames=self.frames * self.cameras, cameras=1, camera=0 * some.camera)

    @cached_property
    def corners(self) -> FloatArray:
        """Corners in the frames of their tags (x right, y up, z out), `(N, 4, 3)`, metres."""
        off = np.tensordot(self.shapes, SHAPES, axes=1)
        return np.asarray(self.edges[self.tag, None, None] / 2.0 * SQUARE + off[self.tag])

    @property
    def shape_sigmas(self) -> FloatArray:
        """Prior standard deviations of each tag's deformations along `SHAPES`, metres, `(K, 6)`: five modes that deform
        the square, and growth (change of size).
        """
        sigmas = np.full((len(self.ids), 6), self.shape_sigma)
        sigmas[:, MODES] = np.where(np.isnan(self.size_sigmas), self.shape_sigma, self.size_sigmas)
        return sigmas

    @property
    def present_edges(self) -> FloatArray:
        """Edge length of each tag including the estimated change of size (growth), metres, `(K,)`."""
        return np.asarray(self.edges + 2.0 * self.shapes[:, MODES] / np.linalg.norm(SQUARE))

    def variance(self, floor: float) -> FloatArray:
        """Variance of a coordinate of a corner, pixels^2, `(N,)`: the sum of the detector's variance and of `floor`^2.
        `floor`, pixels, is the standard deviation of other errors.
        """
        return np.asarray(self.noise**2 + floor**2)

    def counts(self, chosen: BoolArray | None = None) -> IntArray:
        """Number of sightings of each tag, `(K,)`. With a mask `chosen` `(N,)`, only its sightings count."""
        return np.bincount(self.tag if chosen is None else self.tag[chosen], minlength=len(self.ids))


def shift_basis(pitch: FloatArray) -> FloatArray:
    """Factors 1 and (2 / pitch)^2, `(N, 2)`, of a camera's parameters s_1 and s_2. Blur shifts the edges of a tag by
    s_1 + s_2 (2 / pitch)^2 pixels. `pitch` `(N,)` has the pixels per module of each tag in its image. See
    `lmd.adjust.refinement`.
    """
    return np.stack([np.ones_like(pitch), (SMALL_PITCH / pitch) ** 2], axis=1)


def within_images(detected: DetectedTags, cameras: Sequence[Camera]) -> BoolArray:
    """Mask of the detections that are entirely within the image of their camera, `(N,)`."""
    sizes = np.array([[camera.image_width, camera.image_height] for camera in cameras])[detected.camera, None]
    return np.asarray(((detected.corners >= 0.0) & (detected.corners <= sizes)).all(axis=(1, 2)))


def outside_doubts(seen: "Observations") -> list[str]:
    """Sentences for the user, one for each camera that has many detections outside its image."""
    detected, cameras = seen.detected, [one.camera for one in seen.optics]
    whole = within_images(detected, cameras)
    doubts = []
    for index, camera in enumerate(cameras):
        beyond = ~whole[detected.camera == index]
        if beyond.sum() > MOST_OUTSIDE * len(beyond):
            size = f"{camera.image_width:g} x {camera.image_height:g} pixels"
            some = f"{beyond.sum()} of {len(beyond)} detections of camera {index + 1}"
            doubts.append(
                f"{some} lie outside its image of {size}; check that the calibration is of this camera and image size"
            )
    return doubts


@dataclass(frozen=True)
class Observations:
    """Detections of K tags, and the errors of the detector that made them.

    Raises:
        InputError: the numbers of optics and of cameras in the detections differ.
    """

    detected: DetectedTags
    """The detections."""
    optics: tuple[Optics, ...]
    """Optics of the cameras before refinement, in the order of `detected.cameras`."""
    ids: IntArray
    """Ids of the tags, ascending, `(K,)`; detections of other tags are ignored."""
    edges: FloatArray
    """`(K,)` edge lengths of the tags' black squares, metres."""
    modules: int
    """Number N of modules along an edge in the tags' family."""
    errors: CornerErrors
    """Errors of the detector's corners."""

    def __post_init__(self) -> None:
        if len(self.optics) != len(self.detected.cameras):
            named = ", ".join(map(repr, self.detected.cameras))
            raise InputError(f"cameras must have one camera for each of {named}, got {len(self.optics)}.", "cameras")

    def renumbered(self, quarters: IntArray | int) -> "Observations":
        """Copy with renumbered corners of tags: corner 0 becomes corner `quarters`. `quarters` is one number for all
        tags, or an array `(K,)` with a number for each tag.
        """
        every = np.broadcast_to(quarters, len(self.ids))
        return replace(self, detected=self.detected.renumbered(self.ids, every))

    def through(self, optics: Sequence[Optics] | None = None) -> Sightings:
        """Sightings, computed from the detections with the cameras and shifts of edges in `optics`; None for
        `self.optics`. Detections with a corner outside the image or outside the domain of the lens model are left out.
        """
        cameras, shifts = zip(*((one.camera, one.shifts) for one in optics or self.optics), strict=True)
        known = np.flatnonzero(np.isin(self.detected.ids, self.ids))
        order = np.lexsort([getattr(self.detected, name)[known] for name in ("ids", "camera", "frame")])
        chosen = self.detected.of(known[order])
        sides = shortest_side(chosen.corners)
        pitch = sides / self.modules
        off = self.errors.inward_at(pitch) + (shift_basis(pitch) * np.array(shifts)[chosen.camera]).sum(axis=1)
        image = chosen.corners - off[:, None, None] * inward(chosen.corners)
        directions, tangents = np.empty((len(chosen), 4, 3)), np.empty((len(chosen), 4, 2, 3))
        whole = within_images(chosen, cameras)
        for index, camera in enumerate(cameras):
            own = chosen.camera == index
            directions[own] = bearings(camera, image[own])
            tangents[own] = slope(camera, directions[own])
        every = Sightings(
            ids=self.ids,
            edges=self.edges,
            frames=len(chosen.times),
            cameras=len(cameras),
            frame=chosen.frame,
            camera=chosen.camera,
            tag=np.searchsorted(self.ids, chosen.ids),
            image=image,
            directions=directions,
            tangents=tangents,
            sizes=sides,
            pitch=pitch,
            noise=self.errors.sigma(pitch),
            lens=np.empty((len(chosen), RESIDUALS, 0)),
            shapes=np.zeros((len(self.ids), 6)),
            shape_sigma=0.0,
            size_sigmas=np.zeros(len(self.ids)),
            taken=0.0,
        )
        return every.of(np.flatnonzero(whole & np.isfinite(tangents).all(axis=(1, 2, 3))))
