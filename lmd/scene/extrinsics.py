"""Where calibrations say that a camera sits: Kalibr's chain of cameras with an IMU, EuRoC's sensor file, Basalt's."""

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from lmd.core.checks import FloatArray, InputError
from lmd.core.files import read_keys
from lmd.geometry.se3 import are_rotations, inverse, nearest_rotations, pose_of, poses_from_rows

Keys = Mapping[str, Any]


def read_mount(path: Any, name: str | None = None) -> FloatArray:
    """The pose of a camera on the body that carries it, from its optical frame to the body's, `(4, 4)`.

    Args:
        path: a file in YAML or JSON with `T_cam_imu` in each camera (Kalibr), with `T_BS` (EuRoC), or with `T_imu_cam`
            (Basalt).
        name: which camera, such as `cam0`, if there are several.

    Raises:
        InputError: the file cannot be read, has no such entry, several cameras and no `name`, or not that one.
    """
    keys = read_keys(path, "mount")
    found: dict[str, Callable[[], FloatArray]] = {}
    for camera, entry in keys.items():
        if isinstance(entry, Mapping) and "T_cam_imu" in entry:
            found[camera] = lambda entry=entry: inverse(_matrix(entry["T_cam_imu"]))  # type: ignore[misc]
    if isinstance(body := keys.get("T_BS"), Mapping):
        found["cam0"] = lambda: _matrix(body.get("data"))
    basalt = keys.get("value0", keys)
    if isinstance(basalt, Mapping) and isinstance(poses := basalt.get("T_imu_cam"), list):
        found |= {f"cam{i}": lambda pose=pose: _pose(pose) for i, pose in enumerate(poses)}  # type: ignore[misc]
    if not found:
        what = "no T_cam_imu (Kalibr), T_BS (EuRoC) or T_imu_cam (Basalt)"
        raise InputError(f"mount: {path} has {what}, so it does not say where a camera sits.", "mount")
    if name is None and len(found) > 1:
        raise InputError(
            f"mount: {path} has {', '.join(found)}: name one, as in {{path: {path}, name: cam0}}.", "mount"
        )
    if name is not None and name not in found:
        raise InputError(f"mount: {path} has no camera {name!r}, only {', '.join(found)}.", "mount")
    try:
        return found[name or next(iter(found))]()
    except (KeyError, TypeError, ValueError) as error:
        reason = " ".join(str(error).split())
        raise InputError(f"mount: {path}: the pose of the camera cannot be read ({reason}).", "mount") from None


def _matrix(values: Any) -> FloatArray:
    matrix = np.array(values, dtype=np.float64).reshape(4, 4)
    turn = matrix[:3, :3]
    if not (are_rotations(turn) and np.allclose(matrix[3], [0.0, 0.0, 0.0, 1.0])):
        raise ValueError("its matrix is no rigid motion")
    return pose_of(nearest_rotations(turn), matrix[:3, 3])


def _pose(keys: Any) -> FloatArray:
    row = [float(keys[key]) for key in ("px", "py", "pz", "qx", "qy", "qz", "qw")]
    return np.asarray(poses_from_rows(np.array([row]))[0])
