"""Several cameras fixed to one body, such as a robot: where each is, and what it then looks at.

The body's frame has x forward, y left and z up; its x axis is what an orientation PDF speaks of, and its origin what a
room's positions are. Yaw, pitch and roll of a camera are those of ROS and URDF: R = Rz(yaw) Ry(pitch) Rx(roll), each
right-handed about an axis of the body. So a positive yaw turns to the left and a positive pitch looks *down*.
"""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from lmd.core.checks import ONE_TURN, FloatArray, InputError, real, vector
from lmd.core.files import read_keys
from lmd.geometry.se3 import QUATERNION_TOLERANCE
from lmd.scene.camera import Camera
from lmd.scene.camera_calibration import OPTICS, calibrated_camera
from lmd.scene.extrinsics import LEVEL, read_chain

ANGLES = ("yaw", "pitch", "roll")
KEYS = ("translation", *ANGLES, "quaternion", "camera")
CAMERA_KEYS = ("path", "name", "image_size", *OPTICS)
CHAIN_KEYS = ("path", *KEYS[:-1])
# Cameras that are at the same place but for rounding are at the same place: offsets have this many decimals, metres.
SAME_PLACE_DECIMALS = 12


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
        object.__setattr__(self, "translation", vector("translation", self.translation, 3))
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

    @property
    def needs_roll(self) -> bool:
        """Whether the body's roll moves a camera or its optical axis."""
        return any(np.any(mount.translation[1:]) or np.any(mount.rotation[1:, 0]) for mount in self.mounts)

    def views(self, axes: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Where the cameras are and what they look at, for orientations of the body.

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
        """The same, camera by camera and place by place."""
        for camera, offsets, turned in zip(self.cameras, *self.views(axes), strict=True):
            places, place = np.unique(offsets, axis=0, return_inverse=True)
            for g, offset in enumerate(places):
                there = np.flatnonzero(place.reshape(-1) == g)
                yield Station(camera, offset, there, turned[there])


class Station(NamedTuple):
    """A place of a camera: its offset from the body's origin, `(3,)`, world frame, metres.

    `there` `(a,)` says for which of the body's orientations the camera is there, and axes `(a, 6)` what it then looks
    at: optical axis and the image's right.
    """

    camera: Camera
    offset: FloatArray
    there: np.ndarray
    axes: FloatArray


def rig_of(mounts: Any, camera: Camera | None = None) -> Rig:
    """A rig from plain values, as configurations have them.

    Args:
        mounts: a list of mappings with the arguments of `Mount`; `camera` there is a calibration file, or a mapping
            with the arguments of `calibrated_camera`. Or a calibration file that says where its cameras are, see
            `lmd.scene.extrinsics.read_chain`, or a mapping with it as `path` and where the first camera sits on the
            body by the other arguments of `Mount`; by default in its origin, looking along its x axis.
            Or a rig file, see `write_rig`.
        camera: of those mounts that do not say.

    Raises:
        InputError: it is no such list, or a value in it is refused.
    """
    mounts = unfolded(mounts)
    if is_chain(mounts):
        return _chained({"path": mounts} if isinstance(mounts, str | Path) else mounts)
    if isinstance(mounts, str | Mapping) or not isinstance(mounts, Iterable):
        raise InputError(f"rig must be a list of cameras, got {mounts!r}.", "rig")
    entries = list(mounts)
    if not entries:
        raise InputError("rig must have at least one camera, got an empty list.", "rig")
    return Rig(tuple(_mount(f"rig[{i}]", entry, camera) for i, entry in enumerate(entries)))


def unfolded(mounts: Any) -> Any:
    """The list of mounts in a rig file, YAML or JSON with the key `rig`; what is no such file stays what it is.

    Raises:
        InputError: there is no file, or it cannot be read.
    """
    if isinstance(mounts, str | Path) and isinstance(listed := read_keys(mounts, "rig.path").get("rig"), list):
        return listed
    return mounts


def write_rig(path: Path, rig: Rig, sources: Mapping[Camera, Any]) -> None:
    """Write a rig file, see `unfolded`; numbers are those of the rig, to the bit.

    Args:
        path: of the file.
        rig: what is written.
        sources: which calibration each kind of camera has, as `rig_of` takes it; none for the camera of all.
    """
    import yaml

    entries = []
    for mount in rig.mounts:
        turns: dict[str, Any] = {name: getattr(mount, name) for name in ANGLES}
        if mount.quaternion is not None:
            turns = {"quaternion": list(mount.quaternion)}
        own = {"camera": source} if (source := sources.get(mount.camera)) is not None else {}
        entries.append({"translation": list(mount.translation), **turns, **own})
    path.write_text(
        "# Cameras on one body: metres, radians; x forward, y left, z up; positive pitch looks down.\n"
        + yaml.safe_dump({"rig": entries}, default_flow_style=None, sort_keys=False),
        encoding="utf-8",
    )


def is_chain(mounts: Any) -> bool:
    """Whether a rig is given by a calibration file."""
    return isinstance(mounts, str | Path) or (isinstance(mounts, Mapping) and "path" in mounts)


def brings_cameras(mounts: Any) -> bool:
    """Whether no mount of `rig_of` needs a camera from elsewhere."""
    if is_chain(mounts):
        return True
    own = [isinstance(m, Mapping) and m.get("camera") is not None for m in (mounts if isinstance(mounts, list) else ())]
    return bool(own) and all(own)


def _chained(given: Mapping[str, Any]) -> Rig:
    if unknown := [key for key in given if key not in CHAIN_KEYS]:
        raise InputError(f"rig has no key {unknown[0]!r}, only {', '.join(CHAIN_KEYS)}.", "rig")
    from scipy.spatial.transform import Rotation

    where = {key: value for key, value in given.items() if key != "path" and value is not None}
    try:
        poses = read_chain(given["path"])
        cameras = [calibrated_camera(given["path"], name) for name in poses]
        first = Mount(cameras[0], **where)
    except InputError as error:
        raise error.within("rig") from None
    mounts = [first]
    for camera, pose in zip(cameras[1:], list(poses.values())[1:], strict=True):
        place = np.array(first.translation) + first.rotation @ LEVEL @ pose[:3, 3]
        turn = Rotation.from_matrix(first.rotation @ LEVEL @ pose[:3, :3] @ LEVEL.T)
        mounts.append(Mount(camera, tuple(place.tolist()), quaternion=tuple(turn.as_quat().tolist())))
    return Rig(tuple(mounts))


def _mount(name: str, entry: Any, camera: Camera | None) -> Mount:
    if not isinstance(entry, Mapping):
        raise InputError(f"{name} must have keys such as translation and yaw, got {entry!r}.", name)
    if unknown := [key for key in entry if key not in KEYS]:
        raise InputError(f"{name} has no key {unknown[0]!r}, only {', '.join(KEYS)}.", name)
    values = {key: value for key, value in entry.items() if value is not None}
    try:
        own = camera_from(values.pop("camera", None)) or camera
        if own is None:
            raise InputError("camera is missing: there is no other one to take.", "camera")
        return Mount(own, **values)
    except InputError as error:
        raise error.within(name) from None


def camera_from(source: Any) -> Camera | None:
    """The camera of a mount: of a calibration file, or of the arguments of `calibrated_camera`; None for none.

    Raises:
        InputError: it is neither, or the file is refused.
    """
    if source is None:
        return None
    given: Any = {"path": source} if isinstance(source, str | Path) else source
    if not isinstance(given, Mapping):
        raise InputError(f"camera must be a calibration file, or keys such as path and name, got {source!r}.", "camera")
    if unknown := [key for key in given if key not in CAMERA_KEYS]:
        raise InputError(f"camera has no key {unknown[0]!r}, only {', '.join(CAMERA_KEYS)}.", "camera")
    try:
        return calibrated_camera(**{"path": None, **{key: value for key, value in given.items() if value is not None}})
    except InputError as error:
        raise error.within("camera") from None
