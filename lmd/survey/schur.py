"""Schur complement: the normal equations of bundle adjustment, from which frames are eliminated.

A sighting connects one frame with one tag, so the block H_ff of the frames is block diagonal. The *kept* unknowns are
tags, mounts except the first, and nuisance parameters. With their block H_kk, and H_kf, the step of the kept unknowns
solves (H_kk - H_kf H_ff^-1 H_fk) d_k = g_k - H_kf H_ff^-1 g_f. The time is linear in the number of frames.

Source: Triggs et al., "Bundle Adjustment - A Modern Synthesis".
"""

from collections.abc import Callable, Sequence
from functools import partial
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from lmd.core.checks import FloatArray, IntArray
from lmd.geometry.se3 import exp
from lmd.survey.prior import Prior
from lmd.survey.residuals import Poses, Reprojection, solved, student_weight, sums_by, weighted_product
from lmd.survey.sightings import Sightings

FRAME_CHUNK = 128  # frames that are eliminated at once
LEAST_DAMPING = 1e-9  # least relative growth of diagonals in a solution

# The kept unknown of each sighting, `(n,)`, and a matrix of each sighting, `(n, 8, 6)` or `(n, 6, 6)`.
Part = tuple[IntArray, FloatArray]


class FrameChunk(NamedTuple):
    """f frames with n sightings that are eliminated together."""

    some: Sightings
    """The sightings."""
    frames: IntArray
    """`(f,)` indices of the frames."""
    summed: Callable[[FloatArray], FloatArray]
    """Sums by frame, see `sums_by`."""
    owner: IntArray
    """`(n,)` index of each sighting's frame in `frames`."""


class Eliminated(NamedTuple):
    """Normal equations of the frames of a chunk."""

    chunk: FrameChunk
    """The frames."""
    block: FloatArray
    """`(f, 6, 6)` H_ff, damped."""
    gradient: FloatArray
    """`(f, 6)` g_f."""
    crosses: list[Part]
    """Contributions of the sightings to H_kf, `(n, 6, 6)`, for each kind of kept unknowns."""


class SchurSystem:
    """Normal equations of some sightings, all of whose tags and frames have a pose.

    Kept unknowns are in blocks of six: twists of tags, twists of mounts, nuisance parameters of each camera, and shapes
    of tags.

    Args:
        sightings: the sightings.
        prior: prior of tags and mounts.
        nuisances: True if nuisance parameters of cameras and shapes of tags are unknowns, see `Sightings`.
        inflation: factor on the standard deviations of sightings relative to the priors; the weights of sightings
            relative to each other do not change.
    """

    def __init__(self, sightings: Sightings, prior: Prior, nuisances: bool = False, inflation: float = 1.0) -> None:
        self.sightings, self.prior, self.inflation = sightings, prior, inflation
        self.mounts = sightings.cameras - 1 if prior.mounts is None else 0  # number of unknown mounts
        self.posed = len(sightings.ids) + self.mounts  # number of blocks of poses
        self.lens_blocks = sightings.lens.shape[2] // 6 if nuisances else 0  # number of blocks of each camera
        self.first_shape = self.posed + sightings.cameras * self.lens_blocks
        self.kept = self.first_shape + (len(sightings.ids) if nuisances and sightings.shape_sigma else 0)
        # Prior information of nuisance parameters in units of their standard deviations. Shapes also absorb errors that
        # are common to all sightings of a tag, so the inflation must not weaken sightings relative to the priors of
        # shapes.
        lenses = np.arange(self.posed, self.kept) < self.first_shape
        self.nuisance_information = np.where(lenses, 1.0, inflation**-2.0)
        first = np.unique(sightings.frame, return_index=True)[1]
        ends = np.append(first[::FRAME_CHUNK], len(sightings))
        self.chunks = [self._chunk(sightings.of(slice(*between))) for between in pairwise(ends)]

    @staticmethod
    def _chunk(some: Sightings) -> FrameChunk:
        frames, owner = np.unique(some.frame, return_inverse=True)
        return FrameChunk(some, frames, sums_by(owner, len(frames)), owner)

    def _jacobians(self, some: Sightings, at: Reprojection) -> list[Part]:
        """Jacobians by each kind of kept unknowns, `(n, 8, 6)`."""
        found = [(some.tag, at.by_tag)]
        if self.mounts:
            others = some.camera > 0
            index = len(some.ids) + np.where(others, some.camera - 1, 0)
            found.append((index, at.by_mount * others[:, None, None]))
        for block in range(self.lens_blocks):
            index = self.posed + self.lens_blocks * some.camera + block
            found.append((index, some.lens[:, :, 6 * block : 6 * block + 6]))
        if self.kept > self.first_shape:
            found.append((self.first_shape + some.tag, some.shape_sigma * at.by_shape))
        return found

    def eliminate(
        self, part: Eliminated, panel: FloatArray, rows: IntArray, matrix: FloatArray, right: FloatArray
    ) -> None:
        """Eliminate the frames of a chunk from `matrix` and `right`, in place.

        Args:
            part: equations of the frames.
            panel: H_fk, `(f, 6, r, 6)`, for the r kept blocks `rows`.
            rows: indices of the kept blocks, `(r,)`.
            matrix, right: the Schur system, see `schur_system`.
        """
        lower = np.asarray(np.linalg.cholesky(part.block), dtype=np.float64)
        # H_kf L^-T, whose product with its transpose is H_kf H_ff^-1 H_fk.
        half = np.linalg.solve(lower, panel.reshape(len(panel), 6, 6 * len(rows)))
        wide = np.ascontiguousarray(half.reshape(6 * len(panel), 6 * len(rows)).T)
        index = (6 * rows[:, None] + np.arange(6)).ravel()
        matrix[np.ix_(index, index)] -= wide @ wide.T
        right[rows] -= (wide @ solved(lower, part.gradient).ravel()).reshape(-1, 6)

    def eliminate_links(self, poses: Poses, is_robust: bool, matrix: FloatArray, right: FloatArray) -> None:
        """Do nothing, as no frames are linked; see `lmd.survey.linked_adjustment`."""

    def schur_system(
        self, poses: Poses, floor: float, damping: float, weight: float | None = None
    ) -> tuple[FloatArray, FloatArray, list[Eliminated]]:
        """Linearise at `poses` and eliminate the frames.

        Args:
            poses: poses.
            floor: floor of the standard deviation of corners, pixels.
            damping: relative growth of diagonals.
            weight: weight of every sighting and prior; None for robust weights.

        Returns:
            matrix `(6 kept, 6 kept)` and right side `(kept, 6)` of the kept unknowns; the eliminated parts.
        """
        matrix = np.zeros((6 * self.kept, 6 * self.kept))
        cells = matrix.reshape(self.kept, 6, self.kept, 6).transpose(0, 2, 1, 3)
        right, diagonal, parts = np.zeros((self.kept, 6)), np.zeros((self.kept, 6, 6)), []
        for chunk in self.chunks:
            some = chunk.some
            at = Reprojection(some, *poses.of(some))
            variance = some.variance(floor)
            trust = student_weight(at.squared / variance) if weight is None else weight
            product = partial(weighted_product, weight=trust / variance / self.inflation**2)
            error = -at.error[..., None]
            block = chunk.summed(product(at.by_frame, at.by_frame))
            block += (damping + LEAST_DAMPING) * block * np.eye(6) + LEAST_DAMPING * np.eye(6)
            gradient = chunk.summed(product(at.by_frame, error)[..., 0])
            jacobians = self._jacobians(some, at)
            crosses = [(index, product(slope, at.by_frame)) for index, slope in jacobians]
            rows = np.unique(np.concatenate([index for index, _ in jacobians]))
            panel = np.zeros((len(chunk.frames), 6, len(rows), 6))  # H_fk
            turned = panel.transpose(2, 0, 3, 1)
            for k, (index, slope) in enumerate(jacobians):
                np.add.at(turned, (np.searchsorted(rows, index), chunk.owner), crosses[k][1])
                summed = sums_by(index, self.kept)
                diagonal += summed(product(slope, slope))
                right += summed(product(slope, error)[..., 0])
                for other, beside in jacobians[:k]:
                    both = product(slope, beside)
                    np.add.at(cells, (index, other), both)
                    np.add.at(cells, (other, index), np.swapaxes(both, 1, 2))
            parts.append(Eliminated(chunk, block, gradient, crosses))
            self.eliminate(parts[-1], panel, rows, matrix, right)
        self.eliminate_links(poses, weight is None, matrix, right)
        self._add_priors(poses, weight is None, cells, diagonal, right)
        diagonal += damping * diagonal * np.eye(6)
        each = np.arange(self.kept)
        cells[each, each] += diagonal
        return matrix, right, parts

    def _add_priors(
        self, poses: Poses, is_robust: bool, cells: FloatArray, diagonal: FloatArray, right: FloatArray
    ) -> None:
        """Add the information of the priors to blocks of the matrix, `(kept, kept, 6, 6)`, and to the right side."""
        count, off, known = len(self.sightings.ids), self.prior.off(poses.tags), self.prior.information
        if (joint := self.prior.joint) is not None:
            cells[:count, :count] += joint.reshape(count, 6, count, 6).transpose(0, 2, 1, 3)
            right[:count] -= (joint @ off.ravel()).reshape(count, 6)
        else:
            if is_robust:
                known = known * self.prior.weights(self.prior.squares(off))[:, None]
            diagonal[:count] += known[..., None] * np.eye(6)
            right[:count] -= known * off
        if (sheets := self.prior.sheets) is not None:
            fit = sheets.fitted(poses.tags)
            weights = fit.weights if is_robust else np.ones(len(sheets.tag))
            scaled = sheets.information * weights[:, None]
            diagonal[sheets.tag] += scaled[..., None] * np.eye(6)
            right[sheets.tag] -= scaled * fit.off
            one, other = sheets.pairs
            np.subtract.at(cells, (sheets.tag[one], sheets.tag[other]), sheets.couplings(weights))
        diagonal[self.posed :] += self.nuisance_information[:, None, None] * np.eye(6)

    def step(self, poses: Poses, floor: float, damping: float) -> Poses:
        """Poses after one step; unknowns without information do not change."""
        matrix, right, parts = self.schur_system(poses, floor, damping)
        informed = np.flatnonzero(np.diag(matrix) > 0.0)
        some = matrix[np.ix_(informed, informed)]
        some[np.diag_indices_from(some)] *= 1.0 + LEAST_DAMPING
        kept = np.zeros(right.size)
        kept[informed] = np.linalg.solve(some, right.ravel()[informed])
        return self._moved(poses, kept.reshape(self.kept, 6), parts)

    def joint_step(
        self, poses: Poses, floor: float, damping: float, off: FloatArray
    ) -> tuple[Poses, FloatArray, FloatArray]:
        """Take one step of all unknowns, nuisance parameters included, in units of their prior standard deviations.

        Args:
            poses, floor: best poses and floor for the present nuisance parameters.
            damping: relative growth of diagonals.
            off: distance of the nuisance parameters from their prior means, `(n, 6)`.

        Returns:
            poses; step of the nuisance parameters, and their variances, `(n, 6)` each.
        """
        matrix, right, parts = self.schur_system(poses, floor, damping)
        right[self.posed :] -= self.nuisance_information[:, None] * off
        informed = np.flatnonzero(np.diag(matrix) > 0.0)
        whole = np.linalg.inv(matrix[np.ix_(informed, informed)])
        step, variance = np.zeros((2, right.size))
        step[informed], variance[informed] = whole @ right.ravel()[informed], np.diag(whole)
        step, variance = step.reshape(-1, 6), variance.reshape(-1, 6)
        return self._moved(poses, step, parts), step[self.posed :], variance[self.posed :]

    def _moved(self, poses: Poses, kept: FloatArray, parts: list[Eliminated]) -> Poses:
        """Poses after a step `kept` of the kept unknowns, with frames by back-substitution."""
        frames = poses.frames.copy()
        count = len(self.sightings.ids)
        rests = []
        for part in parts:
            pull = sum(np.einsum("nij,ni->nj", cross, kept[index]) for index, cross in part.crosses)
            rests.append(part.gradient - part.chunk.summed(np.asarray(pull)))
        for part, twists in zip(parts, self.frame_steps(parts, rests), strict=True):
            frames[part.chunk.frames] = frames[part.chunk.frames] @ exp(twists)
        mounts = poses.mounts.copy()
        mounts[1 : 1 + self.mounts] = mounts[1 : 1 + self.mounts] @ exp(kept[count : self.posed])
        return Poses(poses.tags @ exp(kept[:count]), frames, mounts)

    def frame_steps(self, parts: Sequence[Eliminated], rests: Sequence[FloatArray]) -> list[FloatArray]:
        """Twists of the frames of each chunk, from right sides `(f, 6)` after the kept unknowns are substituted."""
        return [solved(part.block, rest) for part, rest in zip(parts, rests, strict=True)]
