"""The objective along drives as a problem: its figures, worst drives, optimisers, fresh drives, and refusals."""

from dataclasses import replace
from itertools import pairwise
from types import SimpleNamespace

import numpy as np
import pytest
from contracts.objective import check_selection
from support.composing import composed
from support.drives import DEPLOYMENT, MOTION, PACE, SCENE, SLOW, along
from support.tables import refusals

from lmd.core.checks import InputError
from lmd.estimation.drives import cut, filtered
from lmd.evaluation.bounds import Search, affordable
from lmd.evaluation.mounting import MountingError, mounted
from lmd.evaluation.validation import validation_metrics
from lmd.incremental.field import total_fitness
from lmd.objectives.crowd import target_of
from lmd.objectives.reference_field import field_of
from lmd.optimisers.annealing import Annealing
from lmd.optimisers.ledger import Budget
from lmd.problem import Problem
from lmd.scene.deployment_sources import UniformDeployment
from lmd.sight.evaluator import Evaluator
from lmd.sight.poses import candidate_poses
from lmd.sight.views import visible
from pipelines.building import build_optimiser, build_problem

pytestmark = pytest.mark.long


def problem_of(source=MOTION, **changes):
    of_drives = {"drives": 3, "fresh": 4, "seed": 0, "block": 30.0, "held_out": 5}
    settings = of_drives | {"start_position": 1.0, "start_attitude": 0.5}
    objective, scene = filtered(SCENE, source, SLOW, **(settings | changes))
    return Problem(scene, objective, UniformDeployment(60), threads=1)


def test_figures_are_of_the_time_and_of_fresh_drives():
    problem = problem_of()
    objective, known = problem.objective, problem.values(DEPLOYMENT)
    assert set(known) <= {0.0, 1.0}
    figures = problem.metrics(DEPLOYMENT)
    assert figures["filtered_share"] == pytest.approx(known.mean()) == pytest.approx(figures["fitness"])
    assert 0.1 < known.mean() < 1.0
    shares = [known[a:b].mean() for a, b in zip(objective.drives.first, objective.drives.first[1:], strict=False)]
    assert figures["worst_drives"] == pytest.approx(min(shares))
    off = validation_metrics(problem, DEPLOYMENT, 0)
    fresh = replace(objective, drives=objective.fresh, fresh=None)
    other = Problem(along(SCENE, objective.fresh), fresh, UniformDeployment(60), threads=1)
    assert off["grid_free_filtered_share"] == pytest.approx(other.metrics(DEPLOYMENT)["filtered_share"])
    assert not np.array_equal(objective.fresh.poses[:31], objective.drives.poses[:31])


def test_the_worst_drives_are_the_target_of_moves():
    problem = problem_of(drives=5, worst=0.4)
    objective, evaluator, relevance = problem.objective, problem.fitness_evaluator, problem.fitness_relevance
    known, first = problem.values(DEPLOYMENT), objective.drives.first
    expected = np.sort([known[a:b].mean() for a, b in pairwise(first)])[:2].mean()
    assert 0.0 < expected < known.mean()
    assert problem.fitness_of(DEPLOYMENT) == pytest.approx(expected, abs=1e-12)
    assert problem.metrics(DEPLOYMENT)["worst_drives"] == pytest.approx(expected, abs=1e-12)
    field = field_of(objective, evaluator)
    target = target_of(objective, field, evaluator, relevance)
    assert total_fitness(target, field.state(DEPLOYMENT).units) == pytest.approx(expected, abs=1e-12)
    assert "in the worst 2 of 5 drives" in objective.describe(problem.metrics(DEPLOYMENT), 0, 60)["worst drives"]
    with pytest.raises(InputError, match=r"^the relevance is 0 along the whole of drive 1"):
        objective.fitness(known, np.where(objective.drives.of_frame == 1, 0.0, relevance))


@pytest.mark.thorough("lmd/objectives/filtered", "lmd/optimisers/annealing", "lmd/incremental")
def test_annealing_climbs_the_worst_drives():
    problem = problem_of(drives=5, worst=0.4)
    start = problem.fitness_of(problem.draw(np.random.default_rng(0)))
    result = Annealing(seed=0).run(problem, Budget(100))
    assert result.fitness == pytest.approx(problem.fitness_of(result.deployment), abs=1e-12)
    assert result.fitness > start


def test_tags_are_chosen_by_the_frames_that_see_them():
    problem = problem_of(drives=4)
    objective, evaluator, relevance = problem.objective, problem.fitness_evaluator, problem.fitness_relevance
    check_selection(objective, evaluator, relevance)
    poses, selection = candidate_poses(SCENE.room, 1.5), objective.selection(evaluator, relevance)
    one, two = np.argsort(selection.gains(poses))[-2:]
    selection.add(poses[[one]])
    seen = [visible(evaluator, poses[[k]], objective.drives.positions, objective.drives.axes)[:, 0] for k in (one, two)]
    gained = relevance @ (np.log1p(1.0 * seen[0] + seen[1]) - np.log1p(1.0 * seen[0]))
    assert gained > 0.0
    assert selection.gains(poses[[two]])[0] == pytest.approx(gained)


WALK = pytest.mark.thorough("lmd/objectives/filtered", "lmd/optimisers")  # compiled for it alone


@pytest.mark.parametrize(
    "optimiser", [*(pytest.param(each, marks=WALK) for each in ("greedy", "gradient_ascent")), "ega"]
)
def test_optimisers_place_tags_along_drives(optimiser):
    settings = ["objective=filtered", "objective.drives=2", "objective.fresh=0", "deployment.count=8"]
    problem = build_problem(composed("optimise", *settings, "tag.edge=0.2", "room.spacing=2"))
    result = build_optimiser(composed("optimise", f"optimiser={optimiser}"), 0).run(problem, Budget(60))
    assert result.fitness > problem.fitness_of(problem.draw(np.random.default_rng(0)))


def test_mounting_errors_are_scored_on_fresh_drives():
    problem = problem_of()
    found = mounted(problem, DEPLOYMENT, MountingError(0.02, 0.0, 0.0, draws=2), seed=0)
    assert (
        found.planned.grid_free_filtered_share == validation_metrics(problem, DEPLOYMENT, 0)["grid_free_filtered_share"]
    )
    assert found.draws.grid_free_filtered_share.between(0.0, 1.0).all()


def test_no_bound_is_known():
    with pytest.raises(InputError, match="there is no upper bound for the objective Filtered"):
        affordable(problem_of(), 60, Search())


def test_drives_follow_from_the_seed_and_not_from_their_number():
    one, more, other = (problem_of(**changes).objective.drives for changes in ({}, {"drives": 5}, {"seed": 1}))
    np.testing.assert_array_equal(one.poses, more.poses[: len(one.poses)])
    assert not np.array_equal(one.poses, other.poses)


def test_every_fifth_drive_of_a_recording_is_held_out():
    points = [[1.5, 1.5, 3.0, 0.0, 0.0], [6.0, 1.5, 3.0, 1.57, 0.0], [6.0, 3.5, 3.0, 3.14, 0.0]]
    source = SimpleNamespace(draw=lambda *_: PACE.through(np.array(points)))
    objective = problem_of(source, block=2.0).objective
    whole = cut(source.draw(), 2.0)
    assert len(objective.drives) + len(objective.fresh) == len(whole) > 5
    np.testing.assert_array_equal(objective.fresh.trajectories[0].poses, whole[4].poses)
    with pytest.raises(InputError, match="held_out = 5 needs 5 drives, but the recording gives 1: shorten"):
        problem_of(source, block=500.0)


def test_positions_off_the_drives_have_no_value():
    objective = problem_of().objective
    with pytest.raises(InputError, match="has values along its drives only"):
        objective.values(Evaluator(SCENE, threads=1), DEPLOYMENT.positions[None], DEPLOYMENT.normals[None])


def test_drives_of_a_recording_are_pieces_of_it(tmp_path):
    rows = [f"{0.1 * t},{2.0 + 0.003 * t},2,3.2,{0.01 * t},0" for t in range(600)]
    (tmp_path / "drive.csv").write_text("\n".join(["time,x,y,z,yaw,pitch", *rows]))
    by_file = ["trajectory@objective.trajectory=file", f"objective.trajectory.path={tmp_path / 'drive.csv'}"]
    by_poses = ["poses=recorded", "pdf=recorded", f"poses.path={tmp_path / 'drive.csv'}"]
    one, other = (
        build_problem(composed("optimise", "objective=filtered", "objective.block=5", *overrides))
        for overrides in (by_file, by_poses)
    )
    assert (len(one.objective.drives), len(one.objective.fresh)) == (10, 2)
    np.testing.assert_array_equal(one.objective.drives.poses, other.objective.drives.poses)
    np.testing.assert_allclose(one.relevance, 0.1)
    np.testing.assert_array_equal(one.relevance, other.relevance)


def along_drives(*overrides):
    return build_problem(
        composed("optimise", "objective=filtered", "objective.fresh=1", "objective.drives=1", *overrides)
    )


test_what_cannot_be_is_refused_in_one_sentence = refusals(__file__, **{"a problem along drives": along_drives})
