"""Motion of the body between frames: by odometry, or at a nearly constant velocity.

Both models constrain the relative pose of consecutive frames, with a covariance that grows with the gap between the
frames. A frame that shows a single tag thus places the tag relative to the tags in earlier and later frames.

- *Odometry* O is a trajectory in a frame of its own, whose relative poses drift. The error of frame j relative to frame
  i is r = log((O_i^-1 O_j)^-1 T_i^-1 T_j). Each short step adds independent errors of rotation and translation, with a
  covariance Q in proportion to the step's length; errors propagate to frame j. With the sum C of Ad_O Q Ad_O^T over all
  steps, the covariance of r is Ad_O_j^-1 (C_j - C_i) Ad_O_j^-T. The bias b per metre, a twist for scale and heading, is
  an unknown of the drive: with the sum B of Ad_O times the length of each step, r contains Ad_O_j^-1 (B_j - B_i) b.
- *Constant velocity*: the velocity u in the world and the turn rate w of the body change by white noise, and are
  unknowns of each frame. A link over dt has the errors phi - dt w_i, p_j - p_i - dt u_i, w_j - w_i, u_j - u_i with phi
  = log(R_i^T R_j), and the covariance s^2 [dt^3 / 3, dt^2 / 2; dt^2 / 2, dt]. The model has the velocity in the world,
  as a camera carried straight ahead may turn on the way.

Real bodies are not driven by white noise, so the errors across long gaps do not follow from the errors of short links.
The errors across long gaps are measured in stretches of the drive without gaps: see `with_bridged_gaps`.

Source: Barfoot, "State Estimation for Robotics".
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from lmd.adjust.links import Links, turn_twist
from lmd.core.checks import BoolArray, FloatArray, InputError, IntArray
from lmd.geometry.se3 import adjoint_matrix, exp, inverse, log
from lmd.geometry.trajectory import Trajectory

# Prior standard deviations of rotation and translation; they are re-estimated from the drive.
STEADY = (1.0, 1.0)  # change of the turn rate, rad/s, and of the velocity, m/s, within a second
DRIFT = (0.005, 0.01)  # random drift of odometry after a metre, rad and m
BIAS = (0.005, 0.02)  # common error of every metre of odometry, rad and m
# Metres that a rotation of one rad, and a second, add to the length of a step of odometry.
METRES_PER_RAD, METRES_PER_SECOND = 0.3, 0.01
# Frames are not linked by a constant velocity if the standard deviations of their relative pose, rad and metres, are
# larger.
MOST_TURN, MOST_PLACE = 0.2, 0.5
SHORTEST_GAP = 0.3  # a constant velocity bridges gaps shorter than this, seconds, without evidence from the drive
LONGEST_STEP = 1.0  # maximum seconds between poses of odometry; longer gaps cut the odometry into pieces
# Least value of times since 1970 in ns, us or ms, and the factor that converts them to seconds.
UNITS = ((1e17, 1e-9), (1e14, 1e-6), (1e11, 1e-3))
LONGEST_GAP, GAPS = 5.0, 13  # longest length of a gap that is tried, seconds, and number of lengths that are tried
FEWEST_GAPS = 6  # minimum number of artificial gaps of a length in stretches without gaps
LEAST_PACE = 0.2  # minimum time over which the velocity on each side of a gap is measured, seconds


@dataclass(frozen=True)
class Motion:
    """Motion between the F frames of a drive."""

    times: FloatArray
    """`(F,)` seconds, ascending; NaN for frames without a time."""
    spread: tuple[float, float]
    """Standard deviations of rotation and translation in the units of `STEADY` or `DRIFT`."""
    path: FloatArray | None = None
    """`(F, 4, 4)` poses of the body by odometry, NaN for frames without odometry; None for a constant velocity."""
    drift: FloatArray | None = None
    """`(F, 2, 6, 6)` sums C: covariances due to errors of rotation and of translation, for a spread of 1."""
    bias_sums: FloatArray | None = None
    """`(F, 6, 6)` sums B, derivatives by the bias."""
    piece: IntArray | None = None
    """`(F,)` piece of each frame; frames of different pieces are not linked. None for one piece."""
    gaps: FloatArray | None = None
    """`(n,)` lengths of gaps, seconds, ascending, for which a constant velocity was tested in stretches without
    gaps.
    """
    bridged: FloatArray | None = None
    """`(n, 2)` spreads that explain the errors across the tested gaps; longer gaps are not bridged. None without
    tests.
    """

    @classmethod
    def steady(cls, times: FloatArray) -> "Motion":
        """Motion at a nearly constant velocity."""
        return cls(times, STEADY)

    @classmethod
    def by_odometry(cls, times: FloatArray, odometry: Trajectory) -> "Motion":
        """Motion by odometry.

        Raises:
            InputError: odometry covers less than half of the frames.
        """
        from scipy.spatial.transform import Rotation, Slerp

        own, poses = odometry.time, inverse(odometry.poses[0]) @ odometry.poses
        covered = (times >= own[0]) & (times <= own[-1])
        if 2 * covered.sum() < len(times):
            there = f"{np.nanmin(times):.10g} to {np.nanmax(times):.10g} s" if np.isfinite(times).any() else "no time"
            raise InputError(
                f"odometry has poses from {own[0]:.10g} to {own[-1]:.10g} s, but the frames have {there}: it must be "
                "of the same drive and clock.",
                "odometry",
            )
        steps = log(inverse(poses[:-1]) @ poses[1:])
        far = np.linalg.norm(steps[:, 3:], axis=1) + METRES_PER_RAD * np.linalg.norm(steps[:, :3], axis=1)
        far += METRES_PER_SECOND * np.diff(own)
        ahead = adjoint_matrix(poses[1:])  # steps are short, so the error of a step is applied at its end
        added = np.stack([far[:, None, None] * ahead[..., part] @ np.swapaxes(ahead[..., part], 1, 2)
                          for part in (slice(0, 3), slice(3, 6))], axis=1)  # fmt: skip
        biased = far[:, None, None] * ahead
        sums, bias_sums = (np.concatenate([0.0 * each[:1], np.cumsum(each, axis=0)]) for each in (added, biased))
        at = np.where(covered, times, own[0])
        place = np.clip(np.searchsorted(own, at, side="right") - 1, 0, len(own) - 2)
        share = ((at - own[place]) / (own[place + 1] - own[place]))[:, None]
        path = np.tile(np.eye(4), (len(times), 1, 1))
        path[:, :3, :3] = Slerp(own, Rotation.from_matrix(poses[:, :3, :3]))(at).as_matrix()
        path[:, :3, 3] = (1.0 - share) * poses[place, :3, 3] + share * poses[place + 1, :3, 3]
        drift = sums[place] + share[..., None, None] * added[place]
        bias = bias_sums[place] + share[..., None] * biased[place]
        gaps = np.diff(own) > LONGEST_STEP
        covered &= ~gaps[place] | (share[:, 0] == 0.0)
        path[~covered] = np.nan
        return cls(times, DRIFT, path, drift, bias, np.concatenate([[0], np.cumsum(gaps)])[place])

    def of(self, frames: IntArray, part: IntArray) -> "Motion":
        """Motion between some of the frames, `(n,)`, without links between frames of different parts, `(n,)`."""
        piece = part if self.piece is None else part * (self.piece.max() + 1) + self.piece[frames]
        names = ("times", "path", "drift", "bias_sums")
        chosen: dict[str, Any] = {name: own[frames] for name in names if (own := getattr(self, name)) is not None}
        return replace(self, piece=piece, **chosen)

    @property
    def is_odometry(self) -> bool:
        """True for odometry, False for a constant velocity."""
        return self.path is not None

    @property
    def assumed(self) -> tuple[float, float]:
        """Prior spread."""
        return DRIFT if self.is_odometry else STEADY

    @property
    def longest(self) -> float:
        """Longest gap that a constant velocity bridges, seconds."""
        turn, place = self.spread
        if self.gaps is None or self.bridged is None:
            return float(min((12.0 * MOST_TURN**2 / turn**2) ** (1 / 3), (12.0 * MOST_PLACE**2 / place**2) ** (1 / 3)))
        off = self.bridged * np.sqrt(self.gaps[:, None] ** 3 / 12.0)
        good = np.logical_and.accumulate((off <= (MOST_TURN, MOST_PLACE)).all(axis=1))
        return float(max(self.gaps[good], default=SHORTEST_GAP))

    def _spreads(self, seconds: FloatArray) -> FloatArray:
        """Spreads of a constant velocity over gaps `(M,)`, `(M, 2)`."""
        spreads = np.broadcast_to(self.spread, (len(seconds), 2))
        if self.gaps is None or self.bridged is None or not len(self.gaps):
            return spreads
        measured = np.stack([np.interp(seconds, self.gaps, each) for each in self.bridged.T], axis=1)
        return np.where((seconds > SHORTEST_GAP)[:, None], np.maximum(spreads, measured), spreads)

    def relates(self, i: IntArray, j: IntArray) -> BoolArray:
        """True where the motion constrains frames j relative to frames i, `(M,)`."""
        between = np.abs(self.times[j] - self.times[i])
        if self.path is None:
            there = between <= self.longest
        else:
            there = np.isfinite(self.path[i, 0, 0]) & np.isfinite(self.path[j, 0, 0]) & np.isfinite(between)
        return np.asarray(there if self.piece is None else there & (self.piece[i] == self.piece[j]))

    def follows(self, frames: IntArray) -> BoolArray:
        """True for frames, ascending, that are linked to the previous frame; `(F - 1,)`."""
        i, j = frames[:-1], frames[1:]
        return np.asarray(self.relates(i, j) & (self.times[j] > self.times[i]))

    def linked(self, frames: IntArray) -> BoolArray:
        """True for frames, ascending, that are linked to the previous or the next frame, `(F,)`."""
        follows = np.concatenate([[False], self.follows(frames), [False]])
        return np.asarray(follows[1:] | follows[:-1])

    def links(self, frames: IntArray) -> Links:
        """Links between consecutive `frames`, ascending indices."""
        first = np.flatnonzero(self.follows(frames))
        i, j = frames[first], frames[first + 1]
        seconds, information = self.times[j] - self.times[i], self.information(i, j)
        if self.path is None or self.bias_sums is None:
            return Links(12, first, seconds, information, None, None)
        bias = adjoint_matrix(inverse(self.path[j])) @ (self.bias_sums[j] - self.bias_sums[i]) * np.repeat(BIAS, 3)
        return Links(6, first, seconds, information, inverse(self.path[i]) @ self.path[j], bias)

    def information(self, i: IntArray, j: IntArray) -> FloatArray:
        """Inverse covariance of the error of frames j `(M,)` relative to frames i, see `Links`."""
        turn, place = self.spread
        if self.path is None or self.drift is None:
            seconds = self.times[j] - self.times[i]
            h = seconds[:, None, None]
            spline = np.block([[12.0 / h**3, -6.0 / h**2], [-6.0 / h**2, 4.0 / h]])
            axes = np.repeat(self._spreads(seconds) ** -2.0, 3, axis=1)[:, None] * np.eye(6)
            return np.asarray(np.einsum("mij,mkl->mikjl", spline, axes).reshape(-1, 12, 12))
        back = adjoint_matrix(inverse(self.path[j]))
        grown = self.drift[j] - self.drift[i]
        covariance = back @ (turn**2 * grown[:, 0] + place**2 * grown[:, 1]) @ np.swapaxes(back, 1, 2)
        return np.asarray(np.linalg.inv((covariance + np.swapaxes(covariance, 1, 2)) / 2.0))

    def steps(self, i: IntArray, j: IntArray, velocities: FloatArray | None = None) -> FloatArray:
        """Poses of frames j relative to frames i, `(M, 4, 4)`; NaN if unknown.

        Args:
            i, j: indices of frames, `(M,)`.
            velocities: turn rates and velocities of all frames in the body's frame, `(F, 6)`, NaN if unknown; None for
                a body that stands still. Ignored if the motion is odometry.
        """
        if self.path is not None:
            return np.asarray(inverse(self.path[i]) @ self.path[j])
        seconds = self.times[j] - self.times[i]
        if velocities is None:
            return np.tile(np.eye(4), (len(i), 1, 1))
        pair = np.stack([velocities[i], velocities[j]])
        known = np.isfinite(pair)
        mean = np.where(known, pair, 0.0).sum(axis=0) / np.maximum(known.sum(axis=0), 1)
        lost = ~known.any(axis=0) & (seconds != 0.0)[:, None]
        result = exp(seconds[:, None] * mean)
        result[lost.any(axis=1)] = np.nan
        return np.asarray(result)


def with_bridged_gaps(motion: Motion, poses: FloatArray) -> Motion:
    """Motion at a constant velocity, with the errors across gaps as measured in stretches of the drive without gaps.

    For two frames that are the length of a gap apart, the velocities before and after predict the relative pose. The
    error of the prediction is its difference from the pose estimated with the frames between the two.

    Args:
        motion: motion at a constant velocity, in pieces.
        poses: poses of the frames, `(F, 4, 4)`; frames of one piece are contiguous and have a common world.
    """
    assert motion.piece is not None
    gaps, bridged, clock = [], [], motion.times - np.nanmin(motion.times)
    clock = clock + motion.piece * (np.nanmax(clock) + 10.0 * LONGEST_GAP)

    def nearest(seconds: FloatArray) -> IntArray:
        """Index of the frame nearest to each time of `clock`."""
        after = np.clip(np.searchsorted(clock, seconds), 1, len(clock) - 1)
        return np.asarray(after - (seconds - clock[after - 1] < clock[after] - seconds))

    pace = max(LEAST_PACE, float(np.median(np.diff(clock))))
    for gap in np.geomspace(SHORTEST_GAP, LONGEST_GAP, GAPS):
        ends = np.stack([nearest(clock + by) for by in (-pace, 0.0, gap, gap + pace)])
        before, lasts, after = np.diff(clock[ends], axis=0)
        fits = (np.abs(lasts - gap) < 0.13 * gap) & (np.abs(before - pace) < 0.5 * pace)
        fits &= np.abs(after - pace) < 0.5 * pace
        if len(np.unique((clock[ends[1][fits]] / gap).astype(np.int64))) < FEWEST_GAPS:
            continue
        first, i, j, last = poses[ends[:, fits]]
        into, out = (
            log(inverse(one) @ other)[:, :3] / h[fits, None] for one, other, h in ((first, i, before), (j, last, after))
        )
        moving = (i - first)[:, :3, 3] / before[fits, None], (last - j)[:, :3, 3] / after[fits, None]
        half = lasts[fits, None] / 2.0
        turn = log(exp(-turn_twist(half * (into + out))) @ inverse(i) @ j)[:, :3]
        place = (j - i)[:, :3, 3] - half * (moving[0] + moving[1])
        squares = np.array([(turn**2).sum(axis=1).mean(), (place**2).sum(axis=1).mean()])
        gaps.append(gap)
        bridged.append(np.sqrt(12.0 * squares / gap**3))
    return replace(motion, gaps=np.array(gaps), bridged=np.array(bridged).reshape(-1, 2))


def seconds_of(times: Sequence[str]) -> FloatArray:
    """Times of frames as text, in seconds, `(F,)`; NaN for names of images.

    Numbers are seconds, or ms, us or ns since 1970. The result resolves a tenth of a microsecond.
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
