"""What every optimiser promises, checked for every config in conf/optimiser."""

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from small import make, problem

from lmd.core.checks import InputError
from lmd.optimisers.base import AskTell, Budget
from lmd.optimisers.checkpoint import Checkpoint
from lmd.problem import Problem
from lmd.scene.deployment_sources import RandomDeployment, UniformDeployment
from lmd.scene.labels import Labels
from pipelines.app import CONF

NAMES = sorted(path.stem for path in Path(CONF, "optimiser").glob("*.yaml"))
QUICK = {"annealing", "cma_es", "ega"}  # one of each kind
BUDGET = 200
GUIDE = Path(__file__).parents[2] / "CONTRIBUTING.md"
RNG = np.random.default_rng(0)


class NanProblem(Problem):
    """Every third evaluation fails."""

    done = 0

    def fitness(self, positions, normals):
        fitness = super().fitness(positions, normals)
        fitness[(self.done + np.arange(len(fitness))) % 3 == 2] = np.nan
        self.done += len(fitness)
        return fitness


@pytest.fixture(scope="module", params=[pytest.param(n, marks=() if n in QUICK else pytest.mark.slow) for n in NAMES])
def name(request):
    return request.param


@pytest.fixture(scope="module")
def result(name):
    return make(name).run(problem(), Budget(BUDGET))


def test_it_improves_on_its_start(name):
    start = UniformDeployment(30)
    p = problem(start)
    before = p.metrics(start.draw(p.scene.room, np.random.default_rng()))["fitness"]
    assert make(name).run(p, Budget(BUDGET)).fitness > before


def test_it_spends_the_budget_to_the_evaluation(result):
    assert result.evaluations == BUDGET
    assert result.stopped == "budget"


def test_what_hangs_already_stays_where_it_is_and_counts(name):
    ids = np.arange(40, 25, -1)
    hangs = replace(UniformDeployment(15).draw(problem().scene.room, RNG), labels=Labels(ids, {"note": ["old"] * 15}))
    p = problem(RandomDeployment(15), fixed=hangs)
    result = make(name).run(p, Budget(100))
    assert result.evaluations == 100
    np.testing.assert_array_equal(result.deployment.positions[:15], hangs.positions)
    np.testing.assert_array_equal(result.deployment.normals[:15], hangs.normals)
    assert result.deployment.ids.tolist() == [*ids, *range(15)]
    assert result.deployment.labels.columns["note"] == ["old"] * 15 + [""] * 15
    assert result.fitness == problem().metrics(result.deployment)["fitness"] > problem().fitness_of(hangs)


@pytest.mark.parametrize("evaluations", [1, 7, 31])
def test_it_keeps_any_budget(name, evaluations):
    assert make(name).run(problem(), Budget(evaluations)).evaluations <= evaluations


def test_it_stops_when_its_time_is_up(name):
    result = make(name).run(problem(), Budget(10**9, seconds=0.2))
    assert 0 < result.evaluations < 10**6


def test_its_best_fitness_never_falls_and_is_that_of_its_deployment(result):
    best = [record.best_fitness for record in result.history]
    assert best == sorted(best)
    assert best[-1] == result.fitness == problem().metrics(result.deployment)["fitness"]


def test_its_history_counts_up_to_what_was_spent(result):
    evaluations = [record.evaluations for record in result.history]
    assert evaluations == sorted(set(evaluations))
    assert evaluations[-1] == result.evaluations


def test_same_seed_same_result_on_any_number_of_threads(name, result):
    again = make(name).run(problem(threads=2), Budget(BUDGET))
    np.testing.assert_array_equal(again.deployment.positions, result.deployment.positions)
    assert [r.best_fitness for r in again.history] == [r.best_fitness for r in result.history]


def test_another_seed_another_result(name, result):
    other = make(name, seed=1).run(problem(), Budget(BUDGET))
    assert not np.array_equal(other.deployment.positions, result.deployment.positions)


def test_it_survives_failed_evaluations(name):
    p = problem()
    failing = NanProblem(p.scene, p.objective, p.start, threads=1)
    assert make(name).run(failing, Budget(BUDGET)).fitness > 0.0


def test_interrupted_and_resumed_it_ends_where_it_would_have(name, result, tmp_path):
    calls = iter(range(10**9))
    optimiser = make(name)
    stopped = optimiser.run(problem(), Budget(BUDGET), lambda _: next(calls) == 2)
    assert stopped.stopped == "interrupted"
    assert stopped.evaluations < BUDGET
    Checkpoint(optimiser, {}).save(tmp_path)
    checkpoint = Checkpoint(make(name), {})
    checkpoint.resume(tmp_path, problem())
    resumed = checkpoint.optimiser.run(problem(), Budget(BUDGET))
    np.testing.assert_array_equal(resumed.deployment.positions, result.deployment.positions)
    assert [(r.evaluations, r.best_fitness) for r in resumed.history] == [
        (r.evaluations, r.best_fitness) for r in result.history
    ]


@pytest.mark.parametrize("number", [0, 1])
def test_the_optimisers_of_the_guide_work_and_are_checkpointed(number, tmp_path):
    blocks = re.findall(r"```python\n(.*?)```", GUIDE.read_text(encoding="utf-8"), re.DOTALL)
    names: dict[str, type[AskTell]] = {}
    exec([block for block in blocks if "lmd.optimisers" in block][number], names)
    made, p = names[("HillClimber", "Theirs")[number]], problem()
    whole, half = made().run(p, Budget(60)), made()
    half.run(p, Budget(60), lambda o: o.ledger.evaluations > 25)
    Checkpoint(half, {}).save(tmp_path)
    checkpoint = Checkpoint(made(), {})
    checkpoint.resume(tmp_path, p)
    resumed = checkpoint.optimiser.run(p, Budget(60))
    assert resumed.fitness == whole.fitness > whole.history[0].best_fitness
    np.testing.assert_array_equal(resumed.deployment.positions, whole.deployment.positions)


def test_a_run_in_which_every_evaluation_fails_says_so():
    class Hopeless(Problem):
        def fitness(self, positions, normals):
            return np.full(len(positions), np.nan)

    p = problem()
    with pytest.raises(InputError, match="EGA found no deployment: every evaluation failed"):
        make("ega").run(Hopeless(p.scene, p.objective, p.start), Budget(40))


def test_genes_outside_the_unit_box_are_clipped():
    class Outside(AskTell):
        def _ask(self):
            return np.full((2, self.dim), 7.0)

        def _tell(self, genes, fitness):
            assert genes.max() == 1.0

    Outside().run(problem(), Budget(4))


def test_genes_of_the_wrong_shape_are_refused():
    class Wrong(AskTell):
        def _ask(self):
            return np.zeros((2, 3))

        def _tell(self, genes, fitness):
            raise AssertionError

    with pytest.raises(InputError, match=r"Wrong asked for genes of shape \(2, 3\), not \(B, 60\)"):
        Wrong().run(problem(), Budget(4))


@pytest.mark.parametrize("values", [{"evaluations": 0}, {"evaluations": 1.5}, {"evaluations": 5, "seconds": 0}])
def test_an_impossible_budget_is_refused(values):
    with pytest.raises(InputError, match=r"^(evaluations|seconds) must"):
        Budget(**values)
