"""Limits that are fitted to a recording: halves of time, image circles, the margin, and misses without a cause."""

from dataclasses import replace

import numpy as np
import pytest

from lmd.core.checks import InputError
from lmd.core.tables import write_table
from lmd.detection.calibration import DetectorCalibration, fit, predicted_views
from lmd.detection.tag_views import COLUMNS, FILE, Placed, SurveyedViews, TagViews
from lmd.geometry.camera import Camera
from lmd.render.imaging import Imaging
from lmd.sight.models.limits import Limits

COUNT, MOMENTS, TRUE = 6000, 400, Limits(pitch=2.0, blur=0.0, edge=0.0, incidence=62.0, margin=25.0)
CIRCLES = (900.0, 700.0)  # of two cameras
PINHOLE = Camera(3.5, 0.0075, 0.0075, (640.0, 512.0), 1280, 1024, 0.0)
FISHEYE = replace(PINHOLE, distortion=(0.0, 0.0, 0.0, 0.0), distortion_model="equidistant")


def recording(rng, circles=CIRCLES):
    """TagViews of two cameras, evenly over all that matters, found within the true limits and circles."""
    pitch, incidence, border, circle = rng.uniform([0.5, 0.0, 0.0, 200.0], [6.0, 1.5, 200.0, 1400.0], (COUNT, 4)).T
    camera, moment = rng.integers(0, 2, COUNT), rng.integers(0, MOMENTS, COUNT)
    views = TagViews(pitch, incidence, 8.0 * pitch, np.full(COUNT, 0.5), np.zeros(COUNT, dtype=bool), np.zeros(COUNT),
                  Placed(camera, moment, border, circle))  # fmt: skip
    return replace(views, seen=predicted_views(views, TRUE, circles))


def check(limits):
    assert np.hypot(limits.pitch, limits.blur * 0.5) == pytest.approx(TRUE.pitch, abs=0.1)
    assert limits.incidence == pytest.approx(TRUE.incidence, abs=1.0)
    assert limits.margin == pytest.approx(TRUE.margin, abs=5.0)


def test_margin_and_image_circles_are_found():
    rng = np.random.default_rng(0)
    views = recording(rng)
    found = fit(views, rng, margin=3.0)
    check(found.limits)
    assert found.circles == pytest.approx(CIRCLES, abs=15.0)
    assert found.known_circles == dict(enumerate(found.circles, 1))
    assert min(found.accuracy, found.precision, found.recall) > 0.97
    text = DetectorCalibration(views, found, {}, MOMENTS).preset("apriltag", "36h11", "survey")
    ends = " pixels of camera 1, ".join(f"{diameter:.0f}" for diameter in found.circles)
    assert f"# Fitted with them: image_circle {ends} pixels of camera 2." in text
    assert f"# Fitted to the first half, in time, of {COUNT} views;" in text


def test_a_camera_whose_image_goes_on_has_no_circle():
    rng = np.random.default_rng(1)
    found = fit(recording(rng, (np.inf, 700.0)), rng, margin=0.0)
    assert found.circles[0] == np.inf
    assert list(found.known_circles) == [2]


def test_misses_that_no_limit_knows_do_not_move_the_limits():
    """A sixth of what is within all limits is hidden, for a twentieth of the time each."""
    rng = np.random.default_rng(2)
    views = recording(rng)
    assert views.placed is not None
    hidden = (views.placed.moment // (MOMENTS // 20) + rng.integers(0, 6, COUNT)) % 6 == 0
    found = fit(replace(views, seen=views.seen & ~hidden), rng, margin=0.0)
    check(found.limits)
    assert found.circles == pytest.approx(CIRCLES, abs=15.0)
    assert found.recall > 0.97
    assert found.precision == pytest.approx(5 / 6, abs=0.03)


def test_the_first_half_in_time_is_fitted_and_the_second_one_judged():
    rng = np.random.default_rng(3)
    views = recording(rng)
    assert views.placed is not None
    late = views.placed.moment >= MOMENTS // 2
    changed = replace(views, seen=np.where(late, views.incidence > 1.0, views.seen))
    found = fit(changed, rng, margin=0.0)
    check(found.limits)
    predicted = predicted_views(changed, found.limits, found.circles)
    assert found.accuracy == (predicted == changed.seen)[late].mean()
    with pytest.raises(InputError, match=r"^views must be of images taken at two or more different times, but all"):
        fit(views[views.placed.moment == 0], rng, margin=0.0)


def test_a_survey_tells_where_and_when(tmp_path):
    """Times are in the order of their numbers, and a pinhole has no image circle."""
    values = {name: [1.0, 1.0, 1.0] for name in COLUMNS}
    values |= {"border": [5.0, 6.0, 7.0], "circle": [800.0, 900.0, 1000.0]}
    write_table(tmp_path / FILE, {"time": ["10.5", "9.5", "9.50"], "camera": [1, 2, 1], **values})
    views = SurveyedViews(str(tmp_path)).views([FISHEYE, PINHOLE], None, None, Imaging(), np.random.default_rng(0))
    placed = views.placed
    assert placed is not None
    assert placed.camera.tolist() == [0, 1, 0]
    assert placed.moment[0] > placed.moment[1:].max()
    assert placed.border.tolist() == [5.0, 6.0, 7.0]
    np.testing.assert_array_equal(placed.circle, [800.0, np.nan, 1000.0])
