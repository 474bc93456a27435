"""Estimators that weigh odometry against landmarks, and PnP with what makes it doubtful."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy.stats import chi2
from support.paper import paper_scene

from lmd.core.checks import InputError
from lmd.estimation.cramer_rao import CramerRaoBound, cramer_rao_bound, pose_information
from lmd.estimation.flights import Pace, RandomMotion
from lmd.estimation.fusion import FixedLagSmoother, InvariantKalmanFilter
from lmd.estimation.pnp import PerspectiveNPoint
from lmd.estimation.recording import Flight, Odometry, record
from lmd.estimation.sensors import PointDetector, TagDetector, corners_of, observation
from lmd.geometry import se3
from lmd.geometry.pose import solutions
from lmd.geometry.projection import project
from lmd.scene.deployment import Deployment
from lmd.scene.deployment_sources import UniformDeployment
from lmd.scene.tag import Tag
from lmd.sight.evaluator import Evaluator

pytest.importorskip("gtsam")

SCENE = paper_scene()
CAMERA = SCENE.camera
EVALUATOR = Evaluator(SCENE, threads=1)
UNIFORM = UniformDeployment(90).draw(SCENE.room, np.random.default_rng(0))
FLIGHTS = [RandomMotion(15.0, Pace(1.0, 1.0, 20.0)).draw(SCENE, np.random.default_rng(i)) for i in range(10)]
DRIFT = Odometry(0.005, 0.02)
TAG = Tag(0.1)


def recorded(detector, odometry=None, flights=FLIGHTS):
    flown = [Flight(EVALUATOR, UNIFORM, flight, np.random.default_rng([9, i])) for i, flight in enumerate(flights)]
    return record(detector, flown, odometry)


def start_of(recording, spread):
    drawn = np.random.default_rng(1).normal(size=(len(recording.poses), 6))
    return recording.poses[:, 0] @ se3.exp(spread * drawn)


def test_odometry_drifts_as_far_as_said():
    steps = np.full(2000, 0.05)
    twists = np.tile([0.1, 0.2, 0.3, 0.4, 0.5, 0.6], (2000, 1))
    off = np.array([DRIFT.measured(twists, steps, np.random.default_rng(i)) - twists for i in range(200)])
    after = (off * steps[:, None]).sum(axis=1)  # of 100 s
    assert_allclose(after.std(axis=0), 10.0 * np.repeat([0.005, 0.02], 3), rtol=0.2)
    assert_array_equal(Odometry().measured(twists, steps, np.random.default_rng(0)), twists)


def test_the_noise_of_the_odometry_changes_nothing_else():
    exact = recorded(PointDetector(0.5), flights=FLIGHTS[:1])
    drifting = recorded(PointDetector(0.5), DRIFT, FLIGHTS[:1])
    assert_array_equal(exact.points, drifting.points)
    assert_array_equal(exact.twists[0], FLIGHTS[0].twists)
    assert (drifting.twists != exact.twists).all()


def test_the_filter_knows_how_wrong_it_is():
    """The normalised estimation error squared follows a chi-squared distribution of six degrees."""
    recording = recorded(PointDetector(0.5), DRIFT)
    start, kalman = start_of(recording, 0.05), InvariantKalmanFilter(0.05, 0.05)
    squares = np.array([
        [
            error @ np.linalg.solve(covariance, error)
            for (pose, covariance), true in zip(kalman.run(recording, s, start[s]), recording.poses[s], strict=True)
            for error in [se3.log(se3.inverse(pose) @ true)]
        ]
        for s in range(len(start))
    ])  # fmt: skip
    low, high = chi2.ppf([0.005, 0.995], 6 * len(start)) / len(start)
    mean = squares[:, ::20].mean(axis=0)  # of independent flights, a second apart
    assert ((mean > low) & (mean < high)).mean() > 0.9
    assert low < squares.mean() < high
    assert (squares > chi2.ppf(0.99, 6)).mean() < 0.02


def test_a_filter_of_corners_is_surer_than_one_of_positions():
    recording = recorded(TagDetector(TAG), DRIFT, FLIGHTS[:3])
    start = start_of(recording, 0.01)
    points, corners = (InvariantKalmanFilter(0.01, 0.01, measured=by) for by in ("points", "corners"))
    for s in range(len(start)):
        (_, one), (_, other) = (list(kalman.run(recording, s, start[s]))[-1] for kalman in (points, corners))
        assert np.trace(other) < np.trace(one)
    wrong = [np.median(kalman.errors(recording, start).position[:, -60:]) for kalman in (points, corners)]
    assert wrong[1] < wrong[0]
    with pytest.raises(InputError, match="measured must be one of points, corners"):
        InvariantKalmanFilter(0.01, 0.01, measured="edges")


@pytest.mark.parametrize("odometry", [DRIFT, Odometry()])
@pytest.mark.parametrize("detector", [PointDetector(0.5), TagDetector(TAG, "aruco")])
def test_the_smoother_follows_the_camera_from_afar(detector, odometry):
    recording = recorded(detector, odometry, FLIGHTS[:4])
    start = recording.poses[:, 0] @ se3.exp(np.array([0.6, 0.5, 0.6, 0.6, 0.5, 0.6]))
    smoother, kalman = (
        kind(1.0, 1.0).errors(recording, start).position for kind in (FixedLagSmoother, InvariantKalmanFilter)
    )
    assert_allclose(smoother[:, 0], np.linalg.norm(start[:, :3, 3] - recording.poses[:, 0, :3, 3], axis=1))
    assert np.median(smoother[:, 150:]) < 0.025
    assert np.median(smoother[:, 150:]) < 1.05 * np.median(kalman[:, 150:])


def tags_before(camera_at, centres, normals):
    """World corners and exact images of upright tags, for a camera at the origin that looks along y."""
    deployment = Deployment(np.array(centres, dtype=float), np.array(normals, dtype=float))
    corners = corners_of(deployment, TAG)
    return corners, project(CAMERA, camera_at, corners.reshape(-1, 3)).reshape(-1, 4, 2)


LOOKING = se3.camera_pose([0.0, 0.0, 0.0], 0.0, 0.0)


@pytest.mark.slow
def test_pnp_on_three_tags_is_as_exact_as_the_fisher_information():
    corners, exact = tags_before(LOOKING, [[-0.8, 3.0, 0.4], [0.9, 2.5, -0.3], [0.1, 2.0, 0.6]],
                                 [[0.6, -0.8, 0.0], [-0.6, -0.8, 0.0], [0.0, -0.8, -0.6]])  # fmt: skip
    world, sigma, rng = corners.reshape(-1, 3), 0.5, np.random.default_rng(0)
    off = np.array([
        se3.log(se3.inverse(LOOKING) @ solutions(CAMERA, world, exact.reshape(-1, 2) + noise)[0].pose)
        for noise in rng.normal(scale=sigma, size=(1000, 12, 2))
    ])  # fmt: skip
    information = pose_information([CAMERA], np.eye(4)[None], LOOKING[None], world, np.ones((1, 12), dtype=bool)[None])[
        0
    ]
    position, attitude = (sigma * bound for bound in cramer_rao_bound(information))
    assert 0.95 < np.sqrt((off[:, 3:] ** 2).sum(axis=1).mean()) / position < 1.05
    assert 0.95 < np.sqrt((off[:, :3] ** 2).sum(axis=1).mean()) / attitude < 1.05
    whitened = np.linalg.cholesky(information).T @ off.T / sigma  # the whole covariance, not only its traces
    assert_allclose(np.cov(whitened), np.eye(6), atol=0.15)


def test_the_bound_of_tags_is_that_of_their_corners():
    recording = recorded(TagDetector(TAG, "aruco"), flights=FLIGHTS[:1])
    errors = CramerRaoBound().errors(recording, None)
    assert_array_equal(np.isfinite(errors.position[0]), recording.visible_counts[0] >= 1)
    t = int(np.argmax(recording.visible_counts[0] >= 2))
    seen, noise = recording.seen[0, t], recording.noise[recording.detections(0, t, t + 1)]
    parts = [
        pose_information(
            [CAMERA], np.eye(4)[None], recording.poses[0, t][None], tag, np.ones((1, 4), dtype=bool)[None]
        )[0]
        / sigma**2
        for tag, sigma in zip(recording.tags[0, seen], noise, strict=True)
    ]
    assert_allclose(errors.position[0, t], cramer_rao_bound(np.sum(parts, axis=0))[0], rtol=1e-6)


@pytest.mark.parametrize("scale", [1e-3, 1.0, 1e3])
def test_whether_there_is_a_bound_does_not_depend_on_the_unit_of_length(scale):
    rng = np.random.default_rng(0)
    unit = np.repeat([1.0, scale], 3)
    jacobians = rng.normal(size=(200, 6, 6))
    fixed = np.swapaxes(jacobians, 1, 2) @ jacobians
    jacobians[:, :, 5] = jacobians[:, :, 2] - jacobians[:, :, 0]
    loose = np.swapaxes(jacobians, 1, 2) @ jacobians
    assert np.isfinite(cramer_rao_bound(unit[:, None] * fixed * unit)[0]).all()
    assert np.isinf(cramer_rao_bound(unit[:, None] * loose * unit)[0]).all()


def doubtful(frames=40):
    """A camera that stands before one small tag, after a frame with three, and its true pose."""
    centres = [[0.3, 5.0, 0.2], [-0.8, 3.0, 0.4], [0.9, 2.5, -0.3]]
    corners, exact = tags_before(LOOKING, centres, [[0.28, -0.96, 0.0], [0.6, -0.8, 0.0], [-0.6, -0.8, 0.0]])
    seen = np.zeros((frames, 3), dtype=bool)
    seen[:, 0], seen[0] = True, True
    _, k = np.nonzero(seen)
    sigma = np.full(len(k), 0.5)
    found = exact[k] + np.random.default_rng(0).normal(scale=0.5, size=(len(k), 4, 2))
    observed = observation(CAMERA, np.full(3, TAG.size), seen, found, sigma)
    template = recorded(TagDetector(TAG), flights=FLIGHTS[:1])
    return replace(
        template,
        time=0.1 * np.arange(frames),
        poses=np.tile(LOOKING, (1, frames, 1, 1)),
        twists=np.zeros((1, frames - 1, 6)),
        landmarks=np.array(centres)[None],
        seen=observed.seen[None],
        points=observed.points[None],
        noise=observed.noise,
        covariance=observed.covariance,
        tags=corners[None],
        corners=observed.corners,
    )


def test_a_single_tag_leaves_doubt_that_odometry_settles():
    recording = doubtful()
    by_odometry = PerspectiveNPoint().errors(recording, None)
    assert by_odometry.available[0] == 1.0
    best = [
        solutions(CAMERA, recording.tags[0, 0], recording.corners[recording.detections(0, t, t + 1)][0])[0].pose
        for t in range(1, 40)
    ]
    turned = se3.angle_between(LOOKING, np.array(best))
    assert (turned > 0.2).any()  # the image alone takes the wrong side now and then
    assert np.median(by_odometry.attitude[0, 1:]) < np.median(turned)
    assert (by_odometry.attitude[0, 1:] > 0.2).mean() < (turned > 0.2).mean()


@pytest.mark.slow
def test_four_points_do_not_end_in_a_wrong_minimum():
    rng = np.random.default_rng(2)
    ray = np.column_stack([rng.uniform(-0.5, 0.5, (4, 2)), np.ones(4)])
    world = se3.act(LOOKING, ray * rng.uniform(1.5, 3.0, (4, 1)))
    exact = project(CAMERA, LOOKING, world)
    off = [
        np.linalg.norm(solutions(CAMERA, world, exact + noise)[0].pose[:3, 3])
        for noise in rng.normal(scale=0.5, size=(300, 4, 2))
    ]
    information = pose_information([CAMERA], np.eye(4)[None], LOOKING[None], world, np.ones((1, 4), dtype=bool)[None])[
        0
    ]
    assert max(off) < 8.0 * 0.5 * cramer_rao_bound(information)[0]


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: Odometry(-1.0), "^turn_noise must be at least 0"),
        (lambda: FixedLagSmoother(1.0, 1.0, lag=0.0), "^lag must be greater than 0"),
        (lambda: InvariantKalmanFilter(1.0, 1.0, 0.0), "^least_turn_noise must be greater than 0"),
    ],
)
def test_bad_estimators_are_refused(make, message):
    with pytest.raises(InputError, match=message):
        make()
