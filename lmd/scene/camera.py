"""The pinhole camera of the paper: intrinsics as on a data sheet, and what they imply; its lens may distort."""

import math
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from lmd.core.checks import FloatArray, InputError, integer, real, vector
from lmd.geometry.distortion import coefficients, turning_point, widest_ray

MM_PER_M = 1000.0


class FieldOfView(NamedTuple):
    """Angles from the optical axis to the four image borders, radians."""

    left: float
    right: float
    top: float
    bottom: float


@dataclass(frozen=True)
class Camera:
    """Intrinsic parameters (Table I of the paper).

    Args:
        focal_length: f, mm.
        pixel_width, pixel_height: s_u and s_v, mm per pixel.
        principal_point: (o_u, o_v), pixels from the left and top border.
        image_width, image_height: w and h, whole pixels.
        aperture: effective diameter d_a, mm; 0 for a pinhole, or a lens of which it is not known: whatever its depth is
            in focus.
        focus_distance: d_s, mm; infinity, the default, is allowed.
        distortion: OpenCV's k1, k2, p1, p2 and, if you like, k3; none for a lens that does not distort, see
            `lmd.geometry.distortion`.

    Raises:
        InputError: a value is not positive, or for the aperture negative, the image has no whole number of pixels, the
            principal point lies outside it, the focus distance is not beyond the focal length, or the distortion folds
            the image.
    """

    focal_length: float
    pixel_width: float
    pixel_height: float
    principal_point: tuple[float, float]
    image_width: float
    image_height: float
    aperture: float
    focus_distance: float = math.inf
    distortion: tuple[float, ...] = ()

    def __post_init__(self) -> None:
        for name in ("focal_length", "pixel_width", "pixel_height"):
            object.__setattr__(self, name, real(name, getattr(self, name), above=0.0))
        object.__setattr__(self, "aperture", real("aperture", self.aperture, low=0.0))
        for name in ("image_width", "image_height"):
            object.__setattr__(self, name, float(integer(name, getattr(self, name), low=1)))
        focus = real("focus_distance", self.focus_distance, above=0.0, infinite=True)
        if focus <= self.focal_length:
            raise InputError(
                f"focus_distance must exceed the focal length of {self.focal_length:g} mm, got {focus:g}.",
                "focus_distance",
            )
        object.__setattr__(self, "focus_distance", focus)
        u, v = vector("principal_point", self.principal_point, 2)
        if not (0.0 < u < self.image_width and 0.0 < v < self.image_height):
            raise InputError(
                f"principal_point must lie inside the {self.image_width:g} x {self.image_height:g} image, "
                f"got [{u:g}, {v:g}].",
                "principal_point",
            )
        object.__setattr__(self, "principal_point", (u, v))
        object.__setattr__(self, "distortion", coefficients(self.distortion))
        if self.distortion and self.widest_ray >= (turn := turning_point(self.distortion)):
            raise InputError(
                f"distortion must show what is farther from the axis farther from the centre, all over the image, but "
                f"{list(self.distortion)} turns back {math.degrees(math.atan(turn)):.3g} degrees off the axis, before "
                "the corners.",
                "distortion",
            )

    @property
    def is_pinhole(self) -> bool:
        """Whether everything is in focus."""
        return self.aperture == 0.0

    @property
    def field_of_view(self) -> FieldOfView:
        """The four angles phi_l, phi_r, phi_t, phi_b: atan(border distance on the sensor / f)."""
        u, v = self.principal_point
        return FieldOfView(
            left=math.atan(u * self.pixel_width / self.focal_length),
            right=math.atan((self.image_width - u) * self.pixel_width / self.focal_length),
            top=math.atan(v * self.pixel_height / self.focal_length),
            bottom=math.atan((self.image_height - v) * self.pixel_height / self.focal_length),
        )

    @cached_property
    def widest_ray(self) -> float:
        """The distance from the optical axis, at a depth of 1, that the image shows at most."""
        (u, v), (focal_u, focal_v) = self.principal_point, self.focal_pixels
        reach = math.hypot(max(u, self.image_width - u) / focal_u, max(v, self.image_height - v) / focal_v)
        return widest_ray(self.distortion, reach) if self.distortion else reach

    @property
    def cone_half_angle(self) -> float:
        """Half-angle of the cone tangent to the frustum, min(phi_l, phi_r, phi_t, phi_b), radians."""
        return min(self.field_of_view)

    @property
    def image_distance(self) -> float:
        """f d_s / (d_s - f), mm: the distance from lens to sensor; f when focused at infinity."""
        if math.isinf(self.focus_distance):
            return self.focal_length
        return self.focal_length * self.focus_distance / (self.focus_distance - self.focal_length)

    def depth_of_field(self, circle_of_confusion: float) -> tuple[float, float]:
        """Near and far limits d_n, d_f of acceptable focus, metres.

        With b = delta min(s_u, s_v): d_n = d_a d_s f / (d_a f + b (d_s - f)) and
        d_f = d_a d_s f / (d_a f - b (d_s - f)). From the hyperfocal distance on (d_a f <= b (d_s - f)) the far
        limit is infinite; focused at infinity d_n = d_a f / b.

        Args:
            circle_of_confusion: permissible diameter delta, pixels.
        """
        blur = circle_of_confusion * min(self.pixel_width, self.pixel_height)
        aperture_focal = self.aperture * self.focal_length
        if math.isinf(self.focus_distance):
            return aperture_focal / blur / MM_PER_M, math.inf
        spread = blur * (self.focus_distance - self.focal_length)
        product = aperture_focal * self.focus_distance
        near = product / (aperture_focal + spread)
        far = product / (aperture_focal - spread) if aperture_focal > spread else math.inf
        return near / MM_PER_M, far / MM_PER_M

    @property
    def focal_pixels(self) -> FloatArray:
        """(f / s_u, f / s_v), pixels, `(2,)`."""
        return np.array([self.focal_length / self.pixel_width, self.focal_length / self.pixel_height])

    @property
    def resolution_at_one_metre(self) -> float:
        """C^R at a depth of 1 m, pixel/mm; the resolution at depth z is this divided by z (Eq. C_k^R)."""
        return self.image_distance / (MM_PER_M * max(self.pixel_width, self.pixel_height))

    def resolution_depth(self, threshold: float) -> float:
        """Depth in metres at which the resolution falls to `threshold` pixel/mm."""
        return self.resolution_at_one_metre / threshold
