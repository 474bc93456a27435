"""Perspective drawing of planes: surfaces first, then tags from far to near.

The bounding box of a tag is sampled several times per pixel through the tag's homography. Samples are averaged over
each pixel, blurred together with the opacity of the tag, and blended over the background. On a uniform background this
equals blurring the whole image.
"""

import math
from collections.abc import Sequence
from functools import lru_cache
from typing import Any

import numpy as np

from lmd.core.checks import FloatArray
from lmd.core.optional import optional
from lmd.render.imaging import Float32Array, Imaging, UInt8Array
from lmd.scene.tag import Tag

# Depth of the near plane, metres; parts nearer to the camera are not drawn.
NEAR_PLANE = 0.02
# Radius of Gaussian kernels, standard deviations.
REACH = 3.5
# Maximum number of samples of one tag; larger tags get fewer per pixel.
MOST_SAMPLES = 4e6
# Maximum resolution of a tag's texture, texels per module.
MOST_TEXELS = 64
# Fractional bits of the vertices in OpenCV's polygons.
SHIFT = 4


class Canvas:
    """Pinhole image on which surfaces and tags are drawn: the light on each pixel, in grey levels stored as float32.

    Args:
        matrix: intrinsic matrix K, from the camera's frame to homogeneous image coordinates that count from the outer
            corner of the top left pixel, `(3, 3)`.
        size: width and height, pixels.
        imaging: grey levels and sampling.
    """

    def __init__(self, matrix: FloatArray, size: tuple[int, int], imaging: Imaging) -> None:
        self.matrix, self.imaging = matrix, imaging
        self.light: Float32Array = np.full((size[1], size[0]), imaging.wall, dtype=np.float32)
        self.cv2: Any = optional("cv2", "detection")

    def outline(self, polygon: FloatArray) -> FloatArray:
        """Outline, in the image, of the part of a convex polygon that is at least `NEAR_PLANE` before the camera.

        `polygon` `(M, 3)` has the vertices in the camera frame, metres. The result `(m, 2)` is in pixels.
        """
        image = clipped(polygon) @ self.matrix.T
        return np.asarray(image[:, :2] / image[:, 2:])

    def surface(self, plane: FloatArray, shape: FloatArray, grey: float, pattern: Float32Array | None) -> FloatArray:
        """Draw a convex polygon of a plane.

        Args:
            plane: matrix `(3, 3)` whose columns are the unit vectors u and v in the plane, and its origin, metres;
                camera frame.
            shape: coordinates (a, b) of the polygon's vertices in the plane, metres, not negative, `(M, 2)`; a vertex
                is at origin + a u + b v.
            grey: mean grey level.
            pattern: offsets of the grey level, `(T, T)` texels of `TEXEL` metres, tiled over larger polygons; None for
                a plain surface.

        Returns:
            Outline in the image, pixels, `(m, 2)`.
        """
        outline = self.outline(np.insert(shape, 2, 1.0, axis=1) @ plane.T)
        window = self._window(outline, 0)
        if window is None:
            return outline
        x, y, width, height = window
        part = self.light[y : y + height, x : x + width]
        mask = np.zeros((height, width), dtype=np.uint8)
        self._fill(mask, outline - [x, y], 1)
        drawn = np.full((height, width), grey, dtype=np.float32)
        if pattern is not None:
            texels = plane @ np.diag([TEXEL, TEXEL, 1.0])
            # BORDER_WRAP is several times slower, even outside the polygon.
            covers = shape.max() <= len(pattern) * TEXEL
            border = self.cv2.BORDER_REPLICATE if covers else self.cv2.BORDER_WRAP
            drawn += self._warp(pattern, self.matrix @ texels, window, 1, border)
        self.cv2.copyTo(drawn, mask, part)
        return outline

    def blur(self, sigma: float) -> None:
        """Blur the image by a Gaussian with standard deviation `sigma`, pixels."""
        self.light = self._blurred(self.light, sigma)

    def tag(
        self, tag: Tag, number: int, square: FloatArray, sigma: float, hidden_by: Sequence[FloatArray] = ()
    ) -> None:
        """Draw a tag on its paper.

        Args:
            tag: family and size.
            number: id of the tag in its family.
            square: corners of the tag in the order of `lmd.geometry.squares.CORNERS`, camera frame, metres,
                `(4, 3)`.
            sigma: standard deviation of the blur, pixels.
            hidden_by: image outlines of the surfaces that occlude the tag, pixels, `(m, 2)` each.
        """
        centre = square.mean(axis=0)
        paper = centre + tag.paper_share * (square - centre)
        outline = self.outline(paper)
        margin = math.ceil(REACH * sigma) + 1
        window = self._window(outline, margin)
        if window is None:
            return
        width, height = window[2:]
        samples = max(1, min(self.imaging.supersampling, int(math.sqrt(MOST_SAMPLES / (width * height)))))
        pitch = samples * math.sqrt(_area(outline)) / tag.paper_modules
        texels = int(np.clip(2 ** round(math.log2(max(pitch, 1.0))), 2, MOST_TEXELS))
        picture = texture(tag, number, texels)
        right, down = ((square[i] - square[0]) / (tag.modules * texels) for i in (1, 3))
        plane = np.stack([right, down, centre - len(picture) / 2.0 * (right + down)], axis=1)
        drawn = self._warp(picture, self.matrix @ plane, window, samples, self.cv2.BORDER_CONSTANT)
        drawn = self.cv2.resize(drawn.astype(np.float32), (width, height), interpolation=self.cv2.INTER_AREA)
        if (paper[:, 2] < NEAR_PLANE).any():  # outside, as the homography also maps points behind the camera
            front = np.zeros((height, width), dtype=np.float32)
            self._fill(front, outline - window[:2], 1)
            drawn *= front[..., None]
        drawn = self._blurred(drawn, sigma) / np.float32(255.0)
        for shape in hidden_by:
            self._fill(drawn, shape - window[:2], 0)
        self._over(drawn, window)

    def _over(self, drawn: Float32Array, window: tuple[int, int, int, int]) -> None:
        """Blend a drawn tag over the image. The drawing fills a window, which may reach beyond the image.

        Args:
            drawn: whiteness and opacity of each pixel, from 0 to 1, `(h, w, 2)`.
            window: x, y, width and height, pixels.
        """
        x, y, width, height = window
        left, top = max(-x, 0), max(-y, 0)
        inside = drawn[top : self.light.shape[0] - y, left : self.light.shape[1] - x]
        part = self.light[y + top : y + height, x + left : x + width]
        black, contrast = np.float32(self.imaging.black), np.float32(self.imaging.white - self.imaging.black)
        part += inside[..., 1] * (black - part) + contrast * inside[..., 0]

    def _window(self, outline: FloatArray, margin: int) -> tuple[int, int, int, int] | None:
        """Bounding box (x, y, width, height) of an outline, enlarged by `margin` on each side; all in pixels.

        The box is clipped to the image, which is also enlarged by `margin` on each side. The result is None if the box
        does not overlap the image, or if the outline is empty.
        """
        if not len(outline):
            return None
        limit = np.array(self.light.shape[::-1])
        low = np.maximum(np.floor(outline.min(axis=0)) - margin, -margin)
        high = np.minimum(np.ceil(outline.max(axis=0)) + margin, limit + margin)
        if (high <= np.maximum(low, 0)).any() or (low >= limit).any():
            return None
        (x, y), (width, height) = low.astype(int), (high - low).astype(int)
        return int(x), int(y), int(width), int(height)

    def _warp(
        self, picture: Any, homography: FloatArray, window: tuple[int, int, int, int], samples: int, border: int
    ) -> Any:
        """Warp `picture` by a homography that maps texels to pixels.

        Texels and pixels count from the outer corner of the first texel or pixel. The result covers the rectangle
        `window` (x, y, width, height), with `samples` values per pixel along each axis. `border` is OpenCV's mode for
        points outside the picture.
        """
        x, y, width, height = window
        from_centre = np.array([[1.0, 0.0, 0.5], [0.0, 1.0, 0.5], [0.0, 0.0, 1.0]])
        to_window = np.array([[samples, 0.0, -samples * x - 0.5], [0.0, samples, -samples * y - 0.5], [0.0, 0.0, 1.0]])
        size = (width * samples, height * samples)
        matrix = to_window @ homography @ from_centre
        return self.cv2.warpPerspective(picture, matrix, size, flags=self.cv2.INTER_LINEAR, borderMode=border)

    def _blurred(self, light: Float32Array, sigma: float) -> Float32Array:
        if sigma == 0.0:
            return light
        kernel = 2 * math.ceil(REACH * sigma) + 1
        border = self.cv2.BORDER_REPLICATE
        return np.asarray(self.cv2.GaussianBlur(light, (kernel, kernel), sigma, borderType=border))

    def _fill(self, image: Any, outline: FloatArray, value: float) -> None:
        """Fill a convex outline in `image` with `value`.

        The outline `(m, 2)` is in pixels from the outer corner of the top left pixel.
        """
        if len(outline) >= 3:
            points = np.rint((outline - 0.5) * 2**SHIFT).astype(np.int32)
            self.cv2.fillConvexPoly(image, points, (value,) * 4, lineType=self.cv2.LINE_8, shift=SHIFT)


def clipped(polygon: FloatArray) -> FloatArray:
    """Part of a convex polygon at depths z of at least `NEAR_PLANE`, as vertices `(m, 3)`; m may be 0.

    `polygon` `(M, 3)` has the vertices of the whole polygon in the camera frame, metres.
    """
    depth = polygon[:, 2] - NEAR_PLANE
    if (depth >= 0.0).all():
        return polygon
    kept = []
    for i, j in zip(range(len(polygon)), [*range(1, len(polygon)), 0], strict=True):
        if depth[i] >= 0.0:
            kept.append(polygon[i])
        if (depth[i] >= 0.0) != (depth[j] >= 0.0):
            kept.append(polygon[i] + depth[i] / (depth[i] - depth[j]) * (polygon[j] - polygon[i]))
    return np.array(kept).reshape(-1, 3)


def _area(outline: FloatArray) -> float:
    """Area of a polygon with the vertices `outline` `(m, 2)`, in the squared unit of the vertices."""
    x, y = outline[:, 0], outline[:, 1]
    return float(abs(x @ np.roll(y, -1) - y @ np.roll(x, -1)) / 2.0)


@lru_cache(maxsize=512)
def texture(tag: Tag, number: int, texels: int) -> UInt8Array:
    """Texture of a tag with its quiet zone, `(S, S, 2)`: whiteness and opacity of each texel, 0 or 255.

    `number` is the id of the tag in its family. There are `texels` texels per module along each axis.
    """
    modules = np.where(tag.picture(number), 255, 0).astype(np.uint8)
    margin = round(tag.quiet_zone * texels)
    white = np.pad(np.kron(modules, np.ones((texels, texels), dtype=np.uint8)), margin, constant_values=255)
    return np.stack([white, np.full_like(white, 255)], axis=-1)


# Edge of a texel of a surface's pattern, metres, and its period in texels.
TEXEL = 0.005
PATTERN = 1024
# Maximum number of a pattern's periods along an edge of the array; 3 periods are 15 m and 38 MB.
MOST_REPEATS = 3


@lru_cache(maxsize=2)
def covering(amplitude: float, seed: int, length: float) -> Float32Array:
    """Random pattern for a square, `(T, T)` texels: offsets that are added to its grey levels.

    The square is covered by copies of a `pattern`, at most `MOST_REPEATS` along an edge.

    Args:
        amplitude: standard deviation, grey levels.
        seed: seed of the pattern.
        length: edge of the square, metres.
    """
    times = min(max(math.ceil(length / (PATTERN * TEXEL)), 1), MOST_REPEATS)
    return np.tile(pattern(amplitude, np.random.default_rng(seed)), (times, times))


def pattern(amplitude: float, rng: np.random.Generator) -> Float32Array:
    """Random pattern of grey levels around 0, `(PATTERN, PATTERN)`.

    The amplitude of the waves that make up the pattern falls as 1 / frequency.

    Args:
        amplitude: standard deviation, grey levels.
        rng: random generator for the pattern.
    """
    frequency = np.hypot(*np.meshgrid(np.fft.rfftfreq(PATTERN), np.fft.fftfreq(PATTERN)))
    # Limits the amplitude of waves longer than an eighth of the period, which would look like a gradient of the wall.
    spectrum = np.fft.rfft2(rng.standard_normal((PATTERN, PATTERN))) / np.maximum(frequency, 8.0 / PATTERN)
    spectrum[0, 0] = 0.0
    patches = np.fft.irfft2(spectrum, (PATTERN, PATTERN))
    return np.asarray(amplitude * patches / patches.std(), dtype=np.float32)
