import math

import numpy as np
import pytest
from hypothesis import given
from numpy.testing import assert_allclose
from support.strategies import pitches, unit_vectors, yaws

from lmd.geometry.frames import landmark_normal, normal_angles, optical_axis, rotation

EXACT = {"rtol": 0.0, "atol": 1e-12}
QUARTER = math.pi / 2


@given(yaws, pitches, yaws)
def test_rotation_is_orthonormal_with_determinant_one(yaw, pitch, roll):
    r = rotation(yaw, pitch, roll)
    assert_allclose(r @ r.T, np.eye(3), **EXACT)
    assert_allclose(np.linalg.det(r), 1.0, **EXACT)


@given(yaws, pitches, yaws)
def test_third_row_of_rotation_is_the_optical_axis_whatever_the_roll(yaw, pitch, roll):
    assert_allclose(rotation(yaw, pitch, roll)[2], optical_axis(yaw, pitch), **EXACT)


@given(yaws, pitches, yaws)
def test_roll_turns_the_image_axes_in_their_plane(yaw, pitch, roll):
    turn = np.array([[math.cos(roll), -math.sin(roll)], [math.sin(roll), math.cos(roll)]])
    assert_allclose(rotation(yaw, pitch, roll)[:2], turn @ rotation(yaw, pitch)[:2], **EXACT)


@given(yaws, pitches)
def test_optical_axis_is_as_printed(yaw, pitch):
    expected = [math.sin(yaw) * math.cos(pitch), math.cos(yaw) * math.cos(pitch), math.sin(pitch)]
    assert_allclose(optical_axis(yaw, pitch), expected, **EXACT)


@pytest.mark.parametrize(
    ("angles", "expected"),
    [
        ((0, 0, 0), [[1, 0, 0], [0, 0, -1], [0, 1, 0]]),
        ((QUARTER, 0, 0), [[0, -1, 0], [0, 0, -1], [1, 0, 0]]),
        ((0, QUARTER, 0), [[1, 0, 0], [0, 1, 0], [0, 0, 1]]),
        ((0, 0, QUARTER), [[0, 0, 1], [1, 0, 0], [0, 1, 0]]),
        ((math.pi, 0, 0), [[-1, 0, 0], [0, 0, -1], [0, -1, 0]]),
    ],
)
def test_printed_matrices_at_special_angles(angles, expected):
    assert_allclose(rotation(*angles), expected, **EXACT)


@given(yaws, pitches, yaws)
def test_rotation_is_the_printed_product(a, b, g):
    r_a = [[math.cos(a), 0, -math.sin(a)], [0, 1, 0], [math.sin(a), 0, math.cos(a)]]
    r_b = [[1, 0, 0], [0, math.cos(b), math.sin(b)], [0, -math.sin(b), math.cos(b)]]
    r_g = [[math.cos(g), -math.sin(g), 0], [math.sin(g), math.cos(g), 0], [0, 0, 1]]
    printed = np.linalg.multi_dot([np.array(m) for m in (r_g, r_b, r_a, [[1, 0, 0], [0, 0, -1], [0, 1, 0]])])
    assert_allclose(rotation(a, b, g), printed, **EXACT)


@given(yaws, pitches)
def test_landmark_normal_is_as_printed(rho, eta):
    expected = [-math.sin(rho) * math.cos(eta), math.cos(rho) * math.cos(eta), -math.sin(eta)]
    assert_allclose(landmark_normal(rho, eta), expected, **EXACT)


@given(unit_vectors)
def test_normal_angles_inverts_landmark_normal(normal):
    yaw, pitch = normal_angles(normal)
    assert abs(yaw) <= math.pi
    assert abs(pitch) <= math.pi / 2
    assert_allclose(landmark_normal(yaw, pitch), normal, rtol=0.0, atol=1e-7)


@pytest.mark.parametrize(("normal", "pitch"), [((0, 0, 1), -QUARTER), ((0, 0, -1), QUARTER)])
def test_a_vertical_normal_has_yaw_zero(normal, pitch):
    assert normal_angles(normal) == (0.0, pitch)


def test_the_level_camera_looks_along_y_with_x_right_and_y_down():
    assert_allclose(rotation(0.0, 0.0) @ [1.0, 5.0, -2.0], [1.0, 2.0, 5.0], **EXACT)


def test_frames_broadcast_over_arrays():
    yaw, pitch = np.linspace(-3, 3, 5)[:, None], np.linspace(-1.5, 1.5, 4)
    assert rotation(yaw, pitch).shape == (5, 4, 3, 3)
    assert optical_axis(yaw, pitch).shape == landmark_normal(yaw, pitch).shape == (5, 4, 3)
    assert optical_axis(0.0, pitch).shape == (4, 3)
