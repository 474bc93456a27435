"""A recording of poses in place of a grid: cells, time, kernels, held-out blocks, and what is refused."""

import json
import math
from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy.spatial.transform import Rotation
from support.paper import chances, paper_camera, paper_scene
from support.rooms import lab, recorded

from lmd.core.checks import InputError
from lmd.estimation.flights import Pace, RandomMotion
from lmd.evaluation.validation import describe_validation, exact_values, held_out_metrics, validation_metrics
from lmd.geometry import se3
from lmd.geometry.frames import rotation
from lmd.objectives.coverage import Coverage
from lmd.objectives.localisation import Localisation
from lmd.optimisers.annealing import Annealing
from lmd.optimisers.ledger import Budget
from lmd.problem import Problem
from lmd.scene.deployment import Deployment
from lmd.scene.deployment_sources import RandomDeployment
from lmd.scene.rig import Mount, Rig
from lmd.scene.tag import Tag
from lmd.sight.evaluator import Evaluator
from lmd.sight.models.fiducial import Fiducial
from lmd.sight.views import visible

HEADER = "time,x,y,z,yaw,pitch\n"
AHEAD, BACK = np.pi / 2, -np.pi / 2  # yaw turns from y towards x


def scene_of(poses, room=None):
    scene = paper_scene()
    room = poses.visited(room or scene.room)
    return replace(scene, room=room, pdf=poses.pdf, recorded=poses)


def rows(*poses):
    return HEADER + "".join(",".join(f"{value:.17g}" for value in pose) + "\n" for pose in poses)


def halves(write, laps=10, **changes):
    """Looks along +x while it stands at x = 2 for one second, then along -x while it stands at x = 5 for two."""
    poses = [
        ((3.0 * lap, 2.0, 2.5, 3.0, AHEAD, 0.0), (3.0 * lap + 1.0, 5.0, 2.5, 3.0, BACK, 0.0)) for lap in range(laps)
    ]
    return recorded(write(rows(*sum(poses, ()), (3.0 * laps, 5.0, 2.5, 3.0, BACK, 0.0))), **changes)


def standing(write, seconds=40, **changes):
    return recorded(write(rows(*((t, 2.0, 2.5, 3.0, 0.0, 0.0) for t in range(seconds + 1)))), **changes)


def walk(write, seed=0, count=200, **changes):
    rng = np.random.default_rng(seed)
    at = np.cumsum(rng.normal(0.0, 0.05, (count, 3)), axis=0) + np.array([3.75, 2.5, 3.0])
    angles = np.stack([np.cumsum(rng.normal(0.0, 0.1, count)), rng.normal(0.0, 0.2, count)], axis=1)
    angles[:, 0] = np.mod(angles[:, 0], 2.0 * np.pi)
    time = np.cumsum(rng.uniform(0.05, 0.2, count))
    return recorded(write(rows(*np.column_stack([time, at, angles]))), **changes)


def test_positions_are_the_cells_visited_and_relevance_is_the_time_spent_there(write):
    text = rows(
        *([t, x, y, 1, 0, 0] for t, x, y in ((0, 1.1, 1.1), (1, 1.2, 1.1), (3, 1.3, 1.1), (4, 2.6, 1), (9, 3, 1)))
    )
    scene = scene_of(recorded(write(text)))
    assert_allclose(scene.room.grid(), [[1.2, 1.1, 1.0], [2.6, 1.0, 1.0]])  # the record nearest to the mean
    assert_allclose(scene.room.relevance.weights(scene.room.grid()), [4.0, 5.0])
    rng = np.random.default_rng(0)
    drawn = scene.room.jittered_grid(2000, rng).reshape(2000, 2, 3)
    assert_array_equal(np.unique(drawn[:, 1], axis=0), [[2.6, 1.0, 1.0]])
    places, times = np.unique(drawn[:, 0, 0], return_counts=True)
    assert_allclose(places, [1.1, 1.2, 1.3])
    assert_allclose(times / 2000, [0.25, 0.5, 0.25], atol=1 / 2000)
    sampled = scene.room.sample(4000, rng)
    assert np.mean(sampled[:, 0] == 2.6) == pytest.approx(5 / 9, abs=0.04)
    assert np.mean(scene.room.sample_evenly(4000, rng)[:, 0] == 2.6) == pytest.approx(5 / 9, abs=1 / 4000)
    assert len(scene.room.finer().grid()) == 3


def test_the_kernel_estimate_is_its_equation(write):
    # Written out with rotation angles from scipy, and no cut.
    poses = walk(write, count=60, direction_bandwidth=20.0, bandwidth=0.3, divisions=6)
    seen, orientations = poses.training, poses.pdf
    nodes = Rotation.from_matrix(np.swapaxes(rotation(orientations.yaw, orientations.pitch, orientations.roll), 1, 2))
    records = Rotation.from_matrix(seen.poses[:, :3, :3])
    theta = np.array([(record.inv() * nodes).magnitude() for record in records])
    step = np.pi / 6
    area = np.sin(np.minimum(orientations.pitch + step / 2, np.pi / 2))
    area -= np.sin(np.maximum(orientations.pitch - step / 2, -np.pi / 2))
    kernel = area * np.exp((np.cos(theta) - 1.0) / math.radians(20.0) ** 2)
    kernel /= kernel.sum(axis=1, keepdims=True)
    for p in ([3.75, 2.5, 3.0], [3.6, 2.4, 3.1]):
        near = np.exp(-((np.linalg.norm(seen.poses[:, :3, 3] - p, axis=1) / 0.3) ** 2) / 2.0)
        expected = (seen.seconds * near) @ kernel / (seen.seconds @ near)
        found = orientations.at(np.array([p]))[0]
        assert found.sum() == pytest.approx(1.0)
        assert_allclose(found, expected, atol=2e-4)
    assert_allclose(orientations.at(np.array([[0.0, 0.0, 0.0]]))[0], orientations.weight)  # far from all records


def test_a_narrow_kernel_goes_to_the_nearest_orientation(write):
    poses = halves(write, direction_bandwidth=0.1)
    assert_allclose(np.sort(poses.pdf.yaw), [BACK, AHEAD], atol=1e-12)
    found = poses.pdf.at(np.array([[2.0, 2.5, 3.0], [5.0, 2.5, 3.0], [3.5, 2.5, 3.0]]))
    assert_allclose(found[:, np.argsort(poses.pdf.yaw)], [[0, 1], [1, 0], [2 / 3, 1 / 3]], atol=1e-12)


def landmark(x):
    """Faces -x, at the height of the camera."""
    return Deployment([[x, 2.5, 3.0]], [[-1.0, 0.0, 0.0]])


def test_orientation_that_depends_on_the_position_moves_the_optimum(write):
    """By hand: x = 2 looks along +x for a third of the time, x = 5 along -x; tags are read up to 3.09 m away.

    A landmark at x = 3.5 is 1.5 m ahead of the first and turns its back on the second: P_1 = 1 and 0. One at the wall,
    x = 7.5, is too far from the first, and the second has it behind: 0 and 0. With the PDF of all positions together,
    which looks along +x with the probability 1/3, they have P_1 = 1/3 and 0, and 0 and 1/3: it would choose the wall,
    as twice the time is spent near it.
    """
    poses = halves(write, direction_bandwidth=0.1)
    own = scene_of(poses)
    pooled = replace(own, pdf=replace(poses.pdf, by_position=None))
    middle, wall = landmark(3.5), landmark(7.5)

    def p1(scene, deployment):
        return chances(Evaluator(scene, threads=1), deployment, 1)

    assert_allclose(p1(own, middle), [1.0, 0.0], atol=1e-12)
    assert_allclose(p1(own, wall), [0.0, 0.0], atol=1e-12)
    assert_allclose(p1(pooled, middle), [1 / 3, 0.0], atol=1e-12)
    assert_allclose(p1(pooled, wall), [0.0, 1 / 3], atol=1e-12)
    fitness = {}
    for name, scene in (("own", own), ("pooled", pooled)):
        problem = Problem(scene, Coverage(1, 0.3), RandomDeployment(1), threads=1)
        fitness[name] = [problem.fitness_of(deployment) for deployment in (middle, wall)]
    assert_allclose(fitness["own"], [1 / 3, 0.0])
    assert_allclose(fitness["pooled"], [1 / 3, 2 / 3])


def test_held_out_blocks_are_every_so_many_th_and_are_not_optimised_on(write):
    poses = standing(write, held_out=5, block=2.0)
    assert_array_equal(poses.kept_back.block, np.repeat([4, 9, 14, 19], 2))
    assert len(poses.training) + len(poses.kept_back) == 40
    assert not set(poses.training.block) & set(poses.kept_back.block)
    without = standing(write)
    assert (len(without.training), len(without.kept_back)) == (40, 0)


@pytest.mark.parametrize("objective", [Coverage(2, 0.5), Localisation(tolerance=0.1)])
def test_held_out_figures_are_shares_of_time_at_the_exact_poses(write, objective):
    poses = walk(write, held_out=3, block=1.5)
    scene = replace(scene_of(poses), tag=Tag(0.2))
    problem = Problem(scene, objective, RandomDeployment(60), threads=1)
    deployment = problem.draw(np.random.default_rng(0))
    figures = validation_metrics(problem, deployment, 0)
    assert figures == held_out_metrics(problem, deployment, poses)
    for name, records in (("recorded", poses.training), ("held_out", poses.kept_back)):
        values = exact_values(problem, deployment, records)
        seen = visible(problem.evaluator, deployment, records.poses[:, :3, 3], se3.axis_and_right(records.poses))
        covered = seen.sum(axis=1) >= 2
        if isinstance(objective, Coverage):
            assert_array_equal(values, covered)
        assert (values <= covered).all()
        assert 0.0 < values.mean() < 1.0
        assert figures[f"{name}_share"] == pytest.approx(np.average(values, weights=records.seconds))
        assert 0.0 < figures[f"{name}_share_standard_error"] < 0.5
    assert set(describe_validation(problem, figures)) == {"held out", "optimised on"}


@pytest.mark.parametrize("objective", [Coverage(2, 0.5), Localisation(tolerance=0.1)])
def test_annealing_climbs_recorded_poses_and_threads_change_nothing(write, objective):
    scene = replace(scene_of(walk(write, held_out=5, block=1.5)), tag=Tag(0.2))
    if isinstance(objective, Localisation):  # compiled for tags, as commands are
        scene = replace(scene, visibility=Fiducial(Tag(0.2)))
    found = []
    for threads in (1, 3):
        problem = Problem(scene, objective, RandomDeployment(8), threads=threads)
        result = Annealing(seed=1).run(problem, Budget(60, None), None)
        assert result.fitness >= problem.fitness_of(problem.draw(np.random.default_rng(0)))
        found.append(result)
    assert_array_equal(found[0].deployment.positions, found[1].deployment.positions)
    json.dumps(problem.settings())


def test_random_flights_go_from_record_to_record_also_where_the_camera_stood_still(write):
    room = lab()  # with a clearance of more than the 0.25 m that this robot kept
    poses = recorded(write(rows(*((t, 0.25, 1.0 + t % 2, 1.0, 0.0, 0.0) for t in range(9)))), spacing=2.0)
    scene = scene_of(poses, room)
    for seed in range(5):
        flown = RandomMotion(5.0, Pace(0.5, 1.0, 10.0)).draw(scene, np.random.default_rng(seed)).poses[:, :3, 3]
        np.testing.assert_allclose(flown[:, [0, 2]], [[0.25, 1.0]] * len(flown), atol=1e-9)
        assert np.ptp(flown[:, 1]) == pytest.approx(1.0, abs=0.05)


def test_the_cameras_of_a_rig_are_looked_for_where_the_body_turns_them(write):
    ahead = Rig((Mount(paper_camera(), (0.3, 0.0, 0.0)),))
    along = recorded(write(rows(*((t, 1.0 + t / 10, 0.1, 3.0, AHEAD, 0.0) for t in range(20)))))
    problem = Problem(replace(scene_of(along), camera=ahead), Coverage(1, 0.3), RandomDeployment(6), threads=1)
    assert problem.evaluator.positions[:, 1].max() == 0.1  # never does it face the wall 10 cm beside it
    across = recorded(write(rows(*((t, 1.0 + t / 10, 0.1, 3.0, math.pi, 0.0) for t in range(20)))))
    with pytest.raises(InputError, match=r"rig has a camera at \[.*, -0.\d+, 3\], outside the room"):
        Problem(replace(scene_of(across), camera=ahead), Coverage(1, 0.3), RandomDeployment(6), threads=1)
