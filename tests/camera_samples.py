"""Small samples of calibrations that devices are shipped with, and of those by programs."""

import io
import json

import numpy as np
from scipy.io import savemat

MATRIX = [600.0, 0.0, 320.0, 0.0, 610.0, 240.0, 0.0, 0.0, 1.0]
LENS = [-0.2, 0.05, 0.001, -0.002, 0.01]
NAMES = dict(zip(["fx", "fy", "cx", "cy"], [600.0, 610.0, 320.0, 240.0], strict=True))
SCRIPT = {
    "camera_matrix": [MATRIX[:3], MATRIX[3:6], MATRIX[6:]],
    "distortion_coefficients": LENS,
    "avg_reprojection_error": 0.2,
}
FTC = """<?xml version='1.0' encoding='UTF-8'?><!-- of a team -->
<Calibrations><Camera vid="Logitech" pid="0x0825"><Calibration size="640 480" focalLength="600.0f, 610.0f"
 principalPoint="320.0f, 240.0f" distortionCoefficients="-0.2, 0.05, 1e-3, -2e-3, 0.01, 0, 0, 0"/></Camera>
</Calibrations>
"""
METASHAPE = """<?xml version="1.0"?><calibration><projection>frame</projection><width>640</width><height>480</height>
<f>610</f><cx>0.5</cx><cy>0.5</cy><b1>-10</b1><k1>-0.2</k1><k2>0.05</k2><k3>0.01</k3><p1>-0.002</p1><p2>0.001</p2>
</calibration>
"""
REPORT = """Calibration results
====================
Camera-system parameters:
cam0 (/cam0/image_raw):
    type: <class 'aslam_cv.libaslam_cv_python.DistortedPinholeCameraGeometry'>
    distortion: [-0.2  0.05  0.001 -0.002] +- [0.0003 0.0002 0.00002 0.00001]
    projection: [600. 610. 320.
                 240.] +- [0.05 0.05 0.08 0.07]
    reprojection error: [0.000001, 0.000002] +- [0.16, 0.15]
"""
REALSENSE = """Device info:
    Serial Number                 : \t123

 Intrinsic of "Color" / 640x480 / {YUYV/RGB8}
  Width:      \t640
  Height:     \t480
  PPX:        \t320
  PPY:        \t240
  Fx:         \t600
  Fy:         \t610
  Distortion: \tBrown Conrady
  Coeffs:     \t-0.2  \t0.05  \t0.001  \t-0.002  \t0.01
  FOV (deg):  \t56.1 x 43

"""
OAK_EXTRINSICS = {
    "rotationMatrix": [[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]],
    "translation": {"x": -7.5, "y": 0.0, "z": 1.0},
    "toCameraSocket": 0,
}
OAK = {
    "cameraType": 0,
    "width": 640,
    "height": 480,
    "intrinsicMatrix": SCRIPT["camera_matrix"],
    "distortionCoeff": [*LENS, 0.1, 0.02, 0.003, *[0.0] * 6],
    "extrinsics": {"rotationMatrix": [], "toCameraSocket": -1},
}
KINECT_LENS = [0.5, 0.51, 0.6, 0.61, 0.7, -2.5, 1.4, 0.6, -2.3, 1.3, 0.0, 0.0, -2e-3, 1e-3]
KINECT_CAMERA = {
    "Intrinsics": {
        "ModelParameterCount": 14,
        "ModelParameters": KINECT_LENS,
        "ModelType": "CALIBRATION_LensDistortionModelBrownConrady",
    },
    "Location": "CALIBRATION_CameraLocationPV0",
    "MetricRadius": 0,
    "Rt": {"Rotation": [1, 0, 0, 0, 0, -1, 0, 1, 0], "Translation": [-0.032, -0.002, 0.004]},
    "SensorWidth": 4096,
    "SensorHeight": 3072,
}
MATLAB = {
    "ImageSize": [480, 640],
    "IntrinsicMatrix": [[600.0, 0.0, 0.0], [0.0, 610.0, 0.0], [321.0, 241.0, 1.0]],
    "RadialDistortion": [-0.2, 0.05, 0.01],
    "TangentialDistortion": [0.001, -0.002],
}
NERF = {"camera_model": "OPENCV", "w": 640, "h": 480, "fl_x": 600.0, "fl_y": 610.0, "cx": 320.5, "cy": 240.5}
NERF |= dict(zip(["k1", "k2", "p1", "p2", "k3"], LENS, strict=True))
KEYS = {
    "depthai": {"boardName": "DM9098", "cameraData": [[0, OAK]]},
    "kinect": {"CalibrationInformation": {"Cameras": [KINECT_CAMERA]}},
    "realsense": {
        "color": {"width": 640, "height": 480, "fx": 600, "fy": 610, "ppx": 320, "ppy": 240}
        | {"model": "distortion.brown_conrady", "coeffs": LENS}
    },
    "matlab": {"params": MATLAB},
    "nerfstudio": {**NERF, "frames": []},
    "visual marker mapping": {
        **{name: str(value) for name, value in NAMES.items()},
        "distortion_coefficients": [str(number) for number in LENS],
        **{"horizontal_resolution": "640", "vertical_resolution": "480"},
    },
    "open3d": {
        "class_name": "PinholeCameraIntrinsic",
        **{"width": 640, "height": 480, "intrinsic_matrix": [600, 0, 0, 0, 610, 0, 320, 240, 1]},
    },
}
CALTECH = {"fc": [[600.0], [610.0]], "cc": [[320.0], [240.0]], "kc": LENS, "alpha_c": 0.0, "nx": 640, "ny": 480}


def binary(write, *args, **arrays):
    """What a function writes to a file."""
    file = io.BytesIO()
    write(file, *args, **arrays)
    return file.getvalue()


ARRAYS = {
    "numpy": binary(np.savez, mtx=SCRIPT["camera_matrix"], dist=[LENS], rvecs=np.zeros((30, 3, 1))),
    "caltech": binary(savemat, CALTECH),
    "mat": binary(savemat, {"params": MATLAB}),
}
TEXTS = {"FTC": FTC, "Metashape": METASHAPE, "Kalibr's report": REPORT, "rs-enumerate-devices": REALSENSE}
SIZES = {"kinect": [1280, 720], "numpy": [640, 480], "Kalibr's report": [640, 480]}  # of those that do not say it
SAMPLES = {name: json.dumps(keys) for name, keys in KEYS.items()} | TEXTS | ARRAYS
