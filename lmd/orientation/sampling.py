"""Steps 2 and 4 of the paper's procedure: samples at random intervals, and whether yaw and pitch are independent."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.signal import correlate
from scipy.stats import MonteCarloMethod, chi2_contingency, circmean

from lmd.core.checks import FloatArray, InputError, real
from lmd.orientation.recording import OrientationRecording

LEAST_SAMPLES = 50
# Mean interval over the correlation time. Half of each interval is fixed, so that no two samples are closer than the
# correlation time: neighbours then correlate by less than 0.05 for an exponential or a Gaussian autocorrelation.
INTERVAL_FACTOR = 2.0
# Bins of equal frequency in the table of the independence test.
YAW_BINS, PITCH_BINS = 8, 4
RESAMPLES = 9999


@dataclass(frozen=True)
class Samples:
    """Discrete measurements of a recording, ordered in time.

    Args:
        yaw, pitch: radians, `(S,)`.
        correlation_time: of the recording, seconds.
        mean_interval: between samples, seconds.
    """

    yaw: FloatArray
    pitch: FloatArray
    correlation_time: float
    mean_interval: float

    def __len__(self) -> int:
        return len(self.yaw)


@dataclass(frozen=True)
class Independence:
    """Outcome of `independence_test`: Pearson's chi-squared of a table, its p value, and the verdict at a level."""

    statistic: float
    p_value: float
    table_shape: tuple[int, int]
    significance: float

    @property
    def rejected(self) -> bool:
        """Whether yaw and pitch are taken to depend on each other."""
        return self.p_value < self.significance


def sample_at_random_intervals(
    recording: OrientationRecording, mean_interval: float | None, rng: np.random.Generator
) -> Samples:
    """Sample a recording at random intervals: half of the mean one, plus an exponential of the same mean.

    The fixed half keeps samples from being near copies of each other; the random half keeps them from falling in step
    with a motion that repeats itself. Records of uneven rate count for as long as they hold.

    Args:
        mean_interval: seconds; None for twice the correlation time, so that samples are nearly independent.

    Raises:
        InputError: the interval is not positive or shorter than the recording's own step, or there are too few
            samples.
    """
    correlation_time = integrated_correlation_time(recording)
    if mean_interval is None:
        interval = max(INTERVAL_FACTOR * correlation_time, recording.step)
    else:
        interval = real("mean_interval", mean_interval, above=0.0)
        if interval < recording.step:
            raise InputError(
                f"mean_interval = {interval:g} s is shorter than the step of {recording.name}, {recording.step:g} s.",
                "mean_interval",
            )
    most = int(2.0 * recording.duration / interval)
    times = recording.time[0] + np.cumsum(interval / 2.0 + rng.exponential(interval / 2.0, most))
    times = times[times <= recording.time[-1]]
    if len(times) < LEAST_SAMPLES:
        raise InputError(
            f"{recording.name}: {recording.duration:.4g} s at a mean interval of {interval:.3g} s give {len(times)} "
            f"samples, fewer than the {LEAST_SAMPLES} an estimate needs (the motion stays correlated for "
            f"{correlation_time:.3g} s; record for longer)."
        )
    yaw, pitch = recording.at(times)
    return Samples(yaw, pitch, correlation_time, interval)


def integrated_correlation_time(recording: OrientationRecording) -> float:
    """Integrated autocorrelation time of the slower one of yaw and pitch, seconds.

    T = step (1 + 2 sum_k rho_k), up to the first lag with rho_k <= 0. The autocorrelation of the yaw is that of the
    unit vector (cos alpha, sin alpha), which knows no seam. A fixed angle has T = step.
    """
    times = np.linspace(recording.time[0], recording.time[-1], len(recording.time))
    yaw, pitch = recording.at(times)
    longest = 1.0
    for signal in (np.exp(1j * yaw), pitch):
        centred = signal - signal.mean()
        if np.abs(centred).max() < 1e-9:
            continue
        covariance = correlate(centred, centred, method="fft")[len(centred) - 1 :].real
        rho = covariance / covariance[0]
        longest = max(longest, 2.0 * rho[: np.argmax(rho <= 0.0)].sum() - 1.0)
    return float(recording.step * longest)


def independence_test(samples: Samples, significance: float, rng: np.random.Generator) -> Independence:
    """Pearson's chi-squared test of the table of yaw by pitch bins, with a Monte Carlo p value.

    Bins are categories, so the seam of the yaw is nothing special, and any dependence that shows in the histograms
    counts, not only a linear one. They hold equal numbers of samples; the p value comes from random tables with the
    same margins and is therefore valid for few samples too. It supposes independent samples, which the random intervals
    provide; samples drawn closer than the correlation time would be rejected too often.

    Args:
        samples: of yaw and pitch, neither of them fixed.
        significance: level of the test, in [0, 1].
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
    """`angle - origin`, radians in [-pi, pi), any shape."""
    return np.asarray(np.mod(angle - origin + np.pi, 2.0 * np.pi) - np.pi)


def _equal_bins(values: FloatArray, bins: int) -> NDArray[np.int64]:
    """Index of the bin of each value `(S,)`, bins of equal frequency as far as ties allow, none of them empty."""
    inner = np.quantile(values, np.arange(1, bins) / bins)
    return np.asarray(np.unique(np.searchsorted(inner, values, side="right"), return_inverse=True)[1], dtype=np.int64)
