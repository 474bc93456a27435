"""Bundle adjustment of frames that are linked by the motion between them, see `lmd.survey.motion`.

With links the block H_ff of all frames is no longer diagonal, but block tridiagonal: its Cholesky factor is a band, and
the frames are still eliminated in a time and a memory that are linear in their number.

The drive itself tells its spread s, by which links are off. The evidence of s is largest where, with theta = log s^2,

    d chi^2 / d theta + d log |Q| / d theta + d log |H| / d theta = 0,

chi^2 and Q being the errors of the links and their covariance, and H the matrix of all unknowns (MacKay, "Bayesian
Interpolation"): the sum of squares is what is expected of it, less what the fit has taken from it. What is assumed of s
counts like some links.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from lmd.core.checks import BoolArray, FloatArray, IntArray
from lmd.survey.adjustment import LEAST_DAMPING, LEAST_SHARE, Adjusted, Adjustment, Eliminated
from lmd.survey.motion import Motion
from lmd.survey.residuals import Poses, Prior
from lmd.survey.sightings import Sightings
from lmd.survey.student import RESIDUALS

COLUMNS = 512  # of what is kept that are eliminated at once
ASSUMED_LINKS = 3.0  # what is assumed of a spread counts like so many links
CHANGE = 1e-3  # relative, for derivatives of determinants
SPREAD_STEPS, MOST_CHANGE, SETTLED = 3, 10.0, 0.03  # and of a spread's square in each of them, and in the last one
WEAKEST = 1e-9  # information on a velocity that nothing speaks of


class Chain(NamedTuple):
    """The matrix of all frames and of what odometry is off by alike, [B c; c^T d], factored; B is a band."""

    factor: FloatArray
    """Of B."""
    border: FloatArray
    """`(n, e)` c, e being 0 or 6."""
    reached: FloatArray
    """`(n, e)` B^-1 c."""
    left: FloatArray
    """`(e, e)` d - c^T B^-1 c."""

    @classmethod
    def of(cls, band: FloatArray, border: FloatArray, corner: FloatArray) -> "Chain":
        """Factor a matrix: the lower band of B, c and d."""
        from scipy.linalg import cho_solve_banded, cholesky_banded

        factor = cholesky_banded(band, lower=True, check_finite=False)
        reached = cho_solve_banded((factor, True), border) if border.size else border
        return cls(factor, border, reached, corner - border.T @ reached)

    def solved(self, right: FloatArray, alike: FloatArray | None = None) -> FloatArray:
        """The part of the frames in the solutions `(n, m)`.

        Args:
            right: of the frames, `(n, m)`.
            alike: of what is off alike, for all m, `(e,)`; None for 0.
        """
        from scipy.linalg import cho_solve_banded

        own = cho_solve_banded((self.factor, True), right, check_finite=False)
        if not self.left.size:
            return np.asarray(own)
        rest = -self.border.T @ own + (0.0 if alike is None else alike[:, None])
        return np.asarray(own - self.reached @ np.linalg.solve(self.left, rest))

    @property
    def log_determinant(self) -> float:
        """Of the matrix."""
        return 2.0 * float(np.log(self.factor[0]).sum()) + float(np.linalg.slogdet(self.left)[1])


class LinkedAdjustment(Adjustment):
    """The system of equations of sightings in frames that are linked.

    Args:
        sightings, prior, nuisances, inflation: see `Adjustment`; `prior.motion` says how the frames are linked.
    """

    def __init__(self, sightings: Sightings, prior: Prior, nuisances: bool = False, inflation: float = 1.0) -> None:
        super().__init__(sightings, prior, nuisances, inflation)
        assert prior.motion is not None
        self.motion = prior.motion
        self.seen = np.unique(sightings.frame)
        self.links = self.motion.links(self.seen)
        self._waiting: list[tuple[Eliminated, FloatArray, IntArray, IntArray]] = []
        self._chain = Chain.of(np.ones((1, 1)), np.empty((1, 0)), np.empty((0, 0)))
        self._pulls = np.empty((0, 0)), np.empty(0)

    def costs(self, poses: Poses) -> list[float]:
        """The parts of the priors and of the links in what is minimised."""
        at = self.links.at(poses.frames[self.seen])
        return [*super().costs(poses), self.links.cost(self.links.squares(at.error)), 0.5 * float(at.lean @ at.lean)]

    def run(self, poses: Poses, floor: float, steps: int, most: float | None = None) -> Adjusted:
        """The best poses near `poses`, see `Adjustment`."""
        self.judge(poses, floor)
        return super().run(poses, floor, steps, most)

    def efficiency(self, poses: Poses, floor: float) -> tuple[float, float]:
        """The mean slope of the equations, and the variance of their right side, see `Adjustment`."""
        self.judge(poses, floor)
        return super().efficiency(poses, floor)

    def eliminate(
        self, part: Eliminated, panel: FloatArray, rows: IntArray, matrix: FloatArray, right: FloatArray
    ) -> None:
        """Keep a chunk for `eliminate_links`."""
        where = np.nonzero(panel)
        across = self.links.size * np.searchsorted(self.seen, part.chunk.seen)[where[0]] + where[1]
        self._waiting.append((part, panel[where], across, 6 * rows[where[2]] + where[3]))

    def eliminate_links(self, poses: Poses, is_robust: bool, matrix: FloatArray, right: FloatArray) -> None:
        """Take all frames out of the system of what is kept."""
        from scipy.sparse import coo_array

        size, count = self.links.size, len(self.seen)
        diagonal = np.tile(WEAKEST * np.eye(size), (count, 1, 1))
        below, pull = np.zeros((count, size, size)), np.zeros((count, size))
        parts, *entries = zip(*self._waiting, strict=True)
        self._waiting.clear()
        for part in parts:
            own = np.searchsorted(self.seen, part.chunk.seen)
            diagonal[own, :6, :6] += _undamped(part.block)
            pull[own, :6] += part.gradient
        at, one, information = self.links.at(poses.frames[self.seen]), self.links.one, self.links.information
        if is_robust:
            information = information * self.links.weights(self.links.squares(at.error))[:, None, None]
        from_one, from_other, from_lean = (
            np.swapaxes(slope, 1, 2) @ information for slope in (at.by_one, at.by_other, at.by_lean)
        )
        diagonal[one] += from_one @ at.by_one
        diagonal[one + 1] += from_other @ at.by_other
        below[one] = from_other @ at.by_one
        pull[one] -= (from_one @ at.error[..., None])[..., 0]
        pull[one + 1] -= (from_other @ at.error[..., None])[..., 0]
        border = np.zeros((count, size, len(at.lean)))
        border[one] += from_one @ at.by_lean
        border[one + 1] += from_other @ at.by_lean
        corner = np.eye(len(at.lean)) + (from_lean @ at.by_lean).sum(axis=0)
        self._pulls = pull, -at.lean - (from_lean @ at.error[..., None]).sum(axis=0)[:, 0]
        self._chain = Chain.of(_banded(diagonal, below), border.reshape(size * count, -1), corner)
        values, across, along = (np.concatenate(each) for each in entries)
        coupling = coo_array((values, (across, along)), shape=(size * count, len(matrix))).tocsc()
        right -= (coupling.T @ self._chain.solved(pull.reshape(-1, 1), self._pulls[1])).reshape(-1, 6)
        for first in range(0, len(matrix), COLUMNS):
            some = slice(first, first + COLUMNS)
            matrix[:, some] -= coupling.T @ self._chain.solved(coupling[:, some].toarray())

    def frame_steps(self, parts: Sequence[tuple[Eliminated, FloatArray]]) -> list[FloatArray]:
        """The twists of the frames of each chunk, by their right sides without what is kept."""
        pull, places = self._pulls[0].copy(), []
        for part, rest in parts:
            own = np.searchsorted(self.seen, part.chunk.seen)
            pull[own, :6] += rest - part.gradient
            places.append(own)
        twists = self._chain.solved(pull.reshape(-1, 1), self._pulls[1]).reshape(pull.shape)[:, :6]
        return [twists[own] for own in places]

    def log_determinant(self, poses: Poses, floor: float, weight: float = 1.0) -> float:
        """Of the matrix of all unknowns, but for those of which nothing is known."""
        matrix, *_ = self.reduced(poses, floor, 0.0, weight)
        spoken = np.flatnonzero(np.diag(matrix) > 0.0)
        kept = float(np.linalg.slogdet(matrix[np.ix_(spoken, spoken)])[1])
        return kept + self._chain.log_determinant

    def judge(self, poses: Poses, floor: float) -> None:
        """Find the share of squares that a fit leaves: links take part in the fit."""
        more = self.log_determinant(poses, floor, 1.0 + CHANGE) - self.log_determinant(poses, floor)
        self.share = max(1.0 - more / np.log1p(CHANGE) / (RESIDUALS * len(self.sightings)), LEAST_SHARE)

    def with_spread(self, turn: float, place: float) -> "LinkedAdjustment":
        """The same with another spread, and the same links."""
        other = LinkedAdjustment.__new__(LinkedAdjustment)
        other.__dict__.update(self.__dict__)
        other.motion = replace(self.motion, spread=(turn, place))
        first, second = self.seen[self.links.one], self.seen[self.links.one + 1]
        other.links = replace(self.links, information=other.motion.information(first, second))
        return other

    def told(self, poses: Poses, floor: float) -> Motion:
        """The motion with the spread that the drive tells."""
        if not len(self.links.one):
            return self.motion
        assumed, found = self.motion.assumed, self
        error = self.links.at(poses.frames[self.seen]).error
        for _ in range(SPREAD_STEPS):
            grown_by, own = [], found.motion.spread
            here, size = found._figures(poses, floor, error), self.links.size
            for which in range(2):
                grown = [s * (1.0 + CHANGE) ** (0.5 * (k == which)) for k, s in enumerate(own)]
                there = found.with_spread(*grown)._figures(poses, floor, error)
                square, volume, fit = (there - here) / np.log1p(CHANGE)
                count = ASSUMED_LINKS * size / 2.0
                most = volume + fit + count  # degrees of freedom that are left to the errors
                growth = (count * (assumed[which] / own[which]) ** 2 - square) / max(most, count)
                grown_by.append(float(np.clip(growth, 1.0 / MOST_CHANGE, MOST_CHANGE)))
            found = found.with_spread(*(s * growth**0.5 for s, growth in zip(own, grown_by, strict=True)))
            if max(abs(growth - 1.0) for growth in grown_by) < SETTLED:
                break
        return found.motion

    def _figures(self, poses: Poses, floor: float, error: FloatArray) -> FloatArray:
        """chi^2 of the links, log |Q|, and log |H|, whose slopes say how large a spread is."""
        squares = self.links.squares(error)
        weights = self.links.weights(squares)
        volume, fit = self.links.log_determinant, self.log_determinant(poses, floor)
        return np.array([float((weights * squares).sum()), volume, fit])


def _undamped(block: FloatArray) -> FloatArray:
    """Blocks of frames without the least damping, which would hold all frames of a long chain where they are."""
    result = block.copy()
    each = np.arange(block.shape[1])
    result[:, each, each] = (block[:, each, each] - LEAST_DAMPING) / (1.0 + LEAST_DAMPING)
    return result


def _banded(diagonal: FloatArray, below: FloatArray) -> FloatArray:
    """The lower band of a block tridiagonal matrix, by its blocks `(F, b, b)`, as scipy has it: `(2 b, F b)`."""
    count, size, _ = diagonal.shape
    banded = np.zeros((2 * size, count, size))
    for column in range(size):
        rows = np.arange(size)
        low = rows[column:]
        banded[low - column, :, column] = diagonal[:, low, column].T
        banded[size + rows - column, :, column] = below[:, :, column].T
    return banded.reshape(2 * size, count * size)


def adjustment_of(sightings: Sightings, prior: Prior, nuisances: bool = False, inflation: float = 1.0) -> Adjustment:
    """The system of equations of some sightings, whose frames are linked if `prior.motion` says how."""
    kind = Adjustment if prior.motion is None else LinkedAdjustment
    return kind(sightings, prior, nuisances, inflation)


def telling(sightings: Sightings, used: BoolArray, motion: Motion | None) -> BoolArray:
    """The sightings among `used` that say something of the map.

    One alone in its frame says nothing, unless that frame is linked to another one.
    """
    counts = np.bincount(sightings.frame[used], minlength=sightings.frames)
    enough = counts >= 2
    if motion is not None:
        frames = np.flatnonzero(counts)
        enough[frames[motion.linked(frames)]] = True
    return np.asarray(used & enough[sightings.frame])
