from dataclasses import replace

import numpy as np
import pytest

from lmd.adjust.links import BIAS
from lmd.adjust.motion import Motion, seconds_of
from lmd.core.checks import InputError
from lmd.geometry.se3 import exp
from lmd.geometry.trajectory import Trajectory


def some_motion(rng, count, kind):
    """A motion of `count` frames at uneven times, and poses near to it."""
    times = np.cumsum(rng.uniform(0.05, 0.3, count))
    path = [np.eye(4)]
    for twist in rng.normal(size=(count - 1, 6)) * [0.2, 0.2, 0.2, 0.1, 0.1, 0.3]:
        path.append(path[-1] @ exp(twist))
    path = np.stack(path)
    if kind == "steady":
        return Motion(times), path
    return Motion.by_odometry(times, Trajectory(times, path)), exp(rng.normal(0.0, 0.5, 6)) @ path


def rates_at(links, poses):
    """Turn rates of bodies and velocities in the world, `(F, 6)`."""
    velocities = links.velocities(poses)
    return np.concatenate([velocities[:, :3], np.einsum("fij,fj->fi", poses[:, :3, :3], velocities[:, 3:])], axis=1)


def moved(poses, k, axis, by):
    poses = poses.copy()
    poses[k] = poses[k] @ exp(by * np.eye(6)[axis])
    return poses


def jacobian(at, k, axis):
    """Derivative of all errors by one component of the twist of frame k."""
    slope = np.zeros_like(at.error)
    slope[k - 1 : k] += at.by_second[k - 1 : k, :, axis]
    slope[k : k + 1] += at.by_first[k : k + 1, :, axis]
    return slope


@pytest.mark.parametrize("kind", ["steady", "odometry"])
def test_jacobians_of_errors_are_those_of_differences(kind):
    rng = np.random.default_rng(3)
    motion, poses = some_motion(rng, 6, kind)
    links, step = motion.links(np.arange(6)), 1e-5
    # The bias depends on all poses, so it is switched off.
    links = replace(links, by_bias=None if links.by_bias is None else 0.0 * links.by_bias)
    at = links.at(poses)
    for k, axis in np.ndindex(6, 6):
        there, here = (moved(poses, k, axis, by) for by in (step, -step))
        slope = jacobian(at, k, axis)
        if kind == "steady":  # velocities depend on all poses
            change = (rates_at(links, there) - rates_at(links, here)) / (2.0 * step)
            slope[:, :6] -= links.seconds[:, None] * change[links.first]
            slope[:, 6:] += change[links.first + 1] - change[links.first]
        expected = (links.at(there).error - links.at(here).error) / (2.0 * step)
        np.testing.assert_allclose(slope, expected, atol=2e-5 if kind == "odometry" else 2e-4)


def test_a_constant_velocity_has_no_error():
    times = np.array([0.0, 0.1, 0.15, 0.4])
    turning = exp(times[:, None] * np.array([0.0, 0.3, 0.1, 0.0, 0.0, 0.0]))
    turning[:, :3, 3] = times[:, None] * [0.7, 0.1, 0.0]
    links = Motion(times).links(np.arange(4))
    np.testing.assert_allclose(links.at(turning).error, 0.0, atol=1e-8)


def test_drift_over_several_steps_is_the_sum_of_the_steps():
    """Covariances of long links against random paths, which share no code with sums of adjoints."""
    rng = np.random.default_rng(5)
    times = np.arange(41) / 20.0
    step = exp(np.array([0.0, 0.02, 0.0, 0.0, 0.0, 0.05]))
    path = [np.eye(4)]
    for _ in times[1:]:
        path.append(path[-1] @ step)
    motion = Motion.by_odometry(times, Trajectory(times, np.stack(path)))
    far = 0.05 + 0.3 * 0.02 + 0.01 * 0.05
    ends = np.tile(np.eye(4), (20000, 1, 1))
    for _ in times[1:]:
        off = rng.normal(size=(20000, 6)) * np.sqrt(far) * np.repeat(motion.spread, 3)
        ends = ends @ (step @ exp(off))
    links = motion.links(np.array([0, 40]))
    links = replace(links, by_bias=0.0 * links.by_bias)
    error = np.array([links.at(np.stack([np.eye(4), end])).error[0] for end in ends[:4000]])
    square = np.einsum("mi,ij,mj->m", error, links.information[0], error)
    assert square.mean() == pytest.approx(6.0, abs=0.25)


def test_the_bias_of_odometry_is_found():
    times = np.arange(201) / 20.0
    step, lean = np.array([0.0, 0.02, 0.0, 0.0, 0.0, 0.05]), np.array([0.0, 0.002, 0.0, 0.0, 0.0, 0.01])
    far = 0.05 + 0.3 * 0.02 + 0.01 * 0.05
    path, true = [np.eye(4)], [np.eye(4)]
    for _ in times[1:]:
        true.append(true[-1] @ exp(step))
        path.append(path[-1] @ exp(step) @ exp(-far * lean))
    motion = Motion.by_odometry(times, Trajectory(times, np.stack(path)))
    motion = replace(motion, spread=(1e-4, 1e-4))
    at = motion.links(np.arange(0, 201, 10)).at(np.stack(true)[::10])
    np.testing.assert_allclose(at.bias * np.repeat(BIAS, 3), lean, rtol=0.02, atol=1e-6)  # of the odometer's metres


FEW_LINKS = [(100.0, 1.0, "gaps up to 1 s, but the frames have 100 to 104 s"), (0.5, 1.5, "gaps of at most 1 s")]


@pytest.mark.parametrize(("later", "apart", "said"), FEW_LINKS)
def test_odometry_that_links_few_frames_is_refused(later, apart, said):
    drive = Trajectory(apart * np.arange(5.0), np.tile(np.eye(4), (5, 1, 1)))
    with pytest.raises(InputError, match=said):
        Motion.by_odometry(later + np.arange(5.0), drive)


def test_odometry_does_not_link_frames_across_a_gap():
    times = np.array([0.0, 0.1, 0.2, 5.0, 5.1])
    drive = Trajectory(times, np.tile(np.eye(4), (5, 1, 1)))
    motion = Motion.by_odometry(times, drive)
    assert motion.follows(np.arange(5)).tolist() == [True, True, False, True]


def test_frames_far_apart_in_time_are_not_linked_by_their_velocity():
    motion = Motion(np.array([0.0, 0.1, 5.0, np.nan, 5.1]))
    assert motion.follows(np.arange(5)).tolist() == [True, False, False, False]
    assert not Motion(np.full(3, np.nan)).follows(np.arange(3)).any()


@pytest.mark.parametrize(
    ("written", "seconds"),
    [
        (("0.5", "1.25"), (0.5, 1.25)),
        (("1527206460042570304", "1527206460542570304"), (1527206460.0425703, 1527206460.5425703)),
        (("1527206460042", "1527206460542"), (1527206460.042, 1527206460.542)),
        (("a.jpg", "b.jpg"), (np.nan, np.nan)),
    ],
)
def test_times_are_seconds(written, seconds):
    np.testing.assert_allclose(seconds_of(written), seconds, atol=1e-6, rtol=0.0)
