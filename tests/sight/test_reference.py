import math

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal
from support.paper import (
    Y,
    Z,
    facing,
    one_position_room,
    paper_camera,
    paper_scene,
)
from support.strategies import cameras, pitches, points, seeds, unit_vectors, yaws

from lmd.geometry.frames import optical_axis, rotation
from lmd.scene import pdf
from lmd.scene.criteria import TOLERANCE
from lmd.scene.deployment_sources import UniformDeployment
from lmd.sight import reference
from lmd.sight.models import paper
from lmd.sight.models.paper import Visibility

ORIGIN = np.zeros(3)
HALF_ANGLE = math.atan(0.696)
NEAR, FAR = paper_camera().depth_of_field(4.0)
LAST_RESOLVED = paper_camera().resolution_depth(0.28)


def seen(*points, axis=Y, **visibility):
    """Which landmarks, all facing the camera at the origin, it covers."""
    return reference.coverage_caps(paper_scene(**visibility), facing(ORIGIN, *points), ORIGIN, axis[None])[0].tolist()


@pytest.mark.parametrize(
    ("nu", "printed"),
    [(0.0, "43.65 / 60.91 / 83.08"), (0.05, "41.01 / 59.86 / 82.46"), (0.10, "38.62 / 59.28 / 82.46")],
)
def test_the_uniform_deployment_scores_as_noted(nu, printed):
    scene = paper_scene(nu=nu)
    counts = reference.counts(scene, UniformDeployment(90).draw(scene.room, np.random.default_rng(0)))
    assert counts.shape == (756, 325)
    probability = reference.coverage_probability(counts, scene.pdf, 2)
    figures = (reference.qualified(probability, 0.65).mean(), probability.mean(), probability.max())
    assert " / ".join(f"{100 * figure:.2f}" for figure in figures) == printed


def test_resolution_falls_with_depth_and_is_zero_behind_the_camera():
    at = paper.resolution(paper_camera(), np.array([1.0, 2.0, -1.0, 0.0]))
    assert_allclose(at, np.array([1.0, 0.5, 0.0, 0.0]) * 5 * 1778 / (1773 * 5.8))


@pytest.mark.parametrize(
    ("angle", "inside"),
    [(0.0, True), (HALF_ANGLE - 1e-6, True), (HALF_ANGLE, True), (HALF_ANGLE + 1e-6, False), (3.0, False)],
)
def test_the_field_of_view_is_a_closed_cone(angle, inside):
    distance = np.array([2.0])
    assert paper.field_of_view(paper_camera(), distance * math.cos(angle), distance) == [inside]
    assert seen([2.0 * math.sin(angle), 2.0 * math.cos(angle), 0.0]) == [inside]


@given(cameras(), points, points, yaws, pitches, yaws)
def test_the_cosine_form_of_the_field_of_view_is_the_printed_tangent_form(camera, point, origin, yaw, pitch, roll):
    x, y, z = rotation(yaw, pitch, roll) @ (point - origin)
    distance = np.linalg.norm(point - origin)
    assume(distance > 1e-3)
    assume(abs(math.atan2(math.hypot(x, y), z) - camera.cone_half_angle) > 1e-6)
    printed = z > 0.0 and math.hypot(x, y) / z <= math.tan(camera.cone_half_angle)
    depth = optical_axis(yaw, pitch) @ (point - origin)
    assert paper.field_of_view(camera, depth, distance) == printed


@pytest.mark.parametrize(
    ("depth", "sharp"),
    [(0.0, False), (0.97, False), (NEAR, True), (5.0, True), (FAR, True), (10.03, False), (-2.0, False)],
)
def test_focus_is_a_closed_interval_of_depths(depth, sharp):
    assert paper.focus(paper_camera(), 4.0, np.array(depth)) == sharp


@pytest.mark.parametrize(
    ("depth", "covered"),
    [(NEAR * (1 - 1e-6), False), (NEAR, True), (2.0, True), (LAST_RESOLVED, True), (LAST_RESOLVED * (1 + 1e-6), False)],
)
def test_a_landmark_ahead_is_covered_from_the_near_limit_to_the_last_resolved_depth(depth, covered):
    assert seen([0.0, depth, 0.0]) == [covered]


def test_the_far_limit_of_focus_bounds_a_fine_resolution():
    assert seen([0, 10.02, 0], [0.5, 10.03, 0], thold=0.01) == [True, False]


@pytest.mark.parametrize(
    ("zeta", "away"), [(0.0, False), (1.57, False), (math.pi / 2, True), (1.58, True), (3.0, True)]
)
def test_a_landmark_seen_edge_on_or_from_behind_is_occluded(zeta, away):
    offset, normal = np.array([[0.0, 2.0, 0.0]]), np.array([[math.sin(zeta), -math.cos(zeta), 0.0]])
    assert paper.faces_away(offset, np.array([2.0]), normal) == [away]


@given(points, unit_vectors)
def test_facing_away_is_the_printed_elevation_angle(point, normal):
    distance = np.linalg.norm(point)
    assume(distance > 1e-3)
    zeta = math.acos(np.clip(normal @ (ORIGIN - point) / distance, -1.0, 1.0))
    assume(abs(zeta - math.pi / 2) > 1e-6)
    assert paper.faces_away(point[None], np.array([distance]), normal[None]) == [zeta >= math.pi / 2]


LOOKED_AT = [0.0, 2.0, 0.0]


@pytest.mark.parametrize(
    ("other", "whole_line", "line_of_sight"),
    [
        ([0.04, 1.0, 0.0], True, True),
        ([0.05, 1.0, 0.0], True, True),
        ([0.051, 1.0, 0.0], False, False),
        ([0.03, 2.0, 0.0], True, False),  # farther by 0.2 mm
        ([0.03, 1.9995, 0.0], True, True),
        ([0.04, 3.0, 0.0], True, False),
        ([0.04, -1.0, 0.0], True, False),
        ([0.0, -2.0, 0.0], True, False),
        ([0.0, 2.0, 0.0], True, True),
        ([0.0, 0.0, 0.0], True, False),  # at the camera itself
    ],
)
def test_who_hides_the_landmark_two_metres_ahead(other, whole_line, line_of_sight):
    offset = np.array([LOOKED_AT, other])
    for occlusion, hides in {"paper": whole_line, "line_of_sight": line_of_sight, "none": False}.items():
        assert paper.hidden_by_others(offset, Visibility(0.28, 0.05, occlusion))[0] == hides
        assert not paper.hidden_by_others(offset, Visibility(0.28, 0.0, occlusion)).any()


def test_coincident_landmarks_hide_each_other_unless_nu_is_zero():
    assert seen(LOOKED_AT, LOOKED_AT) == [False, False]
    assert seen(LOOKED_AT, LOOKED_AT, occlusion="line_of_sight") == [False, False]
    assert seen(LOOKED_AT, LOOKED_AT, nu=0.0) == [True, True]


@given(seeds, st.floats(0.01, 0.5))
def test_hiding_is_the_printed_distance_to_the_line(seed, nu):
    d = np.random.default_rng(seed).uniform(-1.0, 1.0, (4, 3))
    length = np.linalg.norm(d, axis=1)
    cosine = np.clip(d @ d.T / np.outer(length, length), -1.0, 1.0)
    distance = length[None, :] * np.sqrt(1.0 - cosine**2)  # [k, j]
    np.fill_diagonal(distance, np.inf)
    assume((length > 0.05).all())
    assume((np.abs(distance - nu) > 1e-6).all())
    assert_array_equal(paper.hidden_by_others(d, Visibility(0.28, nu)), (distance <= nu).any(axis=1))


def test_a_landmark_is_covered_where_every_criterion_holds():
    scene, points = paper_scene(), [[0, 2, 0], [0, 0.9, 0.3], [2, 1, 0], [0, -2, 0.5], [0.5, 2.5, 0], [0, 1e-310, 1]]
    towards = facing(ORIGIN, *points)
    normals = np.where(np.arange(6)[:, None] == 4, -towards.normals, towards.normals)
    covered = scene.visibility.covered(scene.camera, ORIGIN, Y[None], towards.positions, normals)
    assert covered.tolist() == [[True, False, False, False, False, False]]
    assert paper.resolution(scene.camera, np.array([2.0])) == pytest.approx(5 * 1778 / (1773 * 5.8 * 2))


def test_counts_add_up_the_caps_each_axis_passes_through():
    scene = paper_scene(one_position_room((3.0, 3.0, 3.0)), orientations=pdf.level_flight(2))
    east, north = np.array([5.0, 3.0, 3.0]), np.array([3.0, 5.0, 3.0])
    deployment = facing(np.full(3, 3.0), east, east + 0.2 * Z, north, [1.0, 3.4, 3.0])
    by_yaw = dict(zip(scene.pdf.yaw.tolist(), reference.counts(scene, deployment)[0].tolist(), strict=True))
    assert by_yaw == {-math.pi: 0, -math.pi / 2: 1, 0.0: 1, math.pi / 2: 2}


def test_coverage_probability_is_the_weight_of_the_axes_with_n_caps():
    orientations = pdf.OrientationPdf([0, 1, 2], [0, 0, 0], [0.5, 0.3, 0.2])
    counts = np.array([[2, 1, 0], [3, 3, 3], [0, 0, 0]])
    assert_allclose(reference.coverage_probability(counts, orientations, 1), [0.8, 1.0, 0.0])
    assert_allclose(reference.coverage_probability(counts, orientations, 2), [0.5, 1.0, 0.0])
    assert_allclose(reference.coverage_probability(counts, orientations, 4), 0.0)


def test_a_position_that_reaches_the_threshold_exactly_is_qualified():
    orientations = pdf.grid_with_ends()
    for k in range(326):
        probability = reference.coverage_probability(np.arange(325) < k, orientations, 1)
        assert reference.qualified(probability, k / 325)
        assert not reference.qualified(probability, (k + 1) / 325)
    assert 260 / 325 == 0.8


def test_the_strength_threshold_is_closed_with_the_shared_tolerance():
    at_two_metres = float(paper.resolution(paper_camera(), np.array(2.0)))
    assert seen(LOOKED_AT, thold=at_two_metres) == [True]
    assert seen(LOOKED_AT, thold=at_two_metres * (1 + TOLERANCE / 2)) == [True]
    assert seen(LOOKED_AT, thold=at_two_metres * (1 + TOLERANCE * 3)) == [False]
