"""Broken files end in a sentence: bits, types, sizes and nesting of a small sample of each kind are changed.

A reader is added by a line of `CASES`: a name, a function of a path, and a text that it reads.
"""

import json
import random
from functools import partial

import pytest
from examples import SHARE

from lmd.core.checks import InputError
from lmd.formats.calibrations import calibrated_camera
from lmd.formats.detection_formats import read_detections
from lmd.formats.meshes import read_mesh
from lmd.formats.rigs import read_mount
from lmd.formats.tag_maps import read_deployment
from lmd.formats.trajectories import TrajectoryFile
from lmd.scene.pdf import from_csv as read_pdf
from lmd.survey.boards import Boards
from lmd.survey.prior import MeasuredPoints

BROKEN = round(100 * SHARE)  # files of each kind of change
VALUES = [
    None,
    True,
    "",
    "x",
    "nan",
    -1,
    0,
    1.5,
    1e308,
    -(10**400),
    10**19,
    [],
    {},
    [[]],
    [1, 2],
    {"x": {}},
    "\u2028\x00",
]
TOKENS = [
    "",
    "x",
    "nan",
    "inf",
    "-1",
    "1e400",
    "9" * 400,
    "0.5.5",
    ",",
    ";",
    "|",
    "#",
    "\n",
    "\x00",
    "é",
    '"',
    "[",
    "{",
    ":",
]
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
        ],
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
        },
    },
}
MAP_TEXTS = {
    "normals": "id,x,y,z,nx,ny,nz,ux,uy,uz,edge,family\n1,0,1,0,1,0,0,0,0,1,0.1,36h11\n2,0,2,0,1,0,0,0,0,1,,\n",
    "quaternions": "id,x,y,z,qx,qy,qz,qw,edge\n1,0,1,0,0,0,0,1,0.1\n2,0,2,0,0,0,0,1,\n",
    "spaces": "id x y z roll pitch yaw\n1 0 1 0 1.57 0 0\n2 0 2 0 1.57 0 0\n",
    "clover": "# id length x y z yaw pitch roll\n8\t0.3\t1\t2\n9 0.22 1 2 0.5 1.57 0 0\n",
    "headless": "8 3 1 2 0.5 0.5 0.5 0.5\n9 4 1 2 0 0 0 1\n",
    "fiducial_slam": "7 1.0 2.0 0.5 90.0 0.0 0.0 0.04 31 8 9\n",
    "rtabmap": "1 0 0 1 0 0 0|2 1 0 1 0 0 1.57\n",
    "rtabmap ini": "[Core]\nMarker\\Priors=1 0 0 1 0 0 0|2 1 0 1 0 0 1.57\nMarker\\Length=0.1\nMarker\\Dictionary=20\n",
    "rtabmap poses": "#timestamp x y z qx qy qz qw id\n0.0 1 2 3 0 0 0 1 -7\n1.5 1 2 3 0 0 0 1 4\n",
    "wpilib drawing": "ID,X,Y,Z,Z-Rotation,X-Rotation\n4,100,50,10,90,30\n",
}
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
        },
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
        },
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
CHAIN = {"cam0": {"T_cam_imu": [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]}}
TRAJECTORIES = {
    "tum": "0 1 2 3 0 0 0 1\n0.1 1.1 2 3 0 0 0 1\n0.2 1.2 2 3 0 0 0 1\n",
    "euroc": "#timestamp, p_x, p_y, p_z, q_w, q_x, q_y, q_z\n1e18,1,2,3,1,0,0,0\n1000000000100000000,1.1,2,3,1,0,0,0\n",
    "angles": "time,x,y,z,yaw,pitch\n0,1,2,3,0,0\n0.1,1.1,2,3,0.1,0\n",
}
OBJ = "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 1\nf 1 2 3\nf 1 3 4\nf 1 2 4\nf 2 3 4\n"
ROOMPLAN = {
    "walls": [
        {"dimensions": [4, 2.5, 0], "transform": [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 1.25, 0, 1], "curve": None}
    ],
    "floors": [
        {"dimensions": [4, 4, 0], "polygonCorners": [], "transform": [1, 0, 0, 0, 0, 0, 1, 0, 0, -1, 0, 0, 0, 0, 0, 1]}
    ],
    "doors": [],
    "windows": [],
    "openings": [],
    "objects": [],
}
DETECTED = "time,id,x0,y0,x1,y1,x2,y2,x3,y3\n0,1,10,10,20,10,20,20,10,20\n1,1,11,10,21,10,21,20,11,20\n"
read_map = partial(read_deployment, family="36h11")
CASES = {
    **{f"map {name}": (read_map, json.dumps(keys)) for name, keys in MAPS.items()},
    **{f"map {name}": (read_map, text) for name, text in MAP_TEXTS.items()},
    **{f"calibration {name}": (calibrated_camera, json.dumps(keys)) for name, keys in CALIBRATIONS.items()},
    "mount": (read_mount, json.dumps(CHAIN)),
    **{
        f"trajectory {name}": (lambda path: TrajectoryFile(str(path)).trajectory, t) for name, t in TRAJECTORIES.items()
    },
    "room obj": (lambda path: read_mesh(path.rename(path.with_suffix(".obj")), up="z"), OBJ),
    "room roomplan": (lambda path: read_mesh(path.rename(path.with_suffix(".json"))), json.dumps(ROOMPLAN)),
    "detections": (read_detections, DETECTED),
    "points": (MeasuredPoints.from_csv, "id,x,y,z\n1,0,0,0\n2,1,0,0\n3,0,1,0\n"),
    "boards": (partial(Boards.from_csv, printed=1e-3), "board,id,x,y\na,1,0,0\na,2,0.1,0\n"),
    "pdf": (lambda path: read_pdf(str(path)), "weight,pitch,yaw\n0.25,0.1,1\n0.75,-0.1,2\n"),
}


def places(tree, path=()):
    """Where all values of a tree are."""
    yield path
    inner = tree.items() if isinstance(tree, dict) else enumerate(tree) if isinstance(tree, list) else ()
    for key, value in inner:
        yield from places(value, (*path, key))


def changed(tree, rng):
    """A tree with a value that is another one, is missing, is nested deeply or is there a hundred times."""
    tree = json.loads(json.dumps(tree))
    path = rng.choice([place for place in places(tree) if place])
    above = tree
    for key in path[:-1]:
        above = above[key]
    kind = rng.randrange(5)
    if kind == 0:
        del above[path[-1]]
    elif kind == 1:
        for _ in range(rng.choice([3, 60])):
            above[path[-1]] = [above[path[-1]]] if rng.random() < 0.5 else {"x": above[path[-1]]}
    elif kind == 2 and isinstance(above[path[-1]], list):
        above[path[-1]] *= rng.choice([2, 100])
    else:
        above[path[-1]] = rng.choice(VALUES)
    return tree


def broken(text, rng):
    """A file of a text as bytes, with a change."""
    if text.startswith("{") and rng.random() < 0.6:
        return json.dumps(changed(json.loads(text), rng)).encode()
    kind, place = rng.randrange(4), rng.randrange(len(text))
    if kind == 0:
        content = bytearray(text.encode())
        content[rng.randrange(len(content))] ^= 1 << rng.randrange(8)
        return bytes(content)
    if kind == 1:
        return (text[:place] + text[place + rng.randrange(20) :]).encode()
    if kind == 2:
        return (text[:place] + rng.choice(TOKENS) + text[place + rng.randrange(3) :]).encode()
    return (text[:place] + text[rng.randrange(len(text)) :] * rng.choice([1, 5])).encode()


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("name", CASES)
def test_a_broken_file_is_read_or_refused_in_a_sentence(name, tmp_path):
    read, text = CASES[name]
    path = tmp_path / "file"
    path.write_text(text)
    read(path)
    rng = random.Random(name)
    for _ in range(BROKEN):
        content = broken(text, rng)
        path.write_bytes(content)
        try:
            read(path)
        except InputError:
            pass
        except Exception as error:
            pytest.fail(f"{type(error).__name__}: {error}\nof {content!r}")
