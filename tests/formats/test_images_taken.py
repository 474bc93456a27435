"""The list of images includes those that show no tag."""

import numpy as np
import pytest

from lmd.core.checks import InputError
from lmd.detection.detectors import Detections
from lmd.formats.detection_formats import with_images
from lmd.formats.detections import DetectedTags, without_copies

SQUARE = np.array([[0.0, 0.0], [9.0, 0.0], [9.0, 9.0], [0.0, 9.0]])


def of_two(*rows):
    """Detections (frame, camera) of tag 3 at the times 1.0 to 3.0, each elsewhere."""
    frame, camera = np.array(rows).T
    corners = SQUARE + np.arange(len(rows))[:, None, None]
    return DetectedTags(("1.0", "2.0", "3.0"), ("left", "right"), frame, camera, np.full(len(rows), 3), corners)


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
    one = DetectedTags(("a.png", "b.png"), ("",), np.array([1]), np.array([0]), np.array([3]), SQUARE[None])
    found = with_images(one, listed(tmp_path / "frames.csv", "b.png", head="image"))
    assert found.images.tolist() == [[False], [True]]


@pytest.mark.parametrize(
    ("lines", "head", "message"),
    [
        (["left,1.0,1"], "topic,when,tags", r"' has no column time or stamp or timestamp or image\.$"),
        (["1.0,1"], "stamp,tags", r"' has no column camera or topic or .*, and detections are of 2 cameras\.$"),
        (["left,1.0,1"], "topic,stamp,tags", r"' lacks the image of right at 3\.0, in which a tag was detected\.$"),
    ],
)
def test_a_file_that_lacks_something_is_refused(lines, head, message, tmp_path):
    with pytest.raises(InputError, match="^images: '.*frames.csv" + message):
        with_images(of_two((0, 0), (2, 1)), listed(tmp_path / "frames.csv", *lines, head=head))


def test_photographs_say_which_there_are():
    """The right camera begins later, and its last photograph is blurred."""
    found = [Detections(np.array([3]), SQUARE[None] + k) for k in range(3)]
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
