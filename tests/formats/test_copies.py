import numpy as np
import pytest

from lmd.formats.detections import DetectedTags, without_copies

SQUARE = np.array([[10.0, 20.0], [30.0, 20.0], [30.0, 40.0], [10.0, 40.0]])


def seen(*rows, cameras=("",)):
    """Detections from frame, camera, id and what is added to the corners."""
    frame, camera, ids, away = zip(*rows, strict=True)
    corners = SQUARE + np.array(away)[:, None, None]
    times = tuple(f"{k}.png" for k in range(max(frame) + 1))
    return DetectedTags(times, cameras, np.array(frame), np.array(camera), np.array(ids), corners)


@pytest.mark.parametrize(("away", "is_copy"), [(0.0, True), (0.009, True), (-0.009, True), (0.011, False)])
def test_an_image_counts_once(away, is_copy):
    found = without_copies(seen((0, 0, 7, 0.0), (0, 0, 3, 1.0), (1, 0, 3, 1.0 + away), (1, 0, 7, 0.0)))
    assert found.copies == ({"1.png": "0.png"} if is_copy else {})
    assert found.ids.tolist() == ([7, 3] if is_copy else [7, 3, 3, 7])
    assert found.frame.tolist() == ([0, 0] if is_copy else [0, 0, 1, 1])


def test_images_with_other_tags_are_no_copies():
    one_more = seen((0, 0, 7, 0.0), (1, 0, 7, 0.0), (1, 0, 8, 50.0), (2, 0, 9, 0.0), (3, 0, 7, 0.0), (3, 0, 7, 50.0))
    assert len(without_copies(one_more)) == len(one_more)


def test_a_tag_may_be_there_twice_in_any_order():
    found = without_copies(seen((0, 0, 7, 0.0), (0, 0, 7, 50.0), (1, 0, 7, 50.0), (1, 0, 7, 0.0)))
    assert found.copies == {"1.png": "0.png"}


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
