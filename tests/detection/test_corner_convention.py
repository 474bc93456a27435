"""Which pixels detectors count in, in images of tags that share no code with `lmd.render`, and in photographs."""

import sys
from pathlib import Path

import cv2
import numpy as np
import pytest
from numpy.testing import assert_allclose

from lmd.detection.corner_errors import CORNER_ERRORS

sys.path.append(str(Path(__file__).parents[2] / "benchmarks"))
import corners as measured  # a script

PHOTOGRAPHS = Path(__file__).parents[2] / "../shared/real/photographs"
PITCH, TAGS = 6.0, 10  # pixels a module
SQUARE = np.array([[0.0, 0.0], [8.0, 0.0], [8.0, 8.0], [0.0, 8.0]])


@pytest.fixture(scope="module")
def found():
    return measured.measure(PITCH, 0.5, measured.ORDINARY, TAGS, 0)


@pytest.mark.parametrize("name", measured.DETECTORS)
def test_pixels_are_counted_from_the_border(found, name):
    count, offsets, _ = found[name]
    assert count == TAGS
    assert_allclose(offsets.mean(axis=0), 0.0, atol=0.04)


@pytest.mark.parametrize("name", CORNER_ERRORS)
def test_edges_lie_as_far_inward_as_the_preset_says(found, name):
    assert_allclose(found[name][2].mean(), CORNER_ERRORS[name].inward_at(np.array(PITCH)), atol=0.06)


@pytest.mark.parametrize("blur", [0.0, 0.5])
def test_fitted_edges_meet_where_the_corners_are(blur):
    rng = np.random.default_rng(0)
    into, size = measured.homography(PITCH, rng)
    image = measured.render(measured.tag_picture(5), into, size, blur, measured.ORDINARY, rng)
    true = measured.project(into, SQUARE)
    fitted, found_blur, _ = measured.fitted_corners(image.astype(float), true + rng.uniform(-1.0, 1.0, (4, 2)), 8)
    assert_allclose(fitted, true, atol=0.05)
    # A pixel itself blurs like 0.29 pixels.
    assert_allclose(found_blur, np.hypot(blur, 0.29), atol=0.05)


@pytest.mark.skipif(not PHOTOGRAPHS.exists(), reason="the files of others are not here")
def test_apriltag_is_where_the_edges_of_a_photographed_tag_meet():
    path = PHOTOGRAPHS / "test_image_rotation_0.png"
    image = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)
    corners = measured.DETECTORS["apriltag"].detect(image).corners[0]
    fitted, _, _ = measured.fitted_corners(image.astype(float), corners + np.array([0.8, -0.6]), 8, bends=False)
    offset, inward, _ = measured.shift(corners, fitted)
    assert_allclose(offset, 0.0, atol=0.05)
    assert abs(inward) < 0.05
