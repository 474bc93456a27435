"""Bad files of every format: each is refused in one sentence that names the file and the value, or the way on."""

import json
import re

import pytest
from camera_samples import KINECT_CAMERA, MATLAB, METASHAPE, OAK, OAK_EXTRINSICS, REPORT
from format_samples import FILES, MRCAL, READERS, SAMPLES, content

from lmd.core.checks import InputError
from lmd.formats import registry
from lmd.formats.tag_maps import LARGEST_MAP

TABLE = ".*; write its tags as a table: a header id,x,y,z,qx,qy,qz,qw,edge"


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
    "tag map": [
        ("marker_id,vert_0_x,vert_0_y\n7,0,0\n", "Pupil" + TABLE),
        ("- name: wall\n  markers_x: 2\n", "aruco_opencv" + TABLE),
        ('{"tag_locations": {}}', "it has no tags with places"),
        ('{"reconstructed_tags": []}', "it has no tags with places"),
        ("/**: {ros__parameters: {general: {}, marker_000: {}}}\n", "the key 'marker_size' is missing"),
        ("/**: {ros__parameters: {family: 36h11, size: 0.1, tag: {ids: [1]}}}\n", "apriltag_ros for ROS 2" + TABLE),
        ('{"tags": [{"ID": 1}]}', "the key 'pose' is missing"),
        ('{"tags": []}', "it has no tags with places"),
        ('{"tags": [{"ID": -1, "pose": 3}]}', r"pose must be a mapping with keys, got 3"),
        ('{"layout": []}', "no tag map that is known here .*: it has layout"),
        ("tag_bundles: [3]", r"tag_bundles\[0\] must be a mapping with keys, got 3"),
        ("/**: {ros__parameters: {family: 36h11}}", "no tag map that is known here .*: it has family"),
        (SAMPLES["tag map"]["wpilib"].replace('"W": 1', '"W": 2'), "must have length 1, it has 2"),
        ("{", "cannot be read as YAML or JSON"),
        ("{" + " " * LARGEST_MAP, "has at most 4194304 characters"),
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
