"""Poses of cameras on a body: extrinsics of calibrations, rig files and rigs of configurations."""

import re
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from lmd.core.checks import FloatArray, InputError, argument_of, real, vector
from lmd.core.files import flat, read_keys
from lmd.formats.calibrations import OPTICS, calibrated_camera
from lmd.geometry.camera import Camera
from lmd.geometry.se3 import are_rotations, inverse, nearest_rotations, pose_of, poses_from_rows
from lmd.scene.rig import ANGLES, OPTICAL, Mount, Rig

CHAINED = re.compile(r"cam\d+")  # a camera of Kalibr's chain
KEYS = ("translation", *ANGLES, "quaternion", "camera")
CAMERA_KEYS = ("path", "name", "image_size", "distortion_model", *OPTICS)
CHAIN_KEYS = ("path", *KEYS[:-1])


def rig_of(mounts: Any, camera: Camera | None = None) -> Rig:
    """A rig from plain values, as configurations have them.

    Args:
        mounts: a list of mappings with the arguments of `Mount`; `camera` there is a calibration file, or a mapping
            with the arguments of `calibrated_camera`. Or a mapping with a calibration file that says where its cameras
            are as `path`, see `read_chain`, and where the first camera sits on the body by the
            other arguments of `Mount`; by default in its origin, looking along its x axis.
        camera: of those mounts that do not say.

    Raises:
        InputError: it is no such list, or a value in it is refused.
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
    """What `rig_of` makes a rig of, from a file: a list with the key `rig`, or a calibration of several cameras.

    Raises:
        InputError: the file cannot be read, or its key is no list.
    """
    keys = read_keys(path, "rig")
    if "rig" not in keys:
        return {"path": path}
    if not isinstance(mounts := keys["rig"], list):
        raise InputError(f"rig: {path} has no list of cameras with the key rig.", "rig")
    return mounts


def brings_cameras(mounts: Any) -> bool:
    """Whether no mount of `rig_of` needs a camera from elsewhere."""
    if _is_chain(mounts):
        return True
    own = [isinstance(m, Mapping) and m.get("camera") is not None for m in (mounts if isinstance(mounts, list) else ())]
    return bool(own) and all(own)


def calibrations_of(mounts: Any) -> dict[Camera, Any]:
    """Which calibration each kind of camera of `rig_of` has, for `write_rig`; none for the camera of all.

    Raises:
        InputError: a calibration is refused.
    """
    if _is_chain(mounts):
        sources = [{"path": mounts["path"], "name": name} for name in read_chain(mounts["path"])]
    else:
        sources = [entry["camera"] for entry in mounts if entry.get("camera") is not None]
    return {camera: source for source in sources if (camera := camera_from(source)) is not None}


def _is_chain(mounts: Any) -> bool:
    return isinstance(mounts, Mapping) and "path" in mounts


def _chained(given: Mapping[str, Any]) -> Rig:
    if unknown := [key for key in given if key not in CHAIN_KEYS]:
        raise InputError(f"rig has no key {unknown[0]!r}, only {', '.join(CHAIN_KEYS)}.", "rig")
    from scipy.spatial.transform import Rotation

    where = {key: value for key, value in given.items() if key != "path" and value is not None}
    with argument_of("rig"):
        poses = read_chain(given["path"])
        cameras = [calibrated_camera(given["path"], name) for name in poses]
        first = Mount(cameras[0], **where)
    mounts = [first]
    for camera, pose in zip(cameras[1:], list(poses.values())[1:], strict=True):
        place = np.array(first.translation) + first.rotation @ OPTICAL @ pose[:3, 3]
        turn = Rotation.from_matrix(first.rotation @ OPTICAL @ pose[:3, :3] @ OPTICAL.T)
        mounts.append(Mount(camera, tuple(place.tolist()), quaternion=tuple(turn.as_quat().tolist())))
    return Rig(tuple(mounts))


def write_rig(path: Path, rig: Rig, sources: Mapping[Camera, Any]) -> None:
    """Write a rig file, see `rig_text`."""
    path.write_text(rig_text(rig, sources), encoding="utf-8")


def rig_text(rig: Rig, sources: Mapping[Camera, Any]) -> str:
    """What a rig file says, see `read_mounts`; numbers are those of the rig, to the bit.

    Args:
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
    head = "# Cameras on one body: metres, radians; x forward, y left, z up; positive pitch looks down.\n"
    return head + str(yaml.safe_dump({"rig": entries}, default_flow_style=None, sort_keys=False))


def _mount(name: str, entry: Any, camera: Camera | None) -> Mount:
    if not isinstance(entry, Mapping):
        raise InputError(f"{name} must have keys such as translation and yaw, got {entry!r}.", name)
    if unknown := [key for key in entry if key not in KEYS]:
        raise InputError(f"{name} has no key {unknown[0]!r}, only {', '.join(KEYS)}.", name)
    values = {key: value for key, value in entry.items() if value is not None}
    with argument_of(name):
        own = camera_from(values.pop("camera", None)) or camera
        if own is None:
            raise InputError("camera is missing: there is no other one to take.", "camera")
        return Mount(own, **values)


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
    with argument_of("camera"):
        return calibrated_camera(**{"path": None, **{key: value for key, value in given.items() if value is not None}})


def read_mount(path: Any, name: str | None = None) -> FloatArray:
    """The pose of a camera on the body that carries it, from its optical frame to the body's, `(4, 4)`.

    Args:
        path: a file in YAML or JSON with `T_cam_imu` (Kalibr), `T_imu_cam` (OpenVINS) or `T_SC` (OKVIS) in each camera,
            with `T_BS` (EuRoC), or with a list `T_imu_cam` (Basalt).
        name: which camera, such as `cam0`, if there are several.

    Raises:
        InputError: the file cannot be read, has no such entry, several cameras and no `name`, or not that one.
    """
    found = _on_body(read_keys(path, "mount"))
    if not found:
        what = "no T_cam_imu (Kalibr), T_BS (EuRoC), T_imu_cam (Basalt) or T_SC (OKVIS)"
        raise InputError(f"mount: {path} has {what}, so it does not say where a camera sits.", "mount")
    if name is None and len(found) > 1:
        raise InputError(
            f"mount: {path} has {', '.join(found)}: name one, as in {{path: {path}, name: cam0}}.", "mount"
        )
    if name is not None and name not in found:
        raise InputError(f"mount: {path} has no camera {name!r}, only {', '.join(found)}.", "mount")
    return _read("mount", path, found[name or next(iter(found))])


def read_chain(path: Any) -> dict[str, FloatArray]:
    """The poses of several cameras, each from its optical frame to that of the first, `(4, 4)`, by name.

    Args:
        path: a file as in `read_mount`, or one of Kalibr with `T_cn_cnm1` in each camera but the first.

    Raises:
        InputError: the file cannot be read, or does not say where each camera is.
    """
    keys = read_keys(path, "path")
    if (chain := _chain(keys)) is None:
        chain = _on_body(keys)
    if len(chain) < 2:
        what = "no T_cn_cnm1 or T_cam_imu (Kalibr), T_imu_cam (Basalt) or T_SC (OKVIS) of several cameras"
        raise InputError(f"path: {path} has {what}, so it does not say how they sit to each other.", "path")
    poses = {name: _read("path", path, pose) for name, pose in chain.items()}
    first = inverse(next(iter(poses.values())))
    return {name: first @ pose for name, pose in poses.items()}


def _on_body(keys: Mapping[str, Any]) -> dict[str, Callable[[], FloatArray]]:
    """What reads the pose of each camera on the body, from its optical frame to the body's."""
    found: dict[str, Callable[[], FloatArray]] = {}
    for camera, entry in keys.items():
        if not (isinstance(entry, Mapping) and CHAINED.fullmatch(camera)):
            continue
        if "T_cam_imu" in entry:
            found[camera] = lambda entry=entry: inverse(_matrix(entry["T_cam_imu"]))  # type: ignore[misc]
        elif "T_imu_cam" in entry:
            found[camera] = lambda entry=entry: _matrix(entry["T_imu_cam"])  # type: ignore[misc]
    if isinstance(body := keys.get("T_BS"), Mapping):
        found["cam0"] = lambda: _matrix(body.get("data"))
    basalt = keys.get("value0", keys)
    if isinstance(basalt, Mapping) and isinstance(poses := basalt.get("T_imu_cam"), list):
        found |= {f"cam{i}": lambda pose=pose: _pose(pose) for i, pose in enumerate(poses)}  # type: ignore[misc]
    if isinstance(cameras := keys.get("cameras"), list):
        found |= {
            f"cam{i}": lambda pose=camera["T_SC"]: _matrix(pose)  # type: ignore[misc]
            for i, camera in enumerate(cameras)
            if isinstance(camera, Mapping) and "T_SC" in camera
        }
    return found


def _chain(keys: Mapping[str, Any]) -> dict[str, Callable[[], FloatArray]] | None:
    """What reads the pose of each camera of Kalibr's chain in the first; None if they are not chained."""
    names = sorted((name for name in keys if CHAINED.fullmatch(name)), key=lambda name: int(name[3:]))
    entries = [keys[name] for name in names]
    if not entries or not all(isinstance(entry, Mapping) and "T_cn_cnm1" in entry for entry in entries[1:]):
        return None
    steps = [entry["T_cn_cnm1"] for entry in entries[1:]]

    def pose(index: int) -> FloatArray:
        found = np.eye(4)
        for step in steps[:index]:
            found = found @ inverse(_matrix(step))
        return found

    return {name: lambda index=index: pose(index) for index, name in enumerate(names)}  # type: ignore[misc]


def _read(name: str, path: Any, pose: Callable[[], FloatArray]) -> FloatArray:
    try:
        return pose()
    except KeyError as error:
        raise InputError(f"{name}: {path}: the pose of the camera cannot be read ({error} is missing).", name) from None
    except (TypeError, ValueError, OverflowError) as error:
        reason = " ".join(str(error).split()).removesuffix(".")
        raise InputError(f"{name}: {path}: the pose of the camera cannot be read ({reason}).", name) from None


def _matrix(values: Any) -> FloatArray:
    rows = flat(values) if isinstance(values, list) else values
    matrix = np.array(vector("its matrix", rows, 16)).reshape(4, 4)
    turn = matrix[:3, :3]
    if are_rotations(turn) and np.any(matrix[3, :3]) and not np.any(matrix[:3, 3]):
        raise ValueError("its matrix looks as if it was written column by column, and must be written row by row")
    if not (are_rotations(turn) and np.allclose(matrix[3], [0.0, 0.0, 0.0, 1.0])):
        raise ValueError("its matrix is no rigid motion")
    return pose_of(nearest_rotations(turn), matrix[:3, 3])


def _pose(keys: Any) -> FloatArray:
    if not isinstance(keys, Mapping):
        raise InputError(f"it must have the keys px, py, pz, qx, qy, qz, qw, got {keys!r}")
    row = [real(key, keys[key]) for key in ("px", "py", "pz", "qx", "qy", "qz", "qw")]
    return np.asarray(poses_from_rows(np.array([row]))[0])
