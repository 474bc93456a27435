"""Steps 4 and 5 of the paper's procedure: test that yaw and pitch are independent, and fit of a probability density.

The range of an angle is divided into fine cells of equal width, and a density is represented by the probabilities of
these cells. Parametric families of densities and a kernel estimate are compared by cross-validation. The recording is
divided into contiguous sections (folds). A family is fitted to all folds but one, and its log-likelihood is computed
for the samples of the omitted fold. The one-standard-error rule chooses the simplest family that is worse than the best
family by at most one standard error of the difference of their mean log-likelihoods.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache
from itertools import product

import numpy as np
from scipy.ndimage import gaussian_filter, gaussian_filter1d
from scipy.stats import MonteCarloMethod, chi2_contingency, circmean, norm, truncnorm, vonmises

from lmd.core.checks import FloatArray, IntArray
from lmd.orientation.recording import Samples

CROSS_VALIDATION_FOLDS = 10
# Candidate standard deviations of a kernel, fine cells.
BANDWIDTHS = (1.0, 1.5, 2.0, 3.0, 4.0, 6.0, 8.0, 12.0, 16.0)
YAW_BINS, PITCH_BINS = 8, 4  # bins of equal frequency in the table of the independence test
RESAMPLES = 9999  # random tables of the independence test


@dataclass(frozen=True)
class AngleCells:
    """Division of the range of an angle into fine cells of equal width."""

    low: float
    """Lower bound of the first cell, radians."""
    high: float
    """Upper bound of the last cell, radians."""
    cells: int
    """M, the number of cells."""
    circular: bool
    """True if `low` and `high` are one direction, as for the yaw."""

    @property
    def width(self) -> float:
        """Width of a cell, radians."""
        return (self.high - self.low) / self.cells

    @property
    def edges(self) -> FloatArray:
        """Bounds of the cells, `(M + 1,)`, radians."""
        return np.linspace(self.low, self.high, self.cells + 1)

    @property
    def centres(self) -> FloatArray:
        """Middle of each cell, `(M,)`, radians."""
        return np.asarray((self.edges[:-1] + self.edges[1:]) / 2.0)

    def index(self, angle: FloatArray) -> IntArray:
        """Indices `(S,)` of the cells that contain the angles `angle` `(S,)`, radians."""
        offset = angle - self.low
        if self.circular:
            offset = np.mod(offset, self.high - self.low)
        return np.asarray(np.clip(offset / self.width, 0, self.cells - 1), dtype=np.int64)


@dataclass(frozen=True)
class Density:
    """Density fitted to samples, represented by the probabilities of fine cells."""

    family: str
    """Family: `uniform`, `von_mises`, `normal`, `kernel` or `fixed`."""
    parameters: dict[str, float]
    """Fitted parameters, keyed by name, radians; the concentration of `von_mises` has no unit."""
    probability: FloatArray
    """Probability of each fine cell, `(M,)`, or `(M_1, M_2)` for two angles; the sum is 1."""


Family = Callable[[FloatArray, AngleCells], Density]


@dataclass(frozen=True)
class Candidate:
    """Fit of one family of densities to samples of an angle, and its score in the comparison of families."""

    density: Density
    """Fit to all samples."""
    log_likelihood: float
    """Cross-validated mean log-likelihood per sample, computed with the probabilities of fine cells."""
    behind: float
    """Amount by which `log_likelihood` is below that of the best candidate, at least 0."""
    standard_error: float
    """Standard error of `behind`, estimated from the paired differences of the samples' log-likelihoods."""


def uniform(_angle: FloatArray, axis: AngleCells) -> Density:
    """Return the uniform density of an angle, with equal probabilities for all cells of `axis`."""
    return Density("uniform", {}, np.full(axis.cells, 1.0 / axis.cells))


def von_mises(angle: FloatArray, axis: AngleCells) -> Density:
    """Fit a von Mises distribution (the analogue of a normal distribution on a circle) by maximum likelihood.

    The density at the angle x is exp(kappa cos(x - mu)) / (2 pi I_0(kappa)), with mean mu and concentration kappa.

    Args:
        angle: samples, `(S,)`, radians.
        axis: cells into which the range of the angle is divided.

    Returns:
        probabilities of the cells, and the fitted mu and kappa.
    """
    kappa, mean, _ = vonmises.fit(angle, fscale=1)
    probability = np.diff(vonmises.cdf(axis.edges, kappa, loc=mean))
    return Density("von_mises", {"mean": float(mean), "concentration": float(kappa)}, probability)


def normal(angle: FloatArray, axis: AngleCells) -> Density:
    """Fit a normal distribution, truncated to the range of an angle, to samples of the angle.

    The mean and the standard deviation of the distribution before truncation are those of the samples.

    Args:
        angle: samples, `(S,)`, radians.
        axis: cells into which the range of the angle is divided.
    """
    mean, std = norm.fit(angle)
    std = max(std, axis.width / 4.0)  # at least a quarter of a cell, as a fold may contain a single value
    low, high = (axis.low - mean) / std, (axis.high - mean) / std
    probability = np.diff(truncnorm.cdf(axis.edges, low, high, loc=mean, scale=std))
    return Density("normal", {"mean": float(mean), "standard_deviation": float(std)}, probability)


def kernel_estimate(angle: FloatArray, axis: AngleCells) -> Density:
    """Fit a kernel density estimate to samples `angle` `(S,)`, radians; return it on the cells of `axis`."""
    probability, (bandwidth,) = kernel_density((axis.index(angle),), (axis,))
    return Density("kernel", {"bandwidth": bandwidth}, probability)


def kernel_density(index: tuple[IntArray, ...], axes: tuple[AngleCells, ...]) -> tuple[FloatArray, tuple[float, ...]]:
    """Estimate the density of one angle or of two angles with Gaussian kernels, whose widths cross-validation chooses.

    Kernels are wrapped on a circular range, and reflected at the ends of another range.

    Args:
        index: for each angle, the indices of the cells that contain the S samples, `(S,)`.
        axes: for each angle, the fine cells of its range.

    Returns:
        probabilities of the fine cells, `(M,)` or `(M_1, M_2)`, and the width (bandwidth) of the kernel along each
        angle, radians.
    """
    shape = tuple(axis.cells for axis in axes)
    cell = np.ravel_multi_index(index, shape)
    mode = ["wrap" if axis.circular else "reflect" for axis in axes]

    def counted(chosen: IntArray) -> FloatArray:
        return np.bincount(chosen, minlength=int(np.prod(shape))).reshape(shape).astype(np.float64)

    held_out = _folds(len(cell))
    rest = [counted(np.delete(cell, fold)) for fold in held_out]

    @cache
    def along_first(part: int, bandwidth: float) -> FloatArray:
        return np.asarray(gaussian_filter1d(rest[part], bandwidth, axis=0, mode=mode[0]))

    def log_likelihood(part: int, bandwidths: tuple[float, ...]) -> float:
        density, count = along_first(part, bandwidths[0]), rest[part].sum()
        for axis, bandwidth in enumerate(bandwidths[1:], start=1):
            density = gaussian_filter1d(density, bandwidth, axis=axis, mode=mode[axis])
        return float(_log_likelihood(density / count, count, cell[held_out[part]]).sum())

    def score(bandwidths: tuple[float, ...]) -> float:
        return sum(log_likelihood(part, bandwidths) for part in range(len(rest)))

    best = max(product(BANDWIDTHS, repeat=len(axes)), key=score)
    widths = tuple(float(b * axis.width) for b, axis in zip(best, axes, strict=True))
    return np.asarray(gaussian_filter(counted(cell), best, mode=mode) / len(cell)), widths


def choose(angle: FloatArray, axis: AngleCells, families: Sequence[Family]) -> tuple[Density, tuple[Candidate, ...]]:
    """Fit several families of densities to samples of an angle, and choose one by the one-standard-error rule.

    The rule is explained in the module docstring.

    Args:
        angle: samples, radians, ordered in time, `(S,)`.
        axis: cells into which the range of the angle is divided.
        families: functions that fit a family, such as `von_mises`, in the order from simple to complex.

    Returns:
        the chosen density, and the fits and scores of all families.
    """
    index = axis.index(angle)
    scores = np.empty((len(families), len(angle)))
    for fold in _folds(len(angle)):
        rest = np.delete(angle, fold)
        for i, family in enumerate(families):
            scores[i, fold] = _log_likelihood(family(rest, axis).probability, len(rest), index[fold])
    mean = scores.mean(axis=1)
    difference = scores[np.argmax(mean)] - scores
    behind, error = difference.mean(axis=1), difference.std(axis=1, ddof=1) / np.sqrt(len(angle))
    candidates = tuple(
        Candidate(family(angle, axis), float(m), float(b), float(e))
        for family, m, b, e in zip(families, mean, behind, error, strict=True)
    )
    chosen = next(c for c in candidates if c.behind <= c.standard_error)
    return chosen.density, candidates


def fixed_angle(angle: FloatArray, axis: AngleCells) -> float | None:
    """Circular mean of the samples, radians, if all lie within the width of a fine cell; otherwise None (not fixed)."""
    mean = float(circmean(angle, high=np.pi, low=-np.pi))
    return mean if np.ptp(circular_difference(angle, mean)) < axis.width else None


def _folds(count: int) -> list[IntArray]:
    return np.array_split(np.arange(count), CROSS_VALIDATION_FOLDS)


def _log_likelihood(probability: FloatArray, count: float, index: IntArray) -> FloatArray:
    """Logarithm of the probability that each of S samples lies in its cell, `(S,)`.

    The probabilities were fitted to other samples. An additional sample, spread evenly over all cells, keeps the
    logarithm finite for a cell of probability 0.

    Args:
        probability: fitted probabilities of all cells.
        count: number of samples to which the probabilities were fitted.
        index: index of the cell of each of the S samples, `(S,)`.
    """
    flat = probability.reshape(-1)
    return np.asarray(np.log((count * flat[index] + 1.0 / flat.size) / (count + 1.0)))


@dataclass(frozen=True)
class Independence:
    """Outcome of the test that yaw and pitch are independent, see `independence_test`."""

    statistic: float
    """Pearson's chi-squared statistic of the contingency table of yaw and pitch bins."""
    p_value: float
    """P-value of the statistic."""
    table_shape: tuple[int, int]
    """Number of yaw bins and number of pitch bins."""
    significance: float
    """Significance level of the test."""

    @property
    def rejected(self) -> bool:
        """True if the test rejects that yaw and pitch are independent."""
        return self.p_value < self.significance


def independence_test(samples: Samples, significance: float, rng: np.random.Generator) -> Independence:
    """Test by Pearson's chi-squared statistic that yaw and pitch are independent.

    The statistic is computed from a contingency table, which has the numbers of samples in bins of yaw (rows) and bins
    of pitch (columns). Bins have about equal numbers of samples. Random tables are drawn whose row and column sums
    equal those of the samples' table. The p-value is the fraction of tables, the samples' table included, whose
    statistic is at least that of the samples' table. The p-value is therefore valid for few samples, too.

    The test assumes independent samples. If samples were closer in time than the correlation time of the recording, the
    test would reject too often.

    Args:
        samples: samples of yaw and pitch, neither of them fixed.
        significance: significance level in [0, 1].
        rng: random generator that draws the tables.
    """
    around_mean = circular_difference(samples.yaw, circmean(samples.yaw))
    rows, columns = _equal_bins(around_mean, YAW_BINS), _equal_bins(samples.pitch, PITCH_BINS)
    table = np.zeros((rows.max() + 1, columns.max() + 1), dtype=np.int64)
    np.add.at(table, (rows, columns), 1)
    if min(table.shape) < 2:
        return Independence(0.0, 1.0, table.shape, significance)
    method = MonteCarloMethod(n_resamples=RESAMPLES, rng=rng)
    result = chi2_contingency(table, correction=False, method=method)
    return Independence(float(result.statistic), float(result.pvalue), table.shape, significance)


def circular_difference(angle: FloatArray, origin: float) -> FloatArray:
    """Difference `angle - origin` wrapped to [-pi, pi), radians, shape of `angle`."""
    return np.asarray(np.mod(angle - origin + np.pi, 2.0 * np.pi) - np.pi)


def _equal_bins(values: FloatArray, bins: int) -> IntArray:
    """Divide `values` `(S,)` into at most `bins` bins of about equal frequency; return each value's bin, `(S,)`.

    Equal values are in one bin, so frequencies may differ. No bin is empty.
    """
    inner = np.quantile(values, np.arange(1, bins) / bins)
    return np.asarray(np.unique(np.searchsorted(inner, values, side="right"), return_inverse=True)[1], dtype=np.int64)
