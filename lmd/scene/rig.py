"""Rigs: several cameras fixed to one body, such as a robot.

The body's frame has x forward, y to the left and z up. With a rig, the positions of a room are positions of the body's
origin, and an orientation PDF describes the body's x axis. Yaw, pitch and roll of a camera follow ROS and URDF: R =
Rz(yaw) Ry(pitch) Rx(roll), right-handed about the body's axes. A positive yaw turns to the left, a positive pitch looks
*down*.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Annotated, Any, NamedTuple

import numpy as np

from lmd.core.checks import ONE_TURN, Checked, FloatArray, InputError, Point, real, vector
from lmd.geometry.camera import Camera
from lmd.geometry.se3 import QUATERNION_TOLERANCE, inverse, pose_of

ANGLES = ("yaw", "pitch", "roll")
# Number of decimals of offsets in metres, so that offsets that differ only by rounding are equal.
SAME_PLACE_DECIMALS = 12
# Rotation from a frame with x right, y down, z ahead to a frame with x forward, y left, z up.
OPTICAL = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])


def angle(name: str, value: Any) -> float:
    """Return `value` as an angle in radians; raise `InputError` if it exceeds one turn (probably degrees)."""
    if abs(number := real(name, value)) > ONE_TURN:
        raise InputError(f"{name} must be in radians, at most one turn from zero, got {number:g}.", name)
    return number


def quaternion_of(name: str, value: Any) -> tuple[float, ...]:
    """Return `value` as a unit quaternion x, y, z, w; raise `InputError` if its norm is not 1."""
    quaternion = vector(name, value, 4)
    if abs((length := float(np.linalg.norm(quaternion))) - 1.0) > QUATERNION_TOLERANCE:
        raise InputError(f"{name} must have length 1, {list(quaternion)} has {length:g}.", name)
    return quaternion


@dataclass(frozen=True)
class Mount(Checked):
    """Camera of a rig with its pose on the body.

    Args:
        camera: intrinsics.
        translation: offset of the camera's centre from the body's origin, body frame, metres.
        yaw, pitch, roll: radians; the rotation Rz(yaw) Ry(pitch) Rx(roll) turns vectors from the camera's frame to the
            body's frame. With zero angles the camera looks along the body's x axis, upright.
        quaternion: rotation from the camera's frame to the body's frame as x, y, z, w, instead of the angles. The
            camera's frame has x along the optical axis, y left and z up in the image.

    Raises:
        InputError: a number is not finite, the quaternion is not unit, or both quaternion and angles are given.
    """

    camera: Camera
    translation: Point = (0.0, 0.0, 0.0)
    yaw: Annotated[float, angle] = 0.0
    pitch: Annotated[float, angle] = 0.0
    roll: Annotated[float, angle] = 0.0
    quaternion: Annotated[tuple[float, ...], quaternion_of] | None = None

    def _validate(self) -> None:
        if self.quaternion is not None and any(getattr(self, name) for name in ANGLES):
            raise InputError("quaternion must not be given together with yaw, pitch or roll.", "quaternion")

    @cached_property
    def rotation(self) -> FloatArray:
        """Rotation from the camera's frame (x forward, y left, z up) to the body's frame, `(3, 3)`."""
        from scipy.spatial.transform import Rotation

        if self.quaternion is not None:
            return np.asarray(Rotation.from_quat(self.quaternion).as_matrix())
        return np.asarray(Rotation.from_euler("ZYX", [self.yaw, self.pitch, self.roll]).as_matrix())


@dataclass(frozen=True)
class Rig:
    """Cameras on one body; a landmark counts once if at least one camera sees it.

    Args:
        mounts: cameras with their poses, at least one.

    Raises:
        InputError: `mounts` is empty.
    """

    mounts: tuple[Mount, ...]

    def __post_init__(self) -> None:
        object.__setattr__(self, "mounts", tuple(self.mounts))
        if not self.mounts:
            raise InputError("mounts must have at least one camera, got none.", "mounts")

    @classmethod
    def of_poses(cls, cameras: Sequence[Camera], poses: FloatArray) -> "Rig":
        """Rig of C cameras with given poses; the first camera's frame becomes the body's frame.

        Args:
            cameras: intrinsics of the cameras.
            poses: poses of the cameras in the frame of the first camera (x right, y down, z ahead), `(C, 4, 4)`,
                metres.
        """
        from scipy.spatial.transform import Rotation

        turns = Rotation.from_matrix(OPTICAL @ poses[:, :3, :3] @ OPTICAL.T).as_quat()
        rows = zip(cameras, (poses[:, :3, 3] @ OPTICAL.T).tolist(), turns.tolist(), strict=True)
        return cls(tuple(Mount(camera, tuple(place), quaternion=tuple(turn)) for camera, place, turn in rows))

    @property
    def cameras(self) -> tuple[Camera, ...]:
        """Cameras of the rig, in the order of `mounts`."""
        return tuple(mount.camera for mount in self.mounts)

    @cached_property
    def extrinsics(self) -> FloatArray:
        """Poses of the cameras relative to the body, `(C, 4, 4)`, metres.

        Here the frames of body and cameras have x right, y down, z ahead. If X is the pose of the body in this
        convention (`lmd.geometry.se3.camera_pose`), X extrinsics[c] is the pose of camera c.
        """
        turns = OPTICAL.T @ np.stack([mount.rotation for mount in self.mounts]) @ OPTICAL
        return pose_of(turns, np.stack([mount.translation for mount in self.mounts]) @ OPTICAL)

    @property
    def needs_roll(self) -> bool:
        """True if rolling the body (a rotation about its x axis) moves a camera or turns an optical axis."""
        return any(np.any(mount.translation[1:]) or np.any(mount.rotation[1:, 0]) for mount in self.mounts)

    @property
    def mounted(self) -> FloatArray:
        """Poses of the cameras in the frame of the first camera (x right, y down, z ahead), `(C, 4, 4)`, metres."""
        return np.asarray(inverse(self.extrinsics[0]) @ self.extrinsics)

    def views(self, axes: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Offsets and orientations of the cameras for A orientations of the body.

        Args:
            axes: body's x axis and the direction to its right (-y), two unit vectors, world frame, `(A, 6)`.

        Returns:
            offsets of the cameras from the body's origin, world frame, metres, `(C, A, 3)`.
            orientations of the cameras, `(C, A, 6)`: optical axis and direction to the right in the image, unit
                vectors, world frame.
        """
        forward, right = axes[:, :3], axes[:, 3:]
        body = (forward, -right, np.cross(right, forward))

        def world(vector: Sequence[float] | FloatArray) -> FloatArray:
            return np.asarray(vector[0] * body[0] + vector[1] * body[1] + vector[2] * body[2])

        offsets = np.stack([world(mount.translation) for mount in self.mounts])
        turned = [np.hstack([world(m.rotation[:, 0]), -world(m.rotation[:, 1])]) for m in self.mounts]
        return np.round(offsets, SAME_PLACE_DECIMALS) + 0.0, np.stack(turned)  # + 0.0 turns -0 into 0

    def stations(self, axes: FloatArray) -> "Iterator[Station]":
        """Yield the distinct offsets of each camera from the body's origin, for given orientations of the body.

        A `Station` is one such offset together with its orientations. Stations are ordered by camera, then by offset.

        Args:
            axes: body's x axis and the direction to its right (-y), two unit vectors, world frame, `(A, 6)`.
        """
        for camera, offsets, turned in zip(self.cameras, *self.views(axes), strict=True):
            places, place = np.unique(offsets, axis=0, return_inverse=True)
            for g, offset in enumerate(places):
                there = np.flatnonzero(place.reshape(-1) == g)
                yield Station(camera, offset, there, turned[there])


def rig_of(camera: Camera | Rig) -> Rig | None:
    """Return `camera` if it is a rig, and None if it is a single camera."""
    return camera if isinstance(camera, Rig) else None


class Station(NamedTuple):
    """Offset of a rig's camera from the body's origin, and the orientations of the body that lead to this offset."""

    camera: Camera
    """Intrinsics of the camera."""
    offset: FloatArray
    """Offset of the camera from the body's origin, world frame, metres, `(3,)`."""
    there: np.ndarray
    """Indices of the orientations of the body that give this offset, `(a,)`."""
    axes: FloatArray
    """Optical axis and direction to the right in the image at each of these orientations, world frame, `(a, 6)`."""
