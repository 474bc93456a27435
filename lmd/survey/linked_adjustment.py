"""Bundle adjustment of frames that are linked by motion, see `lmd.survey.motion`.

With links the block H_ff of all frames is block tridiagonal. Its Cholesky factor is a band matrix, so time and memory
for eliminating the frames are linear in their number.

The spread s of the motion is estimated by maximum evidence: with theta = log s^2,

    d chi^2 / d theta + d log |Q| / d theta + d log |H| / d theta = 0,

where chi^2 and Q are the errors of the links and their covariance, and H is the matrix of all unknowns. The prior of s
has the weight of `ASSUMED_LINKS` links.

Source: MacKay, "Bayesian Interpolation".
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from lmd.core.checks import BoolArray, FloatArray, IntArray
from lmd.survey.adjustment import LEAST_SHARE, Adjustment
from lmd.survey.chain import Chain, banded
from lmd.survey.motion import Motion
from lmd.survey.prior import Prior
from lmd.survey.residuals import Poses
from lmd.survey.schur import LEAST_DAMPING, Eliminated
from lmd.survey.sightings import RESIDUALS, Sightings

COLUMNS = 512  # columns of the kept unknowns that are eliminated at once
ASSUMED_LINKS = 3.0  # weight of the prior of a spread, as a number of links
CHANGE = 1e-3  # relative change for derivatives of determinants
# Estimate of a spread: maximum number of steps, largest factor on its square in a step, and relative change of the
# square that ends the estimate.
SPREAD_STEPS, MOST_CHANGE, SETTLED = 3, 10.0, 0.03
WEAKEST = 1e-9  # information on velocities without links


class LinkedAdjustment(Adjustment):
    """Bundle adjustment of sightings in frames that `prior.motion` links, see `SchurSystem`."""

    def __init__(self, sightings: Sightings, prior: Prior, nuisances: bool = False, inflation: float = 1.0) -> None:
        super().__init__(sightings, prior, nuisances, inflation)
        assert prior.motion is not None
        self.motion = prior.motion
        self.seen = np.unique(sightings.frame)
        self.links = self.motion.links(self.seen)
        self._waiting: list[tuple[Eliminated, FloatArray, IntArray, IntArray]] = []
        self._chain = Chain.of(np.ones((1, 1)), np.empty((1, 0)), np.empty((0, 0)))
        self._right = np.empty((0, 0)), np.empty(0)  # right sides of the frames and of the bias
        self._coupling: Any = None  # block of the matrix of the frames and the kept unknowns, sparse

    def prior_losses(self, poses: Poses) -> list[float]:
        """Losses of the priors and of the links."""
        at = self.links.at(poses.frames[self.seen])
        return [
            *super().prior_losses(poses),
            self.links.loss(self.links.squares(at.error)),
            0.5 * float(at.bias @ at.bias),
        ]

    def run(self, poses: Poses, floor: float, steps: int, most: float | None = None) -> tuple[Poses, float]:
        """See `Adjustment.run`."""
        self._update_share(poses, floor)
        return super().run(poses, floor, steps, most)

    def efficiency(self, poses: Poses, floor: float) -> tuple[float, float]:
        """See `Adjustment.efficiency`."""
        self._update_share(poses, floor)
        return super().efficiency(poses, floor)

    def eliminate(
        self, part: Eliminated, panel: FloatArray, rows: IntArray, matrix: FloatArray, right: FloatArray
    ) -> None:
        """Store a chunk for `eliminate_links`."""
        where = np.nonzero(panel)
        across = self.links.size * np.searchsorted(self.seen, part.chunk.frames)[where[0]] + where[1]
        self._waiting.append((part, panel[where], across, 6 * rows[where[2]] + where[3]))

    def eliminate_links(self, poses: Poses, is_robust: bool, matrix: FloatArray, right: FloatArray) -> None:
        """Eliminate all frames from `matrix` and `right`, in place."""
        from scipy.sparse import coo_array

        size, count = self.links.size, len(self.seen)
        diagonal = np.tile(WEAKEST * np.eye(size), (count, 1, 1))
        below, pull = np.zeros((count, size, size)), np.zeros((count, size))
        parts, *entries = zip(*self._waiting, strict=True)
        self._waiting.clear()
        for part in parts:
            own = np.searchsorted(self.seen, part.chunk.frames)
            diagonal[own, :6, :6] += _undamped(part.block)
            pull[own, :6] += part.gradient
        at, first, information = self.links.at(poses.frames[self.seen]), self.links.first, self.links.information
        if is_robust:
            information = information * self.links.weights(self.links.squares(at.error))[:, None, None]
        from_first, from_second, from_bias = (
            np.swapaxes(slope, 1, 2) @ information for slope in (at.by_first, at.by_second, at.by_bias)
        )
        diagonal[first] += from_first @ at.by_first
        diagonal[first + 1] += from_second @ at.by_second
        below[first] = from_second @ at.by_first
        pull[first] -= (from_first @ at.error[..., None])[..., 0]
        pull[first + 1] -= (from_second @ at.error[..., None])[..., 0]
        border = np.zeros((count, size, len(at.bias)))
        border[first] += from_first @ at.by_bias
        border[first + 1] += from_second @ at.by_bias
        corner = np.eye(len(at.bias)) + (from_bias @ at.by_bias).sum(axis=0)
        self._right = pull, -at.bias - (from_bias @ at.error[..., None]).sum(axis=0)[:, 0]
        self._chain = Chain.of(banded(diagonal, below), border.reshape(size * count, -1), corner)
        values, across, along = (np.concatenate(each) for each in entries)
        coupling = coo_array((values, (across, along)), shape=(size * count, len(matrix))).tocsc()
        self._coupling = coupling
        right -= (coupling.T @ self._chain.solved(pull.reshape(-1, 1), self._right[1])).reshape(-1, 6)
        for start in range(0, len(matrix), COLUMNS):
            some = slice(start, start + COLUMNS)
            matrix[:, some] -= coupling.T @ self._chain.solved(coupling[:, some].toarray())

    def frame_steps(self, parts: Sequence[Eliminated], rests: Sequence[FloatArray]) -> list[FloatArray]:
        """See `SchurSystem.frame_steps`."""
        pull = self._right[0].copy()
        places = [np.searchsorted(self.seen, part.chunk.frames) for part in parts]
        for part, rest, own in zip(parts, rests, places, strict=True):
            pull[own, :6] += rest - part.gradient
        twists = self._chain.solved(pull.reshape(-1, 1), self._right[1]).reshape(pull.shape)[:, :6]
        return [twists[own] for own in places]

    def log_determinant(self, poses: Poses, floor: float, weight: float = 1.0) -> float:
        """Log-determinant of the matrix of all unknowns that have information; `weight` is the weight of the
        sightings.
        """
        matrix, *_ = self.schur_system(poses, floor, 0.0, weight)
        informed = np.flatnonzero(np.diag(matrix) > 0.0)
        kept = float(np.linalg.slogdet(matrix[np.ix_(informed, informed)])[1])
        return kept + self._chain.log_determinant

    def frame_covariances(self, poses: Poses, floor: float) -> FloatArray:
        """Marginal covariance of the right-hand twist of each frame of `seen`, `(F, 6, 6)`, as `Adjustment.covariance`.

        With the matrix B of the frames, their block H_fk with the kept unknowns, and the covariance C of the kept
        unknowns, the covariance is B^-1 + B^-1 H_fk C H_kf B^-1.
        """
        slope, spread = self.efficiency(poses, floor)
        matrix, *_ = self.schur_system(poses, floor, 0.0, slope**2 / spread)
        informed = np.flatnonzero(np.diag(matrix) > 0.0)
        values, vectors = np.linalg.eigh(np.linalg.inv(matrix[np.ix_(informed, informed)]))
        root = vectors * np.sqrt(np.maximum(values, 0.0))
        found, coupling = self._chain.inverse_blocks(self.links.size), self._coupling[:, informed]
        for start in range(0, len(informed), COLUMNS):
            reached = self._chain.solved(coupling @ root[:, start : start + COLUMNS])
            reached = reached.reshape(len(found), self.links.size, -1)
            found += reached @ np.swapaxes(reached, 1, 2)
        return found[:, :6, :6]

    def _update_share(self, poses: Poses, floor: float) -> None:
        """Set the share of the squared errors that remains after a fit, links included."""
        more = self.log_determinant(poses, floor, 1.0 + CHANGE) - self.log_determinant(poses, floor)
        self.share = max(1.0 - more / np.log1p(CHANGE) / (RESIDUALS * len(self.sightings)), LEAST_SHARE)

    def _with_spread(self, turn: float, place: float) -> "LinkedAdjustment":
        """Copy with another spread, and the same pairs of linked frames."""
        other = LinkedAdjustment.__new__(LinkedAdjustment)
        other.__dict__.update(self.__dict__)
        other.motion = replace(self.motion, spread=(turn, place))
        first, second = self.seen[self.links.first], self.seen[self.links.first + 1]
        other.links = replace(self.links, information=other.motion.information(first, second))
        return other

    def estimate_motion(self, poses: Poses, floor: float) -> Motion:
        """Motion with the spread of maximum evidence."""
        if not len(self.links.first):
            return self.motion
        assumed, found = self.motion.assumed, self
        error = self.links.at(poses.frames[self.seen]).error
        for _ in range(SPREAD_STEPS):
            growths, own = [], found.motion.spread
            here, size = found._evidence(poses, floor, error), self.links.size
            for which in range(2):
                grown = [s * (1.0 + CHANGE) ** (0.5 * (k == which)) for k, s in enumerate(own)]
                there = found._with_spread(*grown)._evidence(poses, floor, error)
                square, volume, fit = (there - here) / np.log1p(CHANGE)
                count = ASSUMED_LINKS * size / 2.0
                most = volume + fit + count  # degrees of freedom of the errors after the fit
                growth = (count * (assumed[which] / own[which]) ** 2 - square) / max(most, count)
                growths.append(float(np.clip(growth, 1.0 / MOST_CHANGE, MOST_CHANGE)))
            found = found._with_spread(*(s * growth**0.5 for s, growth in zip(own, growths, strict=True)))
            if max(abs(growth - 1.0) for growth in growths) < SETTLED:
                break
        return found.motion

    def _evidence(self, poses: Poses, floor: float, error: FloatArray) -> FloatArray:
        """Terms of the evidence for a spread, chi^2 of the links, log |Q| and log |H|, `(3,)`."""
        squares = self.links.squares(error)
        weights = self.links.weights(squares)
        volume, fit = self.links.log_determinant, self.log_determinant(poses, floor)
        return np.array([float((weights * squares).sum()), volume, fit])


def _undamped(block: FloatArray) -> FloatArray:
    """Blocks of frames without the least damping, which would hold all frames of a long chain in place."""
    result = block.copy()
    each = np.arange(block.shape[1])
    result[:, each, each] = (block[:, each, each] - LEAST_DAMPING) / (1.0 + LEAST_DAMPING)
    return result


def adjustment_of(sightings: Sightings, prior: Prior, nuisances: bool = False, inflation: float = 1.0) -> Adjustment:
    """Bundle adjustment of some sightings, linked if `prior.motion` is not None."""
    kind = Adjustment if prior.motion is None else LinkedAdjustment
    return kind(sightings, prior, nuisances, inflation)


def constraining(sightings: Sightings, used: BoolArray, motion: Motion | None) -> BoolArray:
    """True for the `used` sightings that constrain the map, `(N,)`.

    A single sighting in its frame constrains the map only if the frame is linked to another frame.
    """
    counts = np.bincount(sightings.frame[used], minlength=sightings.frames)
    enough = counts >= 2
    if motion is not None:
        frames = np.flatnonzero(counts)
        enough[frames[motion.linked(frames)]] = True
    return np.asarray(used & enough[sightings.frame])
