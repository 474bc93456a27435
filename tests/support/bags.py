"""Bags of ROS 2 for tests, written by `mcap-ros2-support`, which shares no code with the library that reads them."""

import numpy as np
from mcap_ros2.writer import Writer

from lmd.detection.photographed import images_in
from lmd.formats import bags
from lmd.geometry.camera import Camera

HEADER = """std_msgs/Header header
{body}
================================================================================
MSG: std_msgs/Header
builtin_interfaces/Time stamp
string frame_id
================================================================================
MSG: builtin_interfaces/Time
int32 sec
uint32 nanosec
{more}"""
IMAGE = HEADER.format(
    body="uint32 height\nuint32 width\nstring encoding\nuint8 is_bigendian\nuint32 step\nuint8[] data", more=""
)
COMPRESSED = HEADER.format(body="string format\nuint8[] data", more="")
RULE = "=" * 80
CAMERA_INFO = HEADER.format(
    body="uint32 height\nuint32 width\nstring distortion_model\nfloat64[] d\nfloat64[9] k\nfloat64[9] r\n"
    "float64[12] p\nuint32 binning_x\nuint32 binning_y\nsensor_msgs/RegionOfInterest roi",
    more=f"{RULE}\nMSG: sensor_msgs/RegionOfInterest\nuint32 x_offset\nuint32 y_offset\nuint32 height\nuint32 width\n"
    "bool do_rectify\n",
)
DETECTIONS = HEADER.format(
    body="apriltag_msgs/AprilTagDetection[] detections",
    more=f"{RULE}\nMSG: apriltag_msgs/AprilTagDetection\nstring family\nint32 id\nint32 hamming\nfloat32 goodness\n"
    "float32 decision_margin\napriltag_msgs/Point centre\napriltag_msgs/Point[4] corners\nfloat64[9] homography\n"
    f"{RULE}\nMSG: apriltag_msgs/Point\nfloat64 x\nfloat64 y\n",
)
KINDS = {
    "sensor_msgs/msg/Image": IMAGE,
    "sensor_msgs/msg/CompressedImage": COMPRESSED,
    "sensor_msgs/msg/CameraInfo": CAMERA_INFO,
    "apriltag_msgs/msg/AprilTagDetectionArray": DETECTIONS,
}
SMALL = Camera(2.0, 0.01, 0.01, (8.0, 6.0), 16, 12, 0.0)
GREY = np.random.default_rng(0).integers(0, 256, (12, 16), dtype=np.uint8)
FIRST = 1_700_000_000  # seconds at which bags begin


def header(nanoseconds):
    """Header of a message that many nanoseconds after the beginning."""
    return {"stamp": {"sec": FIRST + nanoseconds // 10**9, "nanosec": nanoseconds % 10**9}, "frame_id": "camera"}


def write(path, messages):
    """Write messages (topic, type, nanoseconds, values)."""
    with path.open("wb") as file:
        writer, schemas = Writer(file), {}
        for topic, kind, nanoseconds, values in messages:
            schemas.setdefault(kind, writer.register_msgdef(kind, KINDS[kind]) if kind not in schemas else None)
            at = FIRST * 10**9 + nanoseconds
            writer.write_message(topic, schemas[kind], {"header": header(nanoseconds), **values}, at, at)
        writer.finish()
    return path


def bag_of(path, values, kind=bags.IMAGE, count=1, topic="/image"):
    """Write a bag with the same message each tenth of a second."""
    return write(path, [(topic, kind, k * 10**8, values) for k in range(count)])


def images(path, **more):
    """Images of a bag by topic."""
    return images_in(path, **{"topic": None, "rate": 5.0, "argument": "photographs", "count": 1, **more})


def only(path, **more):
    """Images of a bag with one topic."""
    (found,) = images(path, **more).values()
    return found


def image(grey, encoding="mono8", padding=0):
    """Values of an Image with a grey or coloured picture, `(h, w)` or `(h, w, c)`."""
    rows = grey.reshape(len(grey), -1)
    rows = [bytes(row) + b"\xff" * padding for row in rows]
    size = {"height": len(grey), "width": grey.shape[1], "encoding": encoding, "is_bigendian": 0}
    return {**size, "step": len(rows[0]), "data": b"".join(rows)}


def camera_info(camera):
    """Values of a CameraInfo."""
    (f, g), (u, v) = camera.focal_pixels.tolist(), camera.principal_point
    matrix = [f, 0.0, u - 0.5, 0.0, g, v - 0.5, 0.0, 0.0, 1.0]
    lens = {"distortion_model": "plumb_bob", "d": [*camera.distortion] or [0.0] * 5}
    rest = {"r": [1.0, 0, 0, 0, 1, 0, 0, 0, 1], "p": [0.0] * 12, "binning_x": 0, "binning_y": 0}
    roi = {"x_offset": 0, "y_offset": 0, "height": 0, "width": 0, "do_rectify": False}
    return {
        "height": int(camera.image_height),
        "width": int(camera.image_width),
        "k": matrix,
        **lens,
        **rest,
        "roi": roi,
    }


def tags(ids, corners):
    """Values of an AprilTagDetectionArray, as the library numbers corners: from the bottom left, counter-clockwise."""
    return {
        "detections": [
            {
                "family": "tag36h11", "id": int(number), "hamming": 0, "goodness": 0.0, "decision_margin": 60.0,
                "centre": dict(zip("xy", four.mean(axis=0).tolist(), strict=True)),
                "corners": [dict(zip("xy", corner.tolist(), strict=True)) for corner in four[[3, 2, 1, 0]]],
                "homography": [0.0] * 9,
            }
            for number, four in zip(ids, corners, strict=True)
        ]
    }  # fmt: skip
