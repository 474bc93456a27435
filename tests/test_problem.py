import numpy as np
import pytest
from paper import one_position_room, paper_room, paper_scene

from lmd import pdf
from lmd.checks import InputError
from lmd.deployment import RandomDeployment, UniformDeployment
from lmd.problem import CoverageProblem, Objective
from lmd.sight import reference
from lmd.space.relevance import Relevance


def coarse_scene(**room):
    return paper_scene(room=paper_room(**({"spacing": 1.5} | room)), orientations=pdf.grid_with_ends(6))


def problem(scene=None, n=2, thold_p=0.5, start=None, **options):
    return CoverageProblem(scene or coarse_scene(), Objective(n, thold_p), start or RandomDeployment(40), **options)


def test_metrics_are_the_references():
    scene = coarse_scene()
    deployment = UniformDeployment(40).draw(scene.room, np.random.default_rng())
    metrics = problem(scene).metrics(deployment)
    probability = reference.coverage_probability(reference.counts(scene, deployment), scene.pdf, 2)
    is_qualified = reference.qualified(probability, 0.5)
    assert metrics["qualified_ratio"] == is_qualified.mean()
    assert metrics["average_coverage_probability"] == pytest.approx(probability.mean(), abs=1e-12)
    assert metrics["maximum_coverage_probability"] == pytest.approx(probability.max(), abs=1e-12)
    assert metrics["cost"] == is_qualified.sum()
    assert metrics["fitness"] == metrics["qualified_ratio"]


@pytest.mark.parametrize("encoding", ["wall", "paper"])
@pytest.mark.parametrize("flush", [True, False])
def test_fitness_of_genes_is_the_fitness_of_their_deployment(encoding, flush):
    p = problem(encoding=encoding, flush=flush)
    genes = np.random.default_rng(1).random((5, p.dim))
    assert p.evaluate(genes).tolist() == [p.metrics(p.decode(g))["fitness"] for g in genes]


def test_relevance_weighs_the_fitness_but_not_the_qualified_ratio():
    half = {"low": [0.0, 0.0, 0.0], "high": [3.75, 5.0, 6.0], "weight": 3.0}
    p = problem(coarse_scene(relevance=Relevance(regions=[half])))
    deployment = p.start.draw(p.scene.room, np.random.default_rng(0))
    is_qualified = reference.qualified(p.probabilities(deployment), 0.5)
    near = p.evaluator.positions[:, 0] <= 3.75
    metrics = p.metrics(deployment)
    assert metrics["qualified_ratio"] == is_qualified.mean()
    assert metrics["cost"] == 3 * is_qualified[near].sum() + is_qualified[~near].sum()
    assert metrics["fitness"] == pytest.approx(metrics["cost"] / (3 * near.sum() + (~near).sum()))
    assert p.evaluate(p.encode(deployment)[None])[0] == pytest.approx(metrics["fitness"])


def test_fitness_does_not_depend_on_threads_or_batch():
    one, three = problem(threads=1), problem(threads=3)
    genes = np.random.default_rng(2).random((4, one.dim))
    together = one.evaluate(genes)
    np.testing.assert_array_equal(together, three.evaluate(genes))
    np.testing.assert_array_equal(together, [one.evaluate(g[None])[0] for g in genes])


def test_a_start_that_does_not_vary_is_drawn_once():
    rng = np.random.default_rng(0)
    assert problem(start=UniformDeployment(40)).starting_genes(7, rng).shape == (1, 80)
    assert problem(start=RandomDeployment(40)).starting_genes(7, rng).shape == (7, 80)


def test_more_landmarks_than_exist_cannot_be_required():
    with pytest.raises(InputError, match=r"objective\.n = 4 exceeds the number of landmarks, 3"):
        problem(n=4, start=RandomDeployment(3))


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ((0, 0.5), r"objective\.n must be at least 1, got 0"),
        ((1.5, 0.5), r"objective\.n must be a whole number, got 1\.5"),
        (("two", 0.5), r"objective\.n must be a whole number, got 'two'"),
        ((2, 1.01), r"objective\.thold_p must be in \[0, 1\], got 1\.01"),
        ((2, -0.1), r"objective\.thold_p must be in \[0, 1\], got -0\.1"),
        ((2, float("nan")), r"objective\.thold_p must be finite, got nan"),
    ],
)
def test_an_impossible_objective_is_refused(values, message):
    with pytest.raises(InputError, match=message):
        Objective(*values)


def test_one_position_is_a_problem_too():
    p = problem(paper_scene(room=one_position_room()), thold_p=0.0)
    assert p.evaluate(np.random.default_rng(0).random((1, p.dim))) == [1.0]
