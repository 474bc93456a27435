"""Several cameras fixed to one body, such as a robot: where each is, and what it then looks at.

The body's frame has x forward, y left and z up; its x axis is what an orientation PDF speaks of, and its origin what a
room's positions are. Yaw, pitch and roll of a camera are those of ROS and URDF: R = Rz(yaw) Ry(pitch) Rx(roll), each
right-handed about an axis of the body. So a positive yaw turns to the left and a positive pitch looks *down*.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from lmd.core.checks import ONE_TURN, FloatArray, InputError, check_fields, real, vector
from lmd.geometry.camera import Camera
from lmd.geometry.se3 import QUATERNION_TOLERANCE, inverse, pose_of

ANGLES = ("yaw", "pitch", "roll")
# Cameras that are at the same place but for rounding are at the same place: offsets have this many decimals, metres.
SAME_PLACE_DECIMALS = 12
# From x right, y down, z ahead to x forward, y left, z up.
OPTICAL = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])


@dataclass(frozen=True)
class Mount:
    """One camera of a rig, and where it is fixed.

    Args:
        camera: its intrinsics.
        translation: of its centre from the body's origin, body frame, metres.
        yaw, pitch, roll: radians, see above; with none of them it looks along the body's x axis, upright.
        quaternion: x, y, z, w of the same rotation, in place of the angles: it turns the camera's frame with x along
            the optical axis, y to the left of the image and z up in it to the body's frame.

    Raises:
        InputError: a number is not finite, the quaternion has not length 1, or comes with an angle.
    """

    camera: Camera
    translation: tuple[float, ...] = (0.0, 0.0, 0.0)
    yaw: float = 0.0
    pitch: float = 0.0
    roll: float = 0.0
    quaternion: tuple[float, ...] | None = None

    def __post_init__(self) -> None:
        check_fields(self, vector, "translation", size=3)
        for name in ANGLES:
            angle = real(name, getattr(self, name))
            if abs(angle) > ONE_TURN:
                raise InputError(f"{name} must be in radians, at most one turn from zero, got {angle:g}.", name)
            object.__setattr__(self, name, angle)
        if self.quaternion is None:
            return
        quaternion = vector("quaternion", self.quaternion, 4)
        if abs((length := float(np.linalg.norm(quaternion))) - 1.0) > QUATERNION_TOLERANCE:
            raise InputError(f"quaternion must have length 1, {list(quaternion)} has {length:g}.", "quaternion")
        if any(getattr(self, name) for name in ANGLES):
            raise InputError("quaternion must not come with yaw, pitch or roll: it says them already.", "quaternion")
        object.__setattr__(self, "quaternion", quaternion)

    @cached_property
    def rotation(self) -> FloatArray:
        """From the camera's frame (forward, left, up) to the body's, `(3, 3)`."""
        from scipy.spatial.transform import Rotation

        if self.quaternion is not None:
            return np.asarray(Rotation.from_quat(self.quaternion).as_matrix())
        return np.asarray(Rotation.from_euler("ZYX", [self.yaw, self.pitch, self.roll]).as_matrix())


@dataclass(frozen=True)
class Rig:
    """Cameras on one body; a landmark counts if any of them sees it, and once if several do.

    Args:
        mounts: at least one.

    Raises:
        InputError: there is none.
    """

    mounts: tuple[Mount, ...]

    def __post_init__(self) -> None:
        object.__setattr__(self, "mounts", tuple(self.mounts))
        if not self.mounts:
            raise InputError("mounts must have at least one camera, got none.", "mounts")

    @property
    def cameras(self) -> tuple[Camera, ...]:
        """The camera of each mount."""
        return tuple(mount.camera for mount in self.mounts)

    @cached_property
    def extrinsics(self) -> FloatArray:
        """Poses of the cameras on the body, `(C, 4, 4)`. In either frame x is right, y down and z ahead.

        With the body's pose X in such a frame (`lmd.geometry.se3.camera_pose`), that of camera c is X extrinsics[c].
        """
        turns = OPTICAL.T @ np.stack([mount.rotation for mount in self.mounts]) @ OPTICAL
        return pose_of(turns, np.stack([mount.translation for mount in self.mounts]) @ OPTICAL)

    def with_mount(self, number: int, mount: Mount) -> "Rig":
        """The rig with another mount of the camera with a number."""
        return Rig((*self.mounts[:number], mount, *self.mounts[number + 1 :]))

    @property
    def needs_roll(self) -> bool:
        """True if the body's roll moves a camera or its optical axis."""
        return any(np.any(mount.translation[1:]) or np.any(mount.rotation[1:, 0]) for mount in self.mounts)

    @property
    def mounted(self) -> FloatArray:
        """The poses of the cameras (x right, y down, z the optical axis) in the frame of the first, `(C, 4, 4)`."""
        return np.asarray(inverse(self.extrinsics[0]) @ self.extrinsics)

    def views(self, axes: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Offsets and optical axes of the cameras for orientations of the body.

        Args:
            axes: the body's x axis, and right (-y), `(A, 6)`: two unit vectors in the world frame, see
                `lmd.scene.pdf.Orientations`.

        Returns:
            offsets from the body's origin, `(C, A, 3)`, world frame, metres; optical axes and the image's right,
            `(C, A, 6)`.
        """
        forward, right = axes[:, :3], axes[:, 3:]
        body = (forward, -right, np.cross(right, forward))

        def world(vector: Sequence[float] | FloatArray) -> FloatArray:
            return np.asarray(vector[0] * body[0] + vector[1] * body[1] + vector[2] * body[2])

        offsets = np.stack([world(mount.translation) for mount in self.mounts])
        turned = [np.hstack([world(m.rotation[:, 0]), -world(m.rotation[:, 1])]) for m in self.mounts]
        return np.round(offsets, SAME_PLACE_DECIMALS) + 0.0, np.stack(turned)  # + 0.0 turns -0 into 0

    def stations(self, axes: FloatArray) -> "Iterator[Station]":
        """The stations of the cameras, camera by camera and place by place."""
        for camera, offsets, turned in zip(self.cameras, *self.views(axes), strict=True):
            places, place = np.unique(offsets, axis=0, return_inverse=True)
            for g, offset in enumerate(places):
                there = np.flatnonzero(place.reshape(-1) == g)
                yield Station(camera, offset, there, turned[there])


def rig_of(camera: Camera | Rig) -> Rig | None:
    """The rig; None for a single camera."""
    return camera if isinstance(camera, Rig) else None


class Station(NamedTuple):
    """A place of a camera: its offset from the body's origin, `(3,)`, world frame, metres.

    `there` `(a,)` says for which of the body's orientations the camera is there, and axes `(a, 6)` what it then looks
    at: optical axis and the image's right.
    """

    camera: Camera
    offset: FloatArray
    there: np.ndarray
    axes: FloatArray
