"""Tests of significance, against printed tables and against counting every case."""

from itertools import combinations, product

import numpy as np
import pytest

from lmd.evaluation.comparison import a12, friedman, holm, mann_whitney, mean_ranks, median_interval, nemenyi, wilcoxon

# Critical values of Nemenyi's test at 0.05 for 2, 3, 5 and 10 columns, as Demsar (2006) prints them in Table 5 (a).
CRITICAL = {2: 1.960, 3: 2.343, 5: 2.728, 10: 3.164}


def test_the_signed_rank_test_counts_all_signs():
    differences = np.array([3.0, -1.0, 4.0, 2.0, 7.0, 5.0, 6.0])
    ranks = np.argsort(np.argsort(np.abs(differences))) + 1
    sums = [ranks @ (np.array(signs) > 0) for signs in product([-1, 1], repeat=len(ranks))]
    observed = ranks @ (differences > 0)
    expected = 2 * min(np.mean(np.array(sums) >= observed), np.mean(np.array(sums) <= observed))
    assert wilcoxon(differences, np.zeros(7)) == pytest.approx(expected)


def test_pairs_that_do_not_differ_say_nothing_and_one_pair_is_none():
    assert wilcoxon(np.ones(5), np.ones(5)) == 1.0
    assert np.isnan(wilcoxon(np.ones(1), np.zeros(1)))


@pytest.mark.parametrize(
    "second", [(2.0, 2.0, 2.0), (4.0, 5.0, 6.0), (1.0, 2.0, 3.0, 2.0)], ids=["all tied", "no tie", "some tied"]
)
def test_the_test_of_mann_and_whitney_counts_all_halves_with_ties_too(second):
    values = np.array([1.0, 1.5 if second[-1] == 6.0 else 1.0, 1.0 + second[0] / 10.0, *second])
    ahead = np.sign(values[:, None] - values)
    halves = [[*half] for half in combinations(range(len(values)), 3)]
    sums = [ahead[half][:, [i for i in range(len(values)) if i not in half]].sum() for half in halves]
    expected = 2.0 * min(np.mean(np.array(sums) <= sums[0]), np.mean(np.array(sums) >= sums[0]))
    assert mann_whitney(values[:3], values[3:]) == pytest.approx(min(expected, 1.0))
    assert np.isnan(mann_whitney(values[:1], values))


def test_holms_correction_steps_down():
    np.testing.assert_allclose(holm(np.array([0.01, 0.04, np.nan, 0.03, 0.4])), [0.04, 0.09, np.nan, 0.09, 0.4])
    assert holm(np.array([0.6, 0.7])).tolist() == [1.0, 1.0]


def test_ranks_count_from_the_best_and_ties_share_theirs():
    assert mean_ranks(np.array([[3.0, 1.0, 2.0], [5.0, 5.0, 4.0]])).tolist() == [1.25, 2.25, 2.5]


def test_friedmans_test_has_the_statistic_of_the_textbooks():
    values = np.random.default_rng(2).random((9, 3)) + np.array([0.0, 0.2, 0.4])
    rows, columns = values.shape
    ranks = np.array([[1 + (row > value).sum() for value in row] for row in values]).mean(axis=0)
    chi2 = 12 * rows / (columns * (columns + 1)) * ((ranks**2).sum() - columns * (columns + 1) ** 2 / 4)
    assert friedman(values) == pytest.approx(np.exp(-chi2 / 2))  # the tail with two degrees of freedom
    assert friedman(np.ones((5, 3))) == 1.0
    assert np.isnan(friedman(values[:1]))


@pytest.mark.parametrize(("columns", "critical"), CRITICAL.items())
def test_nemenyis_test_has_the_printed_critical_values(columns, critical):
    rows = 1000
    best_of = np.linspace(0.0, 1.0, columns)
    values = np.tile(best_of, (rows, 1))
    apart = critical * np.sqrt(columns * (columns + 1) / (6 * rows))  # ranks that are just so far apart
    swapped = round(rows * (1 - apart) / 2)
    values[:swapped, [-1, -2]] = values[:swapped, [-2, -1]]
    assert nemenyi(values)[-1, -2] == pytest.approx(0.05, abs=0.003)
    assert np.isnan(nemenyi(values[:1])).all()


def test_an_effect_size_counts_pairs():
    first, second = np.array([1.0, 2.0, 3.0]), np.array([2.0, 0.0])
    assert a12(first, second) == np.mean([(a > b) + 0.5 * (a == b) for a in first for b in second])


def test_the_interval_of_a_median_covers_it_and_is_the_same_again():
    values = np.random.default_rng(1).normal(size=20)
    low, high = median_interval(values, seed=3)
    assert values.min() < low < np.median(values) < high < values.max()
    assert median_interval(values, seed=3) == (low, high)
    assert median_interval(np.array([0.4]), seed=0) == (0.4, 0.4)
