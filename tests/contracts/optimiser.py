"""What an optimiser promises."""

from dataclasses import replace

import numpy as np

from lmd.optimisers.base import AskTell
from lmd.optimisers.checkpoint import Checkpoint
from lmd.optimisers.ledger import Budget
from lmd.problem import Problem
from lmd.scene.deployment_sources import RandomDeployment, UniformDeployment
from lmd.scene.labels import Labels


class Scores(Problem):
    """Keeps the fitness of every evaluation, in their order."""

    def __init__(self, *args, **keywords):
        self.scored = []
        super().__init__(*args, **keywords)

    def fitness(self, positions, normals):
        fitness = super().fitness(positions, normals)
        self.scored += fitness.tolist()
        return fitness


class NanProblem(Scores):
    """Every third evaluation fails."""

    done = 0

    def fitness(self, positions, normals):
        fitness = super().fitness(positions, normals)
        fitness[(self.done + np.arange(len(fitness))) % 3 == 2] = np.nan
        self.done += len(fitness)
        return fitness


def check_optimiser(make, problem, folder, evaluations=130):
    """Check all that follows.

    Args:
        make: gives an optimiser that has not run; takes its `seed`.
        problem: gives a small problem; takes `start`, `threads` and `fixed` of `lmd.problem.Problem`.
        folder: for a checkpoint.
        evaluations: of a run, enough to improve.
    """
    whole = make().run(problem(), Budget(evaluations))
    check_books(whole, problem(), evaluations)
    check_counts(make, problem)
    small = check_small_budgets(make, problem)
    check_improvement(make, problem, evaluations)
    check_seeds(make, problem, whole, small)
    check_fixed(make, problem)
    check_failures(make, problem, evaluations // 2)
    check_going_on(make, problem, whole, folder)


def check_books(result, problem, evaluations):
    """The budget is spent to the evaluation, and the history rises to the fitness of the deployment."""
    assert (result.evaluations, result.stopped) == (evaluations, "budget")
    best, spent = zip(*((record.best_fitness, record.evaluations) for record in result.history), strict=True)
    assert list(best) == sorted(best)
    assert best[-1] == result.fitness == problem.metrics(result.deployment)["fitness"]
    assert list(spent) == sorted(set(spent))
    assert spent[-1] == result.evaluations


def check_counts(make, problem):
    """A black box records each improvement at the evaluation that made it."""
    optimiser, p = make(), problem()
    if not isinstance(optimiser, AskTell):
        return
    scored = Scores(p.scene, p.objective, p.start, threads=1)
    history = optimiser.run(scored, Budget(70)).history
    best = np.maximum.accumulate(scored.scored)
    assert len(best) == 70
    rises = np.flatnonzero(np.diff(best, prepend=-np.inf) > 0.0)
    improved = {record.best_fitness: record.evaluations for record in reversed(history)}  # the first of each
    assert improved == dict(zip(best[rises].tolist(), (rises + 1).tolist(), strict=True))


def check_small_budgets(make, problem):
    """No budget is overdrawn, and a run stops when its time is up; returns what the largest budget found."""
    for evaluations in (1, 7, 31):
        result = make().run(problem(), Budget(evaluations))
        assert result.evaluations <= evaluations
    assert 0 < make().run(problem(), Budget(10**9, seconds=0.05)).evaluations < 10**6
    return result


def check_improvement(make, problem, evaluations):
    """Check that the optimiser's result is better than a random start."""
    p = problem(UniformDeployment(30))
    before = p.fitness_of(p.draw(np.random.default_rng()))
    assert make().run(p, Budget(evaluations)).fitness > before


def check_seeds(make, problem, whole, small):
    """Check that a seed gives equal results on any number of threads, and another seed different ones."""
    same_run(make().run(problem(threads=2), Budget(whole.evaluations)), whole)
    other = make(seed=1).run(problem(), Budget(31))
    assert not np.array_equal(other.deployment.positions, small.deployment.positions)


def check_fixed(make, problem):
    """What hangs already stays where it is, keeps its labels, and counts."""
    ids, source = np.arange(40, 25, -1), UniformDeployment(15)
    hangs = replace(source.draw(problem().scene.room, np.random.default_rng(0)),
                    labels=Labels(ids, {"note": ["old"] * 15}))  # fmt: skip
    result = make().run(problem(RandomDeployment(15), fixed=hangs), Budget(70))
    assert result.evaluations == 70
    np.testing.assert_array_equal(result.deployment.positions[:15], hangs.positions)
    np.testing.assert_array_equal(result.deployment.normals[:15], hangs.normals)
    assert result.deployment.ids.tolist() == [*ids, *range(15)]
    assert result.deployment.labels.columns["note"] == ["old"] * 15 + [""] * 15
    assert result.fitness == problem().metrics(result.deployment)["fitness"] > problem().fitness_of(hangs)


def check_failures(make, problem, evaluations):
    """It survives evaluations that fail."""
    p = problem()
    assert make().run(NanProblem(p.scene, p.objective, p.start, threads=1), Budget(evaluations)).fitness > 0.0


def check_going_on(make, problem, whole, folder):
    """Interrupted, kept and resumed it ends where it would have."""
    calls, optimiser, budget = iter(range(10**9)), make(), Budget(whole.evaluations)
    stopped = optimiser.run(problem(), budget, lambda _: next(calls) == 2)
    assert stopped.stopped == "interrupted"
    assert stopped.evaluations < whole.evaluations
    Checkpoint(optimiser, {}).save(folder)
    checkpoint = Checkpoint(make(), {})
    checkpoint.resume(folder, problem())
    same_run(checkpoint.optimiser.run(problem(), budget), whole)


def same_run(one, other):
    np.testing.assert_array_equal(one.deployment.positions, other.deployment.positions)
    assert [(r.evaluations, r.best_fitness) for r in one.history] == [
        (r.evaluations, r.best_fitness) for r in other.history
    ]
