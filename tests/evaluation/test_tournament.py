"""Optimisers over several problems: ranks, tests, profiles, and IOHprofiler's format against iohinspector."""

import math

import numpy as np
import pytest
from scipy import stats

from lmd.evaluation.comparison import OptimiserRun, expected_running_time
from lmd.evaluation.tournament import (
    critical_difference,
    tournament,
    write_iohprofiler,
)
from lmd.optimisers.ledger import Record


def run_of(problem, optimiser, seed, values, step=1.0):
    history = [Record(step * (i + 1), best, 0.0) for i, best in enumerate(np.maximum.accumulate(values).tolist())]
    return OptimiserRun(optimiser, seed, {"fitness": history[-1].best_fitness}, history, None, problem=problem)


@pytest.fixture(scope="module")
def runs():
    rng = np.random.default_rng(0)
    return [
        run_of(problem, name, seed, rng.random(20) * (0.5 + 0.05 * k), step=1.0 if name != "c" else 1.25)
        for problem in ("p", "q", "r", "s")
        for k, name in enumerate("abc")
        for seed in range(4)
    ]


def test_ranks_are_of_medians_over_seeds(runs):
    held = tournament(runs, "fitness")
    medians = {
        (p, o): np.median([run.metrics["fitness"] for run in runs if (run.problem, run.optimiser) == (p, o)])
        for p in "pqrs"
        for o in "abc"
    }
    for problem in "pqrs":
        for optimiser in "abc":
            assert held.values.loc[problem, optimiser] == medians[problem, optimiser]
    by_hand = {o: np.mean([sum(medians[p, x] >= medians[p, o] for x in "abc") for p in "pqrs"]) for o in "abc"}
    assert held.ranks.to_dict() == by_hand
    assert held.friedman == stats.friedmanchisquare(*(held.values[name] for name in "abc")).pvalue
    assert list(held.ranks) == sorted(held.ranks)


def test_a_lead_is_tested_over_the_seeds(runs):
    held = tournament(runs, "fitness")
    own = {o: [run.metrics["fitness"] for run in runs if (run.problem, run.optimiser) == ("q", o)] for o in "abc"}
    first, second = sorted(own, key=lambda name: -np.median(own[name]))[:2]
    assert held.winners["q"] == [first]
    assert held.leads["q"] == stats.mannwhitneyu(own[first], own[second]).pvalue
    alone = tournament([run for run in runs if run.optimiser == "a"], "fitness")
    assert math.isnan(alone.leads["q"])


def test_a_problem_that_an_optimiser_did_not_take_is_left_out_of_the_tests(runs):
    held = tournament([run for run in runs if (run.problem, run.optimiser) != ("p", "a")], "fitness")
    assert held.complete == 3
    assert math.isnan(held.values.loc["p", "a"])
    assert "a" not in held.winners["p"]


def test_the_critical_difference_is_that_of_demsar():
    """Table 5 of Demsar (2006): q = 1.960, 2.343 and 3.164 for 2, 3 and 10 classifiers at 5 %; his example: 1.25."""
    for count, q in ((2, 1.960), (3, 2.343), (4, 2.569), (10, 3.164)):
        expected = q * math.sqrt(count * (count + 1) / (6 * 14))
        assert critical_difference(count, 14) == pytest.approx(expected, rel=5e-4)
    assert critical_difference(4, 14) == pytest.approx(1.25, abs=0.005)


@pytest.fixture(scope="module")
def read(runs, tmp_path_factory):
    """The runs as iohinspector reads them."""
    from iohinspector import DataManager

    folder = tmp_path_factory.mktemp("ioh")
    for number, problem in enumerate("pqrs", 1):
        for name in "abc":
            own = [run for run in runs if (run.problem, run.optimiser) == (problem, name)]
            write_iohprofiler(folder / name, own, problem, number, dim=16)
    manager = DataManager()
    manager.add_folder(str(folder))
    assert manager.overview["algorithm_name"].unique().sort().to_list() == list("abc")
    assert manager.overview["run_id"].max() == 4
    return manager.load(monotonic=False, include_meta_data=True)


COLUMNS = ["data_id", "algorithm_name", "evaluations", "raw_y"]


def test_iohinspector_has_our_expected_running_times(read, runs):
    from iohinspector.metrics import aggregate_running_time

    for problem in "pqrs":
        own = read.filter(read["function_name"] == problem)
        theirs = aggregate_running_time(own, f_min=0.2, f_max=0.5, scale_f_log=False, maximization=True, eval_max=20)
        for name in "ab":  # their runs end after 20 evaluations
            group = [run for run in runs if (run.problem, run.optimiser) == (problem, name)]
            for _, row in theirs[theirs.algorithm_name == name].iterrows():
                assert expected_running_time(group, row.raw_y) == pytest.approx(row.ERT, abs=1e-12)


def test_the_rankings_on_instances_held_out_and_not_are_set_side_by_side():
    from lmd.suite.leaderboard import leaderboard

    level = {"tiny_mean": {"a": 0.3, "b": 0.2, "c": 0.1}, "tiny_mean-1000": {"a": 0.3, "b": 0.1, "c": 0.2}}
    runs = [run_of(problem, name, 0, [value]) for problem, own in level.items() for name, value in own.items()]
    found = leaderboard({0: runs}, level)
    assert found.figures["rank_1_development/fitness/b"] == found.figures["rank_1_held_out/fitness/c"] == 2.0
    assert found.figures["tau_1/fitness"] == pytest.approx(1 / 3)  # two pairs of three are in the same order
    assert "### Fitness, held-out instances" in found.text
    assert "Kendall's tau between the two rankings by fitness: 0.33." in found.text
