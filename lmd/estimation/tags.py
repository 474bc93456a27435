"""Tags that are found by their corners: their places in the camera's frame, and a detector that errs by pitch."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from lmd.core.checks import BoolArray, FloatArray, check_fields, choice, real
from lmd.core.optional import optional
from lmd.detection.corner_errors import CORNER_ERRORS
from lmd.detection.quality import pitch
from lmd.estimation.measurements import Detector, detected
from lmd.estimation.recording import Each, Flight, Look, Observation, Sensor, check_images, joined
from lmd.geometry.camera import Camera
from lmd.geometry.pose import straightened
from lmd.geometry.projection import bearings, intrinsics, project, slope
from lmd.geometry.se3 import skew
from lmd.geometry.squares import CORNERS, corners
from lmd.scene.deployment import Deployment
from lmd.scene.tag import Tag


@dataclass(frozen=True)
class TagDetector:
    """What becomes of a visible tag in an image, by what was measured of a real detector; a `Sensor`.

    The errors of its corners are drawn by its pitch (`lmd.detection.corner_errors`). Its place comes from its own four
    corners.

    Args:
        tag: at every landmark, upright.
        reader: the detector whose errors they are, one of `CORNER_ERRORS`.
        missed: probability that a visible tag is not detected.

    Raises:
        InputError: the tag is a point, the detector was not measured, or a value is out of range.
    """

    tag: Tag
    reader: str = "aruco"
    missed: float = 0.0

    def __post_init__(self) -> None:
        self.tag.check_edge()
        choice("reader", self.reader, tuple(CORNER_ERRORS))
        check_fields(self, real, "missed", low=0.0, high=1.0)

    def observed(self, flights: Sequence[Flight], each: Each = map) -> list[Observation]:
        """See `Sensor.observed`; a tag is visible as the scene's visibility model says."""
        check_images(flights)
        return [joined(list(map(self._observed, f.looks())), f.camera.extrinsics) for f in flights]

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
    """A detector whose noise is that of a real one where landmarks are tags, and constant where they are points.

    Args:
        tag: at every landmark.
        reader, missed: see `TagDetector`.
        pixel_noise, missed, edge: see `Detector`.
    """
    return Detector(pixel_noise, missed, edge) if tag.is_point else TagDetector(tag, reader, missed)


def corners_of(deployment: Deployment, tag: Tag) -> FloatArray:
    """The corners of tags at the landmarks, world frame, metres, `(K, 4, 3)`."""
    return corners(deployment.positions, deployment.normals, deployment.ups, deployment.edges_of(tag))


def observation(
    camera: Camera, edges: FloatArray, seen: BoolArray, found: FloatArray, noise: FloatArray
) -> Observation:
    """What tags observe of themselves by their corners.

    Args:
        edges: of the tags, metres, `(K,)`.
        seen: `(T, K)`.
        found: corners, pixels from the border, `(M, 4, 2)`.
        noise: their standard deviation, pixels, `(M,)`.
    """
    points = np.zeros((*seen.shape, 3))
    own = edges[np.nonzero(seen)[-1]]
    turns, points[seen] = _places(camera, own, found)
    return Observation(seen, points, noise, _covariance(camera, own, turns, points[seen]), found)


def _places(camera: Camera, edges: FloatArray, found: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Rotation `(M, 3, 3)` from each tag's frame (right, up, normal) to the camera's, and its centre there `(M, 3)`.

    Of the two poses of a square that look alike, that which fits its corners better (IPPE).
    """
    cv2 = optional("cv2", "detection")
    matrix, squares = intrinsics(camera), _squares(edges)
    turns, shifts, straight = (
        np.zeros((len(found), 3)),
        np.zeros((len(found), 3)),
        np.tile(np.eye(3), (len(found), 1, 1)),
    )
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

    The block of the inverse information on a tag's pose: y = R q + t moves by -R [q]x w + v, w in the tag's frame.
    """
    squares = _squares(edges)
    y = centres[:, None] + squares @ np.swapaxes(turns, 1, 2)  # (M, 4, 3)
    turned = -turns[:, None] @ skew(squares)  # (M, 4, 3, 3)
    jacobian = slope(camera, y) @ np.concatenate([turned, np.broadcast_to(np.eye(3), turned.shape)], axis=-1)
    information = (np.swapaxes(jacobian, -1, -2) @ jacobian).sum(axis=1)
    return np.asarray(np.linalg.inv(information)[:, 3:, 3:])


def _squares(edges: FloatArray) -> FloatArray:
    """Corners of squares with edges `(M,)` in their own frames (right, up, normal), metres, `(M, 4, 3)`."""
    return np.pad(CORNERS * edges[:, None, None] / 2.0, ((0, 0), (0, 0), (0, 1)))
