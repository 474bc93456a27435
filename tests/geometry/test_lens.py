"""Lenses against OpenCV, and what is bounded of them against directions drawn all over the image."""

import math

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.strategies import lenses

from lmd.geometry.lens import Lens, approximation, ceiling, lens_of

FOCAL, FAR = 600.0, 3.0  # pixels, and focal lengths from the centre: farther out is no image
NOTHING = np.zeros(3)


def directions(widest, size=40):
    """Unit vectors up to an angle from the axis, on its edge too, `(size^2, 3)`."""
    theta, phi = (
        part.ravel() for part in np.meshgrid(np.linspace(0.0, widest, size), np.linspace(-np.pi, np.pi, size))
    )
    return np.stack([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)], axis=-1)


def by_opencv(lens, points):
    numbers, rays = np.array(lens.coefficients), points[:, None]
    project = cv2.fisheye.projectPoints if lens.model == "equidistant" else cv2.projectPoints
    return project(rays, NOTHING, NOTHING, np.diag([FOCAL, FOCAL, 1.0]), numbers)[0][:, 0]


@given(lenses(), st.floats(0.1, 10.0))
def test_points_are_imaged_as_by_opencv(lens, far):
    points = far * directions(min(lens.fold, math.radians(89.0)))
    image = FOCAL * lens.project(points)
    inside = np.linalg.norm(image, axis=1) < FAR * FOCAL
    np.testing.assert_allclose(image[inside], by_opencv(lens, points)[inside], atol=1e-9)


@given(lenses())
def test_a_direction_is_found_from_its_image(lens):
    unit = directions(0.999 * lens.fold)
    image = lens.project(unit)
    inside = np.linalg.norm(image, axis=1) < FAR
    np.testing.assert_allclose(lens.directions(image[inside]), unit[inside], atol=1e-7)


@given(lenses(), st.floats(0.5, 2.0))
def test_the_jacobian_is_the_slope(lens, far):
    points, step = far * directions(0.9 * min(lens.widest(FAR), lens.fold)), 1e-6
    moved = [(lens.project(points + way) - lens.project(points - way)) / (2.0 * step) for way in step * np.eye(3)]
    np.testing.assert_allclose(lens.jacobian(points), np.stack(moved, axis=-1), rtol=1e-5, atol=1e-5)


@given(lenses(), st.floats(0.05, 1.5))
def test_what_is_imaged_in_a_circle_is_within_the_widest_angle_and_stretched_within_its_bounds(lens, reach):
    widest = lens.widest(reach)
    if widest < lens.fold:
        beyond = directions(lens.fold)
        beyond = beyond[np.arccos(np.clip(beyond[:, 2], -1.0, 1.0)) > widest * (1.0 + 1e-9)]
        assert (np.linalg.norm(lens.project(beyond), axis=1) >= reach * (1.0 - 1e-9)).all()
    bounds, within = lens.stretch(widest), directions(widest)
    stretches = np.linalg.svd(lens.jacobian(within), compute_uv=False)
    for least, values, most in (
        (bounds.least, stretches, bounds.most),
        (bounds.least_area, stretches.prod(axis=1), bounds.most_area),
    ):
        assert least <= values.min() * (1.0 + 1e-9) + 1e-9
        assert values.max() <= most * (1.0 + 1e-9)


@given(lenses(), st.floats(0.05, 1.5))
def test_a_lens_is_between_two_pinholes(lens, reach):
    widest = min(lens.widest(reach), 1.4)
    bounds, within = lens.stretch(widest, power=1), directions(widest)
    stretches, cosine = np.linalg.svd(lens.jacobian(within), compute_uv=False), within[:, 2]
    assert (bounds.least <= stretches[:, 1] * cosine * (1.0 + 1e-9) + 1e-9).all()
    assert (stretches[:, 0] * cosine**2 <= bounds.most * (1.0 + 1e-9)).all()
    areas = stretches.prod(axis=1) * cosine**3
    assert (bounds.least_area <= areas * (1.0 + 1e-9) + 1e-9).all()
    assert (areas <= bounds.most_area * (1.0 + 1e-9)).all()


@given(lenses(), st.floats(0.05, 1.5))
def test_the_rough_image_is_off_and_the_ceiling_above_as_said(lens, reach):
    widest = lens.widest(reach)
    within, (rough, off) = directions(widest), approximation(lens, widest)
    scale = np.polynomial.polynomial.polyval(1.0 - within[:, 2], rough)
    assert np.linalg.norm(scale[:, None] * within[:, :2] - lens.project(within), axis=1).max() <= off
    theta, stretches = np.arccos(within[:, 2]), np.linalg.svd(lens.jacobian(within), compute_uv=False)[:, 0]
    order = np.argsort(theta)
    bound = np.polynomial.polynomial.polyval(1.0 - within[order, 2], ceiling(lens, widest))
    assert (np.maximum.accumulate(stretches[order]) <= bound + 1e-9).all()


@given(lenses(), st.floats(0.05, 1.5))
def test_nothing_folds_within_the_widest_angle(lens, reach):
    widest = 0.999 * lens.widest(reach)
    inner, outer = lens.project(directions(0.9 * widest)), lens.project(directions(widest))
    assert np.linalg.norm(inner, axis=1).max() <= np.linalg.norm(outer, axis=1).max()
    frame = lens.jacobian(directions(widest))
    facing = np.cross(frame[:, 0], frame[:, 1])  # along the direction itself, never against it
    assert ((facing * directions(widest)).sum(axis=1) > 0.0).all()


def test_by_hand():
    # r (1 - r^2 / 3) is largest at r = 1, where it is 2/3.
    folding = Lens("plumb_bob", (-1 / 3, 0.0, 0.0, 0.0))
    assert folding.fold == pytest.approx(math.pi / 4)
    assert folding.widest(0.5 - 0.125 / 3) == pytest.approx(math.atan(0.5))
    assert folding.widest(0.7) == folding.fold
    assert np.isnan(folding.directions(np.array([[0.7, 0.0]]))).all()
    # theta (1 - theta^2 / 12) is largest at theta = 2, behind the camera.
    fisheye = Lens("equidistant", (-1 / 12, 0.0, 0.0, 0.0))
    assert fisheye.fold == pytest.approx(2.0)
    behind = np.array([[math.sin(1.9), 0.0, math.cos(1.9)]])
    np.testing.assert_allclose(fisheye.project(behind), [[1.9 - 1.9**3 / 12, 0.0]])
    np.testing.assert_allclose(fisheye.directions(fisheye.project(behind)), behind, atol=1e-9)
    # An ideal one stretches by pi / 2 across the radius at a right angle, and a pinhole that shrinks by 1 on its axis.
    ideal = Lens("equidistant", (0.0, 0.0, 0.0, 0.0)).stretch(math.pi / 2)
    np.testing.assert_allclose(ideal, (1.0, math.pi / 2, 1.0, math.pi / 2), rtol=1e-3)
    assert Lens("plumb_bob", (-0.1, 0.0, 0.0, 0.0)).stretch(1e-3).most == pytest.approx(1.0, abs=1e-5)


def test_a_rational_lens_folds_before_its_pole():
    assert Lens("rational_polynomial", (0.1, 0.0, 0.0, 0.0, 0.0, -1.0, 0.0, 0.0)).fold <= math.pi / 4


def test_coefficients():
    assert lens_of("plumb_bob", []) is lens_of("rational_polynomial", [0] * 14) is None
    assert lens_of("plumb_bob", [0.1, 0.2, 0.3, 0.4]).coefficients == (0.1, 0.2, 0.3, 0.4, 0.0)
    assert lens_of("plumb_bob", [1, 2, 3, 4, 5, 0, 0, 0]).coefficients == (1.0, 2.0, 3.0, 4.0, 5.0)
    assert lens_of("plumb_bob", [1, 2, 3, 4, 5, 6, 0, 0, 0, 0, 0, 0, 0, 0]).coefficients == (1, 2, 3, 4, 5, 6, 0, 0)
    prism = lens_of("rational_polynomial", [0.0] * 8 + [0.1, 0.0, 0.0, 0.0])
    assert lens_of(prism.model, prism.coefficients) == prism
    assert lens_of("equidistant", [0, 0, 0, 0]).coefficients == (0.0, 0.0, 0.0, 0.0)
