"""Intrinsics of a camera as given on a data sheet, and quantities derived from them; the lens may have distortion."""

import math
from dataclasses import dataclass, field
from functools import cached_property, partial
from typing import Annotated, Any, NamedTuple

import numpy as np

from lmd.core.checks import (
    Checked,
    FloatArray,
    InputError,
    NotNegative,
    Pair,
    Positive,
    integer,
    real,
)
from lmd.geometry.lens import Lens, lens_of

MM_PER_M = 1000.0
# Distance of the first pixel's centre from the image border, pixels. The origin of ROS and OpenCV is this centre, the
# origin of COLMAP is the border.
PIXEL_CENTRE = 0.5
# Largest half-angle of `Camera.cone_half_angle`, rad: a wider cone would contain points at zero depth.
WIDEST_CONE = math.radians(89.0)


class FieldOfView(NamedTuple):
    """Angles between the optical axis and the four image borders (left, right, top, bottom), radians."""

    left: float
    right: float
    top: float
    bottom: float


def pixels(name: str, value: Any) -> float:
    """Return `value` as a float if it is a whole number of pixels, at least 1; otherwise raise `InputError`. `name` is
    the name of the value in the error message.
    """
    return float(integer(name, value, low=1))


Distance = Annotated[float, partial(real, above=0.0, infinite=True)]


@dataclass(frozen=True)
class Camera(Checked):
    """Intrinsic parameters of a camera (Table I of the paper).

    Raises:
        InputError: a value is out of range, the principal point lies outside the image, or the focus distance is not
            beyond the focal length. The error is also raised if the lens model is unknown, if its projection is not
            injective up to the nearest image border, or if an image circle is given without distortion.
    """

    focal_length: Positive
    """Focal length f, mm."""
    pixel_width: Positive
    """Pixel width s_u, mm per pixel."""
    pixel_height: Positive
    """Pixel height s_v, mm per pixel."""
    principal_point: Pair
    """Principal point (o_u, o_v), pixels from the left and top border."""
    image_width: Annotated[float, pixels]
    """Image width w, whole pixels."""
    image_height: Annotated[float, pixels]
    """Image height h, whole pixels."""
    aperture: NotNegative
    """Effective diameter d_a of the aperture, mm; 0 (no defocus blur) for a pinhole or an unknown aperture."""
    focus_distance: Distance = math.inf
    """Distance d_s of the plane in focus, mm; may be infinite."""
    distortion: tuple[float, ...] = ()
    """Distortion coefficients of the lens in OpenCV's order; empty for a pinhole without distortion."""
    distortion_model: str = "plumb_bob"
    """Lens model: `plumb_bob`, `rational_polynomial` or `equidistant`, see `lmd.geometry.lens.Lens`."""
    image_circle: Distance = math.inf
    """Diameter of the image circle of a distorting lens, pixels; infinite if the circle covers the sensor."""
    note: str = field(default="", compare=False, repr=False)
    """Remark for users on the origin of the values."""

    def _validate(self) -> None:
        if self.focus_distance <= self.focal_length:
            raise InputError(
                f"focus_distance must exceed the focal length of {self.focal_length:g} mm, "
                f"got {self.focus_distance:g}.",
                "focus_distance",
            )
        u, v = self.principal_point
        if not (0.0 < u < self.image_width and 0.0 < v < self.image_height):
            raise InputError(
                f"principal_point must lie inside the {self.image_width:g} x {self.image_height:g} image, "
                f"got [{u:g}, {v:g}].",
                "principal_point",
            )
        lens = self.lens
        object.__setattr__(self, "distortion", () if lens is None else lens.coefficients)
        if lens is not None and lens.widest(nearest := min(self._borders)) >= lens.fold:
            raise InputError(
                "distortion must keep the image radius increasing with the angle up to the nearest border of the "
                f"image, at {nearest:.3g} focal lengths, but with {list(self.distortion)} it decreases beyond "
                f"{math.degrees(lens.fold):.3g} degrees off the axis.",
                "distortion",
            )
        if lens is None and self.image_circle < math.inf:
            raise InputError("image_circle needs distortion: the image of a pinhole is unbounded.", "image_circle")

    @property
    def cameras(self) -> "tuple[Camera, ...]":
        """Tuple that contains only this camera. `lmd.scene.rig.Rig` has this property too, so code can treat a camera
        as a rig.
        """
        return (self,)

    @property
    def extrinsics(self) -> FloatArray:
        """Pose of the camera on its body, `(1, 4, 4)`: the identity, because the body frame of a single camera is the
        camera frame.
        """
        return np.eye(4)[None]

    @property
    def is_pinhole(self) -> bool:
        """True if the camera has no defocus blur."""
        return self.aperture == 0.0

    @cached_property
    def lens(self) -> Lens | None:
        """Distorting lens; None for a pinhole without distortion."""
        return lens_of(self.distortion_model, self.distortion)

    @property
    def _borders(self) -> FieldOfView:
        """Distances of the four image borders (left, right, top, bottom) from the principal point, in focal lengths.
        The result is a `FieldOfView` with distances in place of angles.
        """
        u, v = self.principal_point
        width, height = self.pixel_width / self.focal_length, self.pixel_height / self.focal_length
        return FieldOfView(
            left=u * width,
            right=(self.image_width - u) * width,
            top=v * height,
            bottom=(self.image_height - v) * height,
        )

    @property
    def field_of_view(self) -> FieldOfView:
        """Angles phi_l, phi_r, phi_t, phi_b between the optical axis and the image borders: atan(border distance on the
        sensor / f).

        For a distorting lens, the angle of a border is that of the ray through the border's point nearest to the
        principal point. The angle is at most `widest_angle`.
        """
        if self.lens is None:
            return FieldOfView(*map(math.atan, self._borders))
        (left, right, top, bottom), none = self._borders, 0.0
        found = self.lens.directions(np.array([[-left, none], [right, none], [none, -top], [none, bottom]]))
        return FieldOfView(*np.fmin(np.arccos(found[:, 2]), self.widest_angle).tolist())

    @cached_property
    def widest_angle(self) -> float:
        """Largest angle between the optical axis and a ray that reaches the image, rad."""
        left, right, top, bottom = self._borders
        corner = math.hypot(max(left, right), max(top, bottom))
        if self.lens is None:
            return math.atan(corner)
        radius = self.image_circle / 2.0 / float(self.focal_pixels.max())
        return self.lens.widest(min(corner, radius))

    @property
    def cone_half_angle(self) -> float:
        """Half-angle of the cone tangent to the frustum, min(phi_l, phi_r, phi_t, phi_b, `WIDEST_CONE`), rad."""
        return min(*self.field_of_view, WIDEST_CONE)

    @property
    def image_distance(self) -> float:
        """Distance from the lens to the sensor, f d_s / (d_s - f), mm; f if the camera is focused at infinity."""
        if math.isinf(self.focus_distance):
            return self.focal_length
        return self.focal_length * self.focus_distance / (self.focus_distance - self.focal_length)

    def depth_of_field(self, circle_of_confusion: float) -> tuple[float, float]:
        """Compute the near and far limits d_n, d_f of acceptable focus, metres.

        d_n = d_a d_s f / (d_a f + b (d_s - f)) and d_f = d_a d_s f / (d_a f - b (d_s - f)). Here d_a is the aperture,
        d_s the focus distance, f the focal length, and b = delta min(s_u, s_v) for the pixel size s_u x s_v. The far
        limit is infinite if the focus is at or beyond the hyperfocal distance, that is, if d_a f <= b (d_s - f). If
        focused at infinity, d_n = d_a f / b.

        Args:
            circle_of_confusion: largest diameter delta of the blur disc at which a point counts as sharp, pixels.
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
        """Focal lengths (f / s_u, f / s_v), pixels, `(2,)`."""
        return np.array([self.focal_length / self.pixel_width, self.focal_length / self.pixel_height])

    @property
    def resolution_at_one_metre(self) -> float:
        """Resolution C^R at a depth of 1 m, pixels per mm; it is C^R / z at a depth of z metres (Eq. C_k^R)."""
        return self.image_distance / (MM_PER_M * max(self.pixel_width, self.pixel_height))

    def resolution_depth(self, threshold: float) -> float:
        """Depth, metres, at which the resolution falls to `threshold`, pixels per mm."""
        return self.resolution_at_one_metre / threshold
