import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from numpy.testing import assert_allclose
from scipy.linalg import expm

from lmd.geometry import se3
from lmd.geometry.frames import optical_axis, rotation

RNG = np.random.default_rng(0)


def twists(most):
    return arrays(np.float64, 6, elements=st.floats(-most, most))


def wedge(twist):
    """[[w]x v; 0 0] in se(3)."""
    matrix = np.zeros((4, 4))
    matrix[:3, :3], matrix[:3, 3] = se3.skew(twist[:3]), twist[3:]
    return matrix


def scaled(direction, angle):
    return direction / np.linalg.norm(direction) * angle


@given(twists(2.0))
def test_exp_is_the_matrix_exponential(twist):
    assert_allclose(se3.exp(twist), expm(wedge(twist)), atol=1e-12)


@pytest.mark.parametrize("angle", [0.0, 1e-12, 0.99e-4, 1e-4, 1.01e-4, 1.0, np.pi - 1e-4, np.pi - 1e-9])
def test_log_undoes_exp_at_every_angle(angle):
    directions = RNG.normal(size=(50, 3))
    angular = directions / np.linalg.norm(directions, axis=1, keepdims=True) * angle
    twist = np.hstack([angular, RNG.normal(size=(50, 3))])
    assert_allclose(se3.exp(se3.log(se3.exp(twist))), se3.exp(twist), atol=1e-9)
    assert_allclose(se3.log(se3.exp(twist)), twist, atol=1e-7)


@given(twists(3.0), twists(3.0), twists(3.0))
def test_poses_are_a_group(a, b, c):
    x, y, z = se3.exp(a), se3.exp(b), se3.exp(c)
    assert_allclose((x @ y) @ z, x @ (y @ z), atol=1e-9)
    assert_allclose(x @ se3.inverse(x), np.eye(4), atol=1e-12)
    assert_allclose(se3.exp(-a), se3.inverse(x), atol=1e-9)
    assert_allclose(se3.act(x @ y, c.reshape(2, 3)), se3.act(x, se3.act(y, c.reshape(2, 3))), atol=1e-9)


@given(twists(2.0), twists(2.0))
def test_the_adjoint_carries_a_body_twist_to_the_world(a, b):
    x = se3.exp(a)
    assert_allclose(wedge(se3.adjoint(x, b)), x @ wedge(b) @ se3.inverse(x), atol=1e-9)


def test_a_batch_is_its_members():
    twist = RNG.normal(size=(2, 3, 6))
    poses = se3.exp(twist)
    assert poses.shape == (2, 3, 4, 4)
    assert_allclose(poses[1, 2], se3.exp(twist[1, 2]), atol=1e-15)
    assert_allclose(se3.log(poses)[1, 2], se3.log(poses[1, 2]), atol=1e-15)


def test_a_camera_pose_is_the_inverse_of_the_papers_frame_equation():
    position, yaw, pitch, roll = np.array([1.0, 2.0, 3.0]), 0.7, -0.4, 0.2
    pose = se3.camera_pose(position, yaw, pitch, roll)
    assert_allclose(pose[:3, 2], optical_axis(yaw, pitch))
    points = RNG.normal(size=(5, 3))
    local = (points - position) @ rotation(yaw, pitch, roll).T
    assert_allclose(se3.act(se3.inverse(pose), points), local)


@pytest.mark.parametrize("angle", [0.0, 1e-9, 0.3, np.pi])
def test_angle_between_is_the_angle_of_the_rotation_between(angle):
    start = se3.exp(RNG.normal(size=6))
    turn = np.concatenate([scaled(RNG.normal(size=3), angle), RNG.normal(size=3)])
    assert_allclose(se3.angle_between(start, start @ se3.exp(turn)), angle, atol=1e-8, rtol=1e-6)


@pytest.mark.parametrize("angle", [0.0, 1e-3, 0.0199, 0.0201, 1.0, 3.0])
def test_the_left_jacobian_is_the_integral_of_the_adjoint(angle):
    twist = np.concatenate([scaled(RNG.normal(size=3), angle), RNG.normal(size=3)])
    nodes, weights = np.polynomial.legendre.leggauss(20)
    adjoints = np.array([expm((node + 1.0) / 2.0 * se3.bracket_matrix(twist)) for node in nodes])
    assert_allclose(se3.left_jacobian(twist), np.einsum("i,ijk->jk", weights / 2.0, adjoints), atol=1e-8)
    assert_allclose(expm(se3.bracket_matrix(twist)), se3.adjoint_matrix(se3.exp(twist)), atol=1e-9)
