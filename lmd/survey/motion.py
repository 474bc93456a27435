"""Motion of the body between the frames of a video: by an odometer, or near to a constant velocity.

Both say how two consecutive frames are to each other, with a covariance that grows between them. A frame that shows one
tag then says where that tag is beside the tags of the frames before and after.

- *Odometry* O is a path in a frame of its own, whose relative poses drift. The error of frame j beside frame i is
  r = log((O_i^-1 O_j)^-1 T_i^-1 T_j). Each short step adds independent errors of turn and place with variances in
  proportion to its length, and what a step adds is carried on to frame j: with the sum C of Ad_O Q Ad_O^T over all
  steps, the covariance of r is Ad_O_j^-1 (C_j - C_i) Ad_O_j^-T. What every metre is off by, a twist b for the scale and
  the heading, is an unknown of the drive: with the sum B of Ad_O times the length of each step, it is in r as
  Ad_O_j^-1 (B_j - B_i) b.
- *Constant velocity*: velocity u, in the world, and turn rate w, in the body, change by white noise (Barfoot, "State
  Estimation for Robotics"). They are unknowns of each frame. A link over dt has the errors phi - dt w_i, p_j - p_i -
  dt u_i, w_j - w_i, u_j - u_i with phi = log(R_i^T R_j), and the covariance s^2 [dt^3 / 3, dt^2 / 2; dt^2 / 2, dt].
  The velocity is that of the world and not that of the body, as who walks straight ahead looks about.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from lmd.core.checks import BoolArray, FloatArray, InputError, IntArray
from lmd.geometry.se3 import exp, inverse, log
from lmd.geometry.trajectory import Trajectory
from lmd.survey.links import Links, adjoints

# Standard deviations that a drive is assumed to have until it tells its own: of turn and place.
STEADY = (1.0, 1.0)  # change of the turn rate, rad/s, and of the velocity, m/s, within a second
DRIFT = (0.005, 0.01)  # of odometry after a metre, rad and m
LEAN = (0.005, 0.02)  # what every metre of odometry is off by alike, rad and m
# A turn of one rad makes an odometer drift like so many metres, and a second, in which it may stand, like so many.
METRES_PER_RAD, METRES_PER_SECOND = 0.3, 0.01
# Frames are not linked where a constant velocity says less of their relative pose, rad and metres.
MOST_TURN, MOST_PLACE = 0.2, 0.5
SHORTEST_GAP = 0.3  # seconds; a constant velocity bridges shorter ones untried
LONGEST_STEP = 1.0  # seconds, between poses of odometry; it says nothing across a longer one
# Times are seconds, or since 1970 in ms, us or ns, by their size.
UNITS = ((1e17, 1e-9), (1e14, 1e-6), (1e11, 1e-3))


@dataclass(frozen=True)
class Motion:
    """The motion between the F frames of a drive, as far as it is known.

    Args:
        times: seconds, ascending, `(F,)`; NaN for frames without a time.
        spread: standard deviations of turn and place, `(2,)`, see `STEADY` and `DRIFT`.
        path: poses of the body by odometry, `(F, 4, 4)`, NaN where it says nothing; None for a constant velocity.
        drift: sums C of the covariances for turn and for place, each for a spread of one, `(F, 2, 6, 6)`.
        leans: sums B, `(F, 6, 6)`.
        piece: of odometry that each frame is in, `(F,)`; it says nothing from one to another.
        gaps: seconds without images that a constant velocity has bridged elsewhere in the drive, ascending, `(n,)`.
        bridged: the spreads that this was off by, `(n, 2)`; nothing is linked across longer gaps than these. None
            where it was not tried.
    """

    times: FloatArray
    spread: tuple[float, float]
    path: FloatArray | None = None
    drift: FloatArray | None = None
    leans: FloatArray | None = None
    piece: IntArray | None = None
    gaps: FloatArray | None = None
    bridged: FloatArray | None = None

    @classmethod
    def steady(cls, times: FloatArray) -> "Motion":
        """A velocity that changes little from one frame to the next."""
        return cls(times, STEADY)

    @classmethod
    def by_odometry(cls, times: FloatArray, odometry: Trajectory) -> "Motion":
        """The motion that an odometer tells.

        Raises:
            InputError: it has poses for less than half of the frames.
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
        # The error of a step is taken to arise at its end; steps are short.
        ahead = adjoints(poses[1:])
        added = np.stack([far[:, None, None] * ahead[..., part] @ np.swapaxes(ahead[..., part], 1, 2)
                          for part in (slice(0, 3), slice(3, 6))], axis=1)  # fmt: skip
        leant = far[:, None, None] * ahead
        sums, lean_sums = (np.concatenate([0.0 * each[:1], np.cumsum(each, axis=0)]) for each in (added, leant))
        at = np.where(covered, times, own[0])
        place = np.clip(np.searchsorted(own, at, side="right") - 1, 0, len(own) - 2)
        share = ((at - own[place]) / (own[place + 1] - own[place]))[:, None]
        path = np.tile(np.eye(4), (len(times), 1, 1))
        path[:, :3, :3] = Slerp(own, Rotation.from_matrix(poses[:, :3, :3]))(at).as_matrix()
        path[:, :3, 3] = (1.0 - share) * poses[place, :3, 3] + share * poses[place + 1, :3, 3]
        drift = sums[place] + share[..., None, None] * added[place]
        leans = lean_sums[place] + share[..., None] * leant[place]
        gaps = np.diff(own) > LONGEST_STEP
        covered &= ~gaps[place] | (share[:, 0] == 0.0)
        path[~covered] = np.nan
        return cls(times, DRIFT, path, drift, leans, np.concatenate([[0], np.cumsum(gaps)])[place])

    def of(self, frames: IntArray, apart: IntArray) -> "Motion":
        """The motion between some of the frames, `(n,)`, that says nothing from one part, `(n,)`, to another."""
        piece = apart if self.piece is None else apart * (self.piece.max() + 1) + self.piece[frames]

        def chosen(values: FloatArray | None) -> FloatArray | None:
            return None if values is None else values[frames]

        return replace(
            self,
            times=self.times[frames],
            path=chosen(self.path),
            drift=chosen(self.drift),
            leans=chosen(self.leans),
            piece=piece,
        )

    @property
    def assumed(self) -> tuple[float, float]:
        """The spread before the drive tells its own."""
        return STEADY if self.path is None else DRIFT

    @property
    def longest(self) -> float:
        """Seconds over which a constant velocity says enough."""
        turn, place = self.spread
        if self.gaps is None or self.bridged is None:
            return float(min((12.0 * MOST_TURN**2 / turn**2) ** (1 / 3), (12.0 * MOST_PLACE**2 / place**2) ** (1 / 3)))
        off = self.bridged * np.sqrt(self.gaps[:, None] ** 3 / 12.0)
        good = np.logical_and.accumulate((off <= (MOST_TURN, MOST_PLACE)).all(axis=1))
        return float(max(self.gaps[good], default=SHORTEST_GAP))

    def _spreads(self, seconds: FloatArray) -> FloatArray:
        """The spreads of a constant velocity between frames so far apart, `(M, 2)`."""
        spreads = np.broadcast_to(self.spread, (len(seconds), 2))
        if self.gaps is None or self.bridged is None or not len(self.gaps):
            return spreads
        told = np.stack([np.interp(seconds, self.gaps, each) for each in self.bridged.T], axis=1)
        return np.where((seconds > SHORTEST_GAP)[:, None], np.maximum(spreads, told), spreads)

    def tells(self, i: IntArray, j: IntArray) -> BoolArray:
        """True where the motion relates frames j to frames i, `(M,)`."""
        between = np.abs(self.times[j] - self.times[i])
        if self.path is None:
            there = between <= self.longest
        else:
            there = np.isfinite(self.path[i, 0, 0]) & np.isfinite(self.path[j, 0, 0]) & np.isfinite(between)
        return np.asarray(there if self.piece is None else there & (self.piece[i] == self.piece[j]))

    def follows(self, frames: IntArray) -> BoolArray:
        """True for frames, ascending, that are linked to the one before; `(F - 1,)`."""
        i, j = frames[:-1], frames[1:]
        return np.asarray(self.tells(i, j) & (self.times[j] > self.times[i]))

    def linked(self, frames: IntArray) -> BoolArray:
        """True for frames, ascending, that are linked to one of the others, `(F,)`."""
        follows = self.follows(frames)
        result = np.zeros(len(frames), dtype=bool)
        result[1:] |= follows
        result[:-1] |= follows
        return result

    def links(self, frames: IntArray) -> Links:
        """The links between frames, ascending."""
        one = np.flatnonzero(self.follows(frames))
        i, j = frames[one], frames[one + 1]
        seconds, information = self.times[j] - self.times[i], self.information(i, j)
        if self.path is None or self.leans is None:
            return Links(12, one, seconds, information, None, None)
        leans = adjoints(inverse(self.path[j])) @ (self.leans[j] - self.leans[i]) * np.repeat(LEAN, 3)
        return Links(6, one, seconds, information, inverse(self.path[i]) @ self.path[j], leans)

    def information(self, i: IntArray, j: IntArray) -> FloatArray:
        """Inverse of the covariance of what frames j, `(M,)`, are off beside frames i, see `Links`."""
        turn, place = self.spread
        if self.path is None or self.drift is None:
            seconds = self.times[j] - self.times[i]
            h = seconds[:, None, None]
            spline = np.block([[12.0 / h**3, -6.0 / h**2], [-6.0 / h**2, 4.0 / h]])
            axes = np.repeat(self._spreads(seconds) ** -2.0, 3, axis=1)[:, None] * np.eye(6)
            return np.asarray(np.einsum("mij,mkl->mikjl", spline, axes).reshape(-1, 12, 12))
        back = adjoints(inverse(self.path[j]))
        grown = self.drift[j] - self.drift[i]
        covariance = back @ (turn**2 * grown[:, 0] + place**2 * grown[:, 1]) @ np.swapaxes(back, 1, 2)
        return np.asarray(np.linalg.inv((covariance + np.swapaxes(covariance, 1, 2)) / 2.0))

    def steps(self, i: IntArray, j: IntArray, velocities: FloatArray | None = None) -> FloatArray:
        """The poses of frames j beside frames i, `(M, 4, 4)`; NaN where they are not known.

        Args:
            velocities: of all frames, each in its body's frame, turn first, `(F, 6)`; NaN where they are not known. The
                body of a steady motion stands still without.
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


def seconds_of(times: Sequence[str]) -> FloatArray:
    """Times of frames as they are written, in seconds, `(F,)`; NaN for names of images.

    Numbers are seconds, or ms, us or ns since 1970.

    Nanoseconds since 1970 have more digits than a float, but a tenth of a microsecond is enough.
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
