"""The intrinsics of the cameras of a survey: what is known of them beforehand, and what the photographs say."""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from lmd.core.checks import FloatArray
from lmd.geometry.camera import PIXEL_CENTRE, Camera
from lmd.geometry.lens import Lens
from lmd.geometry.projection import bearings, slope

# Standard deviations of what intrinsics may be off: of the focal length, of the image's size, of coefficients.
FOCAL_SIGMA, CENTRE_SIGMA, COEFFICIENT_SIGMA = 0.1, 0.1, 0.3
CALIBRATED_SHARE = 0.005
# Likewise of the coefficients of a lens that none are given of: of a pinhole, or of one that was not calibrated.
UNDISTORTED = (0.1, 0.1, 0.01, 0.01, 0.1)
DIFFERENCE = 1e-4  # of a coefficient
# Photographs fix the intrinsics if `Calibrated.unsure` is less, pixels.
FIXED_PIXELS = 1.0
GRID_SIDE = 9  # places along each side of the image that this is asked at


@dataclass(frozen=True)
class Calibrated:
    """A camera as its photographs say.

    Args:
        given, found: the camera before and after.
        sigma: standard deviations of `parameters(found)`, `(P,)`.
        shift, shift_sigma: by how many pixels corners are too far inward in its images, and one standard deviation.
        unsure: by how much the intrinsics may move what is in the image, but for what a turn of the camera undoes: one
            standard deviation, pixels, the median over the image.
    """

    given: Camera
    found: Camera
    sigma: FloatArray
    shift: float
    shift_sigma: float
    unsure: float

    @property
    def is_fixed(self) -> bool:
        """Whether the photographs tell the intrinsics."""
        return self.unsure <= FIXED_PIXELS

    def document(self) -> dict[str, Any]:
        """What a JSON file says of it; centres from the image's border, pixels."""
        rows = {"given": parameters(self.given), "found": parameters(self.found), "sigma": self.sigma}
        names = {"focal_pixels": slice(2), "principal_point": slice(2, 4), "distortion": slice(4, None)}
        told = {row: {name: values[part].tolist() for name, part in names.items()} for row, values in rows.items()}
        shift = {"corner_shift": self.shift, "corner_shift_sigma": self.shift_sigma}
        return {**told, **shift, "unsure_pixels": self.unsure, "fixed": self.is_fixed}

    def to_text(self) -> str:
        """What a terminal shows."""
        was, now = parameters(self.given), parameters(self.found)

        def pair(values: FloatArray) -> str:
            return f"{values[0]:.1f} x {values[1]:.1f}"

        text = f"focal length {pair(now)} pixels (given {pair(was)}), centre {pair(now[2:])} ({pair(was[2:])})"
        text += f"; the image is known to {self.unsure:.2g} pixels"
        if not self.shift_sigma:
            return text
        way = "inward" if self.shift > 0.0 else "outward"
        return f"{text}; corners lie {abs(self.shift):.2g} pixels {way}, known to {self.shift_sigma:.1g}"


def coefficients(camera: Camera) -> tuple[float, ...]:
    """The coefficients of the lens; those of `plumb_bob`, all 0, where none is given."""
    return camera.distortion or (0.0,) * len(UNDISTORTED)


def parameters(camera: Camera) -> FloatArray:
    """Focal lengths and principal point, pixels, and the coefficients of the lens, `(P,)`."""
    return np.array([*camera.focal_pixels, *camera.principal_point, *coefficients(camera)])


def with_parameters(camera: Camera, values: FloatArray) -> Camera:
    """The camera with other intrinsics, see `parameters`.

    Raises:
        InputError: there is no such camera.
    """
    width, height = (camera.focal_length / float(pixels) for pixels in values[:2])
    u, v, *coefficients = values[2:].tolist()
    return replace(
        camera, pixel_width=width, pixel_height=height, principal_point=(u, v), distortion=tuple(coefficients)
    )


def camera_info(camera: Camera) -> dict[str, Any]:
    """The keys of ROS's `camera_info`, which counts pixels from the centre of the first one."""
    (focal_u, focal_v), (u, v) = camera.focal_pixels.tolist(), camera.principal_point
    lens = list(camera.distortion) or [0.0] * 5
    matrix = [focal_u, 0.0, u - PIXEL_CENTRE, 0.0, focal_v, v - PIXEL_CENTRE, 0.0, 0.0, 1.0]
    return {
        "image_width": round(camera.image_width),
        "image_height": round(camera.image_height),
        "camera_matrix": {"rows": 3, "cols": 3, "data": matrix},
        "distortion_model": camera.distortion_model,
        "distortion_coefficients": {"rows": 1, "cols": len(lens), "data": lens},
    }


def spreads(camera: Camera, wide: bool = False) -> FloatArray:
    """Standard deviations of what each of the `parameters` may be off, `(P,)`.

    Args:
        camera: as it was calibrated.
        wide: whether that is a rough guess.
    """
    focal, size = camera.focal_pixels, np.array([camera.image_width, camera.image_height])
    if wide:
        return np.concatenate(
            [FOCAL_SIGMA * focal, CENTRE_SIGMA * size, np.full(len(coefficients(camera)), COEFFICIENT_SIGMA)]
        )
    seen = bearings(camera, image_grid(camera))
    seen = seen[np.isfinite(seen).all(axis=-1)]
    moved = np.linalg.norm(slopes(camera, seen)[..., 4:], axis=1).max(axis=0)
    lens = CALIBRATED_SHARE * focal.mean() / moved if camera.distortion else np.array(UNDISTORTED)
    return np.concatenate([CALIBRATED_SHARE * focal, CALIBRATED_SHARE * size, lens])


def image_grid(camera: Camera) -> FloatArray:
    """Places all over the image, pixels, `(n, 2)`."""
    across, down = np.meshgrid(np.linspace(0.0, 1.0, GRID_SIDE), np.linspace(0.0, 1.0, GRID_SIDE))
    return np.stack([across * camera.image_width, down * camera.image_height], axis=-1).reshape(-1, 2)


def slopes(camera: Camera, directions: FloatArray) -> FloatArray:
    """How the images of directions `(..., 3)` change with the `parameters`, pixels, `(..., 2, P)`."""
    image = directions[..., :2] / directions[..., 2:] if camera.lens is None else camera.lens.image(directions)
    columns = [image * axis for axis in np.eye(2)] + [np.broadcast_to(axis, image.shape) for axis in np.eye(2)]
    given = coefficients(camera)
    for step in DIFFERENCE * np.eye(len(given)):
        there, here = (
            Lens(camera.distortion_model, tuple(np.add(given, way * step))).image(directions) for way in (1.0, -1.0)
        )
        columns.append(camera.focal_pixels * (there - here) / (2.0 * DIFFERENCE))
    return np.stack(columns, axis=-1)


def judged(given: Camera, seen: Camera, shift: float, own: FloatArray) -> Calibrated:
    """A camera with what is known of it.

    Args:
        given: as it was calibrated.
        seen, shift: as the photographs have it, see `Calibrated`.
        own: covariance of its parameters and then of shifts, `(P + n, P + n)`.
    """
    size = len(parameters(seen))
    bundle = bearings(seen, image_grid(seen))
    bundle = bundle[np.isfinite(bundle).all(axis=-1)]
    moved = slopes(seen, bundle).reshape(-1, size)
    turned = np.einsum("nij,anj->nia", slope(seen, bundle), np.cross(np.eye(3)[:, None], bundle)).reshape(-1, 3)
    moved -= turned @ np.linalg.lstsq(turned, moved, rcond=None)[0]
    square = np.einsum("np,pq,nq->n", moved, own[:size, :size], moved).reshape(-1, 2).sum(axis=1)
    sigma = np.sqrt(np.diag(own))
    return Calibrated(given, seen, sigma[:size], shift, float(sigma[size]), float(np.sqrt(np.median(square))))
