"""Rigs (several cameras on one body) from rig files, from calibrations with poses of cameras, and from
configurations.
"""

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from lmd.core.checks import FloatArray, InputError, argument_of, only_keys
from lmd.core.files import read_keys
from lmd.formats.calibrations import OPTICS, ReadCamera, calibrated_camera, read_cameras
from lmd.geometry.camera import Camera
from lmd.geometry.se3 import inverse
from lmd.scene.rig import ANGLES, OPTICAL, Mount, Rig

KEYS = ("translation", *ANGLES, "quaternion", "camera")
CAMERA_KEYS = ("path", "name", "image_size", "distortion_model", *OPTICS)
SHARED_KEYS = ("image_size", "distortion_model")
CHAIN_KEYS = ("path", *KEYS[:-1], "names", *SHARED_KEYS)
BODY, STEP = "body", "step"  # frames of reference in `ReadCamera.poses`
NO_BODY = "no T_cam_imu (Kalibr), T_BS (EuRoC), T_imu_cam (OpenVINS, Basalt) or T_SC (OKVIS)"


def read_mount(path: Any, name: str | None = None) -> FloatArray:
    """Read the pose of a camera on its body, from the camera's optical frame to the body's frame, `(4, 4)`.

    Args:
        path: a calibration that has `T_cam_imu` (Kalibr), `T_imu_cam` (OpenVINS) or `T_SC` (OKVIS) for each camera; or
            `T_BS` (EuRoC); or a list `T_imu_cam` (Basalt).
        name: name of the camera, such as `cam0`, if there are several.

    Raises:
        InputError: the file cannot be read, lacks the pose or the camera `name`, or has several cameras and `name` is
            None.
    """
    found = {camera or "cam0": poses[BODY] for camera, poses in _poses("mount", path).items() if BODY in poses}
    if not found:
        raise InputError(f"mount: {path} has {NO_BODY}, so the pose of its camera on the body is not known.", "mount")
    if name is None and len(found) > 1:
        raise InputError(
            f"mount: {path} has {', '.join(found)}: name one, as in {{path: {path}, name: cam0}}.", "mount"
        )
    if name is not None and name not in found:
        raise InputError(f"mount: {path} has no camera {name!r}, only {', '.join(found)}.", "mount")
    return found[name or next(iter(found))]


def read_chain(path: Any, names: Any = None, **shared: Any) -> dict[str, FloatArray]:
    """Read the poses of several cameras, keyed by name; each is a transform from the camera's optical frame to the
    first camera's optical frame, `(4, 4)`.

    Args:
        path: a file as in `read_mount`; or a file of Kalibr with `T_cn_cnm1` for each camera but the first.
        names: names of the cameras to return, in this order; None for all cameras.
        shared: arguments `image_size` and `distortion_model`, which are common to all cameras, see `read_calibration`.

    Raises:
        InputError: the file cannot be read, or lacks the pose of a camera.
    """
    if names is not None and not (isinstance(names, list) and names and all(isinstance(name, str) for name in names)):
        raise InputError(f"names must be a list of cameras, got {names!r}.", "names")
    found = _poses("path", path, **shared)
    if unknown := [name for name in names or () if name not in found]:
        raise InputError(f"names: {path} has no camera {unknown[0]!r}, only {', '.join(found)}.", "names")
    chain = [np.eye(4)]
    for step in [poses.get(STEP) for poses in found.values()][1:]:
        chain = [] if step is None or not chain else [*chain, chain[-1] @ inverse(step)]
    bodies = {name: poses[BODY] for name, poses in found.items() if BODY in poses}
    placed = dict(zip(found, chain, strict=True)) if len(chain) > 1 else bodies
    if len(placed) < 2 or (lost := [name for name in names or found if name not in placed]):
        what = f"{NO_BODY} and no T_cn_cnm1 (Kalibr) of {', '.join(lost) if len(placed) > 1 else 'several cameras'}"
        raise InputError(f"path: {path} has {what}, so the relative poses of its cameras are not known.", "path")
    first = inverse(placed[(names or list(placed))[0]])
    return {name: first @ placed[name] for name in names or placed}


def _poses(argument: str, path: Any, **shared: Any) -> dict[str, dict[str, FloatArray]]:
    """Poses of the cameras in a calibration file, `(4, 4)`, keyed by the camera's name and then by `body` or `step`.

    For these two poses see `lmd.formats.keyed_cameras.KeyedCameras`.

    Args:
        argument: name of the argument that gave the path, for messages.
        path: the file; one that is not a calibration has no poses.
        shared: arguments of `read_cameras`.
    """

    def poses(camera: ReadCamera) -> dict[str, FloatArray]:
        try:
            return dict(camera.poses())
        except (KeyError, TypeError, ValueError, OverflowError) as error:
            reason = " ".join(str(error).split()).removesuffix(".")
            raise InputError(
                f"{argument}: {path}: the pose of the camera cannot be read ({reason}).", argument
            ) from None

    try:
        cameras = read_cameras(path, argument=argument, **shared)
    except InputError as error:
        if error.argument is not None:
            raise
        cameras = {}  # another kind of file has no poses
    return {name: poses(camera) for name, camera in cameras.items()}


def rig_of(mounts: Any, camera: Camera | None = None) -> Rig:
    """Make a rig from plain values of a configuration.

    Args:
        mounts: list of mappings with the arguments of `Mount`, in which `camera` is a calibration file or a mapping
            with the arguments of `calibrated_camera`. Or one mapping for all cameras: its keys `path` (a calibration
            file with poses), `names`, `image_size` and `distortion_model` are as for `read_chain`. The other keys of
            the mapping are arguments of `Mount` for the pose of the first camera on the body. By default this camera is
            at the body's origin and looks along the body's x axis.
        camera: default camera, for the mounts that state none.

    Raises:
        InputError: `mounts` is neither a list nor a mapping with a `path`, or a value is refused.
    """
    if _is_chain(mounts):
        return _chained(mounts)
    if isinstance(mounts, str | Mapping) or not isinstance(mounts, Iterable):
        raise InputError(f"rig must be a list of cameras, got {mounts!r}.", "rig")
    entries = list(mounts)
    if not entries:
        raise InputError("rig must have at least one camera, got an empty list.", "rig")
    return Rig(tuple(_mount(f"rig[{i}]", entry, camera) for i, entry in enumerate(entries)))


def read_mounts(path: Any) -> Any:
    """Read the mounts of cameras from a file; the result is the argument `mounts` of `rig_of`.

    If the file has the key `rig`, the result is the list at this key; paths of calibrations in the list may be relative
    to the file. Any other file is taken for a calibration of several cameras; the result is then the mapping
    `{"path": path}`.

    Raises:
        InputError: the file cannot be read, or `rig` is not a list.
    """
    keys = read_keys(path, "rig")
    if "rig" not in keys:
        return {"path": path}
    if not isinstance(mounts := keys["rig"], list):
        raise InputError(f"rig: {path} has no list of cameras with the key rig.", "rig")
    for mount in mounts:
        source = mount.get("camera") if isinstance(mount, Mapping) else None
        if isinstance(source, str) and (beside := Path(str(path)).parent / source).is_file():
            mount["camera"] = str(beside)
    return mounts


def brings_cameras(mounts: Any) -> bool:
    """Return True if every mount in `mounts`, an argument of `rig_of`, states its camera."""
    if _is_chain(mounts):
        return True
    own = [isinstance(m, Mapping) and m.get("camera") is not None for m in (mounts if isinstance(mounts, list) else ())]
    return bool(own) and all(own)


def _is_chain(mounts: Any) -> bool:
    return isinstance(mounts, Mapping) and "path" in mounts


def _chained(given: Mapping[str, Any]) -> Rig:
    only_keys("rig", given, CHAIN_KEYS)
    from scipy.spatial.transform import Rotation

    where = {key: value for key, value in given.items() if key in KEYS and value is not None}
    shared = {key: given[key] for key in SHARED_KEYS if given.get(key) is not None}
    with argument_of("rig"):
        poses = read_chain(given["path"], given.get("names"), **shared)
        cameras = [calibrated_camera(given["path"], name, **shared) for name in poses]
        first = Mount(cameras[0], **where)
    mounts = [first]
    for camera, pose in zip(cameras[1:], list(poses.values())[1:], strict=True):
        place = np.array(first.translation) + first.rotation @ OPTICAL @ pose[:3, 3]
        turn = Rotation.from_matrix(first.rotation @ OPTICAL @ pose[:3, :3] @ OPTICAL.T)
        mounts.append(Mount(camera, tuple(place.tolist()), quaternion=tuple(turn.as_quat().tolist())))
    return Rig(tuple(mounts))


def write_rig(path: Path, rig: Rig, sources: Mapping[Camera, Any]) -> None:
    """Write a rig file, the text that `rig_text` makes of `rig` and `sources`."""
    path.write_text(rig_text(rig, sources), encoding="utf-8")


def rig_text(rig: Rig, sources: Mapping[Camera, Any]) -> str:
    """Text of a rig file that `read_mounts` reads; numbers are bit-identical to those of the rig.

    Args:
        rig: the rig.
        sources: value of the key `camera` for each camera, as in `rig_of`; None for a camera that is the rig's default
            camera.
    """
    import yaml

    entries = []
    for mount in rig.mounts:
        turns: dict[str, Any] = {name: getattr(mount, name) for name in ANGLES}
        if mount.quaternion is not None:
            turns = {"quaternion": list(mount.quaternion)}
        own = {"camera": source} if (source := sources.get(mount.camera)) is not None else {}
        entries.append({"translation": list(mount.translation), **turns, **own})
    head = "# Cameras on one body: metres, radians; x forward, y left, z up; positive pitch looks down.\n"
    return head + str(yaml.safe_dump({"rig": entries}, default_flow_style=None, sort_keys=False))


def _mount(name: str, entry: Any, camera: Camera | None) -> Mount:
    if not isinstance(entry, Mapping):
        raise InputError(f"{name} must have keys such as translation and yaw, got {entry!r}.", name)
    only_keys(name, entry, KEYS)
    values = {key: value for key, value in entry.items() if value is not None}
    with argument_of(name):
        own = camera_from(values.pop("camera", None)) or camera
        if own is None:
            raise InputError("camera is missing: give a calibration file here, or one for the whole rig.", "camera")
        return Mount(own, **values)


def camera_from(source: Any) -> Camera | None:
    """Make the camera of a mount, from a calibration file or from the arguments of `calibrated_camera`; None if
    `source` is None.

    Raises:
        InputError: `source` is neither a file nor a mapping of arguments, or the file is refused.
    """
    if source is None:
        return None
    given: Any = {"path": source} if isinstance(source, str | Path) else source
    if not isinstance(given, Mapping):
        raise InputError(f"camera must be a calibration file, or keys such as path and name, got {source!r}.", "camera")
    only_keys("camera", given, CAMERA_KEYS)
    with argument_of("camera"):
        return calibrated_camera(**{"path": None, **{key: value for key, value in given.items() if value is not None}})
