"""Recordings of where a camera looked: (time, yaw, pitch) from a CSV, or simulated with a known distribution."""

from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

import numpy as np
from scipy.ndimage import gaussian_filter1d
from scipy.spatial.transform import Rotation
from scipy.stats import norm, truncnorm, vonmises

from lmd.core.checks import FloatArray, InputError, radians, real, seconds
from lmd.core.memory import check_memory
from lmd.core.tables import read_table
from lmd.formats.trajectory_columns import OWN_ANGLES
from lmd.formats.trajectory_rows import steep
from lmd.geometry.frames import normal_angles

ANGLES = ("yaw", "pitch")
QUATERNION = ("qw", "qx", "qy", "qz")
# What a recording of poses has besides; the optical axis does not depend on it.
IGNORED = ("x", "y", "z", OWN_ANGLES[2])
UNIT_TOLERANCE = 1e-3  # of a quaternion printed with a few decimals
RECORD_BYTES = 200  # what a record takes while it is simulated: two dozen numbers


@dataclass(frozen=True)
class OrientationRecording:
    """Yaw alpha and pitch beta of a camera over time; between two records the first one holds.

    Args:
        time: seconds, increasing, `(R,)` with R >= 2.
        yaw: radians, any turn, `(R,)`.
        pitch: radians in [-pi/2, pi/2], positive looks up, `(R,)`.
        name: where it came from, for messages.
        note: what to ask of it, a sentence without an end; empty if nothing.

    Raises:
        InputError: shapes differ, fewer than two records, a value is not finite, time does not increase, or a pitch
            is out of range.
    """

    time: FloatArray
    yaw: FloatArray
    pitch: FloatArray
    name: str = "recording"
    note: str = ""

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
        """From the first record to the last, seconds."""
        return float(self.time[-1] - self.time[0])

    @property
    def step(self) -> float:
        """Mean time from record to record, seconds."""
        return self.duration / (len(self.time) - 1)

    def at(self, time: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Yaw and pitch at times within the recording, `(S,)` each: those of the last record until then.

        Nothing is interpolated, so the seam of the yaw at +-pi needs no care.
        """
        index = np.searchsorted(self.time, time, side="right") - 1
        return self.yaw[index], self.pitch[index]

    def to_csv(self, path: str | Path) -> None:
        """Write `time,yaw,pitch` with every digit."""
        rows = np.stack([self.time, self.yaw, self.pitch], axis=1)
        np.savetxt(path, rows, fmt="%.17g", delimiter=",", header="time,yaw,pitch", comments="")

    @classmethod
    def from_csv(cls, path: str | Path) -> "OrientationRecording":
        """Read a CSV with the columns time (s), yaw and pitch (rad), or time and qw, qx, qy, qz.

        The quaternion turns the camera's optical frame (x right, y down, z along the optical axis) to the world
        frame. Yaw and pitch may be called yaw_from_y and pitch_up, as in recordings of poses. Columns x, y, z are
        ignored. A yaw lies within a turn of zero: larger ones look like degrees.

        Raises:
            InputError: the file cannot be read, what it holds is no recording, or its angles may be others.
        """
        table = read_table(path, name="path")
        if "yaw" in table and "roll" in table:
            raise InputError(
                f"{path} has roll, pitch and yaw, which may be ROS's, of a body: call them {', '.join(OWN_ANGLES)} if "
                "they are a camera's (yaw clockwise from y, pitch up); else give qw, qx, qy, qz of the camera."
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
        yaw, pitch = (-angle for angle in normal_angles(axis))  # the normal has both angles with the opposite sign
        doubt = f"{said} If not, its quaternions are a body's: turn them" if (said := steep(axis[:, 2], path)) else ""
        return cls(time, yaw, pitch, str(path), doubt)


class RecordingSource(Protocol):
    """Something that provides a recording."""

    def record(self, rng: np.random.Generator) -> OrientationRecording:
        """A recording; only a simulated one draws from `rng`."""


@dataclass(frozen=True)
class FileRecording:
    """A recording from a CSV, see `OrientationRecording.from_csv`."""

    path: str | None

    def record(self, rng: np.random.Generator) -> OrientationRecording:
        """See `RecordingSource.record`."""
        if self.path is None:
            raise InputError("path is missing: a CSV with the columns time,yaw,pitch is needed.", "path")
        return OrientationRecording.from_csv(self.path)


@dataclass(frozen=True)
class SimulatedRecording:
    """Smooth random motion whose yaw is von Mises and whose pitch is truncated normal, at every moment.

    Two stationary Gaussian processes z_1, z_2 with the autocorrelation exp(-t^2 / (2 tau^2)) carry it. A phase phi that
    begins anywhere and turns at the rate z_1 / tau is uniform at every moment; the yaw is the von Mises quantile of
    phi / (2 pi) + 1/2, phi in [-pi, pi), and so turns through the seam like any other angle. The pitch is the quantile
    of c g + sqrt(1 - c^2) z_2, where g is the normal quantile of |phi| / pi.

    Args:
        duration: seconds.
        rate: records per second.
        correlation_time: tau, seconds.
        yaw_mean: mean direction of the yaw, radians.
        yaw_concentration: kappa >= 0; 0 is uniform.
        pitch_mean, pitch_std: of the normal distribution that is cut to [-pi/2, pi/2], radians; a std of 0 is a fixed
            pitch.
        coupling: c in [-1, 1], correlation of the pitch with the distance of the yaw from its mean (of their normal
            scores); 0 makes yaw and pitch independent.

    Raises:
        InputError: a value is out of range.
    """

    duration: float
    rate: float
    correlation_time: float
    yaw_mean: float
    yaw_concentration: float
    pitch_mean: float
    pitch_std: float
    coupling: float

    def __post_init__(self) -> None:
        real("rate", self.rate, above=0.0)
        real("duration", self.duration, low=2.0 / self.rate)
        records = self.duration * self.rate
        made = f"duration = {self.duration:g} s makes {records:.4g} records, which"
        check_memory(RECORD_BYTES * records, made, "duration")
        real("correlation_time", self.correlation_time, above=0.0)
        real("yaw_mean", self.yaw_mean)
        real("yaw_concentration", self.yaw_concentration, low=0.0)
        real("pitch_mean", self.pitch_mean, low=-np.pi / 2, high=np.pi / 2)
        real("pitch_std", self.pitch_std, low=0.0)
        real("coupling", self.coupling, low=-1.0, high=1.0)

    def record(self, rng: np.random.Generator) -> OrientationRecording:
        """See `RecordingSource.record`."""
        count = int(self.duration * self.rate) + 1
        z1, z2 = self._processes(rng, count)
        turned = rng.uniform(0.0, 2.0 * np.pi) + np.cumsum(z1) / (self.rate * self.correlation_time)
        phase = np.mod(turned, 2.0 * np.pi) - np.pi
        # SciPy's quantile function searches for every value; the distribution function on a grid is as good.
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
