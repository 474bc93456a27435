"""Independent samples of a recording, and the test of independence of their angles."""

import numpy as np
import pytest
from support.recordings import MOVING, estimated, independent_draws, simulated

from lmd.orientation.density import circular_difference, independence_test
from lmd.orientation.recording import (
    OrientationRecording,
    Samples,
    integrated_correlation_time,
    sample_at_random_intervals,
)


def test_the_correlation_time_is_that_of_the_motion():
    # Of the pitch, the integral of exp(-t^2 / (2 tau^2)); of the slower one where the yaw moves too.
    for tau in (0.5, 1.0, 2.0):
        both = simulated(duration=4000.0, correlation_time=tau, pitch_std=0.1)
        pitch = integrated_correlation_time(OrientationRecording(both.time, np.zeros_like(both.yaw), both.pitch))
        yaw = integrated_correlation_time(OrientationRecording(both.time, both.yaw, np.zeros_like(both.pitch)))
        assert pitch == pytest.approx(np.sqrt(2.0 * np.pi) * tau, rel=0.25)
        assert integrated_correlation_time(both) == max(yaw, pitch)


def test_intervals_are_random_with_the_stated_mean_and_never_shorter_than_half_of_it():
    time = np.arange(0.0, 4000.0, 0.01)
    clock = OrientationRecording(time, time, np.zeros_like(time))  # the yaw tells the time
    intervals = np.diff(sample_at_random_intervals(clock, 4.0, np.random.default_rng(0)).yaw)
    assert intervals.min() >= 2.0 - 0.011
    assert intervals.mean() == pytest.approx(4.0, rel=0.05)
    assert intervals.std() == pytest.approx(2.0, rel=0.1)


def test_the_mean_interval_is_twice_the_correlation_time_unless_given():
    recording = simulated(**MOVING)
    samples = sample_at_random_intervals(recording, None, np.random.default_rng(0))
    assert samples.correlation_time == integrated_correlation_time(recording)
    assert samples.mean_interval == 2.0 * samples.correlation_time


def test_a_steady_turn_is_sampled_all_around():
    # A fixed interval of one turn would see a single yaw.
    time = np.arange(0.0, 2000.0, 0.05)
    recording = OrientationRecording(time, circular_difference(time, 0.0), np.zeros_like(time))
    result = estimated(recording, mean_interval=2.0 * np.pi)
    assert result.yaw.density.family == "uniform"


def test_records_count_for_as_long_as_they_hold():
    # Three quarters of the records are made in a quarter of the time.
    time = np.concatenate([np.arange(0.0, 250.0, 1.0 / 9.0), np.arange(250.0, 1000.0)])
    yaw = np.where(time < 250.0, 1.0, -1.0)
    samples = sample_at_random_intervals(OrientationRecording(time, yaw, 0.0 * time), 1.0, np.random.default_rng(0))
    assert np.mean(samples.yaw == 1.0) == pytest.approx(0.25, abs=0.02)


def test_independent_angles_are_rejected_as_often_as_the_level_says():
    rng = np.random.default_rng(0)
    p_values = [
        independence_test(Samples(rng.vonmises(3.0, 1.0, 200), rng.normal(0.0, 0.2, 200), 1.0, 2.0), 0.05, rng).p_value
        for _ in range(40)
    ]
    assert 0.3 < np.mean(p_values) < 0.7
    assert np.mean(np.array(p_values) < 0.05) < 0.2


def test_a_dependence_that_no_correlation_shows_is_found():
    rng = np.random.default_rng(0)
    yaw = rng.uniform(-np.pi, np.pi, 400)
    pitch = 0.2 * np.cos(2.0 * yaw) + rng.normal(0.0, 0.2, 400)
    assert independence_test(Samples(yaw, pitch, 1.0, 2.0), 0.05, rng).p_value < 0.001


def test_dependent_angles_get_the_joint_density_and_independent_ones_the_product():
    rng = np.random.default_rng(0)
    yaw = rng.uniform(-np.pi, np.pi, 1500)
    noise = rng.normal(0.0, 0.1, 1500)
    joint = estimated(independent_draws(yaw, 0.6 * np.sin(yaw) + noise), mean_interval=2.0, significance=0.01)
    product = estimated(independent_draws(yaw, noise), mean_interval=2.0, significance=0.01)
    assert (joint.form, product.form) == ("joint", "product")

    def mean_pitch(orientations, toward):
        near = np.abs(circular_difference(orientations.yaw, toward)) < 0.6
        return orientations.weight[near] @ orientations.pitch[near] / orientations.weight[near].sum()

    assert mean_pitch(joint.pdf, np.pi / 2) == pytest.approx(0.57, abs=0.08)
    assert mean_pitch(joint.pdf, -np.pi / 2) == pytest.approx(-0.57, abs=0.08)
    assert mean_pitch(product.pdf, np.pi / 2) == pytest.approx(mean_pitch(product.pdf, -np.pi / 2), abs=1e-6)
