"""Whether samples differ by more than chance, and by how much: tests that assume no distribution.

All tests are two-sided. Sources: Demsar, "Statistical Comparisons of Classifiers over Multiple Data Sets" (2006), for
Friedman's test followed by Nemenyi's; Vargha and Delaney, "A Critique and Improvement of the CL Common Language Effect
Size Statistics" (2000), for A12; Holm, "A Simple Sequentially Rejective Multiple Test Procedure" (1979).
"""

import numpy as np
from scipy import stats

from lmd.core.checks import FloatArray

CONFIDENCE = 0.95
LEAST_PAIRS = 2


def wilcoxon(first: FloatArray, second: FloatArray) -> float:
    """P-value of Wilcoxon's signed-rank test on pairs `(N,)`; 1 if no pair differs, NaN for fewer than two pairs."""
    differences = np.subtract(first, second)
    if len(differences) < LEAST_PAIRS:
        return np.nan
    return float(stats.wilcoxon(differences).pvalue) if differences.any() else 1.0


def holm(p_values: FloatArray) -> FloatArray:
    """P-values `(M,)` of several tests with Holm's correction; NaN, for no test, does not count."""
    known = np.flatnonzero(~np.isnan(p_values))
    order = known[np.argsort(p_values[known])]
    corrected = np.full(len(p_values), np.nan)
    factors = np.arange(len(order), 0, -1)
    corrected[order] = np.minimum(np.maximum.accumulate(factors * p_values[order]), 1.0)
    return corrected


def mean_ranks(values: FloatArray) -> FloatArray:
    """Mean rank of each of K columns of `(N, K)` over the rows; 1 for the highest value, ties share their ranks."""
    ranks: FloatArray = stats.rankdata(-values, axis=1).mean(axis=0)
    return ranks


def friedman(values: FloatArray) -> float:
    """P-value of Friedman's test that three or more columns of `(N, K)` are alike; NaN for fewer than two rows."""
    if len(values) < LEAST_PAIRS:
        return np.nan
    if (values == values[:, :1]).all():
        return 1.0
    return float(stats.friedmanchisquare(*values.T).pvalue)


def nemenyi(values: FloatArray) -> FloatArray:
    """P-values `(K, K)` of Nemenyi's test of every two columns of `(N, K)`; NaN for fewer rows than two."""
    rows, columns = values.shape
    if rows < LEAST_PAIRS:
        return np.full((columns, columns), np.nan)
    ranks = mean_ranks(values)
    apart = np.abs(ranks[:, None] - ranks) / np.sqrt(columns * (columns + 1) / (6 * rows))
    p_values: FloatArray = stats.studentized_range.sf(np.sqrt(2.0) * apart, columns, np.inf)
    return p_values


def a12(first: FloatArray, second: FloatArray) -> float:
    """Vargha and Delaney's A12: how probable a value of `first` is above one of `second`, where ties count half."""
    return float(stats.mannwhitneyu(first, second).statistic / (len(first) * len(second)))


def median_interval(values: FloatArray, seed: int) -> tuple[float, float]:
    """The bootstrap's percentile interval of the median with a confidence of 95 %; one value is its own.

    Args:
        values: the sample `(N,)`.
    """
    if len(values) == 1:
        return float(values[0]), float(values[0])
    generator = np.random.default_rng(seed)
    found = stats.bootstrap((values,), np.median, confidence_level=CONFIDENCE, method="percentile", rng=generator)
    return float(found.confidence_interval.low), float(found.confidence_interval.high)
