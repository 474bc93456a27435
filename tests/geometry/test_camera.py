import dataclasses
import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.paper import paper_camera, printed_experiment_camera
from support.strategies import cameras, visibilities
from support.tables import refusals

from lmd.geometry.projection import blur_disc
from lmd.scene.criteria import TOLERANCE
from lmd.sight.models.paper import Visibility


@pytest.mark.parametrize(
    ("camera", "degrees", "near", "far"),
    [
        (paper_camera(), 34.84, 0.9755, 10.03),
        (printed_experiment_camera(), 4.25, 15.6, math.inf),
        (printed_experiment_camera(focal_length=4.03, aperture=1.44), 23.9, 0.44, math.inf),
    ],
)
def test_view_and_depth_of_field_are_those_of_the_papers_cameras(camera, degrees, near, far):
    assert math.degrees(camera.cone_half_angle) == pytest.approx(degrees, abs=0.06)
    assert camera.depth_of_field(4.0) == pytest.approx((near, far), rel=4e-3)


def test_simulation_camera_resolves_0_28_pixel_per_mm_to_3_09_metres():
    assert paper_camera().resolution_depth(0.28) == pytest.approx(3.09, abs=5e-3)


def test_resolution_at_one_metre_is_the_printed_formula():
    assert paper_camera().resolution_at_one_metre == pytest.approx(5 * 1778 / ((1778 - 5) * 1000 * 0.0058))


def test_off_centre_principal_point_gives_four_angles():
    view = paper_camera(principal_point=(300.0, 1000.0)).field_of_view
    assert [math.tan(angle) for angle in view] == pytest.approx([0.348, 1.508, 1.16, 0.232])


@pytest.mark.parametrize(
    ("point", "border"), [((100, 600), "left"), ((1500, 600), "right"), ((800, 90), "top"), ((800, 1110), "bottom")]
)
def test_the_nearest_border_bounds_the_cone(point, border):
    camera = paper_camera(principal_point=point)
    assert camera.cone_half_angle == getattr(camera.field_of_view, border)
    assert camera.cone_half_angle < paper_camera().cone_half_angle


def test_square_pixels_are_not_assumed():
    camera = paper_camera(pixel_width=0.004, pixel_height=0.008)
    assert math.tan(camera.field_of_view.left) == pytest.approx(0.64)
    assert math.tan(camera.field_of_view.top) == pytest.approx(0.96)
    assert camera.resolution_at_one_metre == pytest.approx(camera.image_distance / 8.0)
    near, _ = camera.depth_of_field(4.0)
    assert near == pytest.approx(10 * 1.778 * 5 / (50 + 0.016 * 1773))


@pytest.mark.parametrize("beyond", [-1e-3, 0.0, 1e-6, 1000.0])
def test_far_limit_is_infinite_from_the_hyperfocal_distance_on(beyond):
    camera = paper_camera(pixel_width=0.0625, pixel_height=0.0625, focus_distance=205.0 + beyond)
    near, far = camera.depth_of_field(4.0)
    assert 0.0 < near < far
    assert (far == math.inf) == (beyond >= 0.0)


def test_focus_at_infinity_is_the_limit_of_far_focus():
    at_infinity, far_away = paper_camera(focus_distance=math.inf), paper_camera(focus_distance=1e12)
    assert at_infinity.depth_of_field(4.0) == (pytest.approx(10 * 5 / (4 * 0.0058) / 1000), math.inf)
    assert at_infinity.depth_of_field(4.0)[0] == pytest.approx(far_away.depth_of_field(4.0)[0])
    assert at_infinity.resolution_at_one_metre == pytest.approx(5 / 5.8)
    assert at_infinity.resolution_at_one_metre == pytest.approx(far_away.resolution_at_one_metre)


@given(cameras(), visibilities())
def test_max_depth_is_the_last_double_that_passes(camera, visibility):
    limit, far = visibility.sight(camera).max_depth, camera.depth_of_field(visibility.circle_of_confusion)[1]

    def passes(depth):
        resolved = camera.resolution_at_one_metre / depth >= visibility.thold * (1.0 - TOLERANCE)
        return resolved and depth <= far * (1.0 + TOLERANCE)

    assert passes(limit)
    assert not passes(math.nextafter(limit, math.inf))


@given(cameras(), visibilities())
def test_limits_hold_the_nominal_bounds_with_one_tolerance(camera, visibility):
    limits = visibility.sight(camera)
    near, far = camera.depth_of_field(visibility.circle_of_confusion)
    assert limits.min_depth == near * (1.0 - TOLERANCE)
    assert limits.min_cosine == math.cos(camera.cone_half_angle) - TOLERANCE
    assert limits.max_depth == pytest.approx(min(camera.resolution_depth(visibility.thold), far), rel=3e-9)


@given(cameras(), st.floats(0.1, 20.0))
def test_near_limit_lies_before_the_focus_and_far_limit_behind_it(camera, confusion):
    near, far = camera.depth_of_field(confusion)
    assert near * 1000.0 <= camera.focus_distance * (1 + 1e-12)
    assert far * 1000.0 >= camera.focus_distance * (1 - 1e-12)


@pytest.mark.parametrize("focus", [1778.0, math.inf])
def test_a_pinhole_is_sharp_at_any_depth(focus):
    camera = paper_camera(aperture=0, focus_distance=focus)
    assert camera.is_pinhole
    assert camera.depth_of_field(4.0) == (0.0, math.inf)
    assert blur_disc(camera, [0.01, 1.0, 100.0]).tolist() == [0.0, 0.0, 0.0]
    assert Visibility(thold=0.28).limits_for(camera)["focus"] == "any depth ahead: no aperture"


def test_numbers_may_be_integers():
    assert paper_camera(focal_length=5, focus_distance=1778) == paper_camera()
    assert all(
        isinstance(value, float | tuple | str) for value in dataclasses.asdict(paper_camera(aperture=10)).values()
    )


def test_a_lens_that_distorts_shows_more_or_less():
    plain = paper_camera()
    assert plain.widest_angle == pytest.approx(math.atan(1.16))  # 1000 pixels at 862.07 a unit
    assert plain == paper_camera(distortion=[0.0] * 5)
    assert paper_camera(distortion=(-0.1, 0.01, 0.0, 0.0)).widest_angle > plain.widest_angle
    assert paper_camera(distortion=(0.1, 0.01, 0.0, 0.0)).widest_angle < plain.widest_angle


def test_a_lens_that_folds_before_the_corners_shows_what_is_within():
    # r (1 - 0.3 r^2) is largest at r = 1 / sqrt(0.9), where it is 0.703: beyond the upper and the lower border.
    camera = paper_camera(distortion=(-0.3, 0.0, 0.0, 0.0))
    fold = math.atan(1.0 / math.sqrt(0.9))
    assert camera.widest_angle == pytest.approx(fold)
    left, _, top, _ = camera.field_of_view
    assert left == camera.widest_angle > top
    assert math.tan(top) * (1.0 - 0.3 * math.tan(top) ** 2) == pytest.approx(600 / 862.07, abs=1e-6)


def test_a_fisheye_sees_no_farther_than_its_round_image():
    # 344.8 pixels a radian, and 600 pixels to the upper and the lower border.
    lens = {"distortion": [0.0] * 4, "distortion_model": "equidistant", "pixel_width": 0.0145, "pixel_height": 0.0145}
    camera = paper_camera(**lens, image_circle=1300.0)
    assert camera.widest_angle == pytest.approx(650 / 344.83, abs=1e-4)
    np.testing.assert_allclose(camera.field_of_view, [650 / 344.83] * 2 + [1.74] * 2, atol=1e-4)
    assert paper_camera(**lens, image_circle=5000.0).widest_angle == paper_camera(**lens).widest_angle


def test_a_fisheye_sees_what_is_behind_it():
    # 5 mm / 0.0058 mm make 862 pixels a radian; 0.0145 mm make 344.8, and 1000 pixels to the corner 166 degrees.
    camera = paper_camera(pixel_width=0.0145, pixel_height=0.0145, distortion=[0.0] * 4, distortion_model="equidistant")
    assert camera.distortion == (0.0,) * 4
    assert camera.widest_angle == pytest.approx(2.9)
    np.testing.assert_allclose(camera.field_of_view, [2.32, 2.32, 1.74, 1.74])
    assert camera.cone_half_angle == pytest.approx(math.radians(89.0))


CALLS = {"a camera": paper_camera, "the paper's visibility": lambda thold=0.28, **more: Visibility(thold, **more)}
test_what_cannot_be_is_refused_in_one_sentence = refusals(__file__, **CALLS)
