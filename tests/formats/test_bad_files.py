"""Bad files of every format: each is refused in one sentence that names the file and the value, or the way on."""

import json
import re

import pytest
from camera_samples import KINECT_CAMERA, MATLAB, METASHAPE, OAK, OAK_EXTRINSICS, REPORT
from captured import MRUK, anchor, entity, rectangle, surface
from detection_samples import CORNERS, LIMELIGHT, PHOTON, VMM
from format_samples import FILES, MRCAL, READERS, SAMPLES, content

from lmd.core.checks import InputError
from lmd.formats import registry
from lmd.formats.tag_maps import LARGEST_MAP

KAPTURE = (
    "timestamp, device_id, qw, qx, qy, qz, tx, ty, tz\n0, cam0, 1, 0, 0, 0, 0, 0, 0\n1, cam0, 1, 0, 0, 0, 0, 0, 0\n"
)
SQUARE = "10,20,30,20,30,40,10,40"
TABLE = ".*; write its tags as a table: a header id,x,y,z,qx,qy,qz,qw,edge"
WALL = {"xStart": 0.0, "yStart": 0.0, "xEnd": 600.0, "yEnd": 0.0, "height": 250.0}
CAPTURED = {"walls": [{"transform": [1], "dimensions": [1, 1, 0]}]}


def flat_floor(ring):
    """A scene of Unity with only a floor."""
    floor = anchor("FLOOR", [0, 0, 0], [270, 0, 0], PlaneBoundary2D=ring)
    return {"CoordinateSystem": "Unity", "Rooms": [{"Anchors": [floor]}]}


UNCALIBRATED = {"intrinsicMatrix": [[0.0] * 3] * 3, "extrinsics": {"toCameraSocket": 1}}
INVERSE = {"model": "distortion.inverse_brown_conrady", "coeffs": [-0.05, 0.06, 0.0, 0.0, -0.02]}
STREAM = {"width": 640, "height": 480, "fx": 600, "fy": 600, "ppx": 320, "ppy": 240}
KINECT = {"CalibrationInformation": {"Cameras": [KINECT_CAMERA]}}
# Of devices and programs: what is in the file, and a text in the message.
CAMERAS = [
    (json.dumps({"cameraData": [[0, {"width": 1280}]]}), "the key or value 'intrinsicMatrix' is missing or wrong"),
    (json.dumps({"cameraData": [[0, UNCALIBRATED]]}), "none of its cameras is calibrated"),
    (json.dumps({"cameraData": [[0, OAK | {"cameraType": 3}]]}), "the lens model 'RadialDivision' is not known here"),
    (json.dumps({"cameraData": [[0, OAK | {"distortionCoeff": [0.1] * 14}]]}), "is that of a tilted sensor"),
    (
        json.dumps(
            {"cameraData": [[i, OAK | {"extrinsics": OAK_EXTRINSICS | {"toCameraSocket": 1 - i}}] for i in (0, 1)]}
        ),
        "the extrinsics of its cameras refer to each other in a circle",
    ),
    (json.dumps(STREAM | INVERSE), "its coefficients are of the inverse Brown-Conrady model, which librealsense"),
    (json.dumps(STREAM | INVERSE | {"model": 3}), "the lens model ftheta is not known here"),
    (json.dumps(STREAM | {"coeffs": [0.1] * 5}), "are of no model that it names"),
    (json.dumps({"a": STREAM, "b": STREAM}), "name must be given"),
    (json.dumps(KINECT), "name must be given"),
    ('{"camera_model": "EQUIRECTANGULAR", "fl_x": 1}', "the lens model 'EQUIRECTANGULAR' is not known here"),
    ('{"camera_angle_x": 0.7, "frames": []}', "image_size must be given"),
    (json.dumps({"frames": [{"fl_x": 600.0 + i, "w": 1, "h": 1} for i in range(70)]}), "more than 64 of its frames"),
    ('{"fx": "800", "vertical_resolution": "1", "horizontal_resolution": "2"}', "'fy' is missing or wrong"),
    ("<Calibrations><!-- <Camera/> --></Calibrations>", "it has no calibration, or only such as are comments"),
    (
        "<Calibrations><Camera><Calibration size='640 480'/></Camera></Calibrations>",
        "'focallength' is missing or wrong",
    ),
    ("<calibration><projection>frame</projection></calibration>", "it is of PhotoScan before version 1.2, or has no f"),
    (METASHAPE.replace("frame", "spherical"), "the lens model 'spherical' is not known here"),
    (METASHAPE.replace("<width>640</width>", ""), "its width or height is missing"),
    (REPORT.replace("DistortedP", "FovP"), "the lens model 'FovPinhole' is not known here"),
    ("Calibration results \n====\nCamera-system parameters:\n\tcam0 (/a):\n", "Kalibr without the cameras' projection"),
    (json.dumps(MATLAB | {"MappingCoefficients": [1, 2, 3, 4]}), "of Scaramuzza,' is not known here"),
    (json.dumps(MATLAB | {"ImageSize": []}), "image_size must be given"),
]

# By family: what is in the file, and a text or a pattern in the message.
BAD = {
    "calibration": [
        ("<!DOCTYPE a [<!ENTITY b 'c'>]><a>&b;</a>", "an XML file with a document type or entities is not taken."),
        ("<a><b>", "it cannot be read as XML"),
        (FILES["Basalt"].replace("pinhole-radtan8", "fov"), "the lens model 'fov' is not known here"),
        (FILES["Basalt"].replace("pinhole-radtan8", "ds"), "the key or value 'xi' is missing or wrong"),
        (FILES["COLMAP"].replace("FULL_OPENCV", "FOV"), "the lens model 'FOV' is not known here"),
        (FILES["ORB-SLAM3"].replace("PinHole", "Stereo"), "the lens model 'Stereo' is not known here"),
        (
            FILES["OpenVSLAM"].replace("perspective", "radial_division"),
            "the lens model 'radial_division' is not known here",
        ),
        (FILES["another script"].replace("Raspberry Pi 3 wide", "MEI"), "the lens model 'mei' is not known here"),
        (FILES["VINS"].replace("PINHOLE", "SCARAMUZZA"), "the lens model 'SCARAMUZZA' is not known here"),
        ("cams: [{a: 1}]\n", "it is no calibration that is known here, it has cams: write it as ROS does, with"),
        (f"{{'lensmodel': {'0' * (1 << 20)}}}", "a cameramodel has at most 1048576 characters"),
        (MRCAL.format("CAHVOR", "1"), "the lens model 'CAHVOR' is not known here"),
        (MRCAL.format("OPENCV4", "1"), "intrinsics must be a list of 8 numbers"),
        ("{'lensmodel': __import__('os')}", "it is no cameramodel of mrcal (malformed node or string on line 1)."),
        (FILES["frc971"].replace("image_width", "w"), "image_size must be given, .*: image_width or image_height is"),
        (FILES["Basalt"].replace('"fx"', '"f"'), "the key or value 'fx' is missing or wrong"),
        ("1 OPENCV 640 480 600 610\n", "the key or value"),
        ("<root><camera><name>Camera</name></camera></root>", "such as ViSP's: of a model take px, py, u0, v0"),
        *CAMERAS,
        ("<robot><a/></robot>", "XML with the element 'robot', and only OpenCV's opencv_storage is read"),
        ("[LEFT_CAM_HD]\nfx=700.1\n", "that Stereolabs keeps of a ZED"),
        ("[image]\n\nwidth = 640\n", "sections and keys, as an INI file"),
        ("# oST version 5.0 parameters\n\n\n[image]\n", "ROS's ost.txt: the ost.yaml beside it is read"),
        ("1000.0,0.0,640.0\n0.0,1000.0,360.0\n0.0,0.0,1.0\n", "numbers without names"),
        ("1000 0 640\n0 1000 360\n0 0 1\n", "numbers without names"),
        ('{"M1": [1], "D1": [1], "M2": [1], "D2": [1]}', "two cameras of OpenCV's stereo calibration"),
        ('{"K_left": [1], "K_right": [1]}', "two cameras of OpenCV's stereo calibration"),
        ('{"fx": 1, "fy": 1}', "it is no calibration that is known here, it has fx, fy: write it as ROS does"),
        (
            json.dumps(
                {"cam0": {"camera_model": "pinhole", "intrinsics": 3, "distortion_model": "radtan", "resolution": 1}}
            ),
            "",
        ),
        ({"cam0": "pinhole"}, ""),
        (
            json.dumps(
                {"camera_model": "pinhole", "intrinsics": "f", "distortion_model": "radtan", "resolution": [1, 2]}
            ),
            "",
        ),
        ({"value0": {"intrinsics": [{"camera_type": "kb4", "intrinsics": [1]}], "resolution": [[1, 2]]}}, ""),
        ({"value0": "x"}, ""),
        ({"value0": {"intrinsics": ["x"], "resolution": [[1, 2]]}}, ""),
        ({"cameras": ["x"], "camera_params": {}}, ""),
        ({"model_type": "PINHOLE", "projection_parameters": [1], "image_width": 1, "image_height": 1}, ""),
        ({"resolution": 1, "cameraIntrinsics": [], "distCoeffs": 0}, ""),
        ({"value0": {"intrinsics": [], "resolution": []}}, ""),
        ({"width": 10**400, "height": 480, "K": [10**400] * 9, "D": [0, 0, 0, 0, 0]}, ""),
        (
            json.dumps(
                {
                    "value0": {
                        "intrinsics": [
                            {"camera_type": "ds", "intrinsics": dict.fromkeys(["fx", "fy", "cx", "cy", "xi"], 1)}
                        ],
                        "resolution": [[10**400, 2]],
                    }
                }
            ),
            "",
        ),
    ],
    "trajectory": [
        (
            f"# kapture format: 1.1\n# {KAPTURE}",
            "trajectory of kapture, .* world to camera, .* [(]kapture_export_colmap",
        ),
        (KAPTURE, "trajectory of kapture"),
        ("VERTEX_SE3:QUAT 0 1 2 3 0 0 0 1\n", "a pose graph of g2o, which has no times"),
        ("header:\n  stamp:\n    sec: 1\n", "record it as CSV, by ros2 topic echo --csv"),
        ('{"frames": [{"transform_matrix": []}]}', "it is JSON"),
        ("VehicleName\tTimeStamp\tPOS_X\tPOS_Y\tPOS_Z\tQ_W\tQ_X\tQ_Y\tQ_Z\n", "AirSim, .* north, east and down"),
        ("NVM_V3\n\n2\n", "VisualSFM"),
        ("lidar0,100.000000,100.000000,1,0,0,0,1\n", "line 1 begins with 'lidar0', which is neither a number nor"),
        (
            "# when x y z qw qx qy qz\n0 1 1 1 1 0 0 0\n1 1 1 1 1 0 0 0\n",
            "no column with a name that is known as the time",
        ),
        ("# image_id x y z qw qx qy qz\n0 1 1 1 1 0 0 0\n", "no column with a name that is known as the time"),
        ("#t, e, n, u, a, b, c, d\n0,1,1,1,1,0,0,0\n", "lacks x, y, z, qx"),
        ("# t e n u q_a q_b q_c q_d\n0 1 1 1 1 0 0 0\n", "lacks x, y, z, qx"),
        ("# t x y z qw qx qy qz vx\n0 1 1 1 1 0 0 0\n", "a comment names 9 columns, .* and line 2 has 8 values"),
        ("0,1,1,1,1,0,0,0\n1,1,1,1,1,0,0,0\n", "so that qx or qw may be first: write a first line such as time,x"),
        ("timestamp,p_x,p_y,x,p_z,qx,qy,qz,qw\n", "its columns 'p_x' and 'x' may both be x: leave one"),
        ("time,x [ft],y [ft],z [ft],qx,qy,qz,qw\n0,1,1,1,0,0,0,1\n", r"the unit 'ft' of the column 'x \[ft\]' is not"),
        ("timestamp,position[0],position[1],position[2],q[0],q[1],q[2],q[3]\n1,1,1,1,1,0,0,0\n", "lacks x|which is w"),
        ("timestamp,x,y,z,q[0],q[1],q[2],q[3]\n1,1,1,1,1,0,0,0\n", r"from 'q\[0\]' on do not say which is w"),
        (
            "Timestamp,/a/translation/x,/a/translation/y,/a/rotation/value\n0,1,1,0\n",
            "lacks z, .* add z, the height, and roll = pitch = 0",
        ),
        ("1478254247676381 1 1 1 0 0 0 1\n", "looks like milliseconds, microseconds or nanoseconds: divide it, or let"),
        ("# time_ns x y z qx qy qz qw\n0.0 1 1 1 0 0 0 1\n0.1 1 1 1 0 0 0 1\n", "cannot be in the unit that it names"),
        ("0 1 1 1 0 0 0.001 0.029\n1 1 1 1 0 0 0 1\n", "line 1: the quaternion must have length 1, it has 0.0290"),
        ("0 " * 25 + "\n", "line 1 has 25 values, not 8: .* Name other columns in a line above them"),
        ("#timestamp x y z qx qy qz qw id\n1 1 1 1 0 0 0 1 -3\n", "it has no pose: all its rows have a negative id"),
        ("", "is empty"),
    ],
    "tag map": [
        ("VERTEX_SE3:QUAT 7 2 0 1.2 0 0 0 1\n", "g2o with 1 poses and without edges to a landmark: export the poses"),
        ("marker_id,vert_0_x,vert_0_y\n7,0,0\n", "Pupil" + TABLE),
        ("- name: wall\n  markers_x: 2\n", "aruco_opencv" + TABLE),
        ('{"tag_locations": {}}', "it has no tags with places"),
        ('{"reconstructed_tags": []}', "it has no tags with places"),
        ("/**: {ros__parameters: {general: {}, marker_000: {}}}\n", "the key 'marker_size' is missing"),
        ("/**: {ros__parameters: {family: 36h11, size: 0.1, tag: {ids: [1]}}}\n", "apriltag_ros for ROS 2" + TABLE),
        ("landmarks: [{id: 1, position: [0, 0, 0]}]\n", "has no orientation: it needs roll, pitch and yaw, rad"),
        ('{"tags": [{"ID": 1}]}', "the key 'pose' is missing"),
        ('{"tags": []}', "it has no tags with places"),
        ('{"tags": [{"ID": -1, "pose": 3}]}', r"pose must be a mapping with keys, got 3"),
        ('{"layout": []}', "no tag map that is known here .*: it has layout"),
        ("tag_bundles: [3]", r"tag_bundles\[0\] must be a mapping with keys, got 3"),
        ("/**: {ros__parameters: {family: 36h11}}", "no tag map that is known here .*: it has family"),
        ("1 0.3 a 2", "could not convert string to float"),
        ("1 0.3 1 2 3 4 5 6 7.5", "they are not those of fiducial_slam"),
        ("1 0 0 0 0 0 0 0\n", "an edge of 0 m would be none of a tag. What are its values"),
        ("1 0.1 0 0\n1 0.1 1 0\n", "id 1 belongs to 2 landmarks"),
        (SAMPLES["tag map"]["wpilib"].replace('"W": 1', '"W": 2'), "must have length 1, it has 2"),
        ("{", "cannot be read as YAML or JSON"),
        ("{" + " " * LARGEST_MAP, "has at most 4194304 characters"),
        ("id,x,y,z,nx,ny,nz,edge\n1,1,0,1,0,1,0,wide\n", "edge must be positive metres: .*'wide'"),
        (
            "id,x,y,z,nx,ny,nz,edge\n0,1,0,1,0,1,0,\n1,2,0,1,0,1,0,-0.1\n",
            "edge must be positive metres, landmark 1 has -0.1",
        ),
    ],
    "detections": [
        ("id,x0,y0,x1,y1,x2,y2,x3,y3\n", "lacks the column time or stamp or timestamp or image; what is read is a bag"),
        (f"time,id,x0,y0,x1,y1,x2,y2,x3\n0,3,{SQUARE[:-3]}\n", "lacks the column y3; what is read"),
        (f"time,id,x0,y0,x1,y1,x2,y2,x3,y3\n0,3.5,{SQUARE}\n", "line 2: id is '3.5', not a whole number"),
        (f"time,id,x0,y0,x1,y1,x2,y2,x3,y3\n0,3,left{SQUARE[2:]}\n", "line 2: x0 is 'left', not a number"),
        ("", "is empty; what is read"),
        ('[{"targets": [{"fiducialId": 18}]}]', "has a result without captureTimestampMicros in its metadata"),
        ([PHOTON[0] | {"targets": 3}], "has a value of another kind than its program writes"),
        (VMM | {"tag_observations": [{}]}, "lacks the key 'observations'"),
        (
            '{"a": [1, 2]}',
            "is JSON without targets, Fiducial or tag_observations; what is read is .* JSON of PhotonVision",
        ),
        ('{"a": [1, 2]', "is no JSON"),
        ([PHOTON[0] | {"targets": []}], "has no detection of a tag with corners"),
        (json.dumps(PHOTON).replace(": 18", ": 1.5"), "has the fiducialId 1.5, which is not a whole number"),
        (
            json.dumps(LIMELIGHT).replace(json.dumps(CORNERS), "[]"),
            "has no corners, pts is empty: let the pipeline send",
        ),
        (json.dumps(LIMELIGHT).replace("10.0", "-10.0"), "has corners below 0: its pts count from the middle"),
        (json.dumps(LIMELIGHT).replace('"ts"', '"t"'), "has a result without ts, so its time is not known"),
        (json.dumps(LIMELIGHT).replace("[10.0, 20.0], ", "", 1), "must have four corners in pts, got [["),
        (VMM | {"images": []}, "has an observation in the image 0, which is not among its images"),
        ("18\n10.0 20.0\n", "has no such columns in its first line, '18'; what is read"),
        ("image,tag_id,corner,x,y\na.png,7,0,10,20\n", "has a row for each corner; what is read is a bag"),
        (f"time;id;x0;y0;x1;y1;x2;y2;x3;y3\n0;3;{SQUARE}\n", "has semicolons between its columns"),
        ("time,id,x0,y0,x1,y1,x2,y2,x3,y3\n0,3,1,1,1,1,1,1,1,1\n", "no detection with four corners"),
    ],
    "room": [
        (flat_floor([[0, 0]]), "PlaneBoundary2D must have at least three corners, got 1."),
        (flat_floor([[0, 0], [1, 1], [2, 2]]), "holds no triangles with an area."),
        (flat_floor([[0, 0], [1, 1], [1, 0], [0, 1]]), "holds no triangles with an area."),  # it crosses itself
        ({"walls": [], "floors": [surface([0, 1, 0], [0, 0, 1], [0, 0, 0])]}, "holds no triangles with an area."),
        (
            {"version": 1},
            "it is no room of a headset or a phone that is known here (spatialEntities, Rooms, walls): it ",
        ),
        (MRUK | {"CoordinateSystem": "Unreal"}, "CoordinateSystem must be Unity, got 'Unreal': save the scene by MRUK"),
        (MRUK | {"Rooms": MRUK["Rooms"] * 2}, "it has 2 rooms: leave one of them in the file."),
        ({"spatialEntities": []}, "it has neither a floor nor walls."),
        ({"walls": [{"transform": [1.0], "dimensions": [4, 2.5, 0]}]}, "transform must be a list of 16 numbers"),
        ({"walls": [{"dimensions": [4, 2.5, 0]}]}, "the key or value 'transform' is missing or wrong."),
        ({"walls": 3}, "the key or value "),
        ({"walls": [surface([0, 1, 0], [10**400, 0, 0], [4, 2.5, 0])]}, "transform[0] must be finite"),
        ({"walls": [surface([0, 1, 0], [2, 0, 0], [4, 2.5, 0])]}, "walls[0].transform is no rotation and translation"),
        ({"spatialEntities": [entity("WALL", [10**400, 0, 0], [0, 0, 0, 1])]}, "position[0] must be finite"),
        ({"spatialEntities": [entity("WALL", [0, 0, 0], [0, 0, 0, 10**400])]}, "orientation[3] must be finite"),
        ({"spatialEntities": [entity("WALL", [0, 0, 0], [0, 0, 0, 1], **rectangle(10**400, 1))]}, "must be finite"),
        ([], "has no keys"),
        ("{", "cannot be read as JSON"),
        (
            {"walls": [WALL], "rooms": []},
            "it has the walls of Sweet Home 3D, in centimetres: export its 3D view to OBJ",
        ),
        ({"floorplan": {"corners": {}, "walls": []}, "items": []}, "it is a plan of Blueprint3D, in centimetres"),
        ({"rooms": [CAPTURED, CAPTURED]}, "a CapturedStructure of RoomPlan's with 2 rooms: `jq '.rooms[0]'"),
        ({"type": "FeatureCollection", "features": []}, "it has polygons in GeoJSON"),
        ({"asset": {}, "meshes": []}, "let its name end in .gltf"),
        ({"metadata": {}, "object": {}}, "it is a scene of three.js"),
        ({"levels": {}}, "it is a building of Open-RMF"),
    ],
}
ROWS = [(family, *row) for family, rows in BAD.items() for row in rows]
# Of every sample.
DAMAGES = {
    "empty": lambda _: b"",
    "no text": lambda sample: b"\x00\xff\xfe" + sample,
    "cut": lambda sample: sample[: len(sample) // 3],
    "NaN": lambda sample: re.sub(rb"(?<![\w.])-?\d+\.?\d*(?![\w.])", b"NaN", sample),
}
ALL = [(family, name) for family, own in SAMPLES.items() for name in own]


def refusal(family, path):
    """The sentence in which a file is refused; empty if it is read."""
    try:
        READERS[family](path)
    except InputError as error:
        message = str(error)
        assert path.name in message
        assert "\n" not in message
        assert family == "room" or "object" not in message  # no words of Python's
        return message
    return ""


@pytest.mark.parametrize(("family", "content", "words"), ROWS)
def test_a_bad_file_is_refused_in_one_sentence(family, content, words, tmp_path):
    path = tmp_path / ("room.json" if family == "room" else "file")
    path.write_text(content if isinstance(content, str) else json.dumps(content))
    message = refusal(family, path)
    assert message
    assert words in message or re.search(words, message)


@pytest.mark.parametrize("damage", DAMAGES)
@pytest.mark.parametrize(("family", "name"), ALL)
def test_a_damaged_sample_is_refused_in_one_sentence(family, name, damage, tmp_path):
    path = tmp_path / name
    sample = content(SAMPLES[family][name])
    path.write_bytes(damaged := DAMAGES[damage](sample))
    assert refusal(family, path) or damage == "cut" or damaged == sample  # lines may be whole, and arrays no digits


BAGS = {"bag of ROS 2", "ROS 2"}  # binary files and folders, which `test_bags.py` makes


def test_every_format_that_is_read_has_a_sample(monkeypatch, tmp_path):
    found, recognised = registry.format_of, []
    monkeypatch.setattr(registry, "format_of", lambda *file: recognised.append(found(*file)) or recognised[-1])
    for family, name in ALL:
        path = tmp_path / name
        path.write_bytes(content(SAMPLES[family][name]))
        assert not refusal(family, path)
    listed = {form.name for family in registry.FAMILIES for form in registry.formats(family) if form.read is not None}
    assert listed - BAGS <= {form.name for form in recognised}
