"""Kalibr's `results-cam.txt`: cameras without image sizes, and their poses in the frame of the first camera.

Sources: `CameraUtils.py` and `quaternion_algebra.cpp` (ethz-asl/kalibr), whose quaternions follow the JPL convention.
"""

import re

import numpy as np

from lmd.core.checks import FloatArray, InputError, vector
from lmd.formats.calibration_readers import POSE, Cameras, Keys, camera_of_chain, known_lens
from lmd.geometry.se3 import inverse, pose_of

# Names of Kalibr's camera classes in its chains.
KALIBR_CLASSES = {
    "DistortedPinhole": ("pinhole", "radtan"),
    "EquidistantPinhole": ("pinhole", "equidistant"),
    "EquidistantDistortedPinhole": ("pinhole", "equidistant"),
    "Pinhole": ("pinhole", "none"),
    "Omni": ("omni", "none"),
    "DistortedOmni": ("omni", "radtan"),
    "ExtendedUnified": ("eucm", "none"),
    "DoubleSphere": ("ds", "none"),
}
_LIST = r"\s*\[([^\]]{0,999})\]"  # bounded, so that each beginning looks at as little text
KALIBR_CAMERA = re.compile(
    rf"^[ \t]*(cam\d+)[ \t]*\([^\n]{{0,499}}\):\s*type:[^\n]{{0,499}}\.(\w+?)(?:CameraGeometry)?'>"
    rf"\s*distortion:{_LIST}[^:]{{0,499}}?projection:{_LIST}",
    re.MULTILINE,
)
KALIBR_BASELINE = re.compile(rf"baseline T_(\d+)_(\d+):\s*q:{_LIST}[^t]{{0,499}}?\bt:{_LIST}")


def kalibr_report(text: str, asked: Keys) -> Cameras:
    """Cameras of Kalibr's `results-cam.txt`, with poses in the frame of the first camera; the file has no image
    sizes.
    """
    cameras: Cameras = {}
    pose, baselines = np.eye(4), {int(n): (q, t) for n, _, q, t in KALIBR_BASELINE.findall(text)}
    for index, (name, kind, distortion, projection) in enumerate(KALIBR_CAMERA.findall(text)):
        model, lens = KALIBR_CLASSES[known_lens(kind, KALIBR_CLASSES)]
        entry = {"camera_model": model, "distortion_model": lens, "resolution": asked.get("image_size")}
        entry |= {"intrinsics": _floats(projection), "distortion_coeffs": _floats(distortion)}
        known = index == 0 or index in baselines
        if index in baselines:
            turn, shift = (_floats(numbers) for numbers in baselines[index])
            pose = pose @ inverse(pose_of(_jpl(turn), np.array(vector("t", shift, 3))))
        place = ("cam0", pose if known else None)
        cameras[name] = lambda name=name, entry=entry, place=place: {  # type: ignore[misc]
            **camera_of_chain(f"{name}.", entry),
            POSE: place,
        }
    if not cameras:
        raise InputError(
            "it is a report of Kalibr without the cameras' projection: the camchain*.yaml beside it is read."
        )
    return {"": next(iter(cameras.values()))} if len(cameras) == 1 else cameras


def _floats(text: str) -> list[float]:
    return [float(number) for number in text.replace(",", " ").split()]


def _jpl(quaternion: list[float]) -> FloatArray:
    """Matrix of a quaternion x, y, z, w in the JPL convention: the transpose of the matrix in Hamilton's convention."""
    from scipy.spatial.transform import Rotation

    return np.asarray(Rotation.from_quat(vector("q", quaternion, 4)).as_matrix()).T
