"""Bundle adjustment: the poses of tags, frames and cameras that explain all sightings best.

A sighting has eight residuals e in pixels, see `lmd.survey.sightings`, and the squared error chi^2 = |e|^2 / sigma^2,
where sigma^2 is the detector's own variance and a floor: lenses and bodies are not quite what their calibration says.
The errors are taken for those of Student's distribution with nu degrees of freedom, so what is minimised is the sum of
(nu + 8) / 2 log(1 + chi^2 / nu). Each step is one of Levenberg and Marquardt with the weights (nu + 8) / (nu + chi^2):
a sighting that does not fit counts next to nothing. So does what is known of a tag, unless it is exact. The floor is
that with which the weighted mean of chi^2 is the one that normal errors have.

A sighting connects one frame with one tag, so frames are eliminated (Schur complement): with the blocks H_ff of the
frames, H_kk of what is kept (tags, cameras on the body but the first, and intrinsics) and H_kf, the step of what is
kept solves (H_kk - H_kf H_ff^-1 H_fk) d_k = g_k - H_kf H_ff^-1 g_f. The time is linear in the number of frames.

Sources: Triggs et al., "Bundle Adjustment - A Modern Synthesis"; Lange et al., "Robust Statistical Modeling Using the t
Distribution".
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from lmd.core.checks import FloatArray, IntArray
from lmd.geometry.se3 import exp, nearest_rotations, pose_of
from lmd.survey.residuals import Linearised, Poses, Prior, errors_at, gathered, linearise, summing
from lmd.survey.sightings import Sightings
from lmd.survey.student import DEGREES_OF_FREEDOM, RESIDUALS, cost_of, solved, weight_of

# The mean of (nu + 8) chi^2 / (nu + chi^2) where chi^2 has its own distribution with 8 degrees of freedom.
NORMAL_MEAN = 7.5625
LEAST_SHARE = 0.1
FRAME_CHUNK = 128  # frames that are eliminated at once
FIRST_DAMPING, LEAST_DAMPING, MOST_DAMPING = 1e-4, 1e-9, 1e6
# What remains to be gained, relative to the number of sightings, when a step is the last.
LEAST_GAIN = 1e-7


@dataclass(frozen=True)
class Adjusted:
    """What an adjustment found.

    Args:
        poses: the best ones.
        floor: standard deviation that the detector does not account for, pixels.
        squares: chi^2 of each sighting, `(N,)`.
    """

    poses: Poses
    floor: float
    squares: FloatArray


class Chunk(NamedTuple):
    """Some frames that are eliminated together: f of them, with n sightings."""

    some: Sightings
    """The sightings."""
    seen: IntArray
    """`(f,)` the frames."""
    of: IntArray
    """`(n,)` which of these each sighting is of."""
    summed: Callable[[FloatArray], FloatArray]
    """Sums by frame."""


class Eliminated(NamedTuple):
    """A chunk that was eliminated."""

    chunk: Chunk
    block: FloatArray
    """`(f, 6, 6)` H_ff."""
    gradient: FloatArray
    """`(f, 6)` g_f."""
    crosses: list[tuple[IntArray, FloatArray]]
    """For each kind of what is kept: which of it each sighting is of, and what that adds to H_kf, `(n, 6, 6)`."""


class Adjustment:
    """The system of equations of some sightings, all of whose tags and frames have a pose.

    Args:
        sightings: see there.
        prior: what is known of the tags.
        nuisances: whether what is not known of the cameras and of the shapes of tags is unknown, too, see `Sightings`;
            these follow the tags and the mounts.
        inflation: factor of the standard deviations of sightings, beside what is known beforehand; it changes no weight
            that one has beside another.
    """

    def __init__(self, sightings: Sightings, prior: Prior, nuisances: bool = False, inflation: float = 1.0) -> None:
        self.sightings, self.prior, self.inflation = sightings, prior, inflation
        self.mounts = sightings.cameras - 1 if prior.mounts is None else 0  # that are to be found
        self.placed = len(sightings.ids) + self.mounts
        self.lens_blocks = sightings.lens.shape[2] // 6 if nuisances else 0
        self.flat = self.placed + sightings.cameras * self.lens_blocks  # where shapes begin
        self.kept = self.flat + (len(sightings.ids) if nuisances and sightings.shape_sigma else 0)
        # The unit of nuisances is what they may be off. Shapes also take up what sightings of a tag are off alike, so
        # these count beside them as if there were no inflation.
        self.unit = np.where(np.arange(self.placed, self.kept) < self.flat, 1.0, inflation**-2.0)
        seen, first = np.unique(sightings.frame, return_index=True)
        unknowns = 6 * (len(seen) + len(np.unique(sightings.tag)) + self.mounts) + sightings.taken
        self.share = max(1.0 - unknowns / (RESIDUALS * len(sightings)), LEAST_SHARE)  # of squares that a fit leaves
        ends = np.append(first[::FRAME_CHUNK], len(sightings))
        self._last: tuple[FloatArray, FloatArray] | None = None
        self.chunks = [self._chunk(slice(*between)) for between in pairwise(ends)]

    def _chunk(self, own: slice) -> Chunk:
        some = self.sightings.of(own)
        seen, of = np.unique(some.frame, return_inverse=True)
        return Chunk(some, seen, of, summing(of, len(seen)))

    def _off(self, tags: FloatArray) -> FloatArray:
        """`Prior.off`, remembered of the last tags: a step begins where the one before has led."""
        if self._last is None or self._last[0] is not tags:
            self._last = tags, self.prior.off(tags)
        return self._last[1]

    def squares(self, error: FloatArray, floor: float) -> FloatArray:
        """chi^2 of each sighting, `(N,)`, by its squared error."""
        return np.asarray(error / (self.sightings.noise**2 + floor**2))

    def costs(self, poses: Poses) -> list[float]:
        """What the priors add to what is minimised."""
        costs = [self.prior.cost(self.prior.squares(self._off(poses.tags)))]
        if self.prior.sheets is not None:
            costs.append(cost_of(self.prior.sheets.fitted(poses.tags).squares, 6))
        return costs

    def cost(self, error: FloatArray, costs: Sequence[float], floor: float) -> float:
        """What is minimised, by the squared errors of sightings and what the priors add."""
        return sum(costs, cost_of(self.squares(error, floor)) / self.inflation**2)

    def floor(self, error: FloatArray, most: float) -> float:
        """The floor that the squared errors of sightings speak of, pixels, at most `most`."""
        shared, variance = error / self.share, self.sightings.noise**2
        low, high = 0.0, most
        for _ in range(40):
            middle = (low + high) / 2.0
            square = shared / (variance + middle**2)
            if (weight_of(square) * square).mean() > NORMAL_MEAN:
                low = middle
            else:
                high = middle
        return high

    def covariance(self, poses: Poses, floor: float) -> FloatArray:
        """Covariance of the twists that are kept, each in its own frame, `(6 kept, 6 kept)`; NaN for tags unseen.

        The weights of Student's distribution neither waste nor invent information: with w(chi^2) the mean of
        (w + 2 w' chi^2 / 8) is what the slope of the equations loses, that of w^2 chi^2 / 8 is the variance of their
        right side, and the covariance is that of least squares times the second over the first squared.
        """
        slope, spread = self.efficiency(poses, floor)
        matrix, *_ = self.reduced(poses, floor, 0.0, slope**2 / spread)
        spoken = np.flatnonzero(np.diag(matrix) > 0.0)
        whole = np.full_like(matrix, np.nan)
        whole[np.ix_(spoken, spoken)] = np.linalg.inv(matrix[np.ix_(spoken, spoken)])
        return whole

    def efficiency(self, poses: Poses, floor: float) -> tuple[float, float]:
        """The mean slope of the equations, and the variance of their right side, see `covariance`."""
        square = self.squares(errors_at(self.sightings, poses), floor) / self.share
        weight = weight_of(square)
        slope = (weight - 2.0 / RESIDUALS * square * weight / (DEGREES_OF_FREEDOM + square)).mean()
        return float(slope), float((weight**2 * square).mean() / RESIDUALS)

    def joint_step(
        self, poses: Poses, floor: float, damping: float, off: FloatArray
    ) -> tuple[Poses, FloatArray, FloatArray]:
        """The poses after one step of all unknowns, how nuisances change, and their variances after it, both `(n, 6)`.

        Nuisances are in units of what they may be off.

        Args:
            poses, floor: the best ones with the nuisances as they are.
            damping: by which diagonals grow, relative.
            off: what these are off what was known of them, `(n, 6)`.
        """
        reduced, right, blocks = self.reduced(poses, floor, damping)
        right[self.placed :] -= self.unit[:, None] * off
        spoken = np.flatnonzero(np.diag(reduced) > 0.0)
        whole = np.linalg.inv(reduced[np.ix_(spoken, spoken)])
        step, variance = np.zeros((2, right.size))
        step[spoken], variance[spoken] = whole @ right.ravel()[spoken], np.diag(whole)
        step, variance = step.reshape(-1, 6), variance.reshape(-1, 6)
        return self._moved(poses, step, blocks), step[self.placed :], variance[self.placed :]

    def step(self, poses: Poses, floor: float, damping: float) -> Poses:
        """The poses after one step."""
        reduced, right, blocks = self.reduced(poses, floor, damping)
        return self._moved(poses, _solve(reduced, right).reshape(self.kept, 6), blocks)

    def _moved(self, poses: Poses, kept: FloatArray, blocks: list[Eliminated]) -> Poses:
        """The poses once what is kept has changed by `kept`, and what was eliminated accordingly."""
        frames = poses.frames.copy()
        count = len(self.sightings.ids)
        rests = []
        for part in blocks:
            pull = sum(np.einsum("nij,ni->nj", cross, kept[index]) for index, cross in part.crosses)
            rests.append((part, part.gradient - part.chunk.summed(np.asarray(pull))))
        for (part, _), twists in zip(rests, self.frame_steps(rests), strict=True):
            frames[part.chunk.seen] = frames[part.chunk.seen] @ exp(twists)
        tags = poses.tags @ exp(kept[:count])
        mounts = poses.mounts.copy()
        mounts[1 : 1 + self.mounts] = mounts[1 : 1 + self.mounts] @ exp(kept[count : self.placed])
        return Poses(tags, frames, mounts)

    def unknowns(self, some: Sightings, at: Linearised) -> list[tuple[IntArray, FloatArray]]:
        """For each kind of unknown that is kept: which one each sighting has, `(n,)`, and its slope, `(n, 8, 6)`."""
        found = [(some.tag, at.by_tag)]
        if self.mounts:
            others = some.camera > 0
            index = len(some.ids) + np.where(others, some.camera - 1, 0)
            found.append((index, at.by_mount * others[:, None, None]))
        for block in range(self.lens_blocks):
            index = self.placed + self.lens_blocks * some.camera + block
            found.append((index, some.lens[:, :, 6 * block : 6 * block + 6]))
        if self.kept > self.flat:
            found.append((self.flat + some.tag, some.shape_sigma * at.by_shape))
        return found

    def eliminate(
        self, part: Eliminated, panel: FloatArray, rows: IntArray, matrix: FloatArray, right: FloatArray
    ) -> None:
        """Take the frames of a chunk out of the system of what is kept.

        Args:
            panel: H_fk, `(f, 6, r, 6)`, for the r parts `rows` of what is kept.
            matrix, right: the system, which changes.
        """
        lower = np.asarray(np.linalg.cholesky(part.block), dtype=np.float64)
        # H_kf L^-T, whose product with itself is H_kf H_ff^-1 H_fk.
        half = np.linalg.solve(lower, panel.reshape(len(panel), 6, 6 * len(rows)))
        wide = np.ascontiguousarray(half.reshape(6 * len(panel), 6 * len(rows)).T)
        if len(rows) == self.kept:
            matrix -= wide @ wide.T
        else:
            index = (6 * rows[:, None] + np.arange(6)).ravel()
            matrix[np.ix_(index, index)] -= wide @ wide.T
        reduced = solved(lower, part.gradient)
        right[rows] -= (wide @ reduced.ravel()).reshape(-1, 6)

    def eliminate_links(self, poses: Poses, is_robust: bool, matrix: FloatArray, right: FloatArray) -> None:
        """Take what is linked out of the system of what is kept: nothing, see `lmd.survey.linked`."""

    def frame_steps(self, parts: Sequence[tuple[Eliminated, FloatArray]]) -> list[FloatArray]:
        """The twists of the frames of each chunk, by their right sides `(f, 6)` without what is kept."""
        return [solved(part.block, rest) for part, rest in parts]

    def reduced(
        self, poses: Poses, floor: float, damping: float, weight: float | None = None
    ) -> tuple[FloatArray, FloatArray, list[Eliminated]]:
        """The matrix and the right side of what is kept, and what was eliminated.

        Args:
            poses: where to.
            floor: see `Adjusted`.
            damping: by which diagonals grow, relative.
            weight: of every sighting; None for those of Student's distribution, of priors too.
        """
        count = len(self.sightings.ids)
        matrix = np.zeros((6 * self.kept, 6 * self.kept))
        cells = matrix.reshape(self.kept, 6, self.kept, 6).transpose(0, 2, 1, 3)
        right = np.zeros((self.kept, 6))
        diagonal = np.zeros((self.kept, 6, 6))
        blocks = []
        for chunk in self.chunks:
            some, seen, of, by_frame = chunk
            at = linearise(some, *gathered(some, poses))
            variance = some.noise**2 + floor**2
            trust = weight_of((at.error**2).sum(axis=1) / variance) if weight is None else weight
            inverse_variance = trust / variance / self.inflation**2

            def product(one: FloatArray, other: FloatArray, scale: FloatArray = inverse_variance) -> FloatArray:
                return np.asarray((np.swapaxes(one, 1, 2) * scale[:, None, None]) @ other)

            error = -at.error[..., None]
            block = by_frame(product(at.by_frame, at.by_frame))
            block += (damping + LEAST_DAMPING) * block * np.eye(6) + LEAST_DAMPING * np.eye(6)
            gradient = by_frame(product(at.by_frame, error)[..., 0])
            unknowns = self.unknowns(some, at)
            crosses = [(index, product(slope, at.by_frame)) for index, slope in unknowns]
            rows = np.unique(np.concatenate([index for index, _ in unknowns]))
            panel = np.zeros((len(seen), 6, len(rows), 6))  # H_fk
            turned = panel.transpose(2, 0, 3, 1)
            for k, (index, slope) in enumerate(unknowns):
                np.add.at(turned, (np.searchsorted(rows, index), of), crosses[k][1])
                summed = summing(index, self.kept)
                diagonal += summed(product(slope, slope))
                right += summed(product(slope, error)[..., 0])
                for other, beside in unknowns[:k]:
                    both = product(slope, beside)
                    np.add.at(cells, (index, other), both)
                    np.add.at(cells, (other, index), np.swapaxes(both, 1, 2))
            blocks.append(Eliminated(chunk, block, gradient, crosses))
            self.eliminate(blocks[-1], panel, rows, matrix, right)
        self.eliminate_links(poses, weight is None, matrix, right)
        off = self._off(poses.tags)
        known = self.prior.information
        if weight is None:
            known = known * self.prior.weights(self.prior.squares(off))[:, None]
        diagonal[:count] += known[..., None] * np.eye(6)
        right[:count] -= known * off
        if (sheets := self.prior.sheets) is not None:
            fitted = sheets.fitted(poses.tags)
            weights = fitted.weights if weight is None else np.ones(len(sheets.tag))
            scaled = sheets.information * weights[:, None]
            diagonal[sheets.tag] += scaled[..., None] * np.eye(6)
            right[sheets.tag] -= scaled * fitted.off
            one, other = sheets.pairs
            np.subtract.at(cells, (sheets.tag[one], sheets.tag[other]), sheets.couplings(weights))
        diagonal[self.placed :] += self.unit[:, None, None] * np.eye(6)
        diagonal += damping * diagonal * np.eye(6)
        each = np.arange(self.kept)
        cells[each, each] += diagonal
        return matrix, right, blocks

    def run(self, poses: Poses, floor: float, steps: int, most: float | None = None) -> Adjusted:
        """The best poses near `poses`.

        Args:
            poses: where to begin.
            floor: where to begin, pixels; it is found.
            steps: how many are tried.
            most: of the floor; None for where it begins.
        """
        damping, most = FIRST_DAMPING, floor if most is None else most
        error, costs = errors_at(self.sightings, poses), self.costs(poses)
        cost = self.cost(error, costs, floor)
        for _ in range(steps):
            tried = self.step(poses, floor, damping)
            off, costs = errors_at(self.sightings, tried), self.costs(tried)
            found = self.cost(off, costs, floor)
            if found > cost or not np.isfinite(found):
                damping *= 10.0
                if damping > MOST_DAMPING:
                    break
                continue
            gained, poses, error, damping = cost - found, tried, off, max(damping / 10.0, LEAST_DAMPING)
            before, floor = floor, self.floor(error, most)
            cost = self.cost(error, costs, floor)
            if gained < LEAST_GAIN * len(self.sightings) and abs(floor - before) < 1e-3 * before + 1e-6:
                break
        return Adjusted(_orthonormal(poses), floor, self.squares(error, floor))


def _orthonormal(poses: Poses) -> Poses:
    """The same poses, with the rotations made orthonormal after many products."""

    def exact(pose: FloatArray) -> FloatArray:
        result = pose.copy()
        known = np.isfinite(pose).all(axis=(1, 2))
        result[known] = pose_of(nearest_rotations(pose[known, :3, :3]), pose[known, :3, 3])
        return result

    return replace(poses, tags=exact(poses.tags), frames=exact(poses.frames), mounts=exact(poses.mounts))


def _solve(matrix: FloatArray, right: FloatArray) -> FloatArray:
    """The solution for a symmetric matrix; unknowns that nothing speaks of stay where they are."""
    spoken = np.diag(matrix) > 0.0
    result = np.zeros(right.size)
    index = np.flatnonzero(spoken)
    some = matrix.copy() if spoken.all() else matrix[np.ix_(index, index)]
    some[np.diag_indices_from(some)] *= 1.0 + LEAST_DAMPING
    result[index] = np.linalg.solve(some, right.ravel()[index])
    return result
