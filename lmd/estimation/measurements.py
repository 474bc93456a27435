"""A detector of landmarks that are points, whose apparent size gives their depth."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from lmd.core.checks import BoolArray, FloatArray, check_fields, real
from lmd.estimation.recording import Each, Flight, Look, Observation, check_images, joined
from lmd.geometry.camera import Camera
from lmd.geometry.lens import EQUIDISTANT
from lmd.geometry.projection import bearings, depth_in_focus, project, slope
from lmd.geometry.se3 import act, inverse
from lmd.scene.deployment import Deployment


@dataclass(frozen=True)
class Detector:
    """What becomes of a visible landmark in an image; a `lmd.estimation.recording.Sensor`.

    Noise has three independent parts for each landmark and frame, all normal with the same standard deviation: the two
    image coordinates of its centre, and the apparent length of its edge, f a / z, that gives the depth z.

    Args:
        pixel_noise: standard deviation sigma, pixels; 0 for exact measurements.
        missed: probability that a visible landmark is not detected.
        edge: edge length a of a landmark, metres.

    Raises:
        InputError: a value is out of range.
    """

    pixel_noise: float = 0.0
    missed: float = 0.0
    edge: float = 0.1

    def __post_init__(self) -> None:
        check_fields(self, real, "pixel_noise", low=0.0)
        check_fields(self, real, "missed", low=0.0, high=1.0)
        check_fields(self, real, "edge", above=0.0)

    def observed(self, flights: Sequence[Flight], each: Each = map) -> list[Observation]:
        """See `Sensor.observed`; a landmark is visible as the scene's visibility model says."""
        if self.pixel_noise > 0.0:
            check_images(flights)
        return [joined(list(map(self._observed, f.looks())), f.camera.extrinsics) for f in flights]

    def tags(self, deployment: Deployment) -> None:
        """See `Sensor.tags`."""

    def _observed(self, look: Look) -> Observation:
        flight = look.flight
        seen = detected(look.in_view, self.missed, flight.rng)
        exact = act(inverse(look.poses), flight.deployment.positions)
        points = self.measured(exact, look.camera, flight.rng)
        covariance = self.covariance(points[seen], look.camera)
        return Observation(seen, points, np.full(len(covariance), self.pixel_noise), covariance)

    def measured(self, points: FloatArray, camera: Camera, rng: np.random.Generator) -> FloatArray:
        """Measurements of landmarks at y = (x, y, z) in the camera's frame.

        (x / z, y / z) carries the pixel noise over the focal length, z = f a / w that of the edge w >= 1 pixel. Where
        the lens distorts, the noise is added to the distorted image, and the landmark is where that is seen; behind a
        fisheye the edge gives the distance in place of z.

        Args:
            points: `(..., 3)`, metres; meaningful where the depth z is positive.
            camera: its focal length in pixels, and its lens.

        Returns:
            `(..., 3)`, metres.
        """
        if self.pixel_noise == 0.0:
            return points
        focal, noise = camera.focal_pixels, rng.normal(scale=self.pixel_noise, size=points.shape)
        if camera.lens is not None:
            image = project(camera, np.eye(4), points) + noise[..., :2]
            seen = bearings(camera, image)
            seen = np.where(np.isfinite(seen), seen, points)  # as it is where the noise leaves what the lens images
            ray = seen / depth_in_focus(camera, seen)[..., None]
            depth = depth_in_focus(camera, points)[..., None]
        else:
            depth = np.where(points[..., 2:] > 0.0, points[..., 2:], 1.0)
            image = points[..., :2] / depth + noise[..., :2] / focal
            ray = np.concatenate([image, np.ones_like(depth)], axis=-1)
        width = np.maximum(focal[0] * self.edge / depth + noise[..., 2:], 1.0)
        return np.asarray(focal[0] * self.edge / width * ray)

    def covariance(self, measured: FloatArray, camera: Camera) -> FloatArray:
        """Covariance of y = z (a, b, 1) for one pixel of noise: in the image it moves a and b, in the edge it moves z.

        Args:
            measured: `(M, 3)`, metres.
            camera: its focal length in pixels, and its lens.

        Returns:
            `(M, 3, 3)`, m^2.
        """
        focal, depth = camera.focal_pixels, depth_in_focus(camera, measured)[:, None]
        if camera.lens is None:
            moved = np.zeros((len(measured), 3, 3))
            moved[:, [0, 1], [0, 1]] = depth / focal
            moved[:, :, 2] = measured * depth / (focal[0] * self.edge)
        else:
            # How image and edge move with y; both depths grow with y, one along the axis and one along y itself.
            away = measured / depth if camera.lens.model == EQUIDISTANT else np.array([0.0, 0.0, 1.0])
            edge = np.broadcast_to(-focal[0] * self.edge / depth**2 * away, measured.shape)
            moved = np.linalg.inv(np.concatenate([slope(camera, measured), edge[:, None]], axis=1))
        return np.asarray(moved @ np.swapaxes(moved, 1, 2))


def detected(seen: BoolArray, missed: float, rng: np.random.Generator) -> BoolArray:
    """Draw which of the visible landmarks are detected, the shape of `seen`; `missed` is a probability."""
    return seen & (rng.random(seen.shape) >= missed)
