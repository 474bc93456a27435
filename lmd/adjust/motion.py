"""Motion of the body between frames: by odometry, or at a nearly constant velocity.

Both models constrain the relative pose of consecutive frames, with a covariance that grows with the gap between the
frames. A frame that shows a single tag thus places the tag relative to the tags in earlier and later frames.

- *Odometry* O is a trajectory in coordinates of its own; its relative poses drift. With the poses T of the body, the
  error of frame j relative to frame i is r = log((O_i^-1 O_j)^-1 T_i^-1 T_j). Each short step of odometry adds an
  independent error, whose covariance Q is proportional to the step's length. Let Ad_O be the adjoint matrix of the pose
  O, and C_i the sum of Ad_O Q Ad_O^T over all steps before frame i. Then the covariance of r is Ad_O_j^-1 (C_j - C_i)
  Ad_O_j^-T. Odometry also has a bias b per metre, a twist that models errors of scale and heading; it is an unknown of
  the drive. Let B_i be the sum, over all steps before frame i, of Ad_O times the step's length. Then the bias adds
  Ad_O_j^-1 (B_j - B_i) b to r.
- *Constant velocity*: the velocity u in the world and the turn rate w of the body change by white noise, and are
  unknowns of each frame. Let R be the rotation and p the position of the body, and phi = log(R_i^T R_j). A link over
  the time dt has the errors phi - dt w_i, p_j - p_i - dt u_i, w_j - w_i, u_j - u_i. Along each axis, the errors
  of pose and rate have the covariance s^2 [dt^3 / 3, dt^2 / 2; dt^2 / 2, dt]. Here s is the spread (noise level) of
  rotation for phi and w, and of translation for p and u. The velocity is in the world frame, as a camera carried
  straight ahead may turn on the way.

Real bodies are not driven by white noise, so the errors across long gaps do not follow from the errors of short links.
These errors are measured in pieces of the drive without gaps, see `lmd.adjust.drive`.

Source: Barfoot, "State Estimation for Robotics".
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from lmd.adjust.links import BIAS, Links
from lmd.core.checks import BoolArray, FloatArray, InputError, IntArray
from lmd.geometry.se3 import adjoint_matrix, exp, inverse, log
from lmd.geometry.trajectory import Trajectory

# Prior standard deviations of rotation and translation; they are re-estimated from the drive.
STEADY = (1.0, 1.0)  # change of the turn rate, rad/s, and of the velocity, m/s, within a second
DRIFT = (0.005, 0.01)  # random drift of odometry after a metre, rad and m
# Metres that a rotation of one rad, and a second, add to the length of a step of odometry.
METRES_PER_RAD, METRES_PER_SECOND = 0.3, 0.01
# Frames are not linked by a constant velocity if the standard deviations of their relative pose, rad and metres, are
# larger.
MOST_TURN, MOST_PLACE = 0.2, 0.5
SHORTEST_GAP = 0.3  # a constant velocity bridges gaps shorter than this, seconds, without evidence from the drive
LONGEST_STEP = 1.0  # maximum seconds between poses of odometry; longer gaps cut the odometry into pieces
VELOCITY_SECONDS = 0.05  # velocities by odometry are differences of poses about this far apart, seconds
# An offset of clocks is significant above `SURE` standard deviations. Motion does not show the offset if its standard
# deviation exceeds `HIDDEN`, seconds.
SURE, HIDDEN = 3.0, 0.05
# Least value of times since 1970 in ns, us or ms, and the factor that converts them to seconds.
UNITS = ((1e17, 1e-9), (1e14, 1e-6), (1e11, 1e-3))


class Clock(NamedTuple):
    """Offset of the odometry's clock from the camera's clock, estimated from a drive."""

    offset: float
    """Seconds that are added to the times of the frames to obtain times of the odometry; positive if the camera's clock
    is behind the odometry's clock.
    """
    sigma: float
    """Standard deviation of the offset, seconds."""
    is_corrected: bool = False
    """True if the odometry is taken at the corrected times."""

    @property
    def sentence(self) -> str:
        """Sentence for the user on the offset of the clocks."""
        if self.sigma >= HIDDEN and not self.is_corrected:
            return "the motion does not show an offset of the camera's clock from the odometry's"
        side = "behind" if self.offset > 0.0 else "ahead of"
        done = "corrected" if self.is_corrected else "not significant"
        size, spread = f"{1e3 * abs(self.offset):.1f} ms", f"({1e3 * self.sigma:.1f} ms)"
        return f"the camera's clock is {size} {side} the odometry's {spread}, which is {done}"


@dataclass(frozen=True)
class Motion:
    """Motion between the F frames of a drive."""

    times: FloatArray
    """`(F,)` times of the frames, seconds, ascending; NaN for frames without a time."""
    spread: tuple[float, float] = STEADY
    """Spread of the motion model: factors on the standard deviations of rotation and of translation, in the units of
    `STEADY` (constant velocity) or `DRIFT` (odometry).
    """
    path: FloatArray | None = None
    """`(F, 4, 4)` poses of the body by odometry, NaN for frames without odometry; None for a constant velocity."""
    drift: FloatArray | None = None
    """Matrix C of the module's formulas, summed up to each frame, `(F, 2, 6, 6)`: its two parts are due to errors of
    rotation and of translation, for a spread of 1. None for a constant velocity.
    """
    bias_sums: FloatArray | None = None
    """Matrix B of the module's formulas, summed up to each frame, `(F, 6, 6)`: derivatives of the poses by odometry
    with respect to the bias. None for a constant velocity.
    """
    piece: IntArray | None = None
    """Index of the piece to which each frame belongs, `(F,)`; frames of different pieces are not linked. None for a
    single piece.
    """
    gaps: FloatArray | None = None
    """Errors of the constant-velocity model across gaps, as measured in pieces of the drive without gaps, `(n, 3)`. The
    columns are the length of the gap, seconds, ascending, and the spreads of rotation and of translation that explain
    the errors. Longer gaps are not bridged. None if nothing was measured.
    """
    odometry: Trajectory | None = None
    """The odometry; None for a constant velocity."""
    offset: float = 0.0
    """Seconds that are added to the times of the frames to obtain times of the odometry, see `Clock`."""

    @classmethod
    def by_odometry(cls, times: FloatArray, odometry: Trajectory, offset: float = 0.0) -> "Motion":
        """Make the motion between frames from a trajectory of odometry.

        Args:
            times: times of the frames, `(F,)`, seconds.
            odometry: trajectory of the body.
            offset: seconds that are added to the times of the frames to obtain times of the odometry.

        Raises:
            InputError: odometry covers less than half of the frames. Frames in gaps of more than `LONGEST_STEP` seconds
                between poses of odometry are not covered.
        """
        own, poses = odometry.time, inverse(odometry.poses[0]) @ odometry.poses
        covered = (times + offset >= own[0]) & (times + offset <= own[-1])
        at = np.where(covered, times + offset, own[0])
        (place, share), gaps = odometry.steps_at(at), np.diff(own) > LONGEST_STEP
        covered &= ~gaps[place] | (share == 0.0)
        if 2 * covered.sum() < len(times):
            there = f"{np.nanmin(times):.10g} to {np.nanmax(times):.10g} s" if np.isfinite(times).any() else "no time"
            raise InputError(
                f"odometry has poses from {own[0]:.10g} to {own[-1]:.10g} s, with gaps up to {np.diff(own).max():.3g} "
                f"s, but the frames have {there}: give odometry of the same drive and clock, with gaps of at most "
                f"{LONGEST_STEP:g} s.",
                "odometry",
            )
        steps = log(inverse(poses[:-1]) @ poses[1:])
        far = np.linalg.norm(steps[:, 3:], axis=1) + METRES_PER_RAD * np.linalg.norm(steps[:, :3], axis=1)
        far += METRES_PER_SECOND * np.diff(own)

        def at_frames(added: FloatArray) -> FloatArray:
            """Sum of the matrices of all odometry steps before each frame, `(F, 6, 6)`. `added` `(T - 1, 6, 6)` has one
            matrix for each step. A step that a frame divides counts in part.
            """
            sums = np.concatenate([0.0 * added[:1], np.cumsum(added, axis=0)])
            return np.asarray(sums[place] + share[:, None, None] * added[place])

        ahead = adjoint_matrix(poses[1:])  # steps are short, so the error of a step is applied at its end
        turned = [ahead[..., part] @ np.swapaxes(ahead[..., part], 1, 2) for part in (slice(0, 3), slice(3, 6))]
        *drift, bias = (at_frames(far[:, None, None] * each) for each in (*turned, ahead))
        path = np.where(covered[:, None, None], replace(odometry, poses=poses).at(at), np.nan)
        piece = np.concatenate([[0], np.cumsum(gaps)])[place]
        return cls(times, DRIFT, path, np.stack(drift, axis=1), bias, piece, odometry=odometry, offset=offset)

    def shifted(self, offset: float) -> "Motion":
        """Copy of the motion with another `offset` of the odometry's clock, seconds; the noise level (`spread`) is
        kept.
        """
        assert self.odometry is not None
        return replace(Motion.by_odometry(self.times, self.odometry, offset), spread=self.spread)

    @property
    def velocities(self) -> FloatArray:
        """Turn rate, rad/s, and velocity, m/s, of the body at each frame by odometry, in the body's frame, `(F, 6, 2)`.
        The last axis has two estimates, whose drift is independent: one from the even steps of odometry, one from the
        odd steps. Both estimates are 0 for frames without odometry.
        """
        assert self.odometry is not None
        own, frames = self.odometry.time, np.arange(len(self.times))
        step = max(1, min(int(VELOCITY_SECONDS / np.median(np.diff(own))), (len(own) - 1) // 2))
        steps = Trajectory(own[::step], self.odometry.poses[::step])
        middle, at = (steps.time[1:] + steps.time[:-1]) / 2.0, np.nan_to_num(self.times + self.offset)
        result = np.stack(
            [[np.interp(at, middle[k::2], each[k::2]) for each in steps.twists.T] for k in (0, min(1, len(middle) - 1))]
        )
        return np.where(self.relates(frames, frames)[:, None, None], result.transpose(2, 1, 0), 0.0)

    def of(self, frames: IntArray, part: IntArray) -> "Motion":
        """Motion of the n frames with the indices `frames` `(n,)`. Frames with different numbers in `part` `(n,)` are
        not linked.
        """
        piece = part if self.piece is None else part * (self.piece.max() + 1) + self.piece[frames]
        path, drift, bias = (None if own is None else own[frames] for own in (self.path, self.drift, self.bias_sums))
        return replace(self, times=self.times[frames], piece=piece, path=path, drift=drift, bias_sums=bias)

    @property
    def longest(self) -> float:
        """Longest gap between frames that a link of constant velocity may bridge, seconds."""
        if self.gaps is None:
            return float(min((12.0 * np.square((MOST_TURN, MOST_PLACE)) / np.square(self.spread)) ** (1 / 3)))
        off = self.gaps[:, 1:] * np.sqrt(self.gaps[:, :1] ** 3 / 12.0)
        good = np.logical_and.accumulate((off <= (MOST_TURN, MOST_PLACE)).all(axis=1))
        return float(max(self.gaps[good, 0], default=SHORTEST_GAP))

    def _spreads(self, seconds: FloatArray) -> FloatArray:
        """Spreads (noise levels) of rotation and of translation, `(M, 2)`, of the constant-velocity model across gaps
        with the durations `seconds` `(M,)`.
        """
        spreads = np.broadcast_to(self.spread, (len(seconds), 2))
        if self.gaps is None or not len(self.gaps):
            return spreads
        measured = np.stack([np.interp(seconds, self.gaps[:, 0], each) for each in self.gaps.T[1:]], axis=1)
        return np.where((seconds > SHORTEST_GAP)[:, None], np.maximum(spreads, measured), spreads)

    def relates(self, i: IntArray, j: IntArray) -> BoolArray:
        """Mask of the pairs of frames whose relative pose the motion constrains, `(M,)`. `i` and `j` `(M,)` are the
        indices of the frames.
        """
        between = np.abs(self.times[j] - self.times[i])
        if self.path is None:
            there = between <= self.longest
        else:
            there = np.isfinite(self.path[i, 0, 0]) & np.isfinite(self.path[j, 0, 0]) & np.isfinite(between)
        return np.asarray(there if self.piece is None else there & (self.piece[i] == self.piece[j]))

    def follows(self, frames: IntArray) -> BoolArray:
        """True for each frame that is linked to its predecessor, `(F - 1,)`. `frames` `(F,)` has the ascending indices
        of the frames; the first frame has no predecessor, and no entry in the result.
        """
        i, j = frames[:-1], frames[1:]
        return np.asarray(self.relates(i, j) & (self.times[j] > self.times[i]))

    def linked(self, frames: IntArray) -> BoolArray:
        """True for each frame that is linked to its predecessor or its successor, `(F,)`. `frames` `(F,)` has the
        ascending indices of the frames.
        """
        follows = np.concatenate([[False], self.follows(frames), [False]])
        return np.asarray(follows[1:] | follows[:-1])

    def links(self, frames: IntArray) -> Links:
        """Links between consecutive frames among the frames with the ascending indices `frames`."""
        first = np.flatnonzero(self.follows(frames))
        i, j = frames[first], frames[first + 1]
        seconds, information = self.times[j] - self.times[i], self.information(i, j)
        if self.path is None or self.bias_sums is None:
            return Links(12, first, seconds, information)
        bias = adjoint_matrix(inverse(self.path[j])) @ (self.bias_sums[j] - self.bias_sums[i]) * np.repeat(BIAS, 3)
        return Links(6, first, seconds, information, inverse(self.path[i]) @ self.path[j], bias)

    def information(self, i: IntArray, j: IntArray) -> FloatArray:
        """Inverse covariances of the errors of M links from frames `i` to frames `j`, indices `(M,)` each. The matrices
        have the shape `(M, 6, 6)` for odometry, `(M, 12, 12)` for a constant velocity.
        """
        turn, place = self.spread
        if self.path is None or self.drift is None:
            seconds = self.times[j] - self.times[i]
            h = seconds[:, None, None]
            spline = np.block([[12.0 / h**3, -6.0 / h**2], [-6.0 / h**2, 4.0 / h]])
            axes = np.repeat(self._spreads(seconds) ** -2.0, 3, axis=1)[:, None] * np.eye(6)
            return np.asarray(np.einsum("mij,mkl->mikjl", spline, axes).reshape(-1, 12, 12))
        back, grown = adjoint_matrix(inverse(self.path[j])), self.drift[j] - self.drift[i]
        covariance = back @ (turn**2 * grown[:, 0] + place**2 * grown[:, 1]) @ np.swapaxes(back, 1, 2)
        return np.asarray(np.linalg.inv((covariance + np.swapaxes(covariance, 1, 2)) / 2.0))

    def steps(self, i: IntArray, j: IntArray, velocities: FloatArray | None = None) -> FloatArray:
        """Poses of frames `j` relative to frames `i` that the motion model predicts, `(M, 4, 4)`; NaN if unknown.

        Args:
            i, j: indices of frames, `(M,)`.
            velocities: turn rates and velocities of all frames in the body's frame, `(F, 6)`, NaN if unknown; None if
                the body is assumed to rest. Not used with odometry.
        """
        if self.path is not None:
            return np.asarray(inverse(self.path[i]) @ self.path[j])
        if velocities is None:
            return np.tile(np.eye(4), (len(i), 1, 1))
        seconds, pair = self.times[j] - self.times[i], np.stack([velocities[i], velocities[j]])
        known = np.isfinite(pair)
        mean = np.where(known, pair, 0.0).sum(axis=0) / np.maximum(known.sum(axis=0), 1)
        result = exp(seconds[:, None] * mean)
        result[~known.any(axis=(0, 2)) & (seconds != 0.0)] = np.nan
        return np.asarray(result)


def seconds_of(times: Sequence[str]) -> FloatArray:
    """Times of frames, seconds, `(F,)`, from texts; NaN for a text that is not a number, such as the name of an image.

    Numbers are seconds, or milliseconds, microseconds or nanoseconds since 1970. The resolution is a quarter of a
    microsecond.
    """
    result = np.full(len(times), np.nan)
    for index, text in enumerate(times):
        try:
            result[index] = float(text)
        except ValueError:
            continue
    result[~np.isfinite(result)] = np.nan
    largest = float(np.nanmax(np.abs(result), initial=0.0))
    return result * next((unit for least, unit in UNITS if largest >= least), 1.0)
