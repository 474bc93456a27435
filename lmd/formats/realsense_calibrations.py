"""Readers of intrinsics and extrinsics of RealSense, printed by librealsense or as JSON, as keys of ROS.

Pixels count from the centre of the first pixel. Extrinsics map points from one stream to another, in metres; the
printed rotation is row by row.

Sources: `rs-enumerate-devices.cpp`, `rs_types.h`, `rs.cpp` and `doc` of IntelRealSense/librealsense. The model "inverse
Brown Conrady" has two meanings in librealsense: by `rs_types.h` the polynomial undistorts an image, while
`rs2_project_point_to_pixel` distorts by the polynomial (issues 6382, 7335, 7734 and pull request 13833 leave the
question open).
"""

import itertools
import re
from collections.abc import Mapping
from functools import partial
from typing import Any

import numpy as np

from lmd.core.checks import FloatArray, InputError, real, vector
from lmd.formats.calibration_readers import (
    ANSWERED,
    LENS_MODELS,
    POSE,
    Cameras,
    Keys,
    fitted,
    known_lens,
    no_size,
    ros_keys,
    within,
)
from lmd.geometry.central_models import inverse_brown_conrady, modified_brown_conrady
from lmd.geometry.lens import EQUIDISTANT
from lmd.geometry.se3 import pose_of

# RealSense's lens models by number.
REALSENSE_MODELS = (
    "none",
    "modified_brown_conrady",
    "inverse_brown_conrady",
    "ftheta",
    "brown_conrady",
    "kannala_brandt4",
)
INVERSE = REALSENSE_MODELS[2]
SERIAL = r"Serial Number\s*:\s*(\S+)"
INTRINSIC = r"Intrinsic of \"([^\"\n]+)\"\s*/\s*\d+x\d[^\n]*\n((?:[ \t#/]*[A-Z][\w ()]*:[^\n]*\n?)+)"
REALSENSE = re.compile(f"{SERIAL}|{INTRINSIC}")
EXTRINSIC = re.compile(
    r"Extrinsic from \"([^\"\n]+)\"\s+To\s+\"([^\"\n]+)\"\s*:\s*Rotation Matrix:([-+.\deE\s]+)"
    r"Translation Vector:([-+.\deE \t]+)"
)


def realsense_text(text: str, asked: Keys) -> Cameras:
    """Streams that `rs-enumerate-devices -c` prints, by `STREAM/WIDTHxHEIGHT`, with their poses.

    If the text has several devices, the serial number precedes the name. The second stream of one size, such as raw
    images beside rectified images, has the suffix `/2`.
    """
    device, found, extrinsics = "", [], {}
    for part in REALSENSE.finditer(text):
        if part[1]:
            device = part[1]
            continue
        lines = (line.strip(" \t#/").split(":", 1) for line in part[3].splitlines())
        given = {name.strip().lower(): value.strip() for name, value in lines}
        numbers = {name: float(given[name]) for name in ("width", "height", "fx", "fy", "ppx", "ppy")}
        camera = {**numbers, "model": given["distortion"], "coeffs": [float(k) for k in given["coeffs"].split()]}
        found.append((device, part[2], camera))
    several = len({device for device, *_ in found}) > 1
    if not several:
        extrinsics = {
            (source, to): pose_of(_printed(turn, 9).reshape(3, 3), _printed(shift, 3))
            for source, to, turn, shift in EXTRINSIC.findall(text)
        }
    cameras: Cameras = {}
    sources: dict[str, Keys] = {}
    for device, stream, camera in found:
        name = f"{device}/" * several + f"{stream}/{camera['width']:.0f}x{camera['height']:.0f}"
        if name in sources and sources[name] != camera:  # raw and rectified images of one size, or another device
            name = next(f"{name}/{n}" for n in itertools.count(2) if sources.get(f"{name}/{n}", camera) == camera)
        if name in cameras:
            continue
        sources[name] = camera
        cameras[name] = partial(_realsense, name, camera, asked, _stream_pose(stream, extrinsics))
    return cameras


def _printed(text: str, count: int) -> FloatArray:
    return np.array(vector("extrinsics", [float(number) for number in text.split()], count))


def _stream_pose(stream: str, extrinsics: Mapping[tuple[str, str], FloatArray]) -> tuple[str, FloatArray | None]:
    """Frame of reference and pose `(4, 4)` of a stream in it: the frame of the first stream to which all streams have
    extrinsics.
    """
    streams = [source for source, to in extrinsics if source == to] or sorted({to for _, to in extrinsics})
    frame = next(iter(streams), stream)
    return (frame, np.eye(4)) if frame == stream else (frame, extrinsics.get((stream, frame)))


def is_realsense(keys: Any) -> bool:
    """True for the intrinsics of a stream of a RealSense."""
    return isinstance(keys, Mapping) and {"fx", "fy", "ppx", "ppy"} <= keys.keys()


def realsense(keys: Keys, asked: Keys) -> Cameras:
    """Streams of a JSON or YAML with librealsense's `rs2_intrinsics`, by the keys above them."""
    return {name: partial(_realsense, name, camera, asked) for name, camera in within(keys, is_realsense)}


def _realsense(name: str, camera: Keys, asked: Keys, pose: tuple[str, FloatArray | None] | None = None) -> Keys:
    """Keys of one stream with its pose. The model "inverse Brown Conrady" is unambiguous only if all coefficients are
    0.
    """
    keys = _stream(name, camera, asked)
    return keys if pose is None else {**keys, POSE: pose}


def _stream(name: str, camera: Keys, asked: Keys) -> Keys:
    size = [camera.get("width"), camera.get("height")]
    fx, fy, cx, cy = (real(key, camera[key]) for key in ("fx", "fy", "ppx", "ppy"))
    lens = vector("coeffs", camera.get("coeffs") or [0.0] * 5, None)
    said = camera.get("model", camera.get("distortion_model", ""))
    word = REALSENSE_MODELS[said] if isinstance(said, int) and 0 <= said < len(REALSENSE_MODELS) else str(said)
    word = re.sub(r"[ -]+", "_", word.lower().strip()).removeprefix("distortion.").removeprefix("rs2_distortion_")
    matrix = [fx, 0.0, cx, 0.0, fy, cy, 0.0, 0.0, 1.0]
    if not any(lens) or word == "none":
        return ros_keys(size, matrix, [0.0] * 5)
    if word in ("kannala_brandt4", "brown_conrady"):
        return ros_keys(size, matrix, lens[:4] if word[0] == "k" else lens, LENS_MODELS.get(word, EQUIDISTANT))
    if word == "modified_brown_conrady":
        return fitted(
            modified_brown_conrady(*lens), (fx, fy), (cx, cy), _size(size, asked), "modified Brown-Conrady", lens
        )
    if word not in ("", INVERSE):
        known_lens(word, REALSENSE_MODELS)
        raise InputError("the lens model ftheta is not known here: calibrate the camera, such as by Kalibr.")
    choice = asked.get("distortion_model")
    if choice == INVERSE:
        model = inverse_brown_conrady(*lens)
        return {**fitted(model, (fx, fy), (cx, cy), _size(size, asked), INVERSE, [-k for k in lens]), ANSWERED: True}
    if choice is None:
        raise InputError(
            f"distortion_model must be given: {'the coefficients of ' + name if name else 'its coefficients'} are of "
            f"{'the inverse Brown-Conrady model' if word else 'no model that it names'}, which librealsense describes "
            f"as undistorting ({INVERSE}) and computes as distorting (plumb_bob, as ROS does).",
            "distortion_model",
        )
    return ros_keys(size, matrix, lens, None)


def _size(size: Any, asked: Keys) -> Any:
    """Size of the image: from the file, or the size `asked`."""
    own = size if None not in size else asked.get("image_size")
    if own is None:
        raise no_size()
    return own
