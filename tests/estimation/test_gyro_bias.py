"""Filter that estimates the bias of a gyro: its error dynamics, consistency and convergence."""

from dataclasses import replace

import numpy as np
from numpy.testing import assert_allclose
from scipy.stats import chi2
from support.paper import paper_scene

from lmd.estimation.estimators import squares
from lmd.estimation.flights import Pace, RandomMotion
from lmd.estimation.fusion import CameraPoints
from lmd.estimation.gyro_bias import EquivariantFilter, State
from lmd.estimation.recording import Flight, Odometry, record
from lmd.estimation.sensors import PointDetector
from lmd.geometry import se3
from lmd.geometry.trajectory import Trajectory
from lmd.scene.deployment_sources import UniformDeployment
from lmd.sight.evaluator import Evaluator

SCENE = paper_scene()
UNIFORM = UniformDeployment(90).draw(SCENE.room, np.random.default_rng(0))
EVALUATOR = Evaluator(SCENE, threads=1)
BIASED = Odometry(0.005, 0.02, gyro_bias=0.03, gyro_walk=0.001)
RNG = np.random.default_rng(0)
POSE = se3.exp(np.array([0.4, -0.9, 0.3, 2.0, 1.0, 3.0]))
BIAS, TWIST, STEP = np.array([0.1, -0.2, 0.3, 0.0, 0.0, 0.0]), np.array([0.7, -0.5, 0.4, 0.6, -0.9, 0.8]), 0.2
EPSILON = 1e-6


def recorded(odometry, flights=8, seconds=8.0):
    motion = RandomMotion(seconds, Pace(1.0, 1.0, 10.0))
    flown = [
        Flight(EVALUATOR, UNIFORM, motion.draw(SCENE, np.random.default_rng(i)), np.random.default_rng([5, i]))
        for i in range(flights)
    ]
    return record(PointDetector(0.5), flown, odometry)


def error_of(estimate, pose, bias):
    """Error (x, z) of an estimate, from its definition."""
    z = se3.adjoint(estimate.pose, bias - estimate.bias)
    return np.concatenate([se3.log(pose @ se3.inverse(estimate.pose)), z])


def true_at(estimate, error):
    """The pose and the bias with a given error."""
    bias = estimate.bias + se3.adjoint(se3.inverse(estimate.pose), error[6:])
    return se3.exp(error[:6]) @ estimate.pose, bias


def test_the_error_of_a_step_is_its_finite_difference():
    estimate = State(POSE, BIAS, np.zeros((12, 12)))
    kalman = EquivariantFilter(1.0, 1.0)
    found = kalman.transition(POSE, STEP * (TWIST - BIAS), STEP)
    after = kalman.predicted(estimate, TWIST, STEP, np.zeros(12))
    for j in range(12):
        ends = []
        for sign in (1.0, -1.0):
            pose, bias = true_at(estimate, sign * EPSILON * np.eye(12)[j])
            ends.append(error_of(after, pose @ se3.exp(STEP * (TWIST - bias)), bias))
        assert_allclose((ends[0] - ends[1]) / (2.0 * EPSILON), found[:, j], atol=1e-8)


def test_the_error_of_the_bias_is_linear_in_the_equivariant_filter_however_large():
    estimate = State(POSE, BIAS, np.zeros((12, 12)))
    kalman = EquivariantFilter(1.0, 1.0)
    error = np.concatenate([RNG.normal(size=6), 0.3 * RNG.normal(size=6)])
    pose, bias = true_at(estimate, error)
    after = kalman.predicted(estimate, TWIST, STEP, np.zeros(12))
    there = error_of(after, pose @ se3.exp(STEP * (TWIST - bias)), bias)
    moved = kalman.transition(POSE, STEP * (TWIST - BIAS), STEP) @ error
    assert_allclose(there[6:], moved[6:], atol=1e-12)
    assert np.abs(there[:6] - moved[:6]).max() > 1e-3  # that of the pose is not


def test_the_residual_of_landmarks_is_its_finite_difference():
    landmarks = RNG.uniform(0.0, 4.0, (3, 3))
    exact = se3.act(se3.inverse(POSE), landmarks)

    def residual(pose):
        return EquivariantFilter(1.0, 1.0).residual(pose, CameraPoints(landmarks, exact.reshape(-1), np.eye(9)))

    at_truth, jacobian, covariance = residual(POSE)
    assert_allclose(at_truth, 0.0, atol=1e-12)
    assert_allclose(covariance, np.eye(9), atol=1e-12)
    for j in range(6):
        ends = []
        for sign in (1.0, -1.0):
            twist = sign * EPSILON * np.eye(6)[j]  # the true pose is the estimate, moved by the error
            ends.append(residual(se3.exp(-twist) @ POSE)[0])
        assert_allclose((ends[0] - ends[1]) / (2.0 * EPSILON), jacobian[:, j], atol=1e-8)


def test_the_equivariant_output_errs_by_the_third_order():
    landmarks, worst = RNG.uniform(0.0, 4.0, (3, 3)), []
    direction = RNG.normal(size=6)
    for size in (0.1, 0.05):
        exact = se3.act(se3.inverse(se3.exp(size * direction) @ POSE), landmarks)
        seen = CameraPoints(landmarks, exact.reshape(-1), np.eye(9))
        residual, jacobian, _ = EquivariantFilter(1.0, 1.0).residual(POSE, seen)
        worst.append(np.abs(residual - jacobian @ (size * direction)).max())
    assert 7.0 < worst[0] / worst[1] < 9.0


def test_a_correction_moves_the_estimate_to_its_error():
    estimate = State(POSE, BIAS, np.eye(12))
    change = 0.5 * RNG.normal(size=12)
    corrected = EquivariantFilter(1.0, 1.0).moved(estimate, change)
    pose, bias = true_at(estimate, change)
    assert_allclose(corrected.pose, pose, atol=1e-12)
    assert_allclose(corrected.bias, bias, atol=1e-12)
    # The covariance moves to the coordinates of the new estimate.
    for j in range(12):
        ends = []
        for sign in (1.0, -1.0):
            there = true_at(estimate, change + sign * EPSILON * np.eye(12)[j])
            ends.append(error_of(corrected, *there))
        column = (ends[0] - ends[1]) / (2.0 * EPSILON)
        single = State(POSE, BIAS, np.outer(np.eye(12)[j], np.eye(12)[j]))
        moved = EquivariantFilter(1.0, 1.0).moved(single, change).covariance
        assert_allclose(moved, np.outer(column, column), atol=1e-7)


def test_the_filter_knows_how_wrong_it_is_with_a_biased_gyro():
    recording = recorded(BIASED)
    start = recording.poses[:, 0] @ se3.exp(0.05 * np.random.default_rng(1).normal(size=(8, 6)))
    kalman = EquivariantFilter(0.05, 0.05)
    found = np.stack([
        squares(list(kalman.run(recording, s, start[s])), recording.poses[s]) for s in range(len(start))
    ])  # fmt: skip
    for i, degrees in enumerate((6, 3, 3)):
        low, high = chi2.ppf([0.005, 0.995], degrees * len(start)) / len(start)
        mean = found[:, ::10, i].mean(axis=0)  # of independent flights, a second apart
        assert ((mean > low) & (mean < high)).all()
    blind = replace(recording, odometry=replace(BIASED, gyro_bias=0.0, gyro_walk=0.0))
    without = [squares(list(kalman.run(blind, s, start[s])), recording.poses[s])[:, 0] for s in range(len(start))]
    assert np.mean(without) > 12.0  # a filter that takes the gyro for unbiased


def test_the_bias_is_found():
    recording = recorded(replace(BIASED, gyro_walk=0.0), flights=4)
    motions = [Trajectory(recording.time, poses).twists for poses in recording.poses]
    bias = (recording.twists - motions)[..., :3].mean(axis=1)
    *_, last = zip(
        *(EquivariantFilter(0.1, 0.1).states(recording, s, recording.poses[s, 0]) for s in range(4)), strict=True
    )
    left = np.array([state.bias for state in last]) - np.pad(bias, ((0, 0), (0, 3)))
    assert np.abs(left[:, :3]).max() < 0.012
    assert_allclose(left[:, 3:], 0.0, atol=1e-9)


def test_the_filter_converges_from_60_degrees_and_2_metres():
    recording = recorded(BIASED, flights=4)
    start = recording.poses[:, 0].copy()
    start[:, :3, :3] @= se3.exp(np.array([1.0, 0.0, 0.3, 0.0, 0.0, 0.0]))[:3, :3]
    start[:, :3, 3] += [1.5, -1.2, 0.5]
    errors = EquivariantFilter(1.0, 1.2).errors(recording, start)
    assert np.median(errors.position[:, 60:]) < 0.06
    assert np.median(errors.attitude[:, 60:]) < 0.02
