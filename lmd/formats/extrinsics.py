"""Poses of cameras on a body or relative to each other, from the extrinsics of calibrations."""

import re
from collections.abc import Callable, Mapping
from functools import partial
from typing import Any

import numpy as np

from lmd.core.checks import FloatArray, InputError, real, vector
from lmd.core.files import flat, read_keys
from lmd.formats.calibration_readers import POSE
from lmd.formats.calibrations import keys_of, read_cameras
from lmd.geometry.se3 import are_rotations, inverse, nearest_rotations, pose_of, poses_from_rows

CHAINED = re.compile(r"cam\d+")  # name of a camera in Kalibr's chain


def read_mount(path: Any, name: str | None = None) -> FloatArray:
    """Pose of a camera on the body that carries it, from the camera's optical frame to the body's frame, `(4, 4)`.

    Args:
        path: a file in YAML or JSON with `T_cam_imu` (Kalibr), `T_imu_cam` (OpenVINS) or `T_SC` (OKVIS) in each camera,
            with `T_BS` (EuRoC), or with a list `T_imu_cam` (Basalt).
        name: name of the camera, such as `cam0`, if there are several.

    Raises:
        InputError: the file cannot be read, has no such entry, has no camera `name`, or has several cameras and `name`
            is None.
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


def read_chain(path: Any, names: Any = None, **shared: Any) -> dict[str, FloatArray]:
    """Poses of several cameras, each from its optical frame to the optical frame of the first camera, `(4, 4)`, by
    name.

    Args:
        path: a file as in `read_mount`; a file of Kalibr with `T_cn_cnm1` in each camera but the first; or a
            calibration of a device or a program that includes poses of cameras.
        names: names of the cameras to return, in this order; None for all cameras.
        shared: `image_size` and `distortion_model` of all cameras, see `read_calibration`.

    Raises:
        InputError: the file cannot be read, or lacks the pose of a camera.
    """
    if names is not None and not (isinstance(names, list) and names and all(isinstance(name, str) for name in names)):
        raise InputError(f"names must be a list of cameras, got {names!r}.", "names")
    if posed := _posed(path, names, shared):
        return posed
    keys = read_keys(path, "path")
    if (chain := _chain(keys)) is None:
        chain = _on_body(keys)
    if len(chain) < 2:
        what = "no T_cn_cnm1 or T_cam_imu (Kalibr), T_imu_cam (Basalt) or T_SC (OKVIS) of several cameras"
        raise InputError(f"path: {path} has {what}, so it does not say how they sit to each other.", "path")
    if unknown := [name for name in names or () if name not in chain]:
        raise InputError(f"names: {path} has no camera {unknown[0]!r}, only {', '.join(chain)}.", "names")
    poses = {name: _read("path", path, chain[name]) for name in names or chain}
    first = inverse(next(iter(poses.values())))
    return {name: first @ pose for name, pose in poses.items()}


def _posed(path: Any, names: Any, shared: Mapping[str, Any]) -> dict[str, FloatArray]:
    """Poses of the cameras of a calibration that includes poses; empty if the file is of another kind."""
    try:
        cameras = read_cameras(path, **shared)
        if POSE not in keys_of(path, next(iter(cameras.values()))):
            return {}
    except (InputError, StopIteration):  # a file of poses may have lenses that are not supported
        return {}
    streams = {name.split("/")[0] for name in cameras}
    if names is None and len(streams) < len(cameras):
        raise InputError(f"names must be given, as [A, B]: {path} has {', '.join(cameras)}.", "names")
    if unknown := [name for name in names or () if name not in cameras]:
        raise InputError(f"names: {path} has no camera {unknown[0]!r}, only {', '.join(cameras)}.", "names")
    placed = {name: keys_of(path, cameras[name])[POSE] for name in names or cameras}
    frames = {frame for frame, _ in placed.values()}
    if len(placed) < 2 or len(frames) > 1 or any(pose is None for _, pose in placed.values()):
        raise InputError(f"path: {path} does not say how {', '.join(placed)} sit to each other.", "path")
    poses = {name: _read("path", path, partial(_matrix, pose.tolist())) for name, (_, pose) in placed.items()}
    first = inverse(next(iter(poses.values())))
    return {name: first @ pose for name, pose in poses.items()}


def _on_body(keys: Mapping[str, Any]) -> dict[str, Callable[[], FloatArray]]:
    """Functions that read the pose of each camera, from its optical frame to the body's frame."""
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
    """Functions that read the pose of each camera of Kalibr's chain, in the frame of the first camera; None without a
    chain.
    """
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
