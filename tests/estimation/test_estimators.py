import sys
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from support.paper import paper_camera, paper_room, paper_scene

from lmd.core.checks import InputError
from lmd.estimation.cramer_rao import CramerRaoBound, cramer_rao_bound, cramer_rao_map, pose_information
from lmd.estimation.flights import Pace, RandomMotion
from lmd.estimation.fusion import InvariantKalmanFilter
from lmd.estimation.observer import Observer
from lmd.estimation.pnp import PerspectiveNPoint
from lmd.estimation.recording import Flight, Odometry, Recording, record
from lmd.estimation.sensors import PointDetector, detected
from lmd.geometry import se3
from lmd.geometry.projection import project
from lmd.scene.deployment_sources import UniformDeployment
from lmd.sight.evaluator import Evaluator
from lmd.sight.views import visible

SCENE = paper_scene()
BENT = paper_camera(distortion=(-0.15, 0.02, 0.002, -0.003))
PRISM = paper_camera(distortion=(0.15, -0.04, 0.001, 0.0, 0.004, 0.5, -0.07, 0.006, 0.001, 0.0, -0.002, 0.001))
FISHEYE = paper_camera(distortion=(0.01, -0.005, 0.002, -0.0005), distortion_model="equidistant")
CAMERAS = {"pinhole": SCENE.camera, "plumb bob": BENT, "rational": PRISM, "fisheye": FISHEYE}
EVALUATOR = Evaluator(SCENE, threads=1)
UNIFORM = UniformDeployment(90).draw(SCENE.room, np.random.default_rng(0))
FLIGHT = RandomMotion(20.0, Pace(1.0, 1.0, 20.0)).draw(SCENE, np.random.default_rng(3))


def flight(trajectory=FLIGHT, seed=0, all_visible=False):
    return Flight(EVALUATOR, UNIFORM, trajectory, np.random.default_rng(seed), all_visible)


def recorded(detector=None, flights=(FLIGHT,), seed=0, all_visible=False):
    flown = [flight(trajectory, [seed, i], all_visible) for i, trajectory in enumerate(flights)]
    return record(detector or PointDetector(), flown)


def spread_out(frames, detector, count=8, seed=0):
    """A camera at rest, `frames` times, before `count` landmarks that fill its view."""
    rng = np.random.default_rng(seed)
    pose = se3.camera_pose([1.0, 2.0, 3.0], 0.4, 0.2)
    ray = np.column_stack([rng.uniform(-0.5, 0.5, (count, 2)), np.ones(count)])
    points = ray * rng.uniform(1.5, 3.0, (count, 1))
    poses, points = np.tile(pose, (1, frames, 1, 1)), np.tile(points, (1, frames, 1, 1))
    measured = detector.measured(points, SCENE.camera, rng)
    return Recording(
        0.05 * np.arange(frames),
        poses,
        np.zeros((1, frames - 1, 6)),
        Odometry(),
        se3.act(pose, points[:, 0]),
        SCENE.camera,
        np.ones((1, frames, count), dtype=bool),
        measured,
        np.full(frames * count, detector.pixel_noise),
        detector.covariance(measured.reshape(-1, 3), SCENE.camera),
    )


def start_near(recording, size=0.3):
    return recording.poses[:, 0] @ se3.exp(np.full(6, size))


def test_a_recording_has_what_the_optimiser_counts():
    recording = recorded()
    poses = FLIGHT.poses
    assert_array_equal(recording.seen[0], visible(EVALUATOR, UNIFORM, poses[:, :3, 3], poses[:, :3, 2]))
    s, t, k = np.argwhere(recording.seen)[100]
    assert_allclose(se3.act(poses[t], recording.points[s, t, k][None])[0], UNIFORM.positions[k])
    assert recording.points[s, t, k][2] > 0.0


def test_the_twists_lead_from_each_pose_to_the_next():
    recording = recorded()
    steps = np.diff(recording.time)[:, None] * recording.twists[0]
    assert_allclose(FLIGHT.poses[:-1] @ se3.exp(steps), FLIGHT.poses[1:], atol=1e-9)


def test_the_share_of_time_counts_each_frame_until_the_next():
    seen = np.zeros((1, 4, 3), dtype=bool)
    seen[0, 1, :2] = seen[0, 3, :3] = True
    recording = replace(recorded(), seen=seen, time=np.array([0.0, 1.0, 4.0, 5.0]))
    assert_array_equal(recording.visible_counts, [[0, 2, 0, 3]])
    assert_allclose([recording.share_visible(n)[0] for n in (0, 1, 2, 3)], [1.0, 0.6, 0.6, 0.0])


def test_all_visible_is_all_visible():
    recording = recorded(all_visible=True)
    assert recording.seen.all()
    assert_allclose(
        se3.act(FLIGHT.poses, recording.points[0]), np.broadcast_to(UNIFORM.positions, (401, 90, 3)), atol=1e-12
    )
    with pytest.raises(InputError, match=r"^all_visible must be false if measurements are not exact"):
        recorded(PointDetector(pixel_noise=0.5), all_visible=True)


def test_missed_detections_are_as_many_as_said():
    seen = np.ones((200, 500), dtype=bool)
    assert 0.29 < 1.0 - detected(seen, 0.3, np.random.default_rng(0)).mean() < 0.31
    assert not detected(seen, 1.0, np.random.default_rng(0)).any()
    assert detected(seen, 0.0, np.random.default_rng(0)).all()


@pytest.mark.parametrize("camera", CAMERAS.values(), ids=CAMERAS)
def test_pixel_noise_is_as_large_as_said(camera):
    detector, focal = PointDetector(pixel_noise=0.8, edge=0.2), camera.focal_pixels
    points = np.tile([0.9, -0.8, 2.0], (20_000, 1))
    measured = detector.measured(points, camera, np.random.default_rng(0))
    image, exact = (project(camera, np.eye(4), p) for p in (measured, points))
    assert_allclose((image - exact).std(axis=0), 0.8, rtol=0.03)
    assert_allclose((image - exact).mean(axis=0), 0.0, atol=0.03)
    depth = np.linalg.norm(measured, axis=-1) if camera is FISHEYE else measured[:, 2]
    assert_allclose((focal[0] * 0.2 / depth).std(), 0.8, rtol=0.03)
    assert_array_equal(PointDetector().measured(points, SCENE.camera, np.random.default_rng(0)), points)


@pytest.mark.parametrize("camera", CAMERAS.values(), ids=CAMERAS)
def test_the_covariance_is_that_of_what_is_measured(camera):
    detector, points = PointDetector(pixel_noise=0.2, edge=0.3), np.tile([0.9, -0.8, 2.0], (40_000, 1))
    measured = detector.measured(points, camera, np.random.default_rng(0))
    covariance = 0.2**2 * detector.covariance(points[:1], camera)[0]
    whitened = np.linalg.solve(np.linalg.cholesky(covariance), (measured - points).T)
    assert_allclose(np.cov(whitened), np.eye(3), atol=0.03)


@pytest.mark.parametrize("camera", CAMERAS.values(), ids=CAMERAS)
def test_the_information_is_that_of_the_images_slopes(camera):
    recording = spread_out(1, PointDetector())
    pose, landmarks = recording.poses[0, 0], recording.landmarks[0]

    def image(at):
        return project(camera, at, landmarks).ravel()

    steps = [se3.exp(1e-6 * np.array([d, -d])) for d in np.eye(6)]
    slopes = np.array([(image(pose @ plus) - image(pose @ minus)) / 2e-6 for plus, minus in steps])
    information = pose_information([camera], np.eye(4)[None], pose[None], landmarks, recording.seen[0][None])[0]
    assert_allclose(information, slopes @ slopes.T, rtol=1e-5, atol=1e-3)
    position, attitude = cramer_rao_bound(information)
    variance = np.diag(np.linalg.inv(slopes @ slopes.T))
    assert_allclose([attitude**2, position**2], [variance[:3].sum(), variance[3:].sum()], rtol=1e-4)


def test_information_adds_up_and_nothing_seen_is_none():
    recording = spread_out(4, PointDetector(), count=5)
    seen = np.array([[0, 0, 0, 0, 0], [1, 1, 0, 0, 0], [0, 0, 1, 1, 1], [1, 1, 1, 1, 1]], dtype=bool)
    nothing, first, second, both = pose_information(
        [SCENE.camera], np.eye(4)[None], recording.poses[0], recording.landmarks[0], seen[None]
    )
    assert_array_equal(nothing, np.zeros((6, 6)))
    assert_allclose(first + second, both)


@pytest.mark.parametrize("count", [0, 1, 2, 3, 4])
def test_the_bound_is_finite_from_three_landmarks_on(count):
    recording = spread_out(1, PointDetector(pixel_noise=1.0))
    recording = replace(recording, seen=np.arange(8)[None, None] < count, noise=recording.noise[:count])
    errors = CramerRaoBound().errors(recording, start_near(recording))
    assert np.isfinite(errors.position[0, 0]) == np.isfinite(errors.attitude[0, 0]) == (count >= 3)
    assert errors.available[0] == (count >= 3)


def test_three_landmarks_in_line_do_not_fix_a_pose():
    pose = se3.camera_pose([1.0, 2.0, 3.0], 0.4, 0.2)
    in_line = se3.act(pose, np.array([[-0.5, 0.1, 2.0], [0.0, 0.2, 2.0], [0.5, 0.3, 2.0]]))
    information = pose_information(
        [SCENE.camera], np.eye(4)[None], pose[None], in_line, np.ones((1, 3), dtype=bool)[None]
    )
    assert np.linalg.matrix_rank(information[0], tol=1e-6) == 5
    assert np.isinf(cramer_rao_bound(information)[0])


def test_the_bound_is_proportional_to_the_noise():
    one, two = (CramerRaoBound().errors(spread_out(1, PointDetector(sigma)), None) for sigma in (1.0, 2.0))
    assert_allclose(2.0 * one.position, two.position)
    assert_allclose(4.0 * one.frobenius, two.frobenius)


def test_pnp_finds_exact_poses_and_only_from_four_landmarks_on():
    pytest.importorskip("cv2")
    recording = recorded()
    errors = PerspectiveNPoint().errors(recording, start_near(recording))
    assert_array_equal(np.isfinite(errors.position), recording.visible_counts >= 4)
    assert np.nanmedian(errors.position) < 1e-4
    assert np.nanmedian(errors.attitude) < 1e-4


def test_pnp_reaches_the_bound():
    pytest.importorskip("cv2")
    recording = spread_out(600, PointDetector(pixel_noise=0.5))
    pnp = PerspectiveNPoint().errors(recording, None)
    bound = CramerRaoBound().errors(recording, None)
    assert 0.93 < np.sqrt((pnp.position**2).mean()) / bound.position[0, 0] < 1.07
    assert 0.93 < np.sqrt((pnp.attitude**2).mean()) / bound.attitude[0, 0] < 1.07
    assert 0.87 < pnp.frobenius.mean() / bound.frobenius[0, 0] < 1.15


def test_the_kalman_filter_converges_and_averages_the_noise():
    pytest.importorskip("gtsam")
    recording = recorded(PointDetector(pixel_noise=0.5))
    start = start_near(recording)
    kalman = InvariantKalmanFilter(attitude=0.3, position=0.3).errors(recording, start)
    observer = Observer().errors(recording, start)
    late = slice(300, None)
    assert_allclose(kalman.frobenius[:, 0], observer.frobenius[:, 0])
    assert np.median(kalman.position[0, late]) < 0.3 * np.median(observer.position[0, late])
    assert np.median(kalman.position[0, late]) < 0.005
    assert np.median(kalman.attitude[0, late]) < 0.002


def test_a_missing_package_is_named(monkeypatch):
    monkeypatch.setitem(sys.modules, "cv2", None)
    with pytest.raises(InputError, match=r"needs the package cv2: .*pip install .*\[estimators\]'"):
        PerspectiveNPoint()


def test_a_filter_without_spread_is_refused():
    with pytest.raises(InputError, match=r"^attitude must be greater than 0"):
        InvariantKalmanFilter(attitude=0.0, position=1.0)


@pytest.mark.parametrize(
    ("change", "message"),
    [({"pixel_noise": -1.0}, "pixel_noise"), ({"missed": 1.5}, "missed"), ({"edge": 0.0}, "edge")],
)
def test_a_bad_detector_is_refused(change, message):
    with pytest.raises(InputError, match=rf"^{message} must be"):
        PointDetector(**change)


@pytest.fixture(scope="module")
def coarse():
    scene = paper_scene(paper_room(spacing=2.0))
    return scene, Evaluator(scene, threads=1)


def test_the_map_is_the_bound_of_every_pose(coarse, tmp_path):
    scene, evaluator = coarse
    bounds = cramer_rao_map(scene, evaluator, UNIFORM)
    here, orientations = evaluator.positions[5], scene.pdf
    poses = se3.camera_pose(here, orientations.yaw, orientations.pitch)
    seen = visible(evaluator, UNIFORM, poses[:, :3, 3], poses[:, :3, 2])
    position, attitude = cramer_rao_bound(
        pose_information([scene.camera], np.eye(4)[None], poses, UNIFORM.positions, seen[None])
    )
    finite = np.isfinite(position)
    assert_allclose(bounds.share[5], finite.mean())
    assert np.isclose(np.sort(position[finite]), bounds.position[5], rtol=1e-6).any()
    assert abs((position[finite] <= bounds.position[5] * (1 + 1e-6)).mean() - 0.5) < 0.1
    assert abs((attitude[finite] <= bounds.attitude[5] * (1 + 1e-6)).mean() - 0.5) < 0.1

    metrics = bounds.metrics()
    assert metrics["pose_fixed_share"] == bounds.share.mean()
    assert metrics["position_bound_mm_per_pixel"] == 1e3 * np.median(bounds.position)
    bounds.to_csv(tmp_path / "map.csv")
    table = pd.read_csv(tmp_path / "map.csv")
    assert list(table) == ["x", "y", "z", "share", "position", "attitude"]
    assert_allclose(table.position, bounds.position)


def test_where_no_frame_fixes_the_pose_there_is_no_bound(coarse, tmp_path):
    scene, evaluator = coarse
    bounds = cramer_rao_map(scene, evaluator, UniformDeployment(2).draw(scene.room, np.random.default_rng(0)))
    assert (bounds.share == 0.0).all()
    assert np.isinf(bounds.position).all()
    assert bounds.metrics() == {"pose_fixed_share": 0.0}
    bounds.to_csv(tmp_path / "map.csv")
    assert pd.read_csv(tmp_path / "map.csv").position.isna().all()
