"""Recordings of a camera's yaw and pitch, from a CSV file or simulated, and samples of a recording at random times."""

from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Annotated, Protocol

import numpy as np
from scipy.ndimage import gaussian_filter1d
from scipy.signal import correlate
from scipy.spatial.transform import Rotation
from scipy.stats import norm, truncnorm, vonmises

from lmd.core.checks import Checked, Finite, FloatArray, InputError, NotNegative, Positive, real
from lmd.core.memory import check_memory
from lmd.core.tables import radians, read_table, seconds
from lmd.formats.columns import OWN_ANGLES
from lmd.formats.pose_files import steep
from lmd.geometry.frames import normal_angles

ANGLES = ("yaw", "pitch")
QUATERNION = ("qw", "qx", "qy", "qz")
# Further columns of recorded poses, which do not change the optical axis.
IGNORED = ("x", "y", "z", OWN_ANGLES[2])
UNIT_TOLERANCE = 1e-3  # largest deviation of the length of a quaternion, printed with a few decimals, from 1
RECORD_BYTES = 200  # memory of a record during simulation, bytes: two dozen numbers
LEAST_SAMPLES = 50  # least number of samples for an estimate
# Ratio of the default mean interval to the correlation time. The least interval is half the mean, so samples are at
# least the correlation time apart. Neighbours then correlate by less than 0.05 for a Gaussian autocorrelation.
INTERVAL_FACTOR = 2.0


@dataclass(frozen=True)
class OrientationRecording:
    """Yaw alpha and pitch beta of a camera over time; each record holds until the time of the next record.

    Raises:
        InputError: shapes differ, there are fewer than two records, a value is not finite, time does not increase, or a
            pitch is out of range.
    """

    time: FloatArray
    """Times of the records, seconds, increasing, `(R,)` with R >= 2."""
    yaw: FloatArray
    """Yaw of each record, radians, not limited to one turn, `(R,)`."""
    pitch: FloatArray
    """Pitch of each record, radians in [-pi/2, pi/2], positive for a camera that looks up, `(R,)`."""
    name: str = "recording"
    """Name of the source, for messages."""
    note: str = ""
    """Remark for the user on ambiguous angles, a sentence without its full stop; empty if the angles are clear."""

    def __post_init__(self) -> None:
        for field in ("time", *ANGLES):
            array = np.array(getattr(self, field), dtype=np.float64)
            array.flags.writeable = False
            object.__setattr__(self, field, array)
        if self.time.ndim != 1 or any(a.shape != self.time.shape for a in (self.yaw, self.pitch)):
            raise InputError(f"{self.name}: time, yaw and pitch must be lists of equal length.")
        if len(self.time) < 2:
            raise InputError(f"{self.name} has {len(self.time)} records; a recording needs at least 2.")
        if not all(np.isfinite(a).all() for a in (self.time, self.yaw, self.pitch)):
            raise InputError(f"{self.name} has a value that is not finite.")
        seconds(self.name, self.time)
        if (late := np.flatnonzero(np.diff(self.time) <= 0.0)).size:
            before, after = self.time[late[0] : late[0] + 2]
            raise InputError(f"{self.name}: time must increase, but {before:.16g} s is followed by {after:.16g} s.")
        if (worst := self.pitch[np.argmax(np.abs(self.pitch))]) and abs(worst) > np.pi / 2 + 1e-9:
            raise InputError(f"{self.name}: pitch must be in [-pi/2, pi/2] radians, got {worst:g}.")

    @property
    def duration(self) -> float:
        """Time from the first record to the last, seconds."""
        return float(self.time[-1] - self.time[0])

    @property
    def step(self) -> float:
        """Mean time between records, seconds."""
        return self.duration / (len(self.time) - 1)

    def at(self, time: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Yaw and pitch, radians, `(S,)` each, at S times within the recording.

        Each time gets the angles of the last record up to this time. There is no interpolation, so the jump of the yaw
        between pi and -pi does no harm.
        """
        index = np.searchsorted(self.time, time, side="right") - 1
        return self.yaw[index], self.pitch[index]

    def to_csv(self, path: str | Path) -> None:
        """Write a CSV with the columns `time,yaw,pitch`; all digits of the numbers are written."""
        rows = np.stack([self.time, self.yaw, self.pitch], axis=1)
        np.savetxt(path, rows, fmt="%.17g", delimiter=",", header="time,yaw,pitch", comments="")

    @classmethod
    def from_csv(cls, path: str | Path) -> "OrientationRecording":
        """Read a CSV with the columns time (s), yaw and pitch (rad), or time and qw, qx, qy, qz.

        The quaternion rotates the camera's optical frame (x right, y down, z along the optical axis) to the world
        frame. The columns yaw and pitch may be called yaw_from_y and pitch_up, as in recordings of poses. Columns
        x, y, z are ignored. A yaw beyond +-2 pi is refused, as it may be in degrees.

        Raises:
            InputError: the file cannot be read, is not a recording, or its angles are ambiguous.
        """
        table = read_table(path, name="path")
        if "yaw" in table and "roll" in table:
            raise InputError(
                f"{path} has roll, pitch and yaw, which may be a body's (ROS). If they are a camera's (yaw clockwise "
                f"from y, pitch up), rename them to {', '.join(OWN_ANGLES)}; else give its quaternion, qw, qx, qy, qz."
            )
        if "yaw" in table or "qw" not in table:
            names = OWN_ANGLES[:2] if OWN_ANGLES[0] in table else ANGLES
            time, yaw, pitch = table.numbers(("time", *names), (*IGNORED, *QUATERNION)).T
            radians(table.path, yaw=yaw, pitch=pitch)
            return cls(time, yaw, pitch, str(path))
        rows = table.numbers(("time", *QUATERNION), IGNORED)
        time, quaternion = rows[:, 0], rows[:, 1:]
        length = np.linalg.norm(quaternion, axis=1)
        if (off := np.abs(length - 1.0)).max() > UNIT_TOLERANCE:
            worst = int(np.argmax(off))
            line, its = table.lines[worst], length[worst]
            raise InputError(f"{path} line {line}: the quaternion must have length 1, it has {its:g}.")
        axis = Rotation.from_quat(quaternion, scalar_first=True).apply([0.0, 0.0, 1.0])
        yaw, pitch = (-angle for angle in normal_angles(axis))  # `normal_angles` has both signs opposite
        doubt = f"{said} If not, its quaternions are a body's: rotate them" if (said := steep(axis[:, 2], path)) else ""
        return cls(time, yaw, pitch, str(path), doubt)


class RecordingSource(Protocol):
    """Interface of sources of a recording: files, and simulated motion."""

    def record(self, rng: np.random.Generator) -> OrientationRecording:
        """Return the recording; only a simulated recording draws random numbers from `rng`."""


@dataclass(frozen=True)
class FileRecording:
    """Recording from a CSV, see `OrientationRecording.from_csv`."""

    path: str | None
    """Path of the CSV; `record` raises `InputError` if it is None."""

    def record(self, rng: np.random.Generator) -> OrientationRecording:
        """See `RecordingSource.record`."""
        if self.path is None:
            raise InputError("path is missing: a CSV with the columns time,yaw,pitch is needed.", "path")
        return OrientationRecording.from_csv(self.path)


@dataclass(frozen=True)
class SimulatedRecording(Checked):
    """Recording of a simulated smooth random motion of a camera.

    At any time the yaw has a von Mises distribution, and the pitch a truncated normal distribution.

    z_1 and z_2 are stationary Gaussian processes with the autocorrelation exp(-t^2 / (2 tau^2)). The phase phi, wrapped
    to [-pi, pi), has a uniform start and the rate z_1 / tau, so phi is uniform at any time. The yaw is the quantile of
    the von Mises distribution at the probability phi / (2 pi) + 1/2. The pitch is the quantile of the truncated normal
    distribution at the probability N(s), with s = c g + sqrt(1 - c^2) z_2. Here N is the standard normal distribution
    function, c is `coupling`, and g is the standard normal quantile of |phi| / pi.

    Args:
        duration: length of the recording, seconds.
        rate: records per second.
        correlation_time: tau, seconds.
        yaw_mean: mean direction of the yaw, radians.
        yaw_concentration: concentration kappa >= 0 of the von Mises distribution; 0 is uniform.
        pitch_mean: mean of the normal distribution before truncation to [-pi/2, pi/2], radians.
        pitch_std: standard deviation of the normal distribution before truncation, radians; 0 for a fixed pitch.
        coupling: c in [-1, 1], correlation of s and g, that is, of the pitch with the distance of the yaw from its
            mean; 0 makes yaw and pitch independent.

    Raises:
        InputError: a value is out of range.
    """

    duration: Finite = 1800.0
    rate: Positive = 20.0
    correlation_time: Positive = 1.0
    yaw_mean: Finite = 0.0
    yaw_concentration: NotNegative = 0.0
    pitch_mean: Annotated[float, partial(real, low=-np.pi / 2, high=np.pi / 2)] = 0.0
    pitch_std: NotNegative = 0.1
    coupling: Annotated[float, partial(real, low=-1.0, high=1.0)] = 0.0

    def _validate(self) -> None:
        real("duration", self.duration, low=2.0 / self.rate)
        records = self.duration * self.rate
        made = f"duration = {self.duration:g} s makes {records:.4g} records, which"
        check_memory(RECORD_BYTES * records, made, "duration")

    def record(self, rng: np.random.Generator) -> OrientationRecording:
        """See `RecordingSource.record`."""
        count = int(self.duration * self.rate) + 1
        z1, z2 = self._processes(rng, count)
        turned = rng.uniform(0.0, 2.0 * np.pi) + np.cumsum(z1) / (self.rate * self.correlation_time)
        phase = np.mod(turned, 2.0 * np.pi) - np.pi
        # Interpolation of the distribution function is as accurate as SciPy's quantile function and faster.
        grid = np.linspace(-np.pi, np.pi, 8193)
        around_mean = np.interp(phase / (2.0 * np.pi) + 0.5, vonmises.cdf(grid, self.yaw_concentration), grid)
        yaw = np.mod(around_mean + self.yaw_mean + np.pi, 2.0 * np.pi) - np.pi
        pitch = np.full(count, self.pitch_mean)
        if self.pitch_std > 0.0:
            score = norm.ppf(np.clip(np.abs(phase) / np.pi, 1e-12, 1.0 - 1e-12))
            mixed = self.coupling * score + np.sqrt(1.0 - self.coupling**2) * z2
            low, high = (np.array([-np.pi / 2, np.pi / 2]) - self.pitch_mean) / self.pitch_std
            pitch = truncnorm.ppf(norm.cdf(mixed), low, high, loc=self.pitch_mean, scale=self.pitch_std)
        return OrientationRecording(np.arange(count) / self.rate, yaw, pitch, "the simulated recording")

    def _processes(self, rng: np.random.Generator, count: int) -> FloatArray:
        """Two independent stationary Gaussian processes of mean 0 and variance 1, `(2, count)`."""
        # Smoothing white noise with a Gaussian of width s gives the autocorrelation exp(-t^2 / (4 s^2)).
        width = self.correlation_time * self.rate / np.sqrt(2.0)
        kernel = gaussian_filter1d(np.eye(1, count)[0], width, mode="wrap")
        noise = gaussian_filter1d(rng.standard_normal((2, count)), width, axis=1, mode="wrap")
        return np.asarray(noise / np.linalg.norm(kernel))


@dataclass(frozen=True)
class Samples:
    """Yaw and pitch of a recording at random times, ordered in time."""

    yaw: FloatArray
    """Yaw, radians, `(S,)`."""
    pitch: FloatArray
    """Pitch, radians, `(S,)`."""
    correlation_time: float
    """Correlation time of the recording, seconds."""
    mean_interval: float
    """Mean interval between samples, seconds."""

    def __len__(self) -> int:
        return len(self.yaw)


def sample_at_random_intervals(
    recording: OrientationRecording, mean_interval: float | None, rng: np.random.Generator
) -> Samples:
    """Draw samples from a recording at random intervals.

    An interval is m / 2 + e, where m is the mean interval, and e has an exponential distribution with the mean m / 2.

    The fixed part m / 2 limits the correlation of neighbouring samples; the random part e avoids aliasing with periodic
    motion. Each record is thus drawn with a probability in proportion to its duration, even if the rate of the
    recording is uneven.

    Args:
        recording: recording to sample.
        mean_interval: mean interval m, seconds; None for twice the correlation time, so that samples are nearly
            independent.
        rng: random generator for the intervals.

    Raises:
        InputError: the interval is not positive or is shorter than the recording's step, or there are too few samples.
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
    """Integrated autocorrelation time T of a recording, seconds: the larger one of T of the yaw and T of the pitch.

    A mean over a long duration D is as uncertain as a mean of D / T independent samples. For one angle,

        T = step (1 + 2 sum_k rho_k).

    step is the mean time between records, and rho_k the autocorrelation at a lag of k >= 1 steps. The sum ends before
    the first lag with rho_k <= 0. For the yaw alpha, rho_k is the autocorrelation of `(cos alpha, sin alpha)`, which
    does not jump between pi and -pi. For a fixed angle, T is one step.
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
