"""What lies between a scene and its grey levels: surfaces, lens, exposure, noise."""

import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from lmd.core.checks import FloatArray, InputError, boolean, check_fields, integer, real
from lmd.core.optional import optional

UInt8Array = NDArray[np.uint8]
Float32Array = NDArray[np.float32]
GREY_LEVELS = 255.0


@dataclass(frozen=True)
class Imaging:
    """How a scene becomes an 8-bit image. Surfaces reflect grey levels as seen at exposure 1 and gamma 1.

    Args:
        psf_sigma: standard deviation of the sharpest image of a point, pixels.
        defocus: whether a thin lens (the camera's aperture and focus distance) adds its blur.
        motion_blur: smear in the middle of the image while the camera turns in a random direction, pixels.
        noise: standard deviation in each pixel, grey levels.
        exposure: factor on the light.
        gamma: grey = 255 (light / 255)^(1 / gamma).
        white, black: of a tag, grey levels.
        wall: mean grey level of surfaces; each is a little brighter or darker by the direction it faces.
        texture: standard deviation of the pattern on surfaces, grey levels; 0 for plain ones.
        texture_seed: of that pattern, which stays the same from frame to frame.
        supersampling: samples along each axis of a pixel of a tag.

    Raises:
        InputError: a value is out of range.
    """

    psf_sigma: float = 0.5
    defocus: bool = True
    motion_blur: float = 0.0
    noise: float = 2.0
    exposure: float = 1.0
    gamma: float = 1.0
    white: float = 220.0
    black: float = 25.0
    wall: float = 150.0
    texture: float = 0.0
    texture_seed: int = 0
    supersampling: int = 4

    def __post_init__(self) -> None:
        check_fields(self, real, "psf_sigma", "motion_blur", "noise", "texture", low=0.0)
        check_fields(self, real, "exposure", "gamma", above=0.0)
        check_fields(self, real, "white", "black", "wall", low=0.0, high=GREY_LEVELS)
        if self.white <= self.black:
            raise InputError(f"white must exceed black = {self.black:g}, got {self.white:g}.", "white")
        boolean("defocus", self.defocus)
        check_fields(self, integer, "texture_seed", low=0)
        check_fields(self, integer, "supersampling", low=1, high=16)

    def develop(self, light: Float32Array, rng: np.random.Generator) -> UInt8Array:
        """The 8-bit image of `light` in grey levels, same shape; the noise is drawn from `rng`."""
        cv2 = optional("cv2", "detection")
        grey: FloatArray | Float32Array = light
        exposure = self.exposure
        if self.gamma != 1.0:
            ratio = np.clip(light * np.float32(exposure), 0.0, None) / np.float32(GREY_LEVELS)
            grey, exposure = np.float32(GREY_LEVELS) * ratio ** np.float32(1.0 / self.gamma), 1.0
        # The sum is rounded and clipped to 8 bits as it is made.
        return np.asarray(cv2.addWeighted(grey, exposure, _grain(grey.shape, rng), self.noise, 0.0, dtype=cv2.CV_8U))

    def shade(self, normals: FloatArray) -> FloatArray:
        """Grey levels of surfaces that face `normals` `(..., 3)`: light comes from above and from one side."""
        return np.asarray(self.wall * (1.0 + normals @ LIGHT))


def _grain(shape: tuple[int, ...], rng: np.random.Generator) -> Float32Array:
    """Independent standard normal numbers: a stretch, drawn by `rng`, of a long row that is made once.

    Drawing them anew would take as long as the rest of the image. Two images may share numbers, at other pixels.
    """
    size, begin = math.prod(shape), int(rng.integers(SPARE_GRAIN))
    return _grain_row(size + SPARE_GRAIN)[begin : begin + size].reshape(shape)


@lru_cache(maxsize=2)
def _grain_row(size: int) -> Float32Array:
    """Standard normal numbers, the same every time, `(size,)`."""
    return np.random.default_rng(0x6E6F697365).standard_normal(size, dtype=np.float32)


# Starts that the noise of an image is drawn from.
SPARE_GRAIN = 2**20
# Makes each wall of a room a little different from its neighbours, so that its edges can be seen.
LIGHT = np.array([0.03, 0.05, 0.08])
