"""Landmarks that hang already: they stay, they count, and nothing is put over them."""

from dataclasses import replace

import numpy as np
import pytest
from contracts.field import move
from hypothesis import given
from hypothesis import strategies as st
from support.paper import paper_room
from support.rooms import lab
from support.small import make, problem
from support.strategies import deployments, scenes, seeds

from lmd.core.checks import InputError
from lmd.formats.tag_maps import FileDeployment
from lmd.incremental.coverage_field import coverage_field
from lmd.objectives.coverage import Coverage
from lmd.objectives.localisation import Localisation
from lmd.objectives.sampling import Sampling
from lmd.optimisers.greedy import GreedyDeployment
from lmd.optimisers.ledger import Budget
from lmd.problem import Problem
from lmd.scene.deployment import Deployment
from lmd.scene.deployment_sources import RandomDeployment, UniformDeployment
from lmd.scene.footprints import beside
from lmd.scene.labels import Labels
from lmd.scene.tag import Tag
from lmd.sight.evaluator import Evaluator
from lmd.sight.models.fiducial import Fiducial

ROOM = paper_room(spacing=1.5)
TAG = Tag(edge=0.3)


def drawn(source, seed=0):
    return source.draw(ROOM, np.random.default_rng(seed))


def numbered(deployment, *ids, **columns):
    return replace(deployment, labels=Labels(np.array(ids), columns))


def test_new_landmarks_get_the_least_ids_that_are_free():
    fixed = numbered(drawn(RandomDeployment(3)), 5, 0, 2, note=["a", "b", "c"])
    both = beside(fixed, drawn(RandomDeployment(4), 1))
    assert both.ids.tolist() == [5, 0, 2, 1, 3, 4, 6]
    assert both.labels.columns == {"note": ["a", "b", "c", "", "", "", ""], "fixed": list("1110000")}
    np.testing.assert_array_equal(both.positions[:3], fixed.positions)


def test_the_fixed_ones_may_be_in_the_file_of_all(tmp_path):
    everything = drawn(RandomDeployment(6))
    everything.to_csv(tmp_path / "all.csv")
    measured = everything.positions[[4, 1]] + 0.01 * everything.normals[[4, 1]]
    fixed = numbered(Deployment(measured, everything.normals[[4, 1]]), 4, 1)
    p = problem(FileDeployment(tmp_path / "all.csv"), fixed=fixed)
    both = p.draw(np.random.default_rng(0))
    assert both.ids.tolist() == [4, 1, 0, 2, 3, 5]
    np.testing.assert_array_equal(both.positions, [*measured, *everything.positions[[0, 2, 3, 5]]])
    assert (p.count, p.fixed_count, p.free_count) == (6, 2, 4)


@pytest.mark.parametrize(
    ("fixed", "message"),
    [
        (UniformDeployment(6), r"^fixed and the start both have a landmark 0, .* m apart; give them different ids"),
        (RandomDeployment(6), r"^fixed has all 6 landmarks, which leaves none to place"),
    ],
)
def test_fixed_ones_that_do_not_fit_the_file_of_all_are_refused(tmp_path, fixed, message):
    drawn(RandomDeployment(6)).to_csv(tmp_path / "all.csv")
    with pytest.raises(InputError, match=message):
        problem(FileDeployment(tmp_path / "all.csv"), fixed=drawn(fixed))


@pytest.mark.parametrize(("tag", "optimiser"), [(None, "ega"), (Tag(0.1), "ega"), (None, "greedy")])
def test_on_a_floor_plan_they_stay_where_they_are_and_out_of_doors(tag, optimiser):
    scene = replace(problem().scene, room=lab(), tag=tag)
    hangs = Deployment([[2.0, 0.03, 1.0], [0.0, 1.5, 1.0]], [[0.0, 1.0, 0.0], [1.0, 0.0, 0.0]])
    p = Problem(scene, Coverage(1, 0.3), RandomDeployment(8), 1, hangs)
    np.testing.assert_array_equal(make(optimiser).run(p, Budget(30)).deployment.positions[:2], hangs.positions)
    door = Deployment([[5.0, 0.0, 1.0]], [[0.0, 1.0, 0.0]])
    with pytest.raises(InputError, match=r"^fixed: landmark 0 at \(5, 0, 1\) hangs on wall_0 where no tag may hang"):
        Problem(scene, Coverage(1, 0.3), RandomDeployment(8), 1, door)


# One flush, one that a board holds off the wall, one that was measured to a micrometre and touches the first.
HANGS = Deployment([[0.0, 2.0, 3.0], [0.03, 4.0, 3.0], [0.0, 2.0, 3.0 + TAG.paper_edge - 1e-6]], [[1.0, 0.0, 0.0]] * 3)


@pytest.mark.parametrize("source", ["random", "uniform", "greedy"])
@pytest.mark.parametrize("optimiser", [None, "annealing", "greedy", "ega"])
def test_no_paper_covers_one_that_hangs_already(source, optimiser):
    options = {"fixed": HANGS, "tag": TAG, "walls": ("x_min",)}
    p = problem(RandomDeployment(80), **options)
    if source == "greedy":
        p = problem(GreedyDeployment(80, p.scene, p.objective, threads=1, fixed=p.fixed), **options)
    elif source == "uniform":
        p = problem(UniformDeployment(80), **options)
    found = p.draw(np.random.default_rng(1)) if optimiser is None else make(optimiser).run(p, Budget(60)).deployment
    np.testing.assert_array_equal(found.positions[:3], HANGS.positions)
    at = found.positions[:, 1:]
    apart = np.abs(at[:, None] - at[None]).max(axis=-1) + np.eye(len(at))
    assert apart.min() > TAG.paper_edge - 2e-6
    assert np.delete(apart, 2, axis=0)[:, 3:].min() > TAG.paper_edge * (1.0 - 1e-8)


@given(st.data(), scenes(), st.integers(1, 3), seeds)
def test_stacks_beside_fixed_landmarks_are_as_many_landmarks_on_one_point(data, scene, n, seed):
    """Hidden by nothing, each stack is n landmarks; the fixed ones are what they are."""
    scene = replace(scene, visibility=replace(scene.visibility, occlusion="none"))
    fixed, stacks, targets = (data.draw(deployments(scene.room, most=7)) for _ in range(3))
    evaluator, rng = Evaluator(scene, threads=1), np.random.default_rng(seed)
    field = coverage_field(evaluator, n).stacked(fixed)
    state = field.state(stacks)
    scratch = field.scratch(state)
    for target in np.hstack([targets.positions, targets.normals]):
        move(field, int(rng.integers(len(stacks))), target, -1, state, scratch)
        positions = np.vstack([fixed.positions, *[state.poses[:3].T] * n])
        normals = np.vstack([fixed.normals, *[state.poses[3:].T] * n])
        units = evaluator.units(positions[None], normals[None], n)[0]
        np.testing.assert_array_equal(state.units[field.index_of], units)


WALK = pytest.mark.thorough("lmd/optimisers", "lmd/objectives/localisation", "lmd/incremental")  # compiled for it alone
SAMPLED = [
    Coverage(2, 0.5, Sampling(2, 4)),
    pytest.param(Localisation(tolerance=0.1, sampling=Sampling(2, 4)), marks=WALK),
]


@pytest.mark.parametrize("objective", SAMPLED)
@pytest.mark.parametrize("optimiser", ["annealing", "greedy"])
def test_a_walk_on_samples_leaves_alone_what_hangs_already(optimiser, objective):
    scene, hangs = replace(problem().scene, tag=TAG), drawn(UniformDeployment(10))
    if isinstance(objective, Localisation):  # compiled for tags, as commands are
        scene = replace(scene, visibility=Fiducial(TAG))
    p = Problem(scene, objective, RandomDeployment(15), 1, hangs)
    result = make(optimiser).run(p, Budget(200))
    np.testing.assert_array_equal(result.deployment.positions[:10], hangs.positions)
    assert result.fitness == p.fitness_of(result.deployment) > p.fitness_of(p.draw(np.random.default_rng(0)))
    scene.footprints.check(result.deployment.with_surfaces(scene.room))


def test_the_greedy_choice_goes_on_from_what_hangs():
    first = GreedyDeployment(12, problem().scene, problem().objective, 0.8, 1)
    whole = drawn(first)
    rest = drawn(replace(first, count=7, fixed=whole[:5]))
    np.testing.assert_array_equal(rest.positions, whole.positions[5:])
