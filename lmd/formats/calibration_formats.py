"""Formats of calibrations, in the order in which they are tried."""

import re
from collections.abc import Callable, Mapping
from functools import cached_property
from typing import Any
from xml.etree.ElementTree import Element

from lmd.formats.array_files import arrays_of
from lmd.formats.bag_contents import cameras_in
from lmd.formats.bags import is_bag
from lmd.formats.calibration_readers import (
    COLMAP_CAMERA,
    KALIBR_CAMERA,
    MRCAL,
    Keys,
    basalt,
    camodocal,
    colmap,
    euroc,
    frc971,
    kalibr,
    message,
    mrcal,
    okvis,
    orb_slam,
    photonvision,
    stella_vslam,
    within,
)
from lmd.formats.device_calibrations import azure_kinect, depthai, ftc
from lmd.formats.kalibr_reports import kalibr_report
from lmd.formats.opencv_calibrations import AS_ROS, PRINTED, has_matrix, opencv, opencv_xml, printed, xml_of
from lmd.formats.program_calibrations import (
    caltech,
    intrinsics_of_open3d,
    is_matlab,
    is_stereo_of_matlab,
    matlab,
    metashape,
    nerf,
    open3d,
    visual_marker_mapping,
)
from lmd.formats.realsense_calibrations import is_realsense, realsense, realsense_text
from lmd.formats.refused_calibrations import KEYS, ROOTS, STEREO, TEXTS
from lmd.formats.registry import File, Format, anything, begins, has_keys

# Separator of the messages that ROS's tools print.
FIRST_MESSAGE = re.compile(r"(?<=\n)---[ \t]*\n(?=header:)")


class CalibrationFile(File):
    """File of a calibration; its keys may come from OpenCV's XML."""

    @cached_property
    def arrays(self) -> Keys | None:
        """Keys of a file of arrays; None for a text."""
        return arrays_of(self.path, self.argument, self.largest)

    @cached_property
    def text(self) -> str:
        """Text of the file, up to the end of ROS's first message; empty for a file of arrays."""
        return FIRST_MESSAGE.split(super().text)[0] if self.arrays is None else ""

    @cached_property
    def root(self) -> Element | None:
        """Outermost element of XML; None for another text."""
        return xml_of(self.text)

    @cached_property
    def keys(self) -> Keys:
        """Keys of YAML, JSON, OpenCV's XML or arrays; keys of a section `Camera` also as `Camera.fx`.

        Raises:
            InputError: the text is none of these.
        """
        if self.arrays is not None:
            return self.arrays
        keys = super().keys if self.root is None else opencv_xml(self.root)
        if isinstance(section := keys.get("Camera"), dict):  # stella_vslam has a section, OpenVSLAM has keys with dots
            keys = {**keys, **{f"Camera.{name}": value for name, value in section.items()}}
        return keys


def _marked(read: Callable[[Keys], Mapping[str, Any]], name: str, *keys: str, row: str = "") -> Format:
    """Format that is recognised by keys that no other format has."""
    return Format("calibration", name, has_keys(*keys), lambda file: read(file.keys), row=row)


def _refused(recognises: Callable[[Any], bool], why_not: str | Callable[[Any], str]) -> Format:
    return Format("calibration", "of another program", recognises, why_not=why_not)


def _has_root(tag: str) -> Callable[[CalibrationFile], bool]:
    """Make a test for XML with the outermost element `tag`, and without matrices of OpenCV."""
    return lambda file: (
        file.root is not None and file.root.tag == tag and file.root.find("*[@type_id='opencv-matrix']") is None
    )


def _is_metashape(file: CalibrationFile) -> bool:
    root = file.root
    if root is None:
        return False
    return root.find("projection" if root.tag == "calibration" else ".//sensor/calibration") is not None


def _frames_have(file: File, name: str) -> bool:
    frames = file.keys.get("frames")
    return isinstance(frames, list) and bool(frames) and isinstance(frames[0], dict) and name in frames[0]


def _is_stereo(file: File) -> bool:
    small = {key.lower() for key in file.keys}
    return any(pair <= small for pair in STEREO)


FORMATS = (
    Format(
        "calibration",
        "bag of ROS 2",
        lambda file: is_bag(file.path),
        lambda file: cameras_in(file.path, file.argument),
        row="bag of ROS 2 (MCAP, `.db3`, a folder) | its `CameraInfo`, of whole images; `name=/camera_info` is a topic",
    ),
    Format(
        "calibration",
        "COLMAP",
        lambda file: COLMAP_CAMERA.search(file.text) is not None,
        lambda file: colmap(COLMAP_CAMERA.findall(file.text)),
        row="COLMAP `cameras.txt` | models without a prism; `name=cam1` has the id 1",
    ),
    Format(
        "calibration",
        "mrcal",
        lambda file: MRCAL.match(file.text) is not None,
        lambda file: {"": mrcal(file.text)},
        row="mrcal `cameramodel` | pinhole, `OPENCV4` to `OPENCV12`",
    ),
    Format(
        "calibration",
        "Kalibr's report",
        begins(r"^Calibration results\s*$|^Camera-system parameters"),
        lambda file: kalibr_report(file.text, file.asked),
        row="Kalibr `results-cam.txt` | models as in its `camchain`; no size; `name=cam1`",
    ),
    Format(
        "calibration",
        "RealSense",
        lambda file: 'Intrinsic of "' in file.text,
        lambda file: realsense_text(file.text, file.asked),
        row="RealSense: `rs-enumerate-devices -c` (text), `rs2_intrinsics` (JSON) | `name=Color/1280x720`, or "
        '`image_size`; coefficients of "inverse Brown Conrady" that are not 0 need `distortion_model` '
        "(`inverse_brown_conrady` as documented, `plumb_bob` as computed by librealsense and ROS)",
    ),
    Format("calibration", "ROS", lambda file: bool(PRINTED.search(file.text)), lambda file: printed(file.text)),
    *(_refused(begins(mark), sentence) for mark, sentence in TEXTS),
    Format(
        "calibration",
        "FTC",
        _has_root("Calibrations"),
        lambda file: ftc(file.root),
        row="FTC `teamwebcamcalibrations.xml` | `name=Logitech:0x0825/640x480`, or `name=Logitech:0x0825` and "
        "`image_size`",
    ),
    Format(
        "calibration",
        "Metashape",
        lambda file: (
            (file.root is not None and file.root.find(".//calibration/f/..") is not None) or _is_metashape(file)
        ),
        lambda file: metashape(file.root),
        row="Metashape (XML): a camera's calibration, `cameras.xml`, or OpenCV's export | frame cameras and "
        "fisheyes; `name=sensor0`",
    ),
    *(_refused(_has_root(tag), sentence) for tag, sentence in ROOTS.items()),
    Format(
        "calibration",
        "Kalibr",
        lambda file: any(KALIBR_CAMERA.fullmatch(name) for name in file.keys),
        lambda file: kalibr(file.keys, file.asked["name"]),
        row=(
            "Kalibr `camchain` (YAML) | `cam0`, or `name=cam1`: `pinhole` with `radtan`, `equidistant` or `none`; "
            "`ds`, `eucm`, `omni`"
        ),
    ),
    _marked(
        message,
        "ROS",
        *("width", "height", "K", "D"),
        row="ROS `camera_info`, message (YAML, JSON), prints of its calibrator | of `image_raw`, not rectified images",
    ),
    _marked(message, "ROS", "width", "height", "k", "d"),
    _marked(
        photonvision,
        "PhotonVision",
        *("cameraIntrinsics", "distCoeffs"),
        row="PhotonVision, WPIcal, frc971 (JSON) | only PhotonVision's has a size",
    ),
    _marked(frc971, "frc971", "intrinsics", "dist_coeffs"),
    _marked(
        basalt,
        "Basalt",
        "value0",
        row="Basalt (JSON) | `pinhole`, `pinhole-radtan8`, `kb4`, `ds`, `eucm`; `name=cam0` is the first",
    ),
    _marked(
        orb_slam,
        "ORB-SLAM",
        "Camera.type",
        row="ORB-SLAM2 and 3 (YAML) | `PinHole`, `KannalaBrandt8`, `Rectified`; the first camera; often no size",
    ),
    _marked(
        stella_vslam, "stella_vslam", "Camera.model", row="stella_vslam, OpenVSLAM (YAML) | `perspective`, `fisheye`"
    ),
    _marked(orb_slam, "ORB-SLAM", "Camera.fx"),
    _marked(okvis, "OKVIS", "cameras", "camera_params"),
    _marked(okvis, "OKVIS2", "cameras", "camera_parameters"),
    _marked(
        camodocal,
        "VINS",
        *("model_type", "projection_parameters"),
        row="VINS (YAML) | `PINHOLE`, `KANNALA_BRANDT`, `MEI`",
    ),
    _marked(camodocal, "VINS", "model_type", "mirror_parameters"),
    _marked(
        euroc,
        "EuRoC",
        *("camera_model", "intrinsics", "distortion_model", "resolution"),
        row="EuRoC `sensor.yaml`, OKVIS and OKVIS2 (YAML) | OKVIS: `name=cam0` is the first",
    ),
    Format(
        "calibration",
        "DepthAI",
        has_keys("cameraData"),
        lambda file: depthai(file.keys),
        row="DepthAI: an OAK's calibration (JSON) | `name=CAM_A`; perspective with up to 12 coefficients, fisheye",
    ),
    Format(
        "calibration",
        "Azure Kinect",
        has_keys("CalibrationInformation"),
        lambda file: azure_kinect(file.keys),
        row="Azure Kinect (JSON in its recordings) | `name=color/1280x720`, `depth/640x576`, or `image_size`; the end "
        "of its image as `image_circle`",
    ),
    Format(
        "calibration",
        "RealSense",
        lambda file: any(within(file.keys, is_realsense)),
        lambda file: realsense(file.keys, file.asked),
    ),
    Format(
        "calibration",
        "MATLAB",
        lambda file: any(within(file.keys, lambda keys: is_matlab(keys) or is_stereo_of_matlab(keys))),
        lambda file: matlab(file.keys),
        row="MATLAB: `toStruct(...)` as `.mat` (`-v7`) or by `jsonencode`; Caltech's `Calib_Results.mat` | of two "
        "cameras `name=cam1` and `cam2` in Caltech's and `stereoParameters`",
    ),
    Format(
        "calibration",
        "Caltech",
        lambda file: has_keys("fc", "cc")(file) or has_keys("fc_left")(file),
        lambda file: caltech(file.keys),
    ),
    Format(
        "calibration",
        "nerfstudio",
        lambda file: "fl_x" in file.keys or "camera_angle_x" in file.keys or _frames_have(file, "fl_x"),
        lambda file: nerf(file.keys, file.asked),
        row="nerfstudio, instant-ngp `transforms.json` | `OPENCV`, `OPENCV_FISHEYE`, pinholes; `name=cam0` where "
        "frames differ",
    ),
    _marked(
        visual_marker_mapping,
        "Visual Marker Mapping",
        *("horizontal_resolution", "vertical_resolution", "fx"),
        row="Visual Marker Mapping `camera_intrinsics.json` | numbers as texts",
    ),
    Format(
        "calibration",
        "Open3D",
        lambda file: bool(intrinsics_of_open3d(file.keys)) and not has_matrix(file.keys),
        lambda file: open3d(file.keys),
        row="Open3D `PinholeCameraIntrinsic`, trajectories (JSON) | matrices by columns",
    ),
    Format(
        "calibration",
        "OpenCV",
        lambda file: has_matrix(file.keys),
        lambda file: {"": opencv(file.keys)},
        row=(
            "OpenCV `FileStorage` (YAML, XML, JSON), scripts, NumPy's `.npz` | `fisheye_model: 1`, `fisheye: true`, "
            "`model: fisheye` or `DIM` for a fisheye; four coefficients without a word of the model need "
            "`distortion_model` (`fisheye`, `plumb_bob`)"
        ),
    ),
    *(_refused(has_keys(*marks), sentence) for marks, sentence in KEYS),
    _refused(_is_stereo, f"it holds two cameras of OpenCV's stereo calibration: for each, {AS_ROS}"),
    _refused(
        anything,
        lambda file: (
            f"it is no calibration that is known here, it has {', '.join(file.keys)[:200] or 'no keys'}: {AS_ROS}"
        ),
    ),
)
