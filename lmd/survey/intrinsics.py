"""The intrinsics of the cameras of a survey, found together with its map.

A corner that was found at x and is imaged at pi(p, theta), theta being the intrinsics, has e = pi(p, theta) - x. So e
changes with theta as the image of the direction b does that x was seen in, which is all that an adjustment needs.
After each step the directions are those of the camera as it then is. What is known of theta beforehand is wide, see
`spreads`: it only keeps those in check that the photographs do not tell.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from threadpoolctl import threadpool_limits

from lmd.core.checks import FloatArray, InputError
from lmd.geometry.lens import Lens
from lmd.render.optics import bearings, slope
from lmd.scene.calibration_files import PIXEL_CENTRE
from lmd.scene.camera import Camera
from lmd.survey.estimate import ONE_THREAD, Estimate, adjusted
from lmd.survey.linked import adjustment_of
from lmd.survey.sightings import Sightings
from lmd.survey.start import FLOOR_PIXELS

# Standard deviations of what intrinsics may be off: of the focal length, of the image's size, of coefficients.
FOCAL_SIGMA, CENTRE_SIGMA, COEFFICIENT_SIGMA = 0.1, 0.1, 0.3
MOST_ROUNDS = 10
SETTLED_SIGMAS = 0.5  # standard deviations; a smaller step is the last
MOST_HALVINGS = 6  # of a step that leads to no camera
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
        unsure: by how much the intrinsics may move what is in the image, but for what a turn of the camera undoes: one
            standard deviation, pixels, the median over the image.
    """

    given: Camera
    found: Camera
    sigma: FloatArray
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
        return {**told, "unsure_pixels": self.unsure, "fixed": self.is_fixed}

    def to_text(self) -> str:
        """What a terminal shows."""
        was, now = parameters(self.given), parameters(self.found)

        def pair(values: FloatArray) -> str:
            return f"{values[0]:.1f} x {values[1]:.1f}"

        text = f"focal length {pair(now)} pixels (given {pair(was)}), centre {pair(now[2:])} ({pair(was[2:])})"
        return f"{text}; the image is known to {self.unsure:.2g} pixels"


def parameters(camera: Camera) -> FloatArray:
    """Focal lengths and principal point, pixels, and the coefficients of the lens, `(P,)`."""
    return np.array([*camera.focal_pixels, *camera.principal_point, *camera.distortion])


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


def spreads(camera: Camera) -> FloatArray:
    """What each of the `parameters` may be off, one standard deviation, `(P,)`."""
    focal = FOCAL_SIGMA * camera.focal_pixels
    centre = CENTRE_SIGMA * np.array([camera.image_width, camera.image_height])
    return np.concatenate([focal, centre, np.full(len(camera.distortion), COEFFICIENT_SIGMA)])


def slopes(camera: Camera, directions: FloatArray) -> FloatArray:
    """How the images of directions `(..., 3)` change with the `parameters`, pixels, `(..., 2, P)`."""
    image = directions[..., :2] / directions[..., 2:] if camera.lens is None else camera.lens.image(directions)
    columns = [image * axis for axis in np.eye(2)] + [np.broadcast_to(axis, image.shape) for axis in np.eye(2)]
    for index in range(len(camera.distortion)):
        step = np.eye(len(camera.distortion))[index] * DIFFERENCE
        there, here = (
            Lens(camera.distortion_model, tuple(np.add(camera.distortion, way * step))).image(directions)
            for way in (1.0, -1.0)
        )
        columns.append(camera.focal_pixels * (there - here) / (2.0 * DIFFERENCE))
    return np.stack(columns, axis=-1)


def freed(sightings: Sightings, cameras: Sequence[Camera], given: Sequence[Camera]) -> Sightings:
    """The sightings with the intrinsics of their cameras unknown.

    Args:
        cameras: as they are thought to be.
        given: as they were before; what they may be off says in which units.
    """
    most = max(len(parameters(camera)) for camera in cameras)
    lens = np.zeros((len(sightings), 4, 2, -(-most // 6) * 6))
    for index, camera in enumerate(cameras):
        own = sightings.camera == index
        size = len(parameters(camera))
        lens[own, ..., :size] = slopes(camera, sightings.directions[own]) * spreads(given[index])
    return replace(sightings, lens=lens.reshape(len(sightings), 8, -1))


def calibrated(
    found: Estimate, given: Sequence[Camera], again: Callable[[Sequence[Camera]], Sightings]
) -> tuple[Estimate, tuple[Camera, ...]]:
    """The best poses and intrinsics.

    Args:
        found: with the cameras as they were given.
        given: these.
        again: the sightings as other cameras of the same images have them.
    """
    cameras = tuple(given)
    size = freed(found.sightings, cameras, given).lens.shape[2]
    off = np.zeros((len(given), size))
    with threadpool_limits(limits=ONE_THREAD):
        for _ in range(MOST_ROUNDS):
            some = freed(found.sightings.of(found.used), cameras, given)
            step = adjustment_of(some, found.prior, lenses=True).lens_step(found.poses, found.floor, off)
            cameras, off = _stepped(given, off, step)
            sightings = freed(again(cameras), cameras, given)
            found = adjusted(sightings, found.prior, found.poses, found.group, FLOOR_PIXELS)
            sigma = np.sqrt(np.diagonal(found.intrinsics, axis1=1, axis2=2))
            if (np.abs(step) < SETTLED_SIGMAS * sigma).all():
                break
    return found, cameras


def _stepped(given: Sequence[Camera], off: FloatArray, step: FloatArray) -> tuple[tuple[Camera, ...], FloatArray]:
    """The cameras after a step, or the first part of it that leads to cameras, and how far they are off those given."""
    for halving in range(MOST_HALVINGS):
        there = off + 0.5**halving * step
        try:
            return tuple(_at(camera, there[index]) for index, camera in enumerate(given)), there
        except InputError:
            continue
    return tuple(_at(camera, off[index]) for index, camera in enumerate(given)), off


def _at(camera: Camera, off: FloatArray) -> Camera:
    own = parameters(camera)
    return with_parameters(camera, own + off[: len(own)] * spreads(camera))


def judged(found: Estimate, given: Sequence[Camera], cameras: Sequence[Camera]) -> tuple[Calibrated, ...]:
    """The cameras with what is known of them, from an estimate whose intrinsics were unknown."""
    result = []
    for before, after, covariance in zip(given, cameras, found.intrinsics, strict=True):
        size = len(parameters(after))
        spread = spreads(before)
        own = covariance[:size, :size] * np.outer(spread, spread)
        across, down = np.meshgrid(np.linspace(0.0, 1.0, GRID_SIDE), np.linspace(0.0, 1.0, GRID_SIDE))
        places = np.stack([across * after.image_width, down * after.image_height], axis=-1).reshape(-1, 2)
        seen = bearings(after, places)
        seen = seen[np.isfinite(seen).all(axis=-1)]
        moved = slopes(after, seen).reshape(-1, size)
        turned = np.einsum("nij,anj->nia", slope(after, seen), np.cross(np.eye(3)[:, None], seen)).reshape(-1, 3)
        moved -= turned @ np.linalg.lstsq(turned, moved, rcond=None)[0]
        square = np.einsum("np,pq,nq->n", moved, own, moved).reshape(-1, 2).sum(axis=1)
        result.append(Calibrated(before, after, np.sqrt(np.diag(own)), float(np.sqrt(np.median(square)))))
    return tuple(result)
