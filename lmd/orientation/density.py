"""Step 5 of the paper's procedure: fitting a density to samples of one angle, or of both together.

A density is held as the probabilities of the fine cells of its angles. Candidates are compared by the cross-validated
log-likelihood per sample, which means the same for parametric families and for kernel estimates: each fold, a stretch
of the recording, is scored by what was fitted to the others. The simplest family within one standard error of the best
is chosen (the one-standard-error rule, on paired differences).
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache
from itertools import product

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter, gaussian_filter1d
from scipy.stats import circmean, norm, truncnorm, vonmises

from lmd.core.checks import FloatArray
from lmd.orientation.sampling import circular_difference

CROSS_VALIDATION_FOLDS = 10
# Standard deviations tried for a kernel, in fine cells.
BANDWIDTHS = (1.0, 1.5, 2.0, 3.0, 4.0, 6.0, 8.0, 12.0, 16.0)

IntArray = NDArray[np.int64]


@dataclass(frozen=True)
class Axis:
    """Fine cells of equal width over an angle.

    Args:
        low, high: where they begin and end, radians.
        cells: M, their number.
        circular: whether `high` is `low` again.
    """

    low: float
    high: float
    cells: int
    circular: bool

    @property
    def width(self) -> float:
        """The width of a cell, radians."""
        return (self.high - self.low) / self.cells

    @property
    def edges(self) -> FloatArray:
        """Where cells begin and end, `(M + 1,)`."""
        return np.linspace(self.low, self.high, self.cells + 1)

    @property
    def centres(self) -> FloatArray:
        """The middle of each cell, `(M,)`."""
        return np.asarray((self.edges[:-1] + self.edges[1:]) / 2.0)

    def index(self, angle: FloatArray) -> IntArray:
        """The cell of each angle, `(S,)`."""
        offset = angle - self.low
        if self.circular:
            offset = np.mod(offset, self.high - self.low)
        return np.asarray(np.clip(offset / self.width, 0, self.cells - 1), dtype=np.int64)


@dataclass(frozen=True)
class Density:
    """A fitted density.

    Args:
        family: `uniform`, `von_mises`, `normal`, `kernel` or `fixed`.
        parameters: what was fitted, radians.
        probability: of the fine cells, sum 1.
    """

    family: str
    parameters: dict[str, float]
    probability: FloatArray


Family = Callable[[FloatArray, Axis], Density]


@dataclass(frozen=True)
class Candidate:
    """A family in the comparison.

    Args:
        density: its fit to all samples.
        log_likelihood: cross-validated, mean per sample, of probabilities of fine cells.
        behind: how far that lies behind the best one's.
        standard_error: of `behind`, from the differences sample by sample.
    """

    density: Density
    log_likelihood: float
    behind: float
    standard_error: float


def uniform(_angle: FloatArray, axis: Axis) -> Density:
    """The same probability for every cell."""
    return Density("uniform", {}, np.full(axis.cells, 1.0 / axis.cells))


def von_mises(angle: FloatArray, axis: Axis) -> Density:
    """The von Mises distribution of greatest likelihood: density exp(kappa cos(x - mu)) / (2 pi I_0(kappa))."""
    kappa, mean, _ = vonmises.fit(angle, fscale=1)
    probability = np.diff(vonmises.cdf(axis.edges, kappa, loc=mean))
    return Density("von_mises", {"mean": float(mean), "concentration": float(kappa)}, probability)


def normal(angle: FloatArray, axis: Axis) -> Density:
    """The normal distribution with the samples' mean and standard deviation, cut to the range of the angle."""
    mean, std = norm.fit(angle)
    std = max(std, axis.width / 4.0)  # the cells cannot tell less, and a fold may hold one value only
    low, high = (axis.low - mean) / std, (axis.high - mean) / std
    probability = np.diff(truncnorm.cdf(axis.edges, low, high, loc=mean, scale=std))
    return Density("normal", {"mean": float(mean), "standard_deviation": float(std)}, probability)


def kernel(angle: FloatArray, axis: Axis) -> Density:
    """A kernel estimate, see `kernel_density`."""
    probability, (bandwidth,) = kernel_density((axis.index(angle),), (axis,))
    return Density("kernel", {"bandwidth": bandwidth}, probability)


def kernel_density(index: tuple[IntArray, ...], axes: tuple[Axis, ...]) -> tuple[FloatArray, tuple[float, ...]]:
    """A kernel estimate with Gaussian kernels, wrapped on circular axes and reflected at the ends of others.

    Args:
        index: cells of the samples on each axis, `(S,)` each.
        axes: one or two.

    Returns:
        the probabilities, `(M,)` or `(M_1, M_2)`, and the bandwidth of each axis in radians, chosen by
        cross-validation.
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


def compare(angle: FloatArray, axis: Axis, families: Sequence[Family]) -> tuple[Density, tuple[Candidate, ...]]:
    """Choose a family for samples of one angle by the criterion of this module.

    Args:
        angle: radians, ordered in time, `(S,)`.
        axis: the cells.
        families: the simplest first.

    Returns:
        the chosen density and every candidate.
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


def fixed_angle(angle: FloatArray, axis: Axis) -> float | None:
    """The circular mean of samples that all lie within the width of a fine cell; None where they spread further."""
    mean = float(circmean(angle, high=np.pi, low=-np.pi))
    return mean if np.ptp(circular_difference(angle, mean)) < axis.width else None


def _folds(count: int) -> list[IntArray]:
    return np.array_split(np.arange(count), CROSS_VALIDATION_FOLDS)


def _log_likelihood(probability: FloatArray, count: float, index: IntArray) -> FloatArray:
    """Log probabilities of held-out samples, `(S,)`; one uniform sample more makes the cost of an outlier finite."""
    flat = probability.reshape(-1)
    return np.asarray(np.log((count * flat[index] + 1.0 / flat.size) / (count + 1.0)))
