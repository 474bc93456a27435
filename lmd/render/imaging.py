"""Conversion of a scene's light to the grey levels of an image by lens, exposure and noise."""

import math
from dataclasses import dataclass
from functools import lru_cache, partial
from typing import Annotated

import numpy as np
from numpy.typing import NDArray

from lmd.core.checks import (
    Checked,
    FloatArray,
    Index,
    InputError,
    NotNegative,
    Positive,
    Switch,
    integer,
    real,
)
from lmd.core.optional import optional

UInt8Array = NDArray[np.uint8]
Float32Array = NDArray[np.float32]
GREY_LEVELS = 255.0
Grey = Annotated[float, partial(real, low=0.0, high=GREY_LEVELS)]


@dataclass(frozen=True)
class Imaging(Checked):
    """Settings for the rendering of 8-bit images.

    The brightness of surfaces is given as grey levels at exposure 1 and gamma 1.

    Raises:
        InputError: a value is out of range.
    """

    psf_sigma: NotNegative = 0.5
    """Standard deviation of the point spread function in focus, pixels."""
    defocus: Switch = True
    """True to add the blur of a thin lens with the camera's aperture and focus distance."""
    motion_blur: NotNegative = 0.0
    """Length of the motion blur at the image centre, pixels; the camera rotates in a random direction."""
    noise: NotNegative = 2.0
    """Standard deviation of the noise of a pixel, grey levels."""
    exposure: Positive = 1.0
    """Exposure, a factor on the light."""
    gamma: Positive = 1.0
    """Exponent in grey = 255 (light / 255)^(1 / gamma)."""
    white: Grey = 220.0
    """Brightness of a tag's white parts, grey levels."""
    black: Grey = 25.0
    """Brightness of a tag's black parts, grey levels."""
    wall: Grey = 150.0
    """Mean brightness of surfaces, grey levels; shading depends on the normal, see `shade`."""
    texture: NotNegative = 0.0
    """Standard deviation of the pattern on surfaces, grey levels; 0 for plain surfaces."""
    texture_seed: Index = 0
    """Seed of the pattern, which is constant over frames."""
    supersampling: Annotated[int, partial(integer, low=1, high=16)] = 4
    """Number of samples of a tag along each axis of a pixel."""

    def _validate(self) -> None:
        if self.white <= self.black:
            raise InputError(f"white must exceed black = {self.black:g}, got {self.white:g}.", "white")

    def develop(self, light: Float32Array, rng: np.random.Generator) -> UInt8Array:
        """Convert `light` `(h, w)`, grey levels, to an 8-bit image, with noise drawn from `rng`."""
        cv2 = optional("cv2", "detection")
        grey: FloatArray | Float32Array = light
        exposure = self.exposure
        if self.gamma != 1.0:
            ratio = np.clip(light * np.float32(exposure), 0.0, None) / np.float32(GREY_LEVELS)
            grey, exposure = np.float32(GREY_LEVELS) * ratio ** np.float32(1.0 / self.gamma), 1.0
        # OpenCV rounds the sum and clips it to 8 bits.
        return np.asarray(cv2.addWeighted(grey, exposure, _grain(grey.shape, rng), self.noise, 0.0, dtype=cv2.CV_8U))

    def shade(self, normals: FloatArray) -> FloatArray:
        """Grey levels of surfaces with unit normals `(..., 3)`, lit from above and from one side."""
        return np.asarray(self.wall * (1.0 + normals @ LIGHT))


def _grain(shape: tuple[int, ...], rng: np.random.Generator) -> Float32Array:
    """Draw standard normal noise: a random section of a long cached array.

    New random numbers for every image would double the time of rendering. So two images may share numbers, at different
    pixels.
    """
    size, begin = math.prod(shape), int(rng.integers(SPARE_GRAIN))
    return _grain_row(size + SPARE_GRAIN)[begin : begin + size].reshape(shape)


@lru_cache(maxsize=2)
def _grain_row(size: int) -> Float32Array:
    """Standard normal random numbers from a constant seed, `(size,)`."""
    return np.random.default_rng(0x6E6F697365).standard_normal(size, dtype=np.float32)


# Number of indices in the cached array at which an image's noise may start.
SPARE_GRAIN = 2**20
# Relative brightness per component of the normal. Adjacent walls differ in brightness, so that edges are visible.
LIGHT = np.array([0.03, 0.05, 0.08])
