"""Small samples of each format that is read, and the readers of the families.

Keyed files are in the folders of `formats/files`, with their values in the tables beside them; texts are in
`formats/files/tables.yaml`. `test_fuzz_readers.py` changes the bits, types, sizes and nesting of each.
"""

import itertools
import json
from pathlib import Path

import trimesh
import yaml
from PIL import Image

from lmd.formats.calibrations import calibrated_camera
from lmd.formats.detection_formats import read_detections
from lmd.formats.meshes import read_mesh
from lmd.formats.plans import read_plan_room
from lmd.formats.tag_maps import read_deployment
from lmd.formats.trajectories import TrajectoryFile
from support.rooms import KEYS, hall

FILES = Path(__file__).parents[1] / "formats" / "files"
TABLES, CALIBRATIONS = (yaml.safe_load((FILES / f"{name}.yaml").read_text()) for name in ("tables", "calibrations"))
ARGUMENTS = ("name", "image_size", "distortion_model")  # of `calibrated_camera`, among the values of a calibration
OBJ = "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 1\nf 1 2 3\nf 1 3 4\nf 1 2 4\nf 2 3 4\n"


def read_camera(path):
    row = CALIBRATIONS.get(path.name, {})
    return calibrated_camera(path, **{key: value for key, value in row.items() if key in ARGUMENTS})


def read_trajectory(path):
    row = TABLES["poses"].get(path.name, {})
    return TrajectoryFile(str(path), columns=row.get("columns")).trajectory


def read_tags(path):
    return read_deployment(path, family="36h11", columns=TABLES["tags"].get(path.name, {}).get("columns"))


def keyed(of):
    """Bytes of the keyed files of a family."""
    return {path.name: path.read_bytes() for path in sorted((FILES / of).iterdir())}


def texts(of, *names):
    """Texts of files of `formats/files/tables.yaml`."""
    return {name: TABLES[of][name]["text"] for name in names or TABLES[of]}


BOX = trimesh.creation.box()
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
    "calibration": keyed("calibration"),
    "trajectory": texts("poses", "degrees", "ros2 topic echo of odometry", "tum", "vins", "euroc"),
    "tag map": keyed("tag_map")
    | texts("tags", "size of a list", "quaternions", "header with spaces", "clover", "clover without names", "list")
    | texts("tags", "fiducial_slam", "rtabmap priors", "rtabmap ini", "rtabmap poses"),
    "room": {"room.obj": OBJ, **{f"room.{kind}": BOX.export(file_type=kind) for kind in ("ply", "stl", "glb")}},
    "floor plan": {"map.yaml": json.dumps(KEYS | {"image": "map.pgm"}), "plan.dxf": DXF},
    "detections": texts("detections", "table", "family", "photonvision", "photonvision by camera", "limelight"),
}


def content(sample):
    """The bytes of a sample, which may be a text."""
    return sample if isinstance(sample, bytes) else sample.encode()
