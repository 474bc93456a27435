"""Small samples of each format that is read, and the readers of the families.

A format is added by a line, a file's name and a text, or in `formats/files/tables.yaml`. `test_fuzz_readers.py` changes
the bits, types, sizes and nesting of each, and `formats/test_bad_files.py` damages them.
"""

import itertools
import json
from pathlib import Path

import camera_samples
import map_samples
import yaml
from camera_samples import LENS, MATRIX, NAMES, SCRIPT, SIZES
from occupancy_maps import KEYS, hall
from PIL import Image

from lmd.formats.calibrations import calibrated_camera
from lmd.formats.detection_formats import read_detections
from lmd.formats.meshes import read_mesh
from lmd.formats.plans import read_plan_room
from lmd.formats.tag_maps import read_deployment
from lmd.formats.trajectories import TrajectoryFile

BASALT = {
    "camera_type": "pinhole-radtan8",
    "intrinsics": NAMES | dict(zip(["k1", "k2", "p1", "p2", "k3"], LENS, strict=True)),
}
MRCAL = "{{ 'lensmodel': 'LENSMODEL_{}',\n 'intrinsics': [600, 610, 320, 240, {},],\n 'imagersize': [640, 480] }}"
XML = """<?xml version="1.0"?>
<opencv_storage><image_width>640</image_width><image_height>480</image_height>
<camera_matrix type_id="opencv-matrix"><rows>3</rows><cols>3</cols><dt>d</dt>
<data>600. 0. 320. 0. 610. 240. 0. 0. 1.</data></camera_matrix>
<distortion_coefficients type_id="opencv-matrix"><data>-0.2 0.05 1e-3 -2e-3 0.01</data></distortion_coefficients>
</opencv_storage>"""
FILES = {
    "OpenCV XML": XML,
    "OpenCV 2": XML.replace("camera_matrix", "Camera_Matrix")
    .replace("distortion_c", "Distortion_C")
    .replace("_w", "_W"),
    "script of OpenCV": json.dumps({"mtx": SCRIPT["camera_matrix"], "dist": [LENS], "img_size": [640, 480]}),
    "ros topic echo": "width: 640\nheight: 480\ndistortion_model: plumb_bob\n" + f"d: {LENS}\nk: {MATRIX}\n---\n",
    "ROS's calibrator": f"mono pinhole calibration...\nD = {LENS}\nK = {MATRIX}\nR = {MATRIX}\n# oST version 5.0 "
    "parameters\n\n[image]\n\nwidth\n640\n\nheight\n480\n\n[narrow_stereo]\n",
    "EuRoC": "%YAML:1.0\nT_BS:\n  data: [1.0]\ncamera_model: pinhole\ndistortion_model: radial-tangential\n"
    f"resolution: [640, 480]\nintrinsics: {list(NAMES.values())}\ndistortion_coefficients: {LENS}\n",
    "OKVIS": "cameras:\n  - {T_SC: [1.0], image_dimension: [640, 480], distortion_type: radialtangential,\n"
    f"     distortion_coefficients: {LENS}, focal_length: [600, 610],\n"
    "     principal_point: [320, 240]}\ncamera_params: {}\n",
    "VINS": "%YAML:1.0\n---\nmodel_type: PINHOLE\nimage_width:640\nimage_height: 480\ndistortion_parameters:\n"
    "   k1: -0.2\n   k2: 0.05\n   p1: 0.001\n   p2: -0.002\n   k3: 0.01\n"
    "projection_parameters:\n   fx:600.0\n   fy: 610.0\n   cx: 320.0\n   cy: 240.0\n",
    "message": json.dumps({"width": 640, "height": 480, "K": MATRIX, "D": LENS}),
    "another script": json.dumps(
        {
            "model": "Raspberry Pi 3 wide",
            "image_size": [640, 480],
            "fisheye": False,
            "camera_matrix": SCRIPT["camera_matrix"],
            "distortion_coeffs": LENS,
        }
    ),
    "message of ROS 2": json.dumps({"width": 640, "height": 480, "k": MATRIX, "d": [*LENS, 0.0, 0.0, 0.0]}),
    "PhotonVision": json.dumps(
        {
            "resolution": {"width": 640.0, "height": 480.0},
            "cameraIntrinsics": {"rows": 3, "cols": 3, "data": MATRIX},
            "distCoeffs": {"rows": 1, "cols": 5, "data": LENS},
        }
    ),
    "COLMAP": "# cameras\n1 FULL_OPENCV 640 480 600 610 320.5 240.5 -0.2 0.05 0.001 -0.002 0.01 0 0 0\n",
    "Basalt": json.dumps({"value0": {"intrinsics": [BASALT], "resolution": [[640, 480]]}}),
    "ORB-SLAM3": '%YAML:1.0\nCamera.type: "PinHole"\nCamera1.fx: 600.0\nCamera1.fy: 610.0\nCamera1.cx: 320.0\n'
    "Camera1.cy: 240.0\nCamera1.k1: -0.2\nCamera1.k2: 0.05\nCamera1.p1: 0.001\nCamera1.p2: -0.002\nCamera1.k3: 0.01\n"
    "Camera.width: 640\nCamera.height: 480\n",
    "OpenVSLAM": 'Camera.model: "perspective"\nCamera.fx: 600.0\nCamera.fy: 610.0\nCamera.cx: 320.0\nCamera.cy: 240.0\n'
    "Camera.k1: -0.2\nCamera.k2: 0.05\nCamera.p1: 0.001\nCamera.p2: -0.002\nCamera.k3: 0.01\n"
    "Camera.cols: 640\nCamera.rows: 480\n",
    "stella_vslam": "Camera:\n  {model: perspective, fx: 600.0, fy: 610.0, cx: 320.0, cy: 240.0, k1: -0.2, k2: 0.05,\n"
    "   p1: 0.001, p2: -0.002, k3: 0.01, cols: 640, rows: 480}\nMapping: {backend: g2o}\n",
    "mrcal": MRCAL.format("OPENCV5", "-0.2, 0.05, 0.001, -0.002, 0.01"),
    "frc971": json.dumps({"intrinsics": MATRIX, "dist_coeffs": LENS, "image_width": 640, "image_height": 480}),
}
FILES["OKVIS2"] = FILES["OKVIS"].replace("camera_params", "camera_parameters")
QUATERNION = {"x": 0.0, "y": 0.0, "z": 0.0, "w": 1.0}
MAPS = {
    "wpilib": {
        "field": {"length": 8.0, "width": 4.0},
        "tags": [
            {
                "ID": 4,
                "pose": {
                    "rotation": {"quaternion": dict(zip("WXYZ", (1, 0, 0, 0), strict=True))},
                    "translation": {"x": 1.0, "y": 1.0, "z": 0.5},
                },
            }
        ],
    },
    "own": {"family": "36h11", "edge": 0.1, "tags": [{"id": 1, "position": [1, 2, 3], "quaternion": QUATERNION}]},
    "limelight": {
        "fieldlength": 8.0,
        "fiducials": [
            {
                "family": "apriltag3_36h11_classic",
                "id": 1,
                "size": 152.4,
                "transform": [1, 0, 0, 2, 0, 1, 0, 3, 0, 0, 1, 4, 0, 0, 0, 1],
            }
        ],
    },
    "frc971": {"target_poses": [{"id": 1, "position": {"x": 1, "y": 2, "z": 3}, "orientation": QUATERNION}]},
    "apriltag_ros": {"standalone_tags": [], "tag_bundles": [{"name": "a", "layout": [{"id": 1, "size": 0.1, "x": 1}]}]},
    "standalone": {
        "standalone_tags": [
            {"id": 1, "size": 0.1, **QUATERNION, **{f"q{axis}": value for axis, value in QUATERNION.items()}}
        ]
    },
    "ros2": {"/**": {"ros__parameters": {"tag_bundles": [{"name": "a", "layout": [{"id": 1, "size": 0.1, "x": 1}]}]}}},
    "tagslam": {
        "bodies": [
            {
                "wall": {
                    "is_static": True,
                    "default_tag_size": 0.2,
                    "pose": {"position": {"x": 1, "y": 2, "z": 0}},
                    "board": {"tag_start_id": 10, "tag_size": 0.1, "tag_spacing": 0.5, "tag_rows": 2, "tag_columns": 2},
                    "tags": [{"id": 2, "pose": {"rotation": {"x": 1.5, "y": 0, "z": 0}}}],
                }
            }
        ]
    },
    "fiducial_vlam": {"marker_length": 0.16, "markers": [{"id": 1, "xyz": [0, 0, 1], "rpy": [1.5, 0, 0]}]},
    "aruco": {
        "aruco_bc_dict": "TAG36h11",
        "aruco_bc_mInfoType": 1,
        "aruco_bc_markers": [{"id": 9, "corners": [[0, 1, 1.2], [0, 1.2, 1.2], [0, 1.2, 1], [0, 1, 1]]}],
    },
    "duckietown": {
        "objects": {
            "tag": {
                "kind": "floor_tag",
                "pose": {"~SE2Transform": {"p": [1, 2], "theta_deg": 270}},
                "tag": {"~TagInstance": {"family": "36h11", "size": 0.065, "tag_id": 300}},
            }
        }
    },
}
MAPS |= map_samples.KEYED
CALIBRATIONS = {
    "basalt": {
        "value0": {
            "intrinsics": [
                {
                    "camera_type": "kb4",
                    "intrinsics": {"fx": 500, "fy": 500, "cx": 320, "cy": 240, "k1": 0, "k2": 0, "k3": 0, "k4": 0},
                }
            ],
            "resolution": [[640, 480]],
        }
    },
    "ros": {
        "image_width": 640,
        "image_height": 480,
        "distortion_model": "plumb_bob",
        "camera_matrix": {"rows": 3, "cols": 3, "data": [500, 0, 320, 0, 500, 240, 0, 0, 1]},
        "distortion_coefficients": {"rows": 1, "cols": 5, "data": [0.1, 0, 0, 0, 0]},
    },
    "kalibr": {
        "cam0": {
            "camera_model": "pinhole",
            "intrinsics": [500, 500, 320, 240],
            "distortion_model": "radtan",
            "distortion_coeffs": [0.1, 0, 0, 0],
            "resolution": [640, 480],
        }
    },
    "euroc": {
        "resolution": [640, 480],
        "camera_model": "pinhole",
        "intrinsics": [500, 500, 320, 240],
        "distortion_model": "radial-tangential",
        "distortion_coefficients": [0.1, 0, 0, 0],
    },
    "orb_slam": {
        "Camera.type": "PinHole",
        "Camera.fx": 500.0,
        "Camera.fy": 500.0,
        "Camera.cx": 320.0,
        "Camera.cy": 240.0,
        "Camera.k1": 0.1,
        "Camera.k2": 0.0,
        "Camera.p1": 0.0,
        "Camera.p2": 0.0,
        "Camera.width": 640,
        "Camera.height": 480,
    },
}
TABLES = yaml.safe_load(Path(__file__).with_name("formats").joinpath("files/tables.yaml").read_text(encoding="utf-8"))
OBJ = "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 1\nf 1 2 3\nf 1 3 4\nf 1 2 4\nf 2 3 4\n"


def read_camera(path):
    return calibrated_camera(path, image_size=SIZES.get(path.name))


def read_trajectory(path):
    row = TABLES["poses"].get(path.name, {})
    return TrajectoryFile(str(path), rate=row.get("rate"), columns=row.get("columns")).trajectory


def read_tags(path):
    return read_deployment(path, family="36h11", columns=TABLES["tags"].get(path.name, {}).get("columns"))


def texts(of, *names):
    """Texts of files of `formats/files/tables.yaml`."""
    return {name: TABLES[of][name]["text"] for name in names or TABLES[of]}


_SQUARE = [(0, 0), (6, 0), (6, 4), (0, 4)]
_LINES = (
    f"0\nLINE\n8\nWALLS\n10\n{a}\n20\n{b}\n30\n0\n11\n{c}\n21\n{d}\n31\n0\n"
    for (a, b), (c, d) in itertools.pairwise([*_SQUARE, _SQUARE[0]])
)
DXF = (
    "0\nSECTION\n2\nHEADER\n9\n$ACADVER\n1\nAC1009\n9\n$INSUNITS\n70\n6\n0\nENDSEC\n"
    f"0\nSECTION\n2\nENTITIES\n{''.join(_LINES)}0\nENDSEC\n0\nEOF\n"
)


def read_plan(path):
    """Read a floor plan; the picture of a map is written beside it."""
    Image.fromarray(hall()[::-1]).save(path.with_name("map.pgm"))
    return read_plan_room(None, 2.5, {"height": [0.5, 1.0]}, 1.0, path=str(path))


READERS = {
    "calibration": read_camera,
    "trajectory": read_trajectory,
    "tag map": read_tags,
    "room": read_mesh,
    "floor plan": read_plan,
    "detections": read_detections,
}
SAMPLES = {
    "calibration": FILES | {name: json.dumps(keys) for name, keys in CALIBRATIONS.items()} | camera_samples.SAMPLES,
    "trajectory": texts("poses", "degrees", "ros2 topic echo of odometry", "kitti", "colmap", "tum", "vins", "euroc"),
    "tag map": {name: json.dumps(keys) for name, keys in MAPS.items()}
    | map_samples.TEXTS
    | texts("tags", "size of a list", "quaternions", "header with spaces", "clover", "clover without names", "list")
    | texts("tags", "fiducial_slam", "rtabmap priors", "rtabmap ini", "rtabmap poses"),
    "room": {"room.obj": OBJ},
    "floor plan": {"map.yaml": json.dumps(KEYS | {"image": "map.pgm"}), "plan.dxf": DXF},
    "detections": texts("detections", "table", "family", "photonvision", "photonvision by camera", "limelight"),
}


def content(sample):
    """The bytes of a sample, which may be a text."""
    return sample if isinstance(sample, bytes) else sample.encode()
