"""Simulated detectors of points and of tags, with random errors."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from typing import Annotated

import numpy as np
from scipy.spatial.transform import Rotation

from lmd.core.checks import BoolArray, Checked, FloatArray, NotNegative, Positive, Share, choice
from lmd.core.optional import optional
from lmd.detection.corner_errors import CORNER_ERRORS, pitch
from lmd.estimation.recording import Each, Flight, Look, Observation, Sensor, check_images, merged
from lmd.geometry.camera import Camera
from lmd.geometry.lens import EQUIDISTANT
from lmd.geometry.pose import straightened
from lmd.geometry.projection import bearings, depth_in_focus, intrinsics, project, slope
from lmd.geometry.se3 import act, inverse, skew
from lmd.geometry.squares import CORNERS, corners
from lmd.scene.deployment import Deployment
from lmd.scene.tag import Tag


@dataclass(frozen=True)
class PointDetector(Checked):
    """Detector of landmarks that are points; a `lmd.estimation.recording.Sensor`.

    For each landmark three numbers are measured, with independent normal errors. Two are the image coordinates of the
    centre. The third is the apparent length f a / z of an edge of length a that the landmark is assumed to have. With
    the focal length f, pixels, the apparent length gives the depth z.

    Raises:
        InputError: a value is out of range.
    """

    pixel_noise: NotNegative = 0.0
    """Standard deviation sigma of the noise of each of the three numbers, pixels; 0 for exact measurements."""
    missed: Share = 0.0
    """Probability that a visible landmark is not detected."""
    edge: Positive = 0.1
    """Edge length a of a landmark, metres."""

    def observed(self, flights: Sequence[Flight], each: Each = map) -> list[Observation]:
        """See `Sensor.observed`; the visibility model of the scene decides which landmarks are visible."""
        if self.pixel_noise > 0.0:
            check_images(flights)
        return [merged(list(map(self._observed, f.looks())), f.camera.extrinsics) for f in flights]

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
        """Simulate the measurement of landmarks at y = (x, y, z) in the camera's frame.

        The noise of the image point (x / z, y / z) is the pixel noise divided by the focal length f. The measured depth
        is f a / w, where a is the edge length of the landmark, and w >= 1 pixel the noisy apparent edge length. For a
        distorting lens, the noise is added to the distorted image; for a fisheye, the edge gives the distance instead
        of z.

        Args:
            points: true positions y, metres, `(..., 3)`; the result is arbitrary for z <= 0.
            camera: intrinsics and lens.
            rng: random generator for the noise.

        Returns:
            measured positions y, metres, `(..., 3)`.
        """
        if self.pixel_noise == 0.0:
            return points
        focal, noise = camera.focal_pixels, rng.normal(scale=self.pixel_noise, size=points.shape)
        if camera.lens is not None:
            image = project(camera, np.eye(4), points) + noise[..., :2]
            seen = bearings(camera, image)
            seen = np.where(np.isfinite(seen), seen, points)  # the noisy point may have no ray
            ray = seen / depth_in_focus(camera, seen)[..., None]
            depth = depth_in_focus(camera, points)[..., None]
        else:
            depth = np.where(points[..., 2:] > 0.0, points[..., 2:], 1.0)
            image = points[..., :2] / depth + noise[..., :2] / focal
            ray = np.concatenate([image, np.ones_like(depth)], axis=-1)
        width = np.maximum(focal[0] * self.edge / depth + noise[..., 2:], 1.0)
        return np.asarray(focal[0] * self.edge / width * ray)

    def covariance(self, measured: FloatArray, camera: Camera) -> FloatArray:
        """Covariance of the measured positions y for one pixel of noise in each of the three measured numbers.

        These numbers are the two image coordinates, and the apparent edge length, which gives the depth.

        Args:
            measured: measured positions y, metres, `(M, 3)`.
            camera: intrinsics and lens.

        Returns:
            covariances, m^2, `(M, 3, 3)`.
        """
        focal, depth = camera.focal_pixels, depth_in_focus(camera, measured)[:, None]
        if camera.lens is None:
            moved = np.zeros((len(measured), 3, 3))
            moved[:, [0, 1], [0, 1]] = depth / focal
            moved[:, :, 2] = measured * depth / (focal[0] * self.edge)
        else:
            # Jacobian of image point and edge with respect to y; the edge gives z, or for a fisheye the distance |y|.
            away = measured / depth if camera.lens.model == EQUIDISTANT else np.array([0.0, 0.0, 1.0])
            edge = np.broadcast_to(-focal[0] * self.edge / depth**2 * away, measured.shape)
            moved = np.linalg.inv(np.concatenate([slope(camera, measured), edge[:, None]], axis=1))
        return np.asarray(moved @ np.swapaxes(moved, 1, 2))


def detected(seen: BoolArray, missed: float, rng: np.random.Generator) -> BoolArray:
    """Draw a mask of the detected landmarks, in the shape of `seen`; a visible landmark is missed with probability
    `missed`.
    """
    return seen & (rng.random(seen.shape) >= missed)


@dataclass(frozen=True)
class TagDetector(Checked):
    """Detector of tags with the measured errors of a real detector; a `Sensor`.

    Corner errors are drawn from a distribution that depends on the pitch (`lmd.detection.corner_errors`). The position
    of a tag follows from its corners.

    Raises:
        InputError: the tag is a point, the detector was not measured, or a value is out of range.
    """

    tag: Tag
    """Tag at every landmark; tags hang upright."""
    reader: Annotated[str, partial(choice, options=tuple(CORNER_ERRORS))] = "aruco"
    """Detector, one of `CORNER_ERRORS`, whose errors are drawn."""
    missed: Share = 0.0
    """Probability that a visible tag is not detected."""

    def _validate(self) -> None:
        self.tag.check_edge()

    def observed(self, flights: Sequence[Flight], each: Each = map) -> list[Observation]:
        """See `Sensor.observed`; the visibility model of the scene decides which tags are visible."""
        check_images(flights)
        return [merged(list(map(self._observed, f.looks())), f.camera.extrinsics) for f in flights]

    def tags(self, deployment: Deployment) -> FloatArray:
        """See `Sensor.tags`."""
        return corners_of(deployment, self.tag)

    def _observed(self, look: Look) -> Observation:
        flight = look.flight
        camera, poses, deployment = look.camera, look.poses, flight.deployment
        squares = project(camera, poses, self.tags(deployment).reshape(-1, 3)).reshape(len(poses), -1, 4, 2)
        in_front = np.isfinite(squares).all(axis=(-2, -1))
        seen = detected(look.in_view & in_front, self.missed, flight.rng)
        edges = deployment.edges_of(self.tag)
        pitches = pitch(camera, poses, deployment.positions, deployment.normals, self.tag, edges)[seen]
        errors = CORNER_ERRORS[self.reader]
        found = squares[seen] + errors.draw(pitches, flight.rng)
        return observation(camera, edges, seen, found, errors.sigma(pitches))


def noisy_detector(tag: Tag, reader: str, pixel_noise: float, missed: float, edge: float) -> Sensor:
    """Make a simulated detector: for tags, with the noise of a real detector; for points, with constant noise.

    Args:
        tag: tag at every landmark.
        reader: name of the real detector, a key of `CORNER_ERRORS`; its measured errors are simulated.
        pixel_noise: standard deviation of the image coordinates of points, pixels.
        missed: probability that a visible landmark is not detected.
        edge: edge length of landmarks that are points, metres.
    """
    return PointDetector(pixel_noise, missed, edge) if tag.is_point else TagDetector(tag, reader, missed)


def corners_of(deployment: Deployment, tag: Tag) -> FloatArray:
    """Corners of tags at the landmarks, world frame, metres, `(K, 4, 3)`."""
    return corners(deployment.positions, deployment.normals, deployment.ups, deployment.edges_of(tag))


def observation(
    camera: Camera, edges: FloatArray, seen: BoolArray, found: FloatArray, noise: FloatArray
) -> Observation:
    """Compute the observation of K tags in T frames from the detected corners of the tags.

    Args:
        camera: intrinsics and lens.
        edges: edge lengths of the tags, metres, `(K,)`.
        seen: mask of the detected tags, `(T, K)`.
        found: detected corners, pixels from the outer corner of the image's top left pixel, `(M, 4, 2)`.
        noise: standard deviation of a corner coordinate in each detection, pixels, `(M,)`.
    """
    points = np.zeros((*seen.shape, 3))
    own = edges[np.nonzero(seen)[-1]]
    turns, points[seen] = _places(camera, own, found)
    return Observation(seen, points, noise, _covariance(camera, own, turns, points[seen]), found)


def _places(camera: Camera, edges: FloatArray, found: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Rotation `(M, 3, 3)` from each tag's frame (right, up, normal) to the camera's frame, and centre of the tag in
    the camera's frame, metres, `(M, 3)`. `edges` has the edge lengths, metres, `(M,)`, and `found` the detected
    corners, pixels, `(M, 4, 2)`.

    Two poses of a square have similar images (IPPE); the pose with the smaller reprojection error is taken.
    """
    cv2 = optional("cv2", "detection")
    matrix, squares = intrinsics(camera), _squares(edges)
    turns, shifts = np.zeros((2, len(found), 3))
    straight = np.tile(np.eye(3), (len(found), 1, 1))
    for i, image in enumerate(np.ascontiguousarray(found)):
        if camera.lens is not None:
            straight[i], _, image = straightened(bearings(camera, image))
            matrix = np.eye(3)
        _, turn, shift = cv2.solvePnP(
            squares[i], np.ascontiguousarray(image), matrix, None, flags=cv2.SOLVEPNP_IPPE_SQUARE
        )
        turns[i], shifts[i] = np.ravel(turn), np.ravel(shift)
    back = np.swapaxes(straight, 1, 2)
    return back @ Rotation.from_rotvec(turns).as_matrix(), (back @ shifts[..., None])[..., 0]


def _covariance(camera: Camera, edges: FloatArray, turns: FloatArray, centres: FloatArray) -> FloatArray:
    """Covariance of tags' centres in the camera's frame for one pixel of noise at their corners, m^2, `(M, 3, 3)`.

    The covariance is a block of the inverse Fisher information about the tag's pose. In the camera's frame, a tag has
    the rotation R (`turns`) and the centre t. A corner at q in the tag's frame is then at y = R q + t. A change (w, v)
    of the tag's pose, with w in the tag's frame, moves the corner by -R (q x w) + v.
    """
    squares = _squares(edges)
    y = centres[:, None] + squares @ np.swapaxes(turns, 1, 2)  # (M, 4, 3)
    turned = -turns[:, None] @ skew(squares)  # (M, 4, 3, 3)
    jacobian = slope(camera, y) @ np.concatenate([turned, np.broadcast_to(np.eye(3), turned.shape)], axis=-1)
    information = (np.swapaxes(jacobian, -1, -2) @ jacobian).sum(axis=1)
    return np.asarray(np.linalg.inv(information)[:, 3:, 3:])


def _squares(edges: FloatArray) -> FloatArray:
    """Corners of squares with edge lengths `edges` `(M,)`, each in its own frame (right, up, normal), metres,
    `(M, 4, 3)`.
    """
    return np.pad(CORNERS * edges[:, None, None] / 2.0, ((0, 0), (0, 0), (0, 1)))
