"""Readers of factory calibrations of devices, as keys of ROS: webcams of FTC, OAK, Azure Kinect.

FTC and OAK count pixels from the centre of the first pixel. The file of an Azure Kinect has coordinates from the border
of the image, in image widths and heights.

Sources: the comments of `teamwebcamcalibrations.xml` (FIRST-Tech-Challenge/FtcRobotController); `CameraInfo.hpp`,
`Extrinsics.hpp` and `CalibrationHandler.cpp` (luxonis/depthai-core); `calibration.c`, `mode_specific_calibration.c`,
`intrinsic_transformation.c` and `extrinsic_transformation.c` (microsoft/Azure-Kinect-Sensor-SDK).
"""

import math
from collections.abc import Mapping, Sequence
from functools import partial
from typing import Any
from xml.etree.ElementTree import Element

import numpy as np

from lmd.core.checks import FloatArray, InputError, real, vector
from lmd.core.files import flat
from lmd.formats.calibration_readers import (
    CIRCLE,
    NOTE,
    POSE,
    Cameras,
    Keys,
    entries,
    fitted,
    known_lens,
    matrix_of,
    ros_keys,
    section,
)
from lmd.geometry.camera import PIXEL_CENTRE
from lmd.geometry.central_models import kinect
from lmd.geometry.lens import EQUIDISTANT
from lmd.geometry.se3 import inverse, pose_of

# OAK: lens models by number, and units of a translation per metre.
OAK_MODELS = {0: "Perspective", 1: "Fisheye", 2: "Equirectangular", 3: "RadialDivision"}
CENTIMETRES = 100.0
# Azure Kinect: for each mode the size of the binned sensor, the first pixel of the image on the sensor, and the image
# size, pixels.
DEPTH_MODES = (
    ((512, 96, 90), (320, 288)),
    ((1024, 192, 180), (640, 576)),
    ((512, 0, 0), (512, 512)),
    ((1024, 0, 0), (1024, 1024)),
)
COLOR_SIZES = ((1280, 720), (1920, 1080), (2560, 1440), (2048, 1536), (3840, 2160), (4096, 3072))
KINECT_MODELS = {"CALIBRATION_LensDistortionModelBrownConrady": 2.0, "CALIBRATION_LensDistortionModelRational6KT": 1.0}
KINECT_CAMERAS = {"CALIBRATION_CameraLocationD0": "depth", "CALIBRATION_CameraLocationPV0": "color"}
POLE_STEPS = 1000  # number of steps in the squared tangent of the angle from the axis, in the search for a pole
LEAST_RADIUS, USUAL_RADIUS = 1e-4, 1.7  # a smaller MetricRadius means unknown; the usual radius is then assumed


def ftc(root: Element) -> dict[str, Keys]:
    """Webcams of FTC's `teamwebcamcalibrations.xml`, by `vid:pid/WIDTHxHEIGHT`; lenses have OpenCV's model and
    order.
    """
    cameras = {}
    for device in root.iter("Camera"):
        for calibration in device.iter("Calibration"):
            given = {name.replace("_", "").lower(): text for name, text in calibration.attrib.items()}
            if given.get("remove", "").lower() == "true":
                continue
            size, (fx, fy), (cx, cy) = (
                vector(name, _floats(given[name.lower()]), 2) for name in ("size", "focalLength", "principalPoint")
            )
            lens = _floats(given["distortioncoefficients"])
            name = f"{device.get('vid')}:{device.get('pid')}/{size[0]:.0f}x{size[1]:.0f}"
            cameras[name] = ros_keys(size, [fx, 0.0, cx, 0.0, fy, cy, 0.0, 0.0, 1.0], lens)
    if not cameras:
        raise InputError(
            "it has no calibration, or only such as are comments or to be removed: take the marks <!-- and --> off "
            "that of the camera."
        )
    return cameras


def _floats(text: str) -> list[float]:
    """Numbers of an attribute, which may end in f, with commas, spaces or both between them."""
    texts = text.replace(",", " ").split()
    return [float(number[:-1] if number[-1:] in "fF" else number) for number in texts]


def depthai(keys: Keys) -> dict[str, Keys]:
    """Calibrated cameras of an OAK, by socket; poses are in the frame of the camera to which all extrinsics lead."""
    listed = keys["cameraData"]
    infos = dict(listed.items() if isinstance(listed, Mapping) else (pair for pair in listed))
    infos = {int(socket): info for socket, info in infos.items()}
    cameras: dict[str, Keys] = {}
    for socket, info in sorted(infos.items()):
        matrix = flat(info["intrinsicMatrix"])
        if not any(matrix):
            continue  # a socket that was not calibrated
        kind = OAK_MODELS.get(info.get("cameraType", 0), str(info.get("cameraType")))
        fisheye = known_lens(kind, (OAK_MODELS[0], OAK_MODELS[1])) == OAK_MODELS[1]
        lens = info["distortionCoeff"][:4] if fisheye else info["distortionCoeff"]
        size = [info[name] or None for name in ("width", "height")]
        model = EQUIDISTANT if fisheye else "rational_polynomial"
        own = ros_keys(size, matrix, lens, model)
        note = {} if fisheye or None in size or len(lens) < 8 else _pole_note(size, matrix, lens)
        cameras[_socket(socket)] = {**own, **note, POSE: _oak_pose(infos, socket)}
    if not cameras:
        raise InputError("none of its cameras is calibrated: every intrinsicMatrix is empty or zero.")
    return cameras


def _pole_note(size: Sequence[Any], matrix: Sequence[float], lens: Sequence[float]) -> Keys:
    """Note about a pole of a rational lens within the image, which factory calibrations may have.

    OpenCV continues beyond the pole, as numerator and denominator change sign together; in `lmd` the lens ends at the
    pole.
    """
    fx, _, cx, _, fy, cy, *_ = matrix
    farthest = math.hypot(max(cx, size[0] - cx) / fx, max(cy, size[1] - cy) / fy)
    s = np.linspace(0.0, farthest**2, POLE_STEPS)
    below = np.polynomial.polynomial.polyval(s, [1.0, *lens[5:8]]) <= 0.0
    if not below.any():
        return {}
    angle = math.degrees(math.atan(math.sqrt(s[np.argmax(below)])))
    return {NOTE: f"its rational lens has a pole at {angle:.0f} degrees from the axis, and shows nothing beyond"}


def _socket(number: int) -> str:
    return f"CAM_{chr(ord('A') + number)}"


def _oak_pose(infos: Mapping[int, Any], socket: int) -> tuple[str, FloatArray]:
    """Frame of reference, and pose `(4, 4)` of the camera in this frame, from extrinsics that map points to the next
    camera, in cm.
    """
    pose = np.eye(4)
    for _ in infos:
        extrinsics = infos[socket].get("extrinsics") if socket in infos else None
        if not extrinsics or (following := extrinsics.get("toCameraSocket", -1)) == -1:
            return _socket(socket), pose
        turn = np.array(extrinsics["rotationMatrix"], dtype=np.float64)
        if turn.shape != (3, 3) or not turn.any():
            return _socket(socket), pose
        shift = [extrinsics["translation"][axis] / CENTIMETRES for axis in "xyz"]
        pose, socket = pose_of(turn, np.array(shift)) @ pose, following
    raise InputError("the extrinsics of its cameras refer to each other in a circle.")


def azure_kinect(keys: Keys) -> Cameras:
    """Cameras of an Azure Kinect in each of their modes, such as `color/1280x720`; poses are in the frame of the depth
    camera.

    `MetricRadius` becomes the image circle, as pixels beyond the circle have no image.
    """
    cameras: Cameras = {}
    for camera in entries(section(keys, "CalibrationInformation"), "Cameras"):
        if (name := KINECT_CAMERAS.get(str(camera.get("Location")))) is None:
            continue
        depth = name == "depth"
        modes = DEPTH_MODES if depth else [((w, 0, (3 * w // 4 - h) // 2), (w, h)) for w, h in COLOR_SIZES]
        place = section(camera, "Rt")
        turn = matrix_of("Rotation", place["Rotation"])
        pose = inverse(pose_of(np.array(turn).reshape(3, 3), np.array(vector("Translation", place["Translation"], 3))))
        for mode, size in modes:
            cameras[f"{name}/{size[0]}x{size[1]}"] = partial(_kinect_mode, camera, mode, size, depth, pose)
    return cameras


def _kinect_mode(
    camera: Keys, mode: tuple[int, int, int], size: tuple[int, int], depth: bool, pose: FloatArray
) -> Keys:
    """Camera in one mode; `mode` has the width of the binned sensor, and the first pixel of the image."""
    intrinsics = section(camera, "Intrinsics")
    factor = KINECT_MODELS[known_lens(intrinsics["ModelType"], KINECT_MODELS)]
    given = vector("ModelParameters", list(intrinsics["ModelParameters"])[:14], 14)
    cx, cy, fx, fy, k1, k2, k3, k4, k5, k6, *cod, p2, p1 = given
    wide, high = (real(name, camera[name], above=0.0) for name in ("SensorWidth", "SensorHeight"))
    width, left, top = mode
    height = width if depth else 0.75 * width
    if (wide, high) != (1024.0, 1024.0) if depth else high / wide not in (0.75, 0.5625):
        raise InputError(f"the sensor has {wide:.0f} x {high:.0f} pixels, which no Azure Kinect has.")
    if not depth and high / wide == 0.5625:  # early firmware: a 16 : 9 image in the middle of a 4 : 3 sensor
        cy, fy = 0.125 + 0.75 * cy, 0.75 * fy
    focal = fx * width, fy * height
    centre = cx * width - left - PIXEL_CENTRE, cy * height - top - PIXEL_CENTRE
    lens = [k1, k2, p1, p2, k3, k4, k5, k6]
    if any(cod) or (factor != 2.0 and (p1 or p2)):
        keys = fitted(
            kinect(given[4:10], p1, p2, cod, factor),
            focal,
            centre,
            size,
            "of Azure Kinect",
            [k1, k2, p1, p2, k3, k4, k5, k6],
        )
    else:
        matrix = [focal[0], 0.0, centre[0], 0.0, focal[1], centre[1], 0.0, 0.0, 1.0]
        keys = ros_keys(size, matrix, lens, "rational_polynomial")
    radius = real("MetricRadius", camera.get("MetricRadius", 0.0))
    s = (radius if radius > LEAST_RADIUS else USUAL_RADIUS) ** 2
    reach = max(focal) * s**0.5 * (1.0 + s * (k1 + s * (k2 + s * k3))) / (1.0 + s * (k4 + s * (k5 + s * k6)))
    corner = math.hypot(*(max(c, side - c) for c, side in zip(centre, size, strict=True)))
    circle = {CIRCLE: 2.0 * reach} if 0.0 < reach < corner else {}
    return {**keys, **circle, POSE: ("depth", pose)}
