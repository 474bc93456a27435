"""Evaluations are recorded for each candidate, whatever the size of batches."""

import time

import numpy as np
import pytest
from contracts.optimiser import NanProblem, Scores
from support.small import problem

from lmd.evaluation.comparison import OptimiserRun, attained, curve_targets, expected_running_time
from lmd.optimisers.checkpoint import Checkpoint
from lmd.optimisers.genetic import EGA, RandomSearch
from lmd.optimisers.ledger import Budget, Ledger

EVALUATIONS = 230  # the last batch of 100 is cut short


def run_in_batches(batch, seed, of):
    p = problem()
    return RandomSearch(batch, seed=seed).run(of(p.scene, p.objective, p.start, threads=1), Budget(EVALUATIONS))


@pytest.mark.parametrize("of", [Scores, NanProblem])
def test_one_sequence_of_candidates_has_equal_running_times_in_batches_of_any_size(of):
    runs = {
        batch: [OptimiserRun(str(batch), seed, {}, found.history, found.deployment)
                for seed in range(3) for found in [run_in_batches(batch, seed, of)]]
        for batch in (1, 7, 100)
    }  # fmt: skip
    targets, at = curve_targets(runs[1]), np.arange(1.0, EVALUATIONS + 1)
    expected = [expected_running_time(runs[1], target) for target in targets]
    assert len(set(expected)) >= 5
    for batch in (7, 100):
        assert curve_targets(runs[batch]).tolist() == targets.tolist()
        assert [expected_running_time(runs[batch], target) for target in targets] == expected
        shares = [attained(runs[size], "evaluations", at, targets) for size in (1, batch)]
        np.testing.assert_array_equal(*shares)
        assert shares[0][0] < shares[0][99] < shares[0][-1]


def test_the_history_has_each_improvement_and_the_end_of_each_batch():
    ledger = Ledger()
    ledger.seconds = 2.0
    assert ledger.note_batch(np.array([-np.inf, 0.1, 0.1, 0.3, 0.2, 0.1])) == 3
    ledger.seconds = 5.0
    assert ledger.note_batch(np.array([0.3, 0.2])) is None
    assert ledger.note_batch(np.array([0.2, 0.4])) == 1
    records = [(record.evaluations, record.best_fitness, record.wall_time) for record in ledger.history]
    assert records == [(2, 0.1, 2.0), (4, 0.3, 2.0), (6, 0.3, 2.0), (8, 0.3, 5.0), (10, 0.4, 5.0)]
    assert (ledger.evaluations, ledger.best_fitness) == (10, 0.4)


@pytest.mark.parametrize("budget", [Budget(60), Budget(seconds=0.2)])
def test_no_more_candidates_are_drawn_to_start_from_than_the_budget_can_evaluate(budget, capsys, tmp_path):
    optimiser = EGA(population=100_000)
    began = time.process_time()
    found = optimiser.run(problem(), budget)
    assert time.process_time() - began < 4.0  # to draw them all would take a minute
    assert found.evaluations <= budget.limit
    assert len(optimiser.start) < 100_000
    assert f"note: EGA: the budget allows {len(optimiser.start)} of its 100000 start candidates;" in (
        capsys.readouterr().err
    )
    Checkpoint(optimiser, {}).save(tmp_path)
    again = Checkpoint(EGA(population=100_000), {})
    again.resume(tmp_path, problem())
    assert again.optimiser.ledger.history == optimiser.ledger.history


def test_a_start_within_the_budget_is_drawn_whole_without_a_word(capsys):
    optimiser = EGA(population=60)
    optimiser.run(problem(), Budget(60))
    assert len(optimiser.start) == 60
    assert capsys.readouterr().err == ""
