"""People in the way: kernels count as the reference, and moves end where a full evaluation does."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_array_equal
from support.paper import paper_scene

from lmd.core.checks import InputError
from lmd.evaluation.validation import Sample, validation_metrics
from lmd.geometry.se3 import axis_and_right, camera_pose
from lmd.incremental.field import combined, smoothed, total_fitness
from lmd.objectives.coverage import Coverage, MeanCoverage
from lmd.objectives.crowd import slope_target, target_of
from lmd.objectives.localisation import Localisation
from lmd.objectives.reference_field import field_of
from lmd.objectives.sampling import Sampling
from lmd.optimisers.annealing import Annealing
from lmd.optimisers.gradient_ascent import GradientAscent
from lmd.optimisers.ledger import Budget
from lmd.problem import Problem
from lmd.scene import pdf
from lmd.scene.deployment import Deployment
from lmd.scene.deployment_sources import RandomDeployment
from lmd.scene.rig import Mount, Rig
from lmd.scene.tag import Tag
from lmd.sight import reference
from lmd.sight.evaluator import Evaluator
from lmd.sight.models.fiducial import Fiducial
from lmd.sight.poses import covered_amounts
from lmd.sight.views import visible_to_each
from lmd.space.crowd import Crowd, CrowdStates
from lmd.space.cuboid import Cuboid

ROOM = Cuboid((6.0, 4.0, 2.5), (5.0, 3.0, 1.5), 1.0)
PATHS = "lmd/space/crowd.py", "lmd/sight", "lmd/incremental", "lmd/objectives"


def crowded(crowd, fiducial=False, room=ROOM):
    scene = paper_scene(room, orientations=pdf.grid_with_ends(6), thold=0.3, occlusion="line_of_sight")
    scene = replace(scene, visibility=Fiducial(Tag(0.15)), tag=None) if fiducial else scene
    return replace(scene, crowd=None if crowd is None else crowd.drawn(room))


def tags(scene, count, seed):
    return scene.footprints.draw(RandomDeployment(count), np.random.default_rng(seed))


def test_one_person_hides_all_tags_behind_it():
    # Two tags one above the other, and one person before both: seen together in one state and hidden in the other.
    scene = crowded(None)
    states = np.array([[[5.2, 2.0, 0.2, 0.0, 2.0]], [[5.2, 0.5, 0.2, 0.0, 2.0]]])
    scene = replace(scene, crowd=CrowdStates(Crowd(1, states=2), states))
    pair = Deployment([[6.0, 2.0, 1.0], [6.0, 2.0, 1.3]], [[-1.0, 0.0, 0.0]] * 2)
    position, axis = np.array([[4.2, 2.0, 1.2]] * 2), np.array([[1.0, 0.0, 0.0, 0.0, -1.0, 0.0]] * 2)
    seen = visible_to_each(Evaluator(scene, threads=1), pair, position, axis, np.arange(2))[0]
    assert seen.tolist() == [[False, False], [True, True]]


def test_single_views_and_selections_see_what_is_counted():
    scene = crowded(Crowd(6, states=4))
    deployment, evaluator, rng = tags(scene, 20, 3), Evaluator(scene, threads=1), np.random.default_rng(4)
    positions, states = scene.room.sample(60, rng), rng.integers(4, size=60)
    axes = axis_and_right(camera_pose(positions, *scene.pdf.draw(60, rng)))
    seen = visible_to_each(evaluator, deployment, positions, axes, states)[0]
    each = zip(positions, axes, states, strict=True)
    caps = [reference.coverage_caps(scene.in_state(s), deployment, p, a[None])[0] for p, a, s in each]
    assert_array_equal(seen, caps)
    alone = reference.counts(replace(scene, visibility=replace(scene.visibility, occlusion="none")), deployment[:3])
    found = covered_amounts(evaluator, deployment[:3], np.ones(3))[:, evaluator.axis_of]
    assert_array_equal(found, alone)


def worst_problem(objective):
    scene = crowded(Crowd(4, states=5, fitness="worst", worst=0.4))
    return Problem(scene, objective, RandomDeployment(12), threads=1)


def by_definition(problem, deployment):
    """Mean of the two worst of five states."""
    values, relevance = problem.values(deployment).reshape(5, -1), problem.relevance[: len(problem.places)]
    return np.sort([float(problem.objective.fitness(part, relevance)) for part in values])[:2].mean()


def test_the_worst_states_are_the_target_of_moves():
    problem = worst_problem(MeanCoverage(1, 0.5))
    objective, evaluator, relevance = problem.objective, problem.fitness_evaluator, problem.fitness_relevance
    deployment = problem.draw(np.random.default_rng(0))
    field = field_of(objective, evaluator)
    target, units = target_of(objective, field, evaluator, relevance), field.state(deployment).units
    expected = by_definition(problem, deployment)
    assert 0.0 < expected < problem.metrics(deployment)["average_coverage_probability"]
    assert problem.fitness_of(deployment) == pytest.approx(expected, abs=1e-12)
    assert total_fitness(target, units) == pytest.approx(expected, abs=1e-12)
    terms = np.array([smoothed(target, p, units[p], 0.0, 0.01, 0.0) for p in range(len(units))])
    assert combined(target, terms, terms.sum()) == pytest.approx(expected, abs=1e-12)
    assert total_fitness(slope_target(target, units), units) == pytest.approx(expected, abs=1e-12)


@pytest.mark.thorough(*PATHS, "lmd/optimisers/annealing")
@pytest.mark.parametrize("objective", [Coverage(1, 0.2), Localisation(1, 0.2, tolerance=0.2, ambiguity="ignored")])
@pytest.mark.parametrize("make", [Annealing, GradientAscent])
def test_an_optimiser_climbs_the_worst_states(objective, make):
    # Some 20 s each, which the walk takes to compile.
    problem = worst_problem(objective)
    result = make(seed=1).run(problem, Budget(60))
    expected = problem.fitness_of(result.deployment)
    assert result.fitness == pytest.approx(expected, abs=1e-12)
    assert expected > problem.fitness_of(problem.draw(np.random.default_rng(1)))
    if objective.sampling is None:
        assert expected == pytest.approx(by_definition(problem, result.deployment), abs=1e-12)


@pytest.mark.parametrize(
    ("fitness", "size", "repeats"), [("mean", 8, 8), ("mean", 3, 3), ("worst", 8, 10), ("worst", 3, 3)]
)
def test_samples_use_the_states_evenly(fitness, size, repeats):
    scene = crowded(Crowd(1, states=5, fitness=fitness, worst=0.2))
    cells = len(scene.room.grid())
    drawn = Sampling(size, 4).evaluator(scene, size, np.random.default_rng(0), 1)
    assert len(drawn.positions) == repeats * cells
    used = np.bincount(drawn.states, minlength=5)
    assert used[used > 0].max() - used[used > 0].min() <= repeats
    assert (used > 0).sum() == (5 if fitness == "mean" else min(repeats, 5))


def test_off_the_grid_the_crowd_is_a_fresh_one():
    scene = crowded(Crowd(4, states=4, worst=0.25))
    problem = Problem(scene, MeanCoverage(2, 0.5), RandomDeployment(20), threads=1)
    deployment, sample = problem.draw(np.random.default_rng(0)), Sample(4, 64, 6)
    figures = validation_metrics(problem, deployment, 0, sample)
    worst, mean = (figures[f"grid_free_{w}average_coverage_probability"] for w in ("worst_crowd_", ""))
    empty = Problem(replace(scene, crowd=None), MeanCoverage(2, 0.5), RandomDeployment(20), threads=1)
    alone = validation_metrics(empty, deployment, 0, sample)["grid_free_average_coverage_probability"]
    assert worst < mean < alone
    metrics = problem.metrics(deployment)
    assert metrics["worst_crowd_average_coverage_probability"] < metrics["average_coverage_probability"]
    assert problem.by_place(problem.values(deployment)).mean() == pytest.approx(metrics["average_coverage_probability"])


def test_a_rig_sees_no_crowd():
    scene = crowded(Crowd(2, states=2))
    with pytest.raises(InputError, match="crowd: a rig of 2 cameras works only without"):
        replace(scene, camera=Rig((Mount(scene.camera), Mount(scene.camera, yaw=2.0))))
