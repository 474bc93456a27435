"""Rigs: what is refused, where the cameras are, and scenes whose score a hand calculation gives."""

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from contracts.criterion import check_gains, check_slack
from numpy.testing import assert_allclose, assert_array_equal
from support.paper import chances, facing, one_position_room, paper_camera, paper_scene
from support.rooms import L_SHAPE
from support.tables import rows

from lmd.core.checks import InputError
from lmd.evaluation.bounds import Search, fitness_upper_bound
from lmd.evaluation.validation import Sample, validation_metrics
from lmd.evaluation.verdicts import causes, verdicts
from lmd.formats.rigs import read_mounts, rig_of
from lmd.geometry.frames import rotation
from lmd.objectives.coverage import Coverage
from lmd.problem import Problem
from lmd.scene import pdf
from lmd.scene.deployment import Deployment
from lmd.scene.deployment_sources import RandomDeployment, UniformDeployment
from lmd.scene.pdf import OrientationPdf
from lmd.scene.rig import Mount, Rig
from lmd.sight.evaluator import Evaluator
from lmd.sight.poses import candidate_poses, covered_amounts, gains
from lmd.sight.reference import counts, coverage_caps
from lmd.space.cuboid import Cuboid
from lmd.space.floor_plan import FloorPlan
from lmd.space.parts import Reachable
from lmd.space.prism import Prism

CAMERA = paper_camera()  # sees 34.84 degrees around its axis
FILES = Path(__file__).with_name("files")
HERE = np.array([2.0, 2.0, 2.0])
AHEAD = facing(HERE, [3.9, 2.0, 2.0])  # one landmark, 1.9 m away
YAWS = 72
SEEN = 13  # of 72 yaws: -30 to 30 degrees in steps of 5


def scene_with(*mounts, camera=None, **changes):
    parts = {"room": one_position_room(), "orientations": pdf.level_flight(YAWS // 2), **changes}
    return replace(paper_scene(**parts), camera=Rig(mounts) if mounts else camera or CAMERA)


def around(count):
    return [Mount(CAMERA, yaw=2.0 * math.pi * i / count) for i in range(count)]


def probability(scene, deployment, n):
    found = chances(Evaluator(scene, threads=1), deployment, n)
    by_hand = (counts(scene, deployment) >= n) @ scene.pdf.weight
    assert_allclose(found, by_hand, atol=1e-12)
    return float(found[0])


def test_where_cameras_are_mounted_agrees_with_what_they_look_at():
    rig = Rig(
        (Mount(paper_camera(), (0.1, 0.2, 0.3), yaw=0.4, pitch=0.1), Mount(paper_camera(), (0.0, -0.1, 0.0), roll=0.3))
    )
    body = np.array([[1.0, 0.0, 0.0, 0.0, -1.0, 0.0]])
    offsets, looking = rig.views(body)
    first, second = (
        np.column_stack([view[0, 3:], np.cross(view[0, :3], view[0, 3:]), view[0, :3]]) for view in looking
    )
    assert_allclose(rig.mounted[0], np.eye(4), atol=1e-12)
    assert_allclose(rig.mounted[1, :3, :3], first.T @ second, atol=1e-12)
    assert_allclose(rig.mounted[1, :3, 3], first.T @ (offsets[1] - offsets[0])[0], atol=1e-9)


@pytest.mark.parametrize(
    ("mounts", "n", "share"),
    [
        ([], 1, SEEN / YAWS),
        (around(2), 1, 2 * SEEN / YAWS),
        (around(3), 1, 3 * SEEN / YAWS),
        (around(6), 1, 1.0),  # 60 degrees apart, each 69.7 wide
        ([Mount(CAMERA), Mount(CAMERA)], 1, SEEN / YAWS),
        ([Mount(CAMERA), Mount(CAMERA)], 2, 0.0),  # what both see counts once
    ],
)
def test_each_camera_adds_its_share_of_one_landmark(mounts, n, share):
    assert probability(scene_with(*mounts), AHEAD, n) == pytest.approx(share, abs=1e-12)


def test_a_camera_beside_the_body_sees_past_a_pillar():
    pillar = {"low": [2.0, 0.9, 0.0], "high": [2.2, 1.1, 2.5]}
    room = Prism(FloorPlan(L_SHAPE, 2.5, obstacles=[pillar]), Reachable((1.0, 1.0), 0.3), 0.5)
    mark = Deployment([[3.0, 1.0, 1.0]], [[-1.0, 0.0, 0.0]])
    body, forward = np.array([1.5, 1.0, 1.0]), np.array([[1.0, 0.0, 0.0, 0.0, -1.0, 0.0]])
    for aside, seen in ((0.0, False), (0.1, False), (0.3, True), (-0.3, True)):
        scene = scene_with(Mount(CAMERA, (0.0, aside, 0.0)), room=room, thold=0.1)
        assert coverage_caps(scene, mark, body, forward)[0, 0] == seen
    # To the left of a body that looks along +x is +y: from there a landmark hides behind the pillar's other side.
    left = scene_with(Mount(CAMERA, (0.0, 0.3, 0.0)), room=room, thold=0.1)
    behind = Deployment([[3.0, 0.7, 1.0]], [[-1.0, 0.0, 0.0]])
    assert not coverage_caps(left, behind, body, forward)[0, 0]
    assert_array_equal(Evaluator(left, threads=1).counts(mark), counts(left, mark))


@pytest.mark.parametrize(("mount", "axis"), rows(__file__, "angles of ROS"))
def test_the_angles_are_those_of_ros(mount, axis):
    offsets, turned = Rig((Mount(CAMERA, (0.1, 0.2, 0.3), **mount),)).views(np.array([[1.0, 0, 0, 0, -1.0, 0]]))
    assert_allclose(turned[0, 0, :3], axis, atol=1e-12)
    assert_allclose(offsets[0, 0], [0.1, 0.2, 0.3], atol=1e-12)


def test_the_body_turns_its_cameras_around():
    # An independent way: rotations as matrices, whose rows are the body's right, down and forward.
    angles = np.random.default_rng(0).uniform(-1.5, 1.5, (20, 3))
    turns = rotation(*angles.T)
    mount = Mount(CAMERA, (0.3, -0.1, 0.2), yaw=0.4, pitch=-0.3, roll=1.1)
    offsets, turned = Rig((mount,)).views(np.hstack([turns[:, 2], turns[:, 0]]))
    body = np.stack([turns[:, 2], -turns[:, 0], -turns[:, 1]], axis=-1)  # its columns: forward, left, up
    assert_allclose(offsets[0], body @ mount.translation, atol=1e-11)
    assert_allclose(turned[0, :, :3], body @ mount.rotation[:, 0], atol=1e-12)
    assert_allclose(turned[0, :, 3:], -body @ mount.rotation[:, 1], atol=1e-12)


def test_the_roll_of_the_body_matters_to_what_is_off_its_axis():
    assert not Rig((Mount(CAMERA, (0.2, 0.0, 0.0), roll=0.5),)).needs_roll
    assert Rig((Mount(CAMERA, (0.0, 0.0, 0.1)),)).needs_roll
    assert Rig((Mount(CAMERA, yaw=0.5),)).needs_roll
    rolled = OrientationPdf([math.pi / 2] * 2, [0.0, 0.0], [0.5, 0.5], roll=[0.0, math.pi / 2])
    left = scene_with(Mount(CAMERA, yaw=math.pi / 2), orientations=rolled)
    # Forward is +x. Upright, left is +y; a roll by a quarter turn brings right up, hence left down.
    assert probability(left, facing(HERE, [2.0, 3.9, 2.0]), 1) == pytest.approx(0.5)
    assert probability(left, facing(HERE, [2.0, 2.0, 0.1]), 1) == pytest.approx(0.5)
    assert probability(left, facing(HERE, [2.0, 2.0, 3.9]), 1) == 0.0


def test_a_rig_of_one_camera_in_the_origin_is_that_camera():
    scene = paper_scene()
    rig = replace(scene, camera=Rig((Mount(CAMERA),)))
    deployment = UniformDeployment(60).draw(scene.room, np.random.default_rng(0))
    one, other = Evaluator(scene, threads=1), Evaluator(rig, threads=1)
    assert_array_equal(one.counts(deployment), other.counts(deployment))
    landmarks = deployment.positions[None], deployment.normals[None]
    assert_array_equal(one.units(*landmarks, 2), other.units(*landmarks, 2))
    poses, prices = candidate_poses(scene.room, 1.5), np.random.default_rng(1).random((756, one.axes.shape[1]))
    assert_array_equal(gains(one, poses, prices), gains(other, poses, prices))
    amounts = np.random.default_rng(2).random(len(poses))
    assert_array_equal(covered_amounts(one, poses, amounts), covered_amounts(other, poses, amounts))


def test_what_single_poses_gain_is_what_some_camera_covers():
    scene = scene_with(Mount(CAMERA, (0.2, 0.1, 0.0)), Mount(paper_camera(focal_length=4.0), yaw=2.0), occlusion="none")
    rng = np.random.default_rng(0)
    assert check_gains(scene, RandomDeployment(20).draw(scene.room, rng), rng)
    check_slack(scene, 0.2, rng)


def test_off_the_grid_bounds_and_causes_know_rigs_and_verdicts_refuse_them():
    scene = scene_with(*around(2))
    problem = Problem(scene, Coverage(1, 0.3), RandomDeployment(6), threads=1)
    deployment = problem.draw(np.random.default_rng(0))
    assert 0.0 <= validation_metrics(problem, deployment, 0, Sample(2, 4, 6))["grid_free_qualified_ratio"] <= 1.0
    bound = fitness_upper_bound(problem, 6, Search(spacing=1.0, iterations=20)).walls
    assert bound >= problem.fitness_of(deployment)
    found = causes(scene, deployment, 0)
    assert found.sightings == 2 * 256 * 16 * 6
    assert found.limits["field_of_view"] == "within 34.8 degrees of the optical axis"
    with pytest.raises(InputError, match="works with a single camera, not with a rig of 2"):
        verdicts(scene, deployment, np.eye(4)[None])


def test_a_chain_of_kalibr_is_a_rig_whose_body_is_its_first_camera():
    rig = rig_of(read_mounts(path := FILES / "chain.yaml"))
    assert [camera.focal_pixels[0] for camera in rig.cameras] == pytest.approx([400, 500, 600])
    assert_allclose([mount.translation for mount in rig.mounts], [[0, 0, 0], [0, -0.1, 0], [-0.05, -0.1, 0]])
    right = Mount(CAMERA, yaw=-math.pi / 2.0).rotation
    assert_allclose([mount.rotation for mount in rig.mounts], [np.eye(3), np.eye(3), right], atol=1e-12)
    # On a body that has the first 0.2 m ahead and 0.5 m up, turned to the left.
    turned = rig_of({"path": path, "translation": [0.2, 0.0, 0.5], "yaw": math.pi / 2.0})
    places = [[0.2, 0, 0.5], [0.3, 0, 0.5], [0.3, -0.05, 0.5]]
    assert_allclose([mount.translation for mount in turned.mounts], places, atol=1e-12)
    left = Mount(CAMERA, yaw=math.pi / 2.0).rotation
    assert_allclose([mount.rotation for mount in turned.mounts], [left, left, np.eye(3)], atol=1e-12)


@pytest.mark.parametrize("name", ["imu.yaml", "okvis.yaml"])
def test_cameras_on_an_imu_are_a_rig_too(name):
    rigs = [rig_of(read_mounts(FILES / of)).mounts for of in ("chain.yaml", name)]
    for chained, by_imu in zip(*rigs, strict=False):
        assert_allclose(by_imu.translation, chained.translation, atol=1e-12)
        assert_allclose(by_imu.rotation, chained.rotation, atol=1e-12)


@pytest.mark.parametrize(
    ("ahead", "room"),
    [
        (2.5, one_position_room()),
        (0.5, Cuboid((4.0, 4.0, 4.0), (3.6, 3.6, 3.6), 0.9)),  # the grid keeps 0.65 m from the walls, the body 0.2 m
    ],
)
def test_a_camera_outside_the_room_is_refused(ahead, room):
    scene = scene_with(Mount(CAMERA, (ahead, 0.0, 0.0)), room=room)
    with pytest.raises(InputError, match=r"rig has a camera at .*, outside the room"):
        Problem(scene, Coverage(1, 0.3), RandomDeployment(6), threads=1)
