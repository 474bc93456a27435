import json

import numpy as np
import pyapriltags
import pytest
from detection_samples import LIMELIGHT, PHOTON, VMM

from lmd.core.checks import InputError
from lmd.detection.detectors import AprilTagDetector, Detections
from lmd.formats.detection_formats import read_detections, write_detections
from lmd.formats.detections import DetectedTags
from lmd.scene.tag import Tag

HEADER = "topic,stamp,id,hamming,x0,y0,x1,y1,x2,y2,x3,y3\n"
SQUARE = "10,20,30,20,30,40,10,40"
TURNED = "10,40,30,40,30,20,10,20"


def written(tmp_path, text):
    path = tmp_path / "detections.csv"
    path.write_text(text)
    return path


def test_frames_are_told_apart_by_what_is_written(tmp_path):
    """The two stamps are the same number in double precision."""
    rows = (
        ("left", "1527206460.042570304", 7),
        ("right", "1527206460.042570304", 8),
        ("left", "1527206460.042570305", 7),
    )
    text = HEADER + "".join(f"{topic},{stamp},{number},0,{SQUARE}\n" for topic, stamp, number in rows)
    found = read_detections(written(tmp_path, text))
    assert found.cameras == ("left", "right")
    assert len(found.times) == 2
    assert found.frame.tolist() == [0, 0, 1]
    assert found.camera.tolist() == [0, 1, 0]
    assert found.ids.tolist() == [7, 8, 7]


def test_a_number_is_one_time_however_it_is_written(tmp_path):
    rows = "".join(f"{stamp},3,{SQUARE}\n" for stamp in ("9.5", "9.50", "1e1", "10", "nan", "a.png"))
    found = read_detections(written(tmp_path, f"time,id,x0,y0,x1,y1,x2,y2,x3,y3\n{rows}"))
    assert found.times == ("9.5", "1e1", "a.png", "nan")
    assert found.frame.tolist() == [0, 0, 1, 1, 3, 2]


@pytest.mark.parametrize("column", ["family", "tag_family", "dictionary"])
def test_the_family_is_that_of_the_file_by_any_of_its_names(tmp_path, column):
    head, row = f"time,{column},id,x0,y0,x1,y1,x2,y2,x3,y3\n", f",3,{SQUARE}\n"
    found = read_detections(written(tmp_path, f"{head}0,tag16h5{row}1,16h5{row}2,{row}"))
    assert found.family == "16h5"
    write_detections(tmp_path / "again.csv", found)
    assert read_detections(tmp_path / "again.csv").family == "16h5"
    with pytest.raises(InputError, match=r"detections: '.*' its tags are of the families 16h5 and 36h11, which"):
        read_detections(written(tmp_path, f"{head}0,tag16h5{row}1,tag36h11{row}"))


def test_pixels_are_counted_from_the_border(tmp_path):
    found = read_detections(written(tmp_path, f"time,id,x0,y0,x1,y1,x2,y2,x3,y3\n0.5,3,{SQUARE}\n"))
    np.testing.assert_array_equal(found.corners[0], [[10.5, 20.5], [30.5, 20.5], [30.5, 40.5], [10.5, 40.5]])
    assert found.cameras == ("",)


def test_frames_may_be_called_by_their_images(tmp_path):
    found = read_detections(
        written(tmp_path, f"image,id,x0,y0,x1,y1,x2,y2,x3,y3\nb.png,3,{SQUARE}\na.png,3,{SQUARE}\n")
    )
    assert found.times == ("a.png", "b.png")


def test_a_mirrored_detection_is_left_out(tmp_path):
    body = f"0,3,{SQUARE}\n0,4,{TURNED}\n0,5,{SQUARE}\n"
    assert read_detections(written(tmp_path, "time,id,x0,y0,x1,y1,x2,y2,x3,y3\n" + body)).ids.tolist() == [3, 5]


def test_corners_in_the_order_of_the_apriltag_library_are_put_in_order(tmp_path):
    """It begins at the bottom left and goes round counter-clockwise; the pixels are OpenCV's, as of all detections."""
    found = read_detections(written(tmp_path, f"time,id,x0,y0,x1,y1,x2,y2,x3,y3\n0,3,{TURNED}\n"))
    np.testing.assert_array_equal(found.corners[0], [[10.5, 20.5], [30.5, 20.5], [30.5, 40.5], [10.5, 40.5]])


def test_corners_of_the_apriltag_library_less_half_a_pixel_are_read_as_its_detector_finds_them(tmp_path):
    """It counts pixels from the border of the image, which a file of detections does not."""
    image = np.pad(np.kron(Tag(0.1).picture(3), np.full((6, 6), 255, dtype=np.uint8)), 12, constant_values=255)
    said = pyapriltags.Detector(families="tag36h11", nthreads=1, quad_decimate=1.0).detect(image)[0].corners
    row = ",".join(map(str, (said - 0.5).ravel()))
    found = read_detections(written(tmp_path, f"time,id,x0,y0,x1,y1,x2,y2,x3,y3\n0,3,{row}\n"))
    first, last = 12, len(image) - 12
    np.testing.assert_allclose(
        found.corners[0], [[first, first], [last, first], [last, last], [first, last]], atol=0.01
    )
    np.testing.assert_allclose(found.corners, AprilTagDetector().detect(image).corners, atol=1e-12)


@pytest.mark.parametrize("cameras", [("",), ("left", "right")])
def test_what_is_written_is_read_again(tmp_path, cameras):
    corners = np.array([[10.0, 20.0], [30.5, 20.0], [30.0, 40.25], [10.0, 40.0]]) + np.arange(3)[:, None, None]
    index = np.array([0, 0, 1]), np.array([0, len(cameras) - 1, 0])
    detected = DetectedTags(("b.png", "c.png"), cameras, *index, np.array([7, 8, 7]), corners)
    write_detections(tmp_path / "seen.csv", detected)
    again = read_detections(tmp_path / "seen.csv")
    assert (again.times, again.cameras) == (detected.times, detected.cameras)
    for name in ("frame", "camera", "ids", "corners"):
        np.testing.assert_array_equal(getattr(again, name), getattr(detected, name))


def test_frames_of_a_detector_keep_their_places():
    """Also those in which it found nothing; a video may end before all that were named are read."""
    some = Detections(np.array([3, 5]), np.zeros((2, 4, 2)))
    nothing = Detections(np.empty(0, dtype=np.int64), np.empty((0, 4, 2)))
    found = DetectedTags.in_frames(
        ["a", "b", "c", "d"], [some.ids, nothing.ids, some.ids], [some.corners, nothing.corners, some.corners]
    )
    assert found.times == ("a", "b", "c")
    assert found.frame.tolist() == [0, 0, 2, 2]
    assert found.ids.tolist() == [3, 5, 3, 5]


ACROSS = np.array([[10.0, 10.0], [20.0, 10.0], [20.0, 20.0], [10.0, 20.0]])  # clockwise from the top left


@pytest.mark.parametrize(
    ("keys", "offset", "times"),
    [
        (PHOTON, 0.0, ("0.325917", "0.325918")),  # AprilTag 3 counts from the border
        (LIMELIGHT, 0.0, ("1.3255",)),
        (LIMELIGHT["Results"] | {"ts_us": 1325501}, 0.0, ("1.325501",)),
        (VMM, 0.5, ("DSC1.JPG",)),  # cv2.cornerSubPix counts from the centre of the first pixel
    ],
)
def test_json_of_other_programs(keys, offset, times, tmp_path):
    found = read_detections(written(tmp_path, json.dumps(keys)))
    assert (found.times, found.ids.tolist(), found.cameras) == (times, [18] * len(times), ("",))
    assert found.family == (None if keys is PHOTON else "36h11")
    shift = np.arange(len(times))[:, None, None] * [1.0, 0.0]
    np.testing.assert_allclose(found.corners, ACROSS + offset + shift)


def test_results_may_be_lines_and_have_cameras(tmp_path):
    lines = "".join(json.dumps(result) + "\n" for result in PHOTON)
    whole = read_detections(written(tmp_path, json.dumps(PHOTON)))
    assert read_detections(written(tmp_path, lines)).times == whole.times
    found = read_detections(written(tmp_path, json.dumps({"left": PHOTON, "right": PHOTON[:1]})))
    assert (found.cameras, found.camera.tolist()) == (("left", "right"), [0, 0, 1])
