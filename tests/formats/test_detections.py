"""Detections: frames, corners, lists of images, and copies of images; `test_table_files.py` has their files."""

from dataclasses import replace

import numpy as np
import pyapriltags
import pytest

from lmd.core.checks import InputError
from lmd.detection.detectors import AprilTagDetector, Detections
from lmd.formats.detection_formats import read_detections, with_images, write_detections
from lmd.formats.detections import DetectedTags, without_copies
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
    rows = (("left", 4, 7), ("right", 4, 8), ("left", 5, 7))
    text = HEADER + "".join(f"{topic},1527206460.04257030{end},{number},0,{SQUARE}\n" for topic, end, number in rows)
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


def test_a_mirrored_detection_is_left_out(tmp_path):
    body = f"0,3,{SQUARE}\n0,4,{TURNED}\n0,5,{SQUARE}\n"
    assert read_detections(written(tmp_path, "time,id,x0,y0,x1,y1,x2,y2,x3,y3\n" + body)).ids.tolist() == [3, 5]


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
    found = in_frames(["a", "b", "c", "d"], [some, nothing, some])
    assert found.times == ("a", "b", "c")
    assert found.frame.tolist() == [0, 0, 2, 2]
    assert found.ids.tolist() == [3, 5, 3, 5]


TAG = np.array([[0.0, 0.0], [9.0, 0.0], [9.0, 9.0], [0.0, 9.0]])


def of_two(*rows):
    """Detections of two cameras at three times, each elsewhere, of tag 3."""
    found = seen(*((*row, 3, 1.0 * k) for k, row in enumerate(rows)), cameras=("left", "right"))
    return replace(found, times=("1.0", "2.0", "3.0"))


def listed(path, *lines, head="topic,stamp,tags"):
    path.write_text("\n".join([head, *lines]) + "\n")
    return path


def test_images_that_are_not_listed_were_not_taken(tmp_path):
    """Equal numbers are one time, other cameras are ignored; an image without a tag is a frame."""
    file = listed(tmp_path / "frames.csv", "left,1,1", "right,1.00,0", "left,2.0,1", "left,3.0,0", "right,3,1",
                  "left,9,0", "rear,2.0,0")  # fmt: skip
    found = with_images(of_two((0, 0), (1, 0), (2, 1)), file)
    assert found.taken is not None
    assert found.times == ("1.0", "2.0", "3.0", "9")
    assert found.images.tolist() == [[True, True], [True, False], [True, True], [True, False]]
    assert of_two((0, 0)).images.all()


def test_one_camera_needs_no_name(tmp_path):
    one = DetectedTags(("a.png", "b.png"), ("",), np.array([1]), np.array([0]), np.array([3]), TAG[None])
    found = with_images(one, listed(tmp_path / "frames.csv", "b.png", head="image"))
    assert found.images.tolist() == [[False], [True]]


@pytest.mark.parametrize(
    ("lines", "head", "message"),
    [
        (["left,1.0,1"], "topic,when,tags", r"' has no column time or stamp or timestamp or image\.$"),
        (["1.0,1"], "stamp,tags", r"' has no column camera or topic or .*, but the detections are of 2 cameras\.$"),
        (["left,1.0,1"], "topic,stamp,tags", r"' lacks the image of right at 3\.0, in which a tag was detected\.$"),
    ],
)
def test_a_file_that_lacks_something_is_refused(lines, head, message, tmp_path):
    with pytest.raises(InputError, match="^images: '.*frames.csv" + message):
        with_images(of_two((0, 0), (2, 1)), listed(tmp_path / "frames.csv", *lines, head=head))


def test_photographs_say_which_there_are():
    """The right camera begins later, and its last photograph is blurred."""
    found = [Detections(np.array([3]), TAG[None] + k) for k in range(3)]
    left = in_frames(("1", "2", "3"), found)
    right = in_frames(("2", "3"), found[:2]).without({"3": 4.0})
    both = DetectedTags.together({"left": left, "right": right})
    assert both.images.tolist() == [[True, False], [True, True], [True, False]]


def test_a_copy_counts_as_no_image():
    """The left camera stands still at the second time: its image is that of the first."""
    both = of_two((0, 0), (0, 1), (1, 0), (1, 1))
    same = both.corners.copy()
    same[2] = same[0]
    found = without_copies(DetectedTags(both.times, both.cameras, both.frame, both.camera, both.ids, same))
    assert len(found) == 3
    assert found.images.tolist() == [[True, True], [False, True], [True, True]]


def in_frames(names, found):
    return DetectedTags.in_frames(names, [one.ids for one in found], [one.corners for one in found])


def seen(*rows, cameras=("",)):
    """Detections from frame, camera, id and what is added to the corners."""
    frame, camera, ids, away = zip(*rows, strict=True)
    corners = TAG + np.array(away)[:, None, None]
    times = tuple(f"{k}.png" for k in range(max(frame) + 1))
    return DetectedTags(times, cameras, np.array(frame), np.array(camera), np.array(ids), corners)


@pytest.mark.parametrize(
    ("rows", "copied"),
    [
        *(([(0, 0, 7, 0), (0, 0, 3, 1), (1, 0, 3, 1 + away), (1, 0, 7, 0)], {1}) for away in (0.0, 0.009, -0.009)),
        ([(0, 0, 7, 0), (0, 0, 3, 1), (1, 0, 3, 1.011), (1, 0, 7, 0)], set()),
        ([(0, 0, 7, 0), (0, 0, 7, 50), (1, 0, 7, 50), (1, 0, 7, 0)], {1}),  # a tag twice, in any order
        ([(0, 0, 7, 0), (1, 0, 7, 0), (1, 0, 8, 50), (2, 0, 9, 0), (3, 0, 7, 0), (3, 0, 7, 50)], set()),
    ],
)
def test_an_image_counts_once(rows, copied):
    found = without_copies(seen(*rows))
    assert found.copies == {f"{frame}.png": "0.png" for frame in copied}
    assert found.ids.tolist() == [number for frame, _, number, _ in rows if frame not in copied]
    assert set(found.frame.tolist()) == {frame for frame, *_ in rows} - copied


def test_equal_views_of_several_cameras_stay():
    both = seen((0, 0, 7, 0.0), (0, 1, 7, 0.0), (1, 0, 7, 0.0), (1, 1, 7, 5.0), cameras=("left", "right"))
    found = without_copies(both)
    assert found.copies == {"left/1.png": "left/0.png"}
    assert list(zip(found.frame.tolist(), found.camera.tolist(), strict=True)) == [(0, 0), (0, 1), (1, 1)]


def test_many_images_that_drift_are_compared_with_those_that_count():
    """Each is a copy of the one before, but not of the first."""
    found = without_copies(seen(*((k, 0, 7, 0.006 * k) for k in range(100))))
    assert np.unique(found.frame).tolist() == list(range(0, 100, 2))
    assert found.copies["1.png"] == "0.png"
