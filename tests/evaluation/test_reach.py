"""Range of a tag, and the pose error from it: by hand, and by OpenCV on noisy corners."""

import math
from dataclasses import replace

import cv2
import numpy as np
import pytest
from numpy.testing import assert_allclose
from support.paper import paper_camera

from lmd.evaluation.reach import Reading, is_read, pose_bounds, reach, reach_text, smallest_edge
from lmd.geometry.squares import corners, upright
from lmd.scene.tag import Tag
from lmd.sight.models.fiducial import Fiducial

TAG = Tag(0.12)
SHARP = replace(paper_camera(), aperture=0.0)  # no thin lens: everything is in focus
PIXELS = SHARP.focal_length / SHARP.pixel_width
CRITERIA = Fiducial(TAG)


def test_a_tag_that_faces_the_camera_is_read_while_its_modules_are_large_enough():
    limits = CRITERIA.limits
    pitch = math.hypot(limits.pitch, limits.blur * CRITERIA.psf_sigma)
    by_hand = min(PIXELS * TAG.module / pitch, PIXELS * TAG.size / limits.edge)
    assert_allclose(reach(CRITERIA, SHARP, 0.0).farthest, by_hand, rtol=2e-4)


def test_it_is_read_between_the_two_distances_and_not_beyond():
    for incidence in (0.0, 0.6, 1.0):
        found = reach(CRITERIA, SHARP, incidence)
        for distance, expected in ((0.98, False), (1.02, True)):
            assert is_read(CRITERIA, SHARP, found.nearest * distance, incidence) is expected
            assert is_read(CRITERIA, SHARP, found.farthest / distance, incidence) is expected
    assert math.isnan(reach(CRITERIA, SHARP, math.radians(89.0)).farthest)


def test_the_smallest_tag_is_read_as_far_as_asked():
    def of(edge):
        return Fiducial(Tag(edge))

    for incidence in (0.0, 0.8):
        edge = smallest_edge(of, SHARP, 3.0, incidence)
        assert_allclose(reach(of(edge), SHARP, incidence).farthest, 3.0, rtol=1e-3)
    assert math.isnan(smallest_edge(of, SHARP, 3.0, math.radians(89.0)))


@pytest.mark.parametrize(("distance", "incidence"), [(0.6, 0.5), (1.5, 0.9)])
def test_errors_are_those_of_opencv_on_noisy_corners(distance, incidence):
    noise, draws, rng = 0.2, 400, np.random.default_rng(0)
    normal = np.array([[math.sin(incidence), -math.cos(incidence), 0.0]])
    points = corners(np.array([[0.0, distance, 0.0]]), normal, upright(normal)[1], TAG.size)[0]
    local = points @ np.array([[1.0, 0, 0], [0, 0, -1.0], [0, 1.0, 0]]).T  # right, down, ahead
    matrix = np.array([[PIXELS, 0, 0], [0, PIXELS, 0], [0, 0, 1.0]])
    image = PIXELS * local[:, :2] / local[:, 2:]
    found = []
    for _ in range(draws):
        seen = image + rng.normal(0.0, noise, image.shape)
        turn, shift = np.zeros((3, 1)), np.zeros((3, 1))
        _, turn, shift = cv2.solvePnP(
            local, seen, matrix, None, turn, shift, useExtrinsicGuess=True, flags=cv2.SOLVEPNP_ITERATIVE
        )
        rotation = cv2.Rodrigues(turn)[0]
        found.append([*(-rotation.T @ shift[:, 0]), *turn[:, 0]])
    spread = np.sqrt((np.square(found)).mean(axis=0))
    position, attitude = pose_bounds(SHARP, TAG, [distance], incidence, noise)
    assert_allclose(np.linalg.norm(spread[:3]), position[0], rtol=0.12)
    assert_allclose(np.linalg.norm(spread[3:]), attitude[0], rtol=0.12)


def test_the_tables_have_a_row_for_each_angle():
    text = reach_text(SHARP, TAG, Fiducial(TAG), Reading((0.0, 40.0), (1.0, 3.0)))
    rows = [line.split("   ") for line in text.splitlines() if line.startswith(("0 deg", "40 deg"))]
    assert len(rows) == 4
