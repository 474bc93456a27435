"""Many views of single tags in few images, to learn the limits of a detector.

A tile of an image holds one tag, seen by the whole image's camera under a drawn pitch and incidence: the tag's centre
lies on the ray of the tile, at the depth that gives the pitch. The image keeps its size, on which some detectors'
settings depend.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from lmd.core.checks import BoolArray, FloatArray, InputError, IntArray, check_fields, integer, vector
from lmd.core.memory import check_memory
from lmd.detection.detectors import Detections, Detector
from lmd.detection.evaluation import CORNER_TOLERANCE, corner_error
from lmd.detection.quality import apparent_edge, incidence, pitch
from lmd.geometry.camera import Camera
from lmd.geometry.projection import image_size, intrinsics, project
from lmd.geometry.squares import corners
from lmd.render.canvas import PATTERN, REACH, Canvas, pattern
from lmd.render.imaging import Float32Array, Imaging
from lmd.scene.tag import Tag

# Edges of tiles, pixels; a view goes into the smallest that surely holds it.
TILE_EDGES = (64, 128, 256, 512)
VIEW_BYTES = 1000  # at the least, of one and what is drawn for it
CAMERA_POSE = np.eye(4)
OF_EACH = ("pitch", "incidence", "edge", "sigma", "seen", "error")  # fields of `Views` with a value for each


@dataclass(frozen=True)
class Sampling:
    """Ranges that views are drawn from: uniform, and log-uniform for sigma.

    Args:
        pitch: pixels a module.
        incidence: rad.
        sigma: standard deviation of the whole blur, pixels.
        noise, texture: standard deviations, grey levels; one for all tags of an image.
        exposure: factor on the light, likewise.

    Raises:
        InputError: a range is empty or out of bounds.
    """

    pitch: tuple[float, float] = (0.5, 6.0)
    incidence: tuple[float, float] = (0.0, math.radians(88.0))
    sigma: tuple[float, float] = (0.4, 2.0)
    noise: tuple[float, float] = (1.0, 5.0)
    texture: tuple[float, float] = (0.0, 10.0)
    exposure: tuple[float, float] = (0.5, 1.1)

    def __post_init__(self) -> None:
        for name in self.__dataclass_fields__:
            least = 0.0 if name in ("incidence", "texture") else 1e-3
            most = math.pi / 2.0 if name == "incidence" else None
            low, high = vector(name, getattr(self, name), 2, low=least, high=most)
            if low > high:
                raise InputError(f"{name} must be a range [low, high], got [{low:g}, {high:g}].", name)
            object.__setattr__(self, name, (low, high))


@dataclass(frozen=True)
class Mosaics:
    """Views of single tags in rendered mosaics, a `lmd.detection.calibration.Source`.

    Args:
        count: views to draw.
        sampling: ranges that they are drawn from.

    Raises:
        InputError: there are fewer than two.
    """

    count: int = 6000
    sampling: Sampling = field(default_factory=Sampling)

    def __post_init__(self) -> None:
        check_fields(self, integer, "count", low=2)
        check_memory(VIEW_BYTES * self.count, f"count = {self.count} views", "count")

    @property
    def photographs(self) -> int:
        """See `Source.photographs`."""
        return 0

    def views(
        self, cameras: Sequence[Camera], tag: Tag, detector: Detector, imaging: Imaging, rng: np.random.Generator
    ) -> "Views":
        """See `Source.views`; light and blur are drawn, not those of `imaging`."""
        return sample_views(only(cameras), tag, detector, self.count, rng, self.sampling)


@dataclass(frozen=True)
class Placed:
    """Where M views are in the images of a recording, and when those were taken; `(M,)` each.

    Args:
        camera: of a rig, from 0.
        moment: rank of the time of its image, from 0.
        border: least distance of the corners from the image's border, pixels.
        circle: diameter of the smallest `Camera.image_circle` that has the whole tag, pixels; NaN where the camera has
            no lens that distorts, and so no such circle.
    """

    camera: IntArray
    moment: IntArray
    border: FloatArray
    circle: FloatArray

    def __getitem__(self, which: object) -> "Placed":
        return Placed(*(getattr(self, name)[which] for name in self.__dataclass_fields__))


@dataclass(frozen=True)
class Views:
    """What M views of single tags are like, and what a detector made of them; `(M,)` each.

    Args:
        pitch, incidence, edge, sigma: as in `lmd.detection.quality`, and the whole blur, pixels.
        seen: whether it was detected with its id, in its place.
        error: root mean square of its corners' errors, pixels; NaN where not seen.
        placed: where and when they were seen; None for single views that are drawn or photographed.
    """

    pitch: FloatArray
    incidence: FloatArray
    edge: FloatArray
    sigma: FloatArray
    seen: BoolArray
    error: FloatArray
    placed: Placed | None = None

    def __len__(self) -> int:
        return len(self.pitch)

    def __getitem__(self, which: object) -> "Views":
        placed = None if self.placed is None else self.placed[which]
        return replace(self, placed=placed, **{name: getattr(self, name)[which] for name in OF_EACH})


def only(cameras: Sequence[Camera]) -> Camera:
    """The camera, for views that are made for one.

    Raises:
        InputError: there are several.
    """
    if len(cameras) > 1:
        raise InputError(f"views are those of a single camera, not of a rig of {len(cameras)}.")
    return cameras[0]


def sample_views(
    camera: Camera, tag: Tag, detector: Detector, count: int, rng: np.random.Generator, ranges: Sampling
) -> Views:
    """Draw views, render them and detect.

    Args:
        camera: the images' size and focal lengths; blur is drawn, not taken from its lens.
        tag: its edge does not matter, pitch decides the depth.
        detector: for the tag's family.
        count: views to draw; those too large for the largest tile are left out.

    Raises:
        InputError: not one of the views fits a tile.
    """
    count = integer("count", count, low=1)
    # A lens moves a tag in the image, and hardly bends a single one.
    camera = replace(camera, distortion=(), distortion_model="plumb_bob")
    pitches, tilts = (rng.uniform(*span, count) for span in (ranges.pitch, ranges.incidence))
    sigmas = np.exp(rng.uniform(math.log(ranges.sigma[0]), math.log(ranges.sigma[1]), count))
    width, height = image_size(camera)
    # Off the axis by phi a pinhole stretches by up to 1 / cos(phi) more along one direction than along the other.
    matrix = intrinsics(camera)
    ends = (np.array([[0, 0], [width, 0], [0, height], [width, height]]) - matrix[:2, 2]) / np.diag(matrix)[:2]
    stretch = math.sqrt(1.0 + (ends**2).sum(axis=1).max()) / np.cos(tilts)
    paper = pitches * (tag.modules + 2.0 * tag.quiet_zone)
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
        raise InputError(f"none of {count} views fits a tile of the {width} x {height} image.")
    return Views(*(np.concatenate([getattr(view, name) for view in views]) for name in OF_EACH))


def _tile_centres(camera: Camera, tile: int, count: int) -> FloatArray:
    """Centres of the first `count` tiles, row by row, pixels, `(count, 2)`."""
    row, column = np.divmod(np.arange(count), image_size(camera)[0] // tile)
    return (np.stack([column, row], axis=-1) + 0.5) * tile


def _place(
    camera: Camera, tag: Tag, tile: int, pitches: FloatArray, tilts: FloatArray, rng: np.random.Generator
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Centres, normals and ups `(M, 3)` in the camera's frame: turned and leaning at random, centred on their tiles."""
    matrix = intrinsics(camera)
    at = _tile_centres(camera, tile, len(pitches)) + rng.uniform(-0.5, 0.5, (len(pitches), 2))
    rays = np.insert((at - matrix[:2, 2]) / np.diag(matrix)[:2], 2, 1.0, axis=1)
    towards = -rays / np.linalg.norm(rays, axis=1, keepdims=True)
    normals = np.cos(tilts)[:, None] * towards + np.sin(tilts)[:, None] * _across(towards, rng)
    # Along a ray and with one normal, the pitch falls as 1 / z.
    at_one_metre = pitch(camera, CAMERA_POSE, rays, normals, tag)
    return rays * (at_one_metre / pitches)[:, None], normals, _across(normals, rng)


def _across(axes: FloatArray, rng: np.random.Generator) -> FloatArray:
    """Random unit vectors perpendicular to unit vectors `(M, 3)`."""
    drawn = rng.standard_normal(axes.shape)
    drawn -= (drawn * axes).sum(axis=1, keepdims=True) * axes
    return np.asarray(drawn / np.linalg.norm(drawn, axis=1, keepdims=True))


def _detect(
    camera: Camera,
    tag: Tag,
    detector: Detector,
    scene: tuple[FloatArray, FloatArray, FloatArray],
    sigmas: FloatArray,
    ranges: Sampling,
    patches: Float32Array,
    rng: np.random.Generator,
) -> Views:
    """Render one mosaic and look which of its tags are found."""
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
    return Views(
        pitch(camera, CAMERA_POSE, centres, normals, tag),
        incidence(CAMERA_POSE, centres, normals),
        apparent_edge(camera, CAMERA_POSE, centres, normals, tag),
        sigmas,
        np.isfinite(error),
        error,
    )


def _errors(detections: Detections, ids: NDArray[np.int64], expected: FloatArray) -> FloatArray:
    """Corner errors of the tags of a mosaic, pixels, `(M,)`; NaN for a tag that was not found. Ids may repeat."""
    error = np.full(len(ids), np.nan)
    for number, found in zip(detections.ids, detections.corners, strict=True):
        near = np.linalg.norm(found - expected, axis=-1).max(axis=1) <= CORNER_TOLERANCE
        for k in np.flatnonzero(near & (ids == number)):
            error[k] = corner_error(found, expected[k])
    return error
