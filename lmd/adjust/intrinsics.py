"""Intrinsics of cameras, and shifts of corners by blur, as unknowns: priors, derivatives, estimates and uncertainty."""

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from lmd.core.checks import FloatArray
from lmd.geometry.camera import Camera
from lmd.geometry.lens import Lens
from lmd.geometry.projection import bearings, slope
from lmd.geometry.se3 import skew

# Prior standard deviations of a rough guess: focal length, as a share of itself; principal point, as a share of the
# image's size; coefficients.
FOCAL_SIGMA, CENTRE_SIGMA, COEFFICIENT_SIGMA = 0.1, 0.1, 0.3
# Prior standard deviation of a calibration: as a share of the focal length, as a share of the image's size, and as the
# displacement of the corners by each coefficient, focal lengths.
CALIBRATED_SHARE = 0.005
UNDISTORTED = (0.1, 0.1, 0.01, 0.01, 0.1)  # prior standard deviations of coefficients that are not given
DIFFERENCE = 1e-4  # step of a coefficient for numerical derivatives
GRID_SIDE = 9  # number of places along each side of the image at which `unsure` is evaluated


@dataclass(frozen=True)
class Optics:
    """Camera, and the two parameters of the shift by which blur and exposure move the edges of tags in its images."""

    camera: Camera
    """The camera."""
    shifts: tuple[float, float] = (0.0, 0.0)
    """Parameters s_1 and s_2 of the shift of edges inward, pixels, see `lmd.adjust.refinement`."""

    @property
    def values(self) -> FloatArray:
        """P intrinsics of the camera, followed by the parameters s_1 and s_2 in `shifts`, pixels, `(P + 2,)`.

        The parameters s_1 and s_2 describe the shift by which blur and exposure move the edges of tags in images.
        """
        return np.append(intrinsics_of(self.camera), self.shifts)

    def at(self, values: FloatArray) -> "Optics":
        """Copy with other parameters. `values` `(P + 2,)` has the P intrinsics of the camera, followed by s_1 and s_2,
        the parameters of the shift by which blur and exposure move the edges of tags in images, pixels.

        Raises:
            InputError: no camera has these intrinsics.
        """
        return Optics(with_intrinsics(self.camera, values[:-2]), (float(values[-2]), float(values[-1])))


@dataclass(frozen=True)
class Calibrated:
    """Camera with intrinsics estimated from photographs."""

    given: Camera
    """Camera before the estimate."""
    found: Camera
    """Camera after the estimate."""
    shift: float
    """Shift of corners inward in the camera's images, pixels."""
    covariance: FloatArray
    """`(P + n, P + n)` covariance of the P values `intrinsics_of(found)`, followed by n shift parameters of the camera.
    """

    @property
    def sigma(self) -> FloatArray:
        """Standard deviations of the P intrinsics of the camera `found`, `(P,)`; `intrinsics_of` gives their order."""
        return np.sqrt(np.diag(self.covariance))[: len(intrinsics_of(self.found))]

    @property
    def shift_sigma(self) -> float:
        """Standard deviation of `shift`, the shift of corners inward, pixels."""
        return float(np.sqrt(np.diag(self.covariance))[len(self.sigma)])

    @cached_property
    def unsure(self) -> float:
        """Standard deviation of image points due to the uncertainty of the intrinsics: the median over the image,
        pixels. Displacements that a rotation of the camera could explain do not count.
        """
        size, bundle = len(self.sigma), _bundle(self.found)
        moved = parameter_slopes(self.found, bundle).reshape(-1, size)
        turned = (slope(self.found, bundle) @ skew(bundle)).reshape(-1, 3)
        moved -= turned @ np.linalg.lstsq(turned, moved, rcond=None)[0]
        square = np.einsum("np,pq,nq->n", moved, self.covariance[:size, :size], moved).reshape(-1, 2).sum(axis=1)
        return float(np.sqrt(np.median(square)))

    def document(self) -> dict[str, Any]:
        """Given and estimated intrinsics and standard deviations, as entries of a JSON file. Principal points are in
        pixels from the outer corner of the top left pixel.
        """
        rows = {"given": intrinsics_of(self.given), "found": intrinsics_of(self.found), "sigma": self.sigma}
        names = {"focal_pixels": slice(2), "principal_point": slice(2, 4), "distortion": slice(4, None)}
        figures = {row: {name: values[part].tolist() for name, part in names.items()} for row, values in rows.items()}
        shift = {"corner_shift": self.shift, "corner_shift_sigma": self.shift_sigma}
        return {**figures, **shift, "unsure_pixels": self.unsure}

    def to_text(self) -> str:
        """Sentence for a terminal: the estimated intrinsics with their standard deviations."""
        (f_u, f_v, u, v), (f_u0, f_v0, u0, v0) = (intrinsics_of(one)[:4] for one in (self.found, self.given))
        text = f"focal length {f_u:.1f} x {f_v:.1f} pixels (given {f_u0:.1f} x {f_v0:.1f}), "
        text += f"centre {u:.1f} x {v:.1f} ({u0:.1f} x {v0:.1f}); the image is known to {self.unsure:.2g} pixels"
        if not self.shift_sigma:
            return text
        way = "inward" if self.shift > 0.0 else "outward"
        return f"{text}; corners lie {abs(self.shift):.2g} pixels {way}, known to {self.shift_sigma:.1g}"


def _coefficients(camera: Camera) -> tuple[float, ...]:
    """Distortion coefficients of the camera; for a camera without a lens model, those of `plumb_bob`, all 0."""
    return camera.distortion or (0.0,) * len(UNDISTORTED)


def intrinsics_of(camera: Camera) -> FloatArray:
    """Focal lengths and principal point, pixels, and coefficients of the lens, `(P,)`."""
    return np.array([*camera.focal_pixels, *camera.principal_point, *_coefficients(camera)])


def with_intrinsics(camera: Camera, values: FloatArray) -> Camera:
    """Copy of `camera` with other intrinsics.

    Args:
        camera: the camera.
        values: focal lengths and principal point, pixels, and coefficients of the lens, `(P,)`, see `intrinsics_of`.

    Raises:
        InputError: no camera has these intrinsics.
    """
    width, height = (camera.focal_length / float(pixels) for pixels in values[:2])
    u, v, *lens = values[2:].tolist()
    return replace(camera, pixel_width=width, pixel_height=height, principal_point=(u, v), distortion=tuple(lens))


def prior_sigmas(camera: Camera, rough: bool = False) -> FloatArray:
    """Prior standard deviations of focal lengths, principal point and lens coefficients, `(P,)`, see `intrinsics_of`.

    Args:
        camera: camera before the estimate.
        rough: True if the calibration is a rough guess.
    """
    focal, size = camera.focal_pixels, np.array([camera.image_width, camera.image_height])
    if rough:
        lens = np.full(len(_coefficients(camera)), COEFFICIENT_SIGMA)
        return np.concatenate([FOCAL_SIGMA * focal, CENTRE_SIGMA * size, lens])
    moved = np.linalg.norm(parameter_slopes(camera, _bundle(camera))[..., 4:], axis=1).max(axis=0)
    lens = CALIBRATED_SHARE * focal.mean() / moved if camera.distortion else np.array(UNDISTORTED)
    return np.concatenate([CALIBRATED_SHARE * focal, CALIBRATED_SHARE * size, lens])


def _bundle(camera: Camera) -> FloatArray:
    """Directions of the rays through the points of a regular grid on the image, `(n, 3)`. Points to which the lens maps
    no ray are left out.
    """
    places = np.linspace(0.0, 1.0, GRID_SIDE)
    image = np.stack(np.meshgrid(places * camera.image_width, places * camera.image_height), axis=-1)
    bundle = bearings(camera, image.reshape(-1, 2))
    return np.asarray(bundle[np.isfinite(bundle).all(axis=-1)])


def parameter_slopes(camera: Camera, directions: FloatArray) -> FloatArray:
    """Derivatives of the image points of rays with respect to the P intrinsics, `(..., 2, P)`, pixels per unit of
    each intrinsic. `directions` `(..., 3)` are the rays in the camera's frame.
    """
    image = directions[..., :2] / directions[..., 2:] if camera.lens is None else camera.lens.project(directions)
    columns = [image * axis for axis in np.eye(2)] + [np.broadcast_to(axis, image.shape) for axis in np.eye(2)]
    given = _coefficients(camera)
    for step in DIFFERENCE * np.eye(len(given)):
        there, here = (
            Lens(camera.distortion_model, tuple(np.add(given, way * step))).project(directions) for way in (1.0, -1.0)
        )
        columns.append(camera.focal_pixels * (there - here) / (2.0 * DIFFERENCE))
    return np.stack(columns, axis=-1)
