"""The suite as other libraries take it, each run from its side."""

import json

import numpy as np
import pytest

import lmd.suite
from lmd.core.checks import InputError


@pytest.fixture(scope="module")
def box():
    return lmd.suite.problem("tiny_mean")


@pytest.fixture(scope="module")
def two():
    return lmd.suite.problem("localised_against_tags")


def test_pymoo_minimises_the_negative_values_of_one_objective_or_two(box, two):
    from pymoo.algorithms.moo.nsga2 import NSGA2
    from pymoo.algorithms.soo.nonconvex.ga import GA
    from pymoo.optimize import minimize

    found = minimize(lmd.suite.pymoo_problem(box), GA(pop_size=8), ("n_eval", 24), seed=0)
    assert found.F[0] == -box(found.X)
    assert -found.F[0] >= max(box(genes) for genes in found.pop.get("X"))
    found = minimize(lmd.suite.pymoo_problem(two), NSGA2(pop_size=8), ("n_eval", 16), seed=0)
    assert (-two(found.X) == found.F).all()


def test_nevergrad_minimises_the_negative_values(box, two):
    import nevergrad as ng

    function = lmd.suite.nevergrad_function(box)
    optimiser = ng.optimizers.OnePlusOne(function.parametrization, budget=12)
    optimiser.parametrization.random_state.seed(1)
    found = optimiser.minimize(function)
    genes = found.kwargs["x"]
    assert function(genes) == -box(genes)
    assert lmd.suite.nevergrad_function(two)(two.start()) == (-two(two.start())).tolist()


def test_ioh_maximises(box, tmp_path):
    import ioh

    problem = lmd.suite.ioh_problem(box)
    logger = ioh.logger.Analyzer(root=str(tmp_path), folder_name="runs", algorithm_name="random")
    problem.attach_logger(logger)
    genes = np.random.default_rng(0).random((6, box.dim))
    assert [problem(row) for row in genes] == box(genes).tolist()
    assert problem.state.current_best.y == box(genes).max()
    logger.close()
    (document,) = (tmp_path / "runs").glob("*.json")
    written = json.loads(document.read_text())
    assert written["function_name"] == "tiny_mean"
    assert written["maximization"] is True


def test_optuna_maximises(box, two):
    import optuna

    optuna.logging.set_verbosity(optuna.logging.WARNING)
    study = optuna.create_study(direction="maximize", sampler=optuna.samplers.RandomSampler(seed=0))
    study.optimize(lmd.suite.optuna_objective(box), n_trials=8)
    genes = np.array([[trial.params[f"x{i}"] for i in range(box.dim)] for trial in study.trials])
    assert [trial.value for trial in study.trials] == box(genes).tolist()
    several = optuna.create_study(directions=["maximize"] * 2, sampler=optuna.samplers.RandomSampler(seed=0))
    several.optimize(lmd.suite.optuna_objective(two), n_trials=2)
    genes = np.array([several.trials[0].params[f"x{i}"] for i in range(two.dim)])
    assert several.trials[0].values == two(genes).tolist()


@pytest.mark.parametrize("vectorized", [False, True])
def test_scipy_minimises_the_negative_values(box, vectorized):
    from scipy.optimize import Bounds, differential_evolution

    updating = {"vectorized": True, "updating": "deferred"} if vectorized else {}
    bounds = Bounds(box.lower, box.upper)
    found = differential_evolution(
        lmd.suite.scipy_function(box), bounds, maxiter=1, popsize=1, rng=0, polish=False, **updating
    )
    assert found.fun == -box(found.x)


def test_libraries_of_one_objective_refuse_two(two):
    for adapter in (lmd.suite.ioh_problem, lmd.suite.scipy_function):
        with pytest.raises(InputError, match="localised_against_tags has 2 objectives"):
            adapter(two)


def test_a_problem_of_ones_own_works_as_those_of_the_suite_do(box):
    own = lmd.suite.BlackBox(box.problem, "mine")
    genes = own.start(4)
    assert lmd.suite.scipy_function(own)(genes) == -box(genes)
