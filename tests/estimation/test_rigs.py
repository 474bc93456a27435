"""Estimators of a rig's body from the images of all its cameras; a minute on the first run, for compiling."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose
from support.paper import paper_camera, paper_room, paper_scene

from lmd.estimation.cramer_rao import CramerRaoBound, cramer_rao_bound, pose_information
from lmd.estimation.flights import Pace
from lmd.estimation.fusion import FixedLagSmoother, InvariantKalmanFilter
from lmd.estimation.observer import Observer
from lmd.estimation.pnp import PerspectiveNPoint
from lmd.estimation.recording import Flight, record
from lmd.estimation.sensors import PointDetector, TagDetector, corners_of
from lmd.geometry.pose import PointImage, body_solutions
from lmd.geometry.projection import project
from lmd.geometry.se3 import axis_and_right, camera_pose, exp
from lmd.scene import pdf
from lmd.scene.deployment_sources import UniformDeployment
from lmd.scene.rig import Mount, Rig
from lmd.scene.tag import Tag
from lmd.sight.evaluator import Evaluator

FRONT, WIDE = paper_camera(), paper_camera(focal_length=3.5, distortion=(-0.05, 0.01, 0.001, -0.001))
RIG = Rig((
    Mount(FRONT, (0.2, 0.0, 0.1), pitch=-0.1),
    Mount(WIDE, (-0.2, 0.05, 0.1), yaw=2.4, roll=0.2),
))  # fmt: skip
SCENE = replace(paper_scene(paper_room(), camera=RIG, orientations=pdf.level_flight()), tag=Tag(0.2))
UNIFORM = UniformDeployment(60).draw(SCENE.room, np.random.default_rng(0))
EVALUATOR = Evaluator(SCENE, SCENE.room.grid()[:1], threads=1)
NOISE = 0.5


@pytest.fixture(scope="module")
def flight():
    pace = Pace(speed=1.0, turn_rate=0.6, frame_rate=30.0)
    path = pace.through(np.array([[2.0, 2.0, 2.0, 0.0, 0.0], [5.0, 3.0, 3.5, 1.0, 0.1]]))
    return Flight(EVALUATOR, UNIFORM, path, np.random.default_rng(1))


def test_extrinsics_are_the_views_of_the_rig():
    poses = camera_pose(
        np.zeros((5, 3)), [0.0, 1.0, -2.0, 3.0, 0.4], [0.0, 0.3, -0.5, 1.0, 0.2], [0.0, 0.1, 2.0, -1.0, 0]
    )
    offsets, turned = RIG.views(axis_and_right(poses))
    for c, mounted in enumerate(RIG.extrinsics):
        assert_allclose((poses @ mounted)[:, :3, 3], offsets[c], atol=1e-11)
        assert_allclose(axis_and_right(poses @ mounted), turned[c], atol=1e-11)


def images(pose, rng, noise):
    """Up to four tags before the first camera and two before the second, with noise on every corner."""
    found, tags = [], corners_of(UNIFORM, SCENE.tag)
    for camera, mounted, most in zip(RIG.cameras, RIG.extrinsics, (4, 2), strict=True):
        pixels = project(camera, pose @ mounted, tags)
        inside = ((pixels > 0.0) & (pixels < [1600.0, 1200.0])).all(axis=(1, 2))
        some = np.flatnonzero(inside)[:most]
        there = pixels[some].reshape(-1, 2)
        there = there + rng.normal(0.0, noise, there.shape)
        found.append(PointImage(camera, mounted, tags[some].reshape(-1, 3), there, np.full(len(there), NOISE)))
    return found


POSE = camera_pose(np.array([3.5, 2.5, 3.0]), 0.4, 0.05)


def test_pnp_of_all_images_reaches_the_bound_of_their_sum():
    rng, draws = np.random.default_rng(0), 250
    exact = images(POSE, rng, 0.0)
    counts = [len(image.points) for image in exact]
    assert min(counts) >= 4
    found = np.stack([body_solutions(images(POSE, rng, NOISE))[0].pose for _ in range(draws)])
    points = np.concatenate([image.points for image in exact])
    seen = np.repeat(np.eye(2, dtype=bool), counts, axis=1)[:, None]
    (both, _), (alone, _) = (
        cramer_rao_bound(NOISE**-2 * pose_information(RIG.cameras, RIG.extrinsics, POSE[None], points, its))
        for its in (seen, seen & np.array([True, False])[:, None, None])
    )
    off = found[:, :3, 3] - POSE[:3, 3]
    assert 0.92 <= np.sqrt((off**2).sum(axis=1).mean()) / both[0] <= 1.08
    assert both[0] < 0.8 * alone[0]  # which test_estimators reaches


def test_the_information_is_that_of_differences_of_all_pixels():
    def all_pixels(pose):
        return np.concatenate([
            project(image.camera, pose @ image.mounted, image.points).ravel() for image in images(POSE, rng, 0.0)
        ])  # fmt: skip

    rng, step = np.random.default_rng(0), 1e-6
    slopes = [(all_pixels(POSE @ exp(step * w)) - all_pixels(POSE @ exp(-step * w))) / (2 * step) for w in np.eye(6)]
    exact = images(POSE, rng, 0.0)
    points = np.concatenate([image.points for image in exact])
    seen = np.repeat(np.eye(2, dtype=bool), [len(image.points) for image in exact], axis=1)[:, None]
    told = pose_information(RIG.cameras, RIG.extrinsics, POSE[None], points, seen)[0]
    assert_allclose(told, np.array(slopes) @ np.array(slopes).T, rtol=1e-5, atol=1e-4 * told.max())


def test_every_estimator_follows_the_body(flight):
    tags = record(TagDetector(SCENE.tag, "apriltag"), [flight])
    assert tags.seen.shape[-1] == 2 * len(UNIFORM)
    assert (tags.visible_counts <= tags.seen.sum(axis=-1)).all()
    start = flight.poses[:1]
    bound = CramerRaoBound().errors(tags, start)
    pnp = PerspectiveNPoint().errors(tags, start)
    known = np.isfinite(pnp.position[0]) & np.isfinite(bound.position[0])
    assert known.mean() > 0.5
    assert np.sqrt(((pnp.position[0, known] / bound.position[0, known]) ** 2).mean()) == pytest.approx(1.0, abs=0.15)
    for estimator in (InvariantKalmanFilter(0.1, 0.1), FixedLagSmoother(0.1, 0.1)):
        assert np.nanmedian(estimator.errors(tags, start).position[0, 10:]) < 0.02


def test_the_observer_and_points_take_the_body_too(flight):
    exact = record(PointDetector(), [flight])
    wrong = flight.poses[:1] @ exp(np.array([[0.05, 0.1, 0.0, 0.1, 0.0, 0.1]]))
    errors = Observer().errors(exact, wrong)
    assert errors.frobenius[0, -1] < 0.1 * errors.frobenius[0, 0]
    points = exact.points[0][exact.seen[0]]
    frame, slot = np.nonzero(exact.seen[0])
    world = (flight.poses[frame] @ np.pad(points, ((0, 0), (0, 1)), constant_values=1.0)[..., None])[:, :3, 0]
    assert_allclose(world, UNIFORM.positions[slot % len(UNIFORM)], atol=1e-9)
