"""Readers of calibrations by programs for reconstruction and calibration, as keys of ROS.

| program | the principal point counts from |
| --- | --- |
| Open3D, Visual Marker Mapping, Caltech's toolbox for MATLAB | the centre of the first pixel, as OpenCV |
| MATLAB's toolbox for computer vision | one pixel to the left of and above the centre of the first pixel |
| Metashape | the middle of the image, from whose border pixels are counted |
| nerfstudio, instant-ngp | the border of the image |

Sources: `PinholeCameraIntrinsic` and `PinholeCameraParameters` of Open3D, whose matrices are written by columns;
`cameraIntrinsicsToOpenCV` and `stereoParametersToOpenCV` of MATLAB; "Camera models" in Metashape's manual;
`colmap_utils.py`, `camera_utils.py` and `cameras.py` (nerfstudio-project/nerfstudio), `nerf_loader.cu`
(NVlabs/instant-ngp); `CameraUtilities.cpp` (cfneuhaus/visual_marker_mapping).
"""

import math
import re
from collections.abc import Mapping
from typing import Any
from xml.etree.ElementTree import Element

import numpy as np

from lmd.core.checks import FloatArray, InputError, real, vector
from lmd.core.files import flat
from lmd.formats.calibration_readers import (
    POSE,
    Cameras,
    Keys,
    fitted,
    known_lens,
    matrix_of,
    named,
    no_size,
    ros_keys,
    row_by_row,
    within,
)
from lmd.geometry.camera import PIXEL_CENTRE
from lmd.geometry.central_models import power_series
from lmd.geometry.lens import EQUIDISTANT
from lmd.geometry.se3 import inverse, pose_of

FIRST_PIXEL = 1.0  # MATLAB's coordinate of the centre of the first pixel
MOST_FRAMES = 64  # greatest number of different cameras of frames in a file
MILLIMETRES = 1000.0
NERF_FISHEYE = "OPENCV_FISHEYE"
NERF_MODELS = ("OPENCV", "PINHOLE", "SIMPLE_PINHOLE", "SIMPLE_RADIAL", "RADIAL", NERF_FISHEYE)
NERF_LENS = ("k1", "k2", "k3", "k4", "p1", "p2")
NERF_KEYS = ("w", "h", "fl_x", "fl_y", "cx", "cy", *NERF_LENS, "distortion_params", "camera_model")


def intrinsics_of_open3d(keys: Keys) -> list[Keys]:
    """`PinholeCameraIntrinsic` of a file of Open3D: alone, with extrinsics, or in a trajectory."""
    parts = keys.get("parameters")
    found = [keys, *(part for part in parts if isinstance(part, Mapping))] if isinstance(parts, list) else [keys]
    cameras = (part.get("intrinsic", part) for part in found)
    return [camera for camera in cameras if isinstance(camera, Mapping) and "intrinsic_matrix" in camera]


def open3d(keys: Keys) -> Cameras:
    """Different cameras in a file of Open3D."""
    found: list[Keys] = []
    for camera in intrinsics_of_open3d(keys):
        matrix = row_by_row("intrinsic_matrix", camera["intrinsic_matrix"])
        own = ros_keys((camera.get("width"), camera.get("height")), list(matrix), [0.0] * 5)
        if own not in found:
            found.append(own)
        if len(found) > MOST_FRAMES:
            raise InputError(f"it has more than {MOST_FRAMES} different cameras: it has not one lens.")
    return {"": found[0]} if len(found) == 1 else {f"cam{i}": camera for i, camera in enumerate(found)}


def visual_marker_mapping(keys: Keys) -> Cameras:
    """Camera of Visual Marker Mapping, whose numbers are texts; the lens has OpenCV's five coefficients."""
    size = [int(keys[f"{direction}_resolution"]) for direction in ("horizontal", "vertical")]
    fx, fy, cx, cy = (float(keys[name]) for name in ("fx", "fy", "cx", "cy"))
    lens = [float(number) for number in flat(keys["distortion_coefficients"])]
    return {"": ros_keys(size, [fx, 0.0, cx, 0.0, fy, cy, 0.0, 0.0, 1.0], lens)}


def is_matlab(keys: Any) -> bool:
    """True for the parameters of a camera of MATLAB, as a structure."""
    return isinstance(keys, Mapping) and (
        ("RadialDistortion" in keys and any(name in keys for name in ("IntrinsicMatrix", "K", "FocalLength")))
        or "MappingCoefficients" in keys
    )


def is_stereo_of_matlab(keys: Any) -> bool:
    """True for MATLAB's parameters of two cameras."""
    return isinstance(keys, Mapping) and {"CameraParameters1", "CameraParameters2"} <= keys.keys()


def matlab(keys: Keys) -> Cameras:
    """MATLAB's `cameraParameters`, `cameraIntrinsics` and `stereoParameters` as structures, by the names above them.

    MATLAB multiplies points, as rows, by matrices from the right, so `IntrinsicMatrix` and `RotationOfCamera2` are
    transposed.
    """
    for _, pair in within(keys, is_stereo_of_matlab):
        first, second = (_matlab(pair[f"CameraParameters{i}"]) for i in (1, 2))
        turn = np.array(matrix_of("RotationOfCamera2", pair["RotationOfCamera2"])).reshape(3, 3).T
        unit = str(pair["CameraParameters1"].get("WorldUnits", "mm")).lower()
        scale = {"m": 1.0, "meters": 1.0, "cm": 0.01, "centimeters": 0.01, "in": 0.0254, "inches": 0.0254}.get(
            unit, 1e-3
        )
        shift = np.array(vector("TranslationOfCamera2", flat(pair["TranslationOfCamera2"]), 3)) * scale
        return _pair(first, second, inverse(pose_of(turn, shift)))
    found = {name: _matlab(camera) for name, camera in within(keys, is_matlab)}
    return {"": next(iter(found.values()))} if len(found) == 1 else dict(found)


def _pair(first: Keys, second: Keys, pose: FloatArray) -> Cameras:
    return {"cam1": {**first, POSE: ("cam1", np.eye(4))}, "cam2": {**second, POSE: ("cam1", pose)}}


def _matlab(camera: Keys) -> Keys:
    if "MappingCoefficients" in camera:
        known_lens("fisheyeIntrinsics, of Scaramuzza,", ("cameraIntrinsics", "cameraParameters"))
    name = next((name for name in ("K", "IntrinsicMatrix") if name in camera), "")
    if name:
        fx, skew, cx, _, fy, cy, *_ = row_by_row(name, camera[name])
    else:
        (fx, fy), (cx, cy) = (vector(key, flat(camera[key]), 2) for key in ("FocalLength", "PrincipalPoint"))
        skew = real("Skew", camera.get("Skew", 0.0))
    size = flat(camera.get("ImageSize") or [None, None])[::-1]
    radial, tangential = (flat(camera.get(f"{kind}Distortion") or [0.0, 0.0]) for kind in ("Radial", "Tangential"))
    matrix = [fx, skew, cx - FIRST_PIXEL, 0.0, fy, cy - FIRST_PIXEL, 0.0, 0.0, 1.0]
    return ros_keys(size, matrix, [*radial[:2], *tangential, *(radial[2:] or [0.0])])


def caltech(keys: Keys) -> Cameras:
    """Cameras of Caltech's toolbox: `fc`, `cc`, `alpha_c`, `kc` of one camera, or of two with `_left`, `_right`, and
    `R`, `T`.
    """
    if "fc" in keys:
        return {"": _caltech(keys, "")}
    first, second = (_caltech(keys, end) for end in ("_left", "_right"))
    turn = np.array(matrix_of("R", keys["R"])).reshape(3, 3)
    shift = np.array(vector("T", flat(keys["T"]), 3)) / MILLIMETRES
    return _pair(first, second, inverse(pose_of(turn, shift)))


def _caltech(keys: Keys, end: str) -> Keys:
    fx, fy = vector(f"fc{end}", flat(keys[f"fc{end}"]), 2)
    cx, cy = vector(f"cc{end}", flat(keys[f"cc{end}"]), 2)
    skew = real(f"alpha_c{end}", keys.get(f"alpha_c{end}", 0.0)) * fx
    return ros_keys(
        (keys.get("nx"), keys.get("ny")), [fx, skew, cx, 0.0, fy, cy, 0.0, 0.0, 1.0], flat(keys[f"kc{end}"])
    )


def metashape(root: Element) -> Cameras:
    """Calibration of Metashape, or calibrations of the sensors of its `cameras.xml`, by id."""
    if root.tag == "calibration":
        return {"": _metashape(root)}
    cameras: Cameras = {}
    for sensor in root.iter("sensor"):
        found = [sensor.find(f"calibration[@class='{kind}']") for kind in ("adjusted", "initial")]
        chosen = next((own for own in (*found, sensor.find("calibration")) if own is not None), None)
        if chosen is not None:
            cameras[f"sensor{sensor.get('id')}"] = lambda chosen=chosen: _metashape(chosen)  # type: ignore[misc]
    return {"": next(iter(cameras.values()))} if len(cameras) == 1 else cameras


def _metashape(calibration: Element) -> Keys:
    """Keys of one calibration: P1 and P2 are OpenCV's p2 and p1, and u = w / 2 + cx + x' (f + b1) + y' b2."""
    values = {
        child.tag: float(child.text)
        for child in calibration
        if re.fullmatch(r"f|[cf][xy]|[bkp]\d", child.tag) and child.text
    }
    kind = known_lens(calibration.get("type") or calibration.findtext("projection", "frame"), ("frame", "fisheye"))
    if "fx" in values or "f" not in values:
        raise InputError("it is of PhotoScan before version 1.2, or has no f: export the camera as OpenCV's XML.")
    resolution = calibration.find("resolution")
    texts = [resolution.get(n) if resolution is not None else calibration.findtext(n) for n in ("width", "height")]
    if None in texts:
        raise InputError("its width or height is missing.")
    size = [int(text) for text in texts if text]
    f, cx, cy, b1, b2, k1, k2, k3, k4, p1, p2, p3, p4 = (
        values.get(name, 0.0) for name in ["f", "cx", "cy", "b1", "b2", "k1", "k2", "k3", "k4", "p1", "p2", "p3", "p4"]
    )
    centre = [side / 2.0 + c - PIXEL_CENTRE for side, c in zip(size, (cx, cy), strict=True)]
    matrix = [f + b1, 0.0, centre[0], 0.0, f, centre[1], 0.0, 0.0, 1.0]
    if kind == "fisheye":
        if b2 or p1 or p2:
            known_lens("fisheye with b2, p1 or p2", ("frame", "fisheye without b2, p1, p2"))
        return ros_keys(size, matrix, [k1, k2, k3, k4], EQUIDISTANT)
    if not (k4 or b2 or p3 or p4):
        return ros_keys(size, matrix, [k1, k2, p2, p1, k3])
    model = power_series((k1, k2, k3, k4), (p2, p1, p3, p4), b2 / (f + b1))
    try:
        return fitted(model, (f + b1, f), centre, size, "of Metashape", [k1, k2, p2, p1, k3])
    except InputError as error:
        if not b2:
            raise
        way = "optimise the cameras without fitting b2, and export them again"
        raise InputError(
            f"its skew b2 = {b2:.4g} pixels is more than a lens without skew can follow: {way}."
        ) from error


def nerf(keys: Keys, asked: Keys) -> Cameras:
    """Camera of nerfstudio's or instant-ngp's `transforms.json`, or the different cameras of its frames."""
    shared = {name: value for name, value in keys.items() if name != "frames"}
    frames = keys.get("frames")
    frames = [frame for frame in frames if isinstance(frame, Mapping)] if isinstance(frames, list) else []
    owns: list[Keys] = []
    for frame in frames or [{}]:
        own = shared | {name: frame[name] for name in NERF_KEYS if name in frame}
        if own not in owns:
            owns.append(own)
        if len(owns) > MOST_FRAMES:
            raise InputError(f"more than {MOST_FRAMES} of its frames have a camera of their own: it has not one lens.")
    cameras = [_nerf(own, asked) for own in owns]
    return {"": cameras[0]} if len(cameras) == 1 else {f"cam{i}": camera for i, camera in enumerate(cameras)}


def _nerf(keys: Keys, asked: Keys) -> Keys:
    model = keys.get("camera_model") or (NERF_FISHEYE if keys.get("is_fisheye") else NERF_MODELS[0])
    fisheye = known_lens(model, NERF_MODELS) == NERF_FISHEYE
    size = [keys.get("w"), keys.get("h")]
    if None in size:
        size = list(asked.get("image_size") or size)
    values = dict(keys)
    if "distortion_params" in keys:
        given = vector("distortion_params", keys["distortion_params"], 6)
        values |= zip(NERF_LENS, given, strict=True)
    sides = [None if side is None else real("w" if i == 0 else "h", side, above=0.0) for i, side in enumerate(size)]
    for name, angle, side in (("fl_x", "camera_angle_x", sides[0]), ("fl_y", "camera_angle_y", sides[1])):
        if name not in keys and angle in keys and side is not None:
            values[name] = side / 2.0 / math.tan(real(angle, keys[angle], above=0.0, high=math.pi) / 2.0)
    if "fl_x" not in values and None in sides:
        raise no_size()
    fx = real("fl_x", values["fl_x"])
    fy = real("fl_y", values.get("fl_y", fx))
    middle = [None if side is None else side / 2.0 for side in sides]
    cx, cy = (real(key, values.get(key, half)) - PIXEL_CENTRE for key, half in zip(("cx", "cy"), middle, strict=True))
    if fisheye or not values.get("k4"):
        return named(size, values | {"fx": fx, "fy": fy, "cx": cx, "cy": cy}, fisheye)
    radial = [real(name, values.get(name, 0.0)) for name in ("k1", "k2", "k3", "k4")]
    tangential = [real(name, values.get(name, 0.0)) for name in ("p1", "p2")]
    return fitted(
        power_series(radial, tangential),
        (fx, fy),
        (cx, cy),
        size,
        "of nerfstudio",
        [*radial[:2], *tangential, radial[2]],
    )
