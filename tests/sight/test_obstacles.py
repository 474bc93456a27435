from dataclasses import replace

import numpy as np
import pytest
from contracts.criterion import check_counts, check_every_path, check_gains
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_array_equal
from support.paper import paper_scene
from support.rooms import L_SHAPE, lab, prisms
from support.strategies import cameras, fiducials, pdfs, rolled_pdfs, seeds, visibilities
from support.thorough import examples

from lmd.geometry.se3 import axis_and_right, camera_pose
from lmd.objectives.coverage import Coverage
from lmd.objectives.localisation import Localisation
from lmd.optimisers.annealing import Annealing
from lmd.optimisers.ledger import Budget
from lmd.problem import Problem
from lmd.scene import pdf
from lmd.scene.deployment import Deployment
from lmd.scene.deployment_sources import RandomDeployment
from lmd.scene.scene import Scene
from lmd.scene.tag import Tag
from lmd.sight import reference
from lmd.sight.evaluator import Evaluator
from lmd.sight.models.fiducial import Fiducial
from lmd.sight.obstacles import obstacles_at
from lmd.sight.views import visible
from lmd.space.cuboid import Cuboid
from lmd.space.floor_plan import FloorPlan
from lmd.space.parts import Reachable
from lmd.space.prism import Prism

scenes = st.one_of(
    st.builds(Scene, prisms(), cameras(), pdfs, visibilities()),
    st.builds(Scene, prisms(), cameras(), rolled_pdfs(), fiducials()),
)


def landmarks(room, count, seed):
    """Flush, and anywhere else in the room."""
    rng = np.random.default_rng(seed)
    flush, low, high = RandomDeployment(count).draw(room, rng), *room.bounds()
    points, normals = rng.uniform(low, high, (4 * count, 3)), rng.normal(size=(count, 3))
    free = points[room.contains(points)][:count]
    normals = normals[: len(free)] / np.linalg.norm(normals[: len(free)], axis=1, keepdims=True)
    return flush + Deployment(free, normals) if len(free) else flush


def lab_scene(fiducial, room=None):
    scene = paper_scene(room or lab(), orientations=pdf.grid_with_ends(6), thold=0.3, occlusion="line_of_sight")
    return replace(scene, visibility=Fiducial(Tag(0.15)), tag=None) if fiducial else scene


@examples(60)
@given(scenes, seeds)
def test_counts_are_those_of_the_reference(scene, seed):
    check_counts(scene, landmarks(scene.room, 8, seed), 2)


@pytest.mark.parametrize("fiducial", [False, True])
def test_obstacles_take_some_landmarks_away(fiducial):
    scene = lab_scene(fiducial)
    deployment = scene.footprints.draw(RandomDeployment(30), np.random.default_rng(0))
    evaluator = Evaluator(scene, threads=2)
    with_obstacles = evaluator.counts(deployment)
    evaluator.obstacles = obstacles_at(None, evaluator.positions)
    without = evaluator.counts(deployment)
    assert (with_obstacles <= without).all()
    assert 0 < with_obstacles.sum() < 0.97 * without.sum()


@pytest.mark.parametrize("fiducial", [False, True])
def test_moves_end_where_a_full_evaluation_does(fiducial):
    scene, rng = lab_scene(fiducial), np.random.default_rng(1)
    start, targets = (scene.footprints.draw(RandomDeployment(count), rng) for count in (12, 8))
    check_every_path(scene, start, targets, 2, rng)


@pytest.mark.parametrize("fiducial", [False, True])
def test_what_a_flight_sees_and_what_poses_gain_is_what_is_counted(fiducial):
    scene = lab_scene(fiducial)
    deployment = scene.footprints.draw(RandomDeployment(20), np.random.default_rng(2))
    evaluator = Evaluator(scene, threads=1)
    rng = np.random.default_rng(3)
    positions = scene.room.sample(200, rng)
    axes = axis_and_right(camera_pose(positions, *scene.pdf.draw(200, rng)))
    caps = [
        reference.coverage_caps(scene, deployment, position, axis[None])[0]
        for position, axis in zip(positions, axes, strict=True)
    ]
    assert_array_equal(visible(evaluator, deployment, positions, axes), caps)
    assert check_gains(scene, deployment[:4], rng)


@pytest.mark.parametrize("fiducial", [False, True])
def test_a_cuboid_written_as_a_floor_plan_is_the_cuboid(fiducial):
    names = {"y_min": "wall_0", "x_max": "wall_1", "y_max": "wall_2", "x_min": "wall_3", "floor": "floor"}
    cuboid = Cuboid((6.0, 4.0, 2.5), (5.5, 3.5, 1.5), 0.5, walls=tuple(names))
    plan = FloorPlan([[0, 0], [6, 0], [6, 4], [0, 4]], 2.5, surfaces=list(names.values()))
    prism = Prism(plan, Reachable((0.5, 2.0), 0.25), 0.5)
    assert_array_equal(prism.grid(), cuboid.grid())
    localised = Localisation(tolerance=0.2, sampling=None)  # whose walk is compiled for commands, too
    found, objective = [], localised if fiducial else Coverage(2, 0.5)
    for room in (cuboid, prism):
        scene = lab_scene(fiducial, room)
        problem = Problem(scene, objective, RandomDeployment(12), threads=1)
        deployment = Annealing(seed=5).run(problem, Budget(80)).deployment
        found.append((deployment, Evaluator(scene, threads=1).counts(deployment)))
    (here, counts), (there, others) = found
    assert_array_equal(here.positions, there.positions)
    assert_array_equal(here.normals, there.normals)
    assert_array_equal(counts, others)


def test_a_room_of_two_halves_sees_only_its_own():
    # A wall with a gap of 10 cm: who stands before it sees through, who stands beside does not.
    wall = [{"low": [2.9, 0, 0], "high": [3.1, 1.95, 2.5]}, {"low": [2.9, 2.05, 0], "high": [3.1, 4, 2.5]}]
    plan = FloorPlan([[0, 0], [6, 0], [6, 4], [0, 4]], 2.5, obstacles=wall)
    room = Prism(plan, Reachable((1.0, 1.0), 0.5), 0.5)
    mark, normal = np.array([[6.0, 2.0, 1.0]]), np.array([[-1.0, 0.0, 0.0]])
    scene = paper_scene(room, thold=0.1)
    seen = Evaluator(scene, threads=1).counts(Deployment(mark, normal)).any(axis=1)
    x, y, _ = room.grid().T
    assert_array_equal(seen[x < 2.9], abs(y - 2.0)[x < 2.9] < 0.01)
    assert seen[x > 3.1].any()


def test_a_tag_is_seen_only_if_its_corners_are():
    # The edge of the pillar is in line with the middle of the tag, or 1 mm beside its corner.
    for beside, seen in ((0.0, False), (0.076, True)):
        pillar = {"low": [2.0, 0.5, 0.0], "high": [2.5, 2.0 - beside, 2.5]}
        plan = FloorPlan(L_SHAPE, 2.5, obstacles=[pillar])
        room = Prism(plan, Reachable((1.0, 1.0)), 0.5)
        scene = replace(lab_scene(True, room), visibility=Fiducial(Tag(0.15)))
        tag = Deployment([[3.0, 2.0, 1.0]], [[-1.0, 0.0, 0.0]])
        position, axis = np.array([[1.5, 2.0, 1.0]]), np.array([[1.0, 0.0, 0.0, 0.0, -1.0, 0.0]])
        assert visible(Evaluator(scene, threads=1), tag, position, axis)[0, 0] == seen
