import math

import numpy as np
import pytest
from hypothesis import given
from numpy.testing import assert_allclose
from support.strategies import pitches, unit_vectors, yaws

from lmd.geometry.frames import landmark_normal, normal_angles, optical_axis, rotation

EXACT = {"rtol": 0.0, "atol": 1e-12}
QUARTER = math.pi / 2


@given(yaws, pitches)
def test_optical_axis_is_as_printed(yaw, pitch):
    expected = [math.sin(yaw) * math.cos(pitch), math.cos(yaw) * math.cos(pitch), math.sin(pitch)]
    assert_allclose(optical_axis(yaw, pitch), expected, **EXACT)


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


def test_frames_broadcast_over_arrays():
    yaw, pitch = np.linspace(-3, 3, 5)[:, None], np.linspace(-1.5, 1.5, 4)
    assert rotation(yaw, pitch).shape == (5, 4, 3, 3)
    assert optical_axis(yaw, pitch).shape == landmark_normal(yaw, pitch).shape == (5, 4, 3)
    assert optical_axis(0.0, pitch).shape == (4, 3)
