"""Behaviour of the wrapped libraries beyond the contract in test_optimisers."""

import random
import threading
from functools import partial

import numpy as np
import pytest
from contracts.optimiser import check_going_on
from scipy.optimize import differential_evolution, direct, dual_annealing, minimize, shgo
from support.composing import composed
from support.small import problem, pymoo, run

from lmd.core.checks import InputError
from lmd.optimisers.genetic import RandomSearch
from lmd.optimisers.ledger import Budget
from lmd.optimisers.nevergrad import Nevergrad
from lmd.optimisers.pycma import PyCma
from lmd.optimisers.scipy import Scipy
from lmd.optimisers.wrapped import Wrapped
from lmd.scene.deployment_sources import RandomDeployment
from pipelines.building import budget_of, build_optimiser
from pipelines.nodes import instantiate


def losses_told(optimiser, batches, fitness):
    """Losses passed to the library for a number of batches, after a first one."""
    run(optimiser, 1, fitness=fitness)
    losses, tell = [], optimiser.session.tell
    optimiser.session.tell = lambda genes, told: losses.append(told) or tell(genes, told)
    run(optimiser, batches, fitness=fitness)
    return losses


class Stubborn(Wrapped):
    """Its library's optimiser asks for one point and ends."""

    opened: list[float]

    def _open(self, start, rng):
        self.opened = [*getattr(self, "opened", []), float(start[0, 0])]

        class Session:
            left = 1

            def ask(self):
                self.left -= 1
                return None if self.left < 0 else rng.random((1, start.shape[1]))

            def tell(self, genes, losses):
                print("chatter")

        return Session()


@pytest.mark.parametrize(
    ("make", "batches", "least"),
    [
        *((partial(pymoo, name), 60, -2.0) for name in ("GA", "CMAES", "PatternSearch", "DIRECT", "MixedVariableGA")),
        (partial(pymoo, "Optuna"), 60, -3.0),
        *((partial(PyCma, variant, step=0.2), 40, -1.0) for variant in ("full", "separable", "vkd")),
        (lambda: Scipy(partial(dual_annealing, no_local_search=True)), 250, -2.0),
        (lambda: Scipy(partial(differential_evolution, popsize=1)), 250, -2.0),
        (lambda: Scipy(direct), 250, -2.0),
    ],
)
def test_every_library_gets_better(make, batches, least):
    optimiser = make()
    run(optimiser, batches)
    assert optimiser.ledger.best_fitness > least  # the start is at -3.6


@pytest.mark.parametrize(
    "make",
    [
        *(partial(pymoo, name, pop_size=8) for name in ("GA", "DE", "PSO", "ISRES", "G3PCX", "MixedVariableGA")),
        *(partial(Nevergrad, name, budget=200) for name in ("TwoPointsDE", "PSO", "OnePlusOne", "CMA", "Powell")),
    ],
)
def test_populations_begin_with_the_start(make):
    np.testing.assert_allclose(run(make(), 1)[0][0], np.full(12, 0.6), rtol=1e-7 if make.func is Nevergrad else 0.0)


def test_lists_of_a_configuration_are_tuples_where_a_function_has_them():
    """The defaults of `minimize` come back as `args: []`, which Nelder-Mead refuses."""
    given = {"args": [], "constraints": [], "method": "Nelder-Mead", "tol": 1e-9}
    optimiser = Scipy(partial(minimize, **given))
    run(optimiser, 60)
    assert optimiser.ledger.best_fitness > -3.6 + 1e-6


def test_shgo_is_refused_where_the_corners_of_its_box_do_not_fit_into_memory():
    Scipy(partial(shgo)).check(problem(RandomDeployment(4)))
    for count, corners in ((30, 60), (1000, 2000)):
        with pytest.raises(InputError, match=rf"^minimise: shgo, which begins with the 2\^{corners} corners of a box"):
            Scipy(shgo).check(problem(RandomDeployment(count)))


def test_a_nevergrad_method_that_cannot_work_in_parallel_is_asked_one_by_one():
    assert [len(genes) for genes in run(Nevergrad("Powell", workers=5, budget=100), 3)] == [1, 1, 1]
    assert [len(genes) for genes in run(Nevergrad("TwoPointsDE", workers=5), 3)] == [5, 5, 5]


def test_no_thread_of_a_library_keeps_a_process_from_its_end():
    before = set(threading.enumerate())
    run(Nevergrad("ChainCMAPowell", budget=20), 15)
    waiting = set(threading.enumerate()) - before
    assert waiting
    assert all(thread.daemon for thread in waiting)


def test_a_nevergrad_method_that_needs_a_budget_plans_and_begins_anew(monkeypatch):
    monkeypatch.setattr("lmd.optimisers.nevergrad.PLANNED", 10)
    optimiser = Nevergrad("NGOpt")
    asked = run(optimiser, 11)
    np.testing.assert_allclose(asked[10], asked[np.argmin([np.abs(genes - 0.3).sum() for genes in asked[:10]])])


def test_a_nevergrad_method_that_cannot_learn_from_the_start_goes_on():
    assert len(np.unique(np.concatenate(run(Nevergrad("EDA", budget=40), 20)), axis=0)) == 20


@pytest.mark.parametrize("name", ["TinyLognormalDiscreteOnePlusOne", "TwoPointsDE", "PSO", "NGOpt"])
def test_what_plans_with_the_evaluations_runs_without_their_number(name):
    cfg = composed(
        "optimise", "optimiser=nevergrad", f"optimiser.name={name}", "budget.evaluations=null", "budget.seconds=0.05"
    )
    assert build_optimiser(cfg, 0).run(problem(), budget_of(cfg)).evaluations > 0


def test_nevergrad_is_told_the_budget_of_the_run():
    node = composed("optimise", "optimiser=nevergrad", "budget.evaluations=77").optimiser
    assert instantiate(node, seed=0).budget == 77


def test_scipy_begins_with_the_start_and_once_more_with_the_best_when_it_ends():
    optimiser = Scipy(partial(dual_annealing, no_local_search=True, maxfun=10))
    asked = run(optimiser, 30)
    np.testing.assert_array_equal(asked[0][0], np.full(12, 0.6))
    losses = [np.abs(genes - 0.3).sum() for genes in asked]
    assert any((later == asked[np.argmin(losses[:i])]).all() for i, later in enumerate(asked) if i > 1)


def test_an_optimiser_that_ends_is_followed_by_one_that_starts_from_the_best():
    optimiser = Stubborn()
    asked = [float(genes[0, 0]) for genes in run(optimiser, 20, fitness=lambda genes: genes[:, 0])]
    assert len(set(asked)) == 20  # each with another seed
    assert optimiser.opened == [0.6, *np.maximum.accumulate(asked)[:-1]]


def test_of_equal_deployments_the_later_counts_as_better():
    optimiser = PyCma()
    losses = np.concatenate(losses_told(optimiser, 3, fitness=lambda genes: np.full(len(genes), 0.5)))
    assert (np.diff(losses) < 0.0).all()
    np.testing.assert_allclose(losses, -0.5, atol=1e-9)


def test_pycma_goes_on_after_it_has_converged():
    optimiser = PyCma("full", step=0.3)
    flat = run(optimiser, 120, dim=2, fitness=lambda genes: np.zeros(len(genes)))
    assert len(flat) == 120


@pytest.mark.parametrize(
    "make",
    [
        lambda: pymoo("PatternSearch"),
        lambda: pymoo("CMAES", sigma=0.3),
        lambda: Nevergrad("LognormalDiscreteOnePlusOne"),
        lambda: Nevergrad("Powell", budget=100),
        lambda: PyCma("vkd"),
        lambda: Scipy(differential_evolution),
        lambda: pymoo("G3PCX", pop_size=10),
        lambda: Stubborn(),
    ],
)
def test_what_was_told_again_goes_on_as_if_nothing_had_happened(make, tmp_path):
    check_going_on(make, problem, make().run(problem(), Budget(60)), tmp_path)


def test_failed_evaluations_cost_a_finite_loss():
    for optimiser in (pymoo("CMAES"), PyCma(), Nevergrad("TwoPointsDE")):
        losses = losses_told(optimiser, 4, lambda genes: np.where(np.arange(len(genes)) == 0, -np.inf, genes[:, 0]))
        assert all(np.isfinite(told).all() for told in losses)


def test_libraries_leave_the_global_generators_alone_and_are_silent(capfd, recwarn):
    before = np.random.get_state()[1].copy(), random.getstate()  # noqa: NPY002
    for optimiser in (pymoo("CMAES"), PyCma(), Nevergrad("LognormalDiscreteOnePlusOne"), Stubborn()):
        run(optimiser, 5)
    np.testing.assert_array_equal(np.random.get_state()[1], before[0])  # noqa: NPY002
    assert random.getstate() == before[1]
    assert capfd.readouterr() == ("", "")
    assert not list(recwarn)


def test_random_search_does_not_depend_on_its_batch():
    one, other = run(RandomSearch(batch=4), 6), run(RandomSearch(batch=12), 2)
    np.testing.assert_array_equal(np.concatenate(one), np.concatenate(other))
