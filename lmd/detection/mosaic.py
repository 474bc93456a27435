"""Mosaics: rendered images of many tiles, each with a view of a single tag.

Each tag has a random pitch and incidence angle. The centre of the tag lies on the ray through the centre of its tile,
at the depth that gives the pitch. The mosaic has the image size of the camera, as the settings of some detectors depend
on it.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from itertools import pairwise
from typing import Annotated

import numpy as np
from numpy.typing import NDArray

from lmd.core.checks import Checked, FloatArray, InputError, integer, span
from lmd.core.memory import check_memory
from lmd.detection.corner_errors import apparent_edge, incidence, pitch
from lmd.detection.detectors import CORNER_TOLERANCE, Detections, Detector, corner_error
from lmd.detection.tag_views import TagViews, only
from lmd.geometry.camera import Camera
from lmd.geometry.projection import image_size, intrinsics, project
from lmd.geometry.squares import corners
from lmd.render.canvas import PATTERN, REACH, Canvas, pattern
from lmd.render.imaging import Float32Array, Imaging
from lmd.scene.tag import Tag

# Edges of square tiles, pixels; a view is rendered in the smallest tile that contains the view.
TILE_EDGES = (64, 128, 256, 512)
# Lower bound on the memory of a view, bytes.
VIEW_BYTES = 1000
CAMERA_POSE = np.eye(4)
Factor = Annotated[tuple[float, float], partial(span, low=1e-3)]


@dataclass(frozen=True)
class ViewRanges(Checked):
    """Ranges of the parameters of random views. Each parameter is drawn uniformly from its range, except the blur
    `sigma`, whose logarithm is drawn uniformly.

    Raises:
        InputError: a range is empty or out of bounds.
    """

    pitch: Factor = (0.5, 6.0)
    """Pitch, pixels per module."""
    incidence: Annotated[tuple[float, float], partial(span, low=0.0, high=math.pi / 2.0)] = (0.0, math.radians(88.0))
    """Angle between the normal of the tag and the direction to the camera, rad."""
    sigma: Factor = (0.4, 2.0)
    """Standard deviation of the total blur, pixels."""
    noise: Factor = (1.0, 5.0)
    """Standard deviation of the noise, grey levels; one value is drawn for each image."""
    texture: Annotated[tuple[float, float], partial(span, low=0.0)] = (0.0, 10.0)
    """Standard deviation of the background's grey levels; one value is drawn for each image."""
    exposure: Factor = (0.5, 1.1)
    """Exposure, a factor on the light; one value is drawn for each image."""


@dataclass(frozen=True)
class Mosaics(Checked):
    """Source of random views of tags, rendered in mosaics (images of many tiles with one tag each).

    Raises:
        InputError: `count` is less than two.
    """

    count: Annotated[int, partial(integer, low=2)] = 6000
    """Number of views that are drawn."""
    sampling: ViewRanges = field(default_factory=ViewRanges)
    """Ranges of the views."""

    def _validate(self) -> None:
        check_memory(VIEW_BYTES * self.count, f"count = {self.count} views", "count")

    @property
    def photographs(self) -> int:
        """Number of photographs that the views are taken from: 0, as the views are rendered."""
        return 0

    def views(
        self, cameras: Sequence[Camera], tag: Tag, detector: Detector, imaging: Imaging, rng: np.random.Generator
    ) -> TagViews:
        """Draw random views, render them and run a detector; return the views with the detections.

        Light and blur are random, so `imaging` is ignored.

        Args:
            cameras: sequence of exactly one camera.
            tag: family and quiet zone of the tags.
            detector: detector of the family.
            imaging: ignored.
            rng: random generator for all parameters.

        Raises:
            InputError: there are several cameras, or none of the views fits a tile of a mosaic.
        """
        return sample_views(only(cameras), tag, detector, self.count, rng, self.sampling)


def sample_views(
    camera: Camera, tag: Tag, detector: Detector, count: int, rng: np.random.Generator, ranges: ViewRanges
) -> TagViews:
    """Draw random views, render them and run a detector; return the views with the detections.

    Args:
        camera: size and focal lengths of the images; its distortion and blur are ignored.
        tag: family and quiet zone; the edge length has no effect, as the drawn pitch determines the depth.
        detector: detector of the family.
        count: number of views; views too large for the largest tile are left out.
        rng: random generator for all parameters.
        ranges: ranges of the views.

    Raises:
        InputError: none of the views fits a tile.
    """
    count = integer("count", count, low=1)
    # Distortion is negligible within a tile.
    camera = replace(camera, distortion=(), distortion_model="plumb_bob")
    pitches, tilts = (rng.uniform(*span, count) for span in (ranges.pitch, ranges.incidence))
    sigmas = np.exp(rng.uniform(math.log(ranges.sigma[0]), math.log(ranges.sigma[1]), count))
    width, height = image_size(camera)
    # At the angle phi from the optical axis, a pinhole's radial scale is 1 / cos(phi) times the tangential scale.
    matrix = intrinsics(camera)
    ends = (np.array([[0, 0], [width, 0], [0, height], [width, height]]) - matrix[:2, 2]) / np.diag(matrix)[:2]
    stretch = math.sqrt(1.0 + (ends**2).sum(axis=1).max()) / np.cos(tilts)
    paper = pitches * tag.paper_modules
    diameter = math.sqrt(2.0) * paper * stretch + 2.0 * REACH * sigmas
    patches = pattern(1.0, rng)
    views = []
    for smaller, tile in pairwise((0, *TILE_EDGES)):
        chosen = np.flatnonzero((smaller < diameter) & (diameter <= tile))
        in_image = (width // tile) * (height // tile)
        if not len(chosen) or not in_image:
            continue
        for part in np.array_split(chosen, math.ceil(len(chosen) / in_image)):
            scene = _place(camera, tag, tile, pitches[part], tilts[part], rng)
            views.append(_detect(camera, tag, detector, scene, sigmas[part], ranges, patches, rng))
    if not views:
        raise InputError(f"in all {count} views the tag is too large for a part of the {width} x {height} image.")
    return TagViews.concatenated(views)


def _tile_centres(camera: Camera, tile: int, count: int) -> FloatArray:
    """Centres of the first `count` tiles of a mosaic, row by row, pixels, `(count, 2)`; `tile` is the edge of a tile,
    pixels.
    """
    row, column = np.divmod(np.arange(count), image_size(camera)[0] // tile)
    return (np.stack([column, row], axis=-1) + 0.5) * tile


def _place(
    camera: Camera, tag: Tag, tile: int, pitches: FloatArray, tilts: FloatArray, rng: np.random.Generator
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Place M tags with given pitches (pixels per module) and incidence angles (`tilts`, rad), each in the middle of
    its tile; the directions of tilt and of the upper edge are random. `tile` is the edge of a tile, pixels. Returns the
    centres, normals and up vectors of the tags in the camera's frame, `(M, 3)` each.
    """
    matrix = intrinsics(camera)
    at = _tile_centres(camera, tile, len(pitches)) + rng.uniform(-0.5, 0.5, (len(pitches), 2))
    rays = np.insert((at - matrix[:2, 2]) / np.diag(matrix)[:2], 2, 1.0, axis=1)
    towards = -rays / np.linalg.norm(rays, axis=1, keepdims=True)
    normals = np.cos(tilts)[:, None] * towards + np.sin(tilts)[:, None] * _across(towards, rng)
    # Along a ray, the pitch of tags with one normal is proportional to 1 / z.
    at_one_metre = pitch(camera, CAMERA_POSE, rays, normals, tag)
    return rays * (at_one_metre / pitches)[:, None], normals, _across(normals, rng)


def _across(axes: FloatArray, rng: np.random.Generator) -> FloatArray:
    """Random unit vectors, each perpendicular to one of the unit vectors `axes`, `(M, 3)`."""
    drawn = rng.standard_normal(axes.shape)
    drawn -= (drawn * axes).sum(axis=1, keepdims=True) * axes
    return np.asarray(drawn / np.linalg.norm(drawn, axis=1, keepdims=True))


def _detect(
    camera: Camera,
    tag: Tag,
    detector: Detector,
    scene: tuple[FloatArray, FloatArray, FloatArray],
    sigmas: FloatArray,
    ranges: ViewRanges,
    patches: Float32Array,
    rng: np.random.Generator,
) -> TagViews:
    """Render one mosaic of M tags, run the detector on it, and return the views with the detections.

    Args:
        camera: size and focal lengths of the mosaic.
        tag: family and size of the tags.
        detector: detector of the family.
        scene: centres, normals and up vectors of the tags, camera's frame, `(M, 3)` each.
        sigmas: standard deviation of the blur of each tag, pixels, `(M,)`.
        ranges: ranges of noise, texture and exposure.
        patches: periodic pattern for the background.
        rng: random generator for ids, noise, texture and exposure.
    """
    centres, normals, ups = scene
    squares = corners(centres, normals, ups, tag.size)
    ids = rng.integers(tag.ids, size=len(sigmas))
    imaging = Imaging(noise=rng.uniform(*ranges.noise), exposure=rng.uniform(*ranges.exposure))
    canvas = Canvas(intrinsics(camera), image_size(camera), imaging)
    rows, columns = (np.arange(size) + rng.integers(PATTERN) for size in canvas.light.shape)
    canvas.light += np.float32(rng.uniform(*ranges.texture)) * patches[np.ix_(rows % PATTERN, columns % PATTERN)]
    for number, square, sigma in zip(ids, squares, sigmas, strict=True):
        canvas.tag(tag, int(number), square, float(sigma))
    expected = project(camera, CAMERA_POSE, squares.reshape(-1, 3)).reshape(-1, 4, 2)
    error = _errors(detector.detect(imaging.develop(canvas.light, rng)), ids, expected)
    return TagViews(
        pitch(camera, CAMERA_POSE, centres, normals, tag),
        incidence(CAMERA_POSE, centres, normals),
        apparent_edge(camera, CAMERA_POSE, centres, normals, tag),
        sigmas,
        np.isfinite(error),
        error,
    )


def _errors(detections: Detections, ids: NDArray[np.int64], expected: FloatArray) -> FloatArray:
    """Root mean square corner error of each tag of a mosaic, pixels, `(M,)`; NaN for tags that are not detected.

    `expected` has the exact corners, pixels, `(M, 4, 2)`. Several tags of a mosaic may have one id. So a detection is
    assigned to a tag by the id and by the distances between detected and exact corners.
    """
    error = np.full(len(ids), np.nan)
    for number, found in zip(detections.ids, detections.corners, strict=True):
        near = np.linalg.norm(found - expected, axis=-1).max(axis=1) <= CORNER_TOLERANCE
        for k in np.flatnonzero(near & (ids == number)):
            error[k] = corner_error(found, expected[k])
    return error
