"""Prior of the unknowns of a bundle adjustment: tags, printed sheets, mounts, motion."""

from dataclasses import dataclass, field

import numpy as np

from lmd.adjust.corners import Poses, student_loss, student_weight
from lmd.adjust.motion import Motion
from lmd.adjust.mounts import Mounts
from lmd.adjust.sheets import Sheets
from lmd.core.checks import BoolArray, FloatArray, IntArray
from lmd.geometry.se3 import inverse, log

EXACT_SIGMA = 1e-6  # standard deviation of poses that count as exact, metres and rad


class Kept:
    """Normal equations of `count` unknowns, in blocks of six."""

    def __init__(self, count: int) -> None:
        self.matrix, self.right = np.zeros((6 * count, 6 * count)), np.zeros((count, 6))
        self.cells = self.matrix.reshape(count, 6, count, 6).transpose(0, 2, 1, 3)
        self.diagonal = np.zeros((count, 6, 6))  # added to the matrix at last, so that it may be damped

    def add(self, index: IntArray | slice, information: FloatArray, off: FloatArray) -> None:
        """Add independent priors `(n, 6)` on the unknowns `index`, which are off by `off` `(n, 6)`."""
        self.diagonal[index] += information[..., None] * np.eye(6)
        self.right[index] -= information * off


@dataclass(frozen=True)
class Prior:
    """Prior of the unknowns of a bundle adjustment."""

    tags: FloatArray
    """`(K, 4, 4)` expected poses of tags; any pose where `information` is 0."""
    information: FloatArray
    """`(K, 6)` inverse variances of rotations about the axes of each tag and of shifts along them; 0 if unknown."""
    sheets: Sheets | None = None
    """Tags that were printed together, all of them placed."""
    mounts: Mounts | None = None
    """Mounts of the cameras; None if they are unknown."""
    motion: Motion | None = None
    """Motion between the frames; None if frames are independent of each other."""
    joint: FloatArray | None = field(default=None, repr=False)
    """`(6 K, 6 K)` information of the twists of all tags from their expected poses, if their errors are correlated; it
    takes the place of the values of `information`, which then says which tags have a prior. None for independent tags.
    """

    @property
    def exact(self) -> BoolArray:
        """True for tags with exactly known poses, `(K,)`: no sighting moves them."""
        return np.asarray((self.information >= 0.5 * EXACT_SIGMA**-2.0).all(axis=1))

    @property
    def is_posed(self) -> BoolArray:
        """True for tags whose orientation is known, `(K,)`."""
        return np.asarray(self.information[:, :3].any(axis=1))

    @property
    def has_unknown_mounts(self) -> bool:
        """True if the mounts are unknowns of the adjustment."""
        return self.mounts is None or self.mounts.sigmas is not None

    def off(self, tags: FloatArray) -> FloatArray:
        """Twists from the expected poses to `tags`, `(K, 6)`; 0 for tags without a prior."""
        known = self.information.any(axis=1)
        twists = np.zeros((len(tags), 6))
        twists[known] = log(inverse(self.tags[known]) @ tags[known])
        return twists

    def squares(self, off: FloatArray) -> FloatArray:
        """chi^2 of each tag, `(K,)`, by its twist `off`."""
        return np.asarray((self.information * off**2).sum(axis=1))

    def _tag_loss(self, off: FloatArray) -> float:
        if self.joint is not None:
            return 0.5 * float(off.ravel() @ self.joint @ off.ravel())
        exact, squares = self.exact, self.squares(off)
        return student_loss(squares[~exact], 6) + float(student_weight(np.zeros(1), 6)[0] / 2.0 * squares[exact].sum())

    def loss(self, poses: Poses) -> float:
        """Sum of the losses of tags, sheets and mounts; exact and correlated tags, and mounts, have a quadratic loss,
        the others a robust one.
        """
        loss = self._tag_loss(self.off(poses.tags))
        if self.sheets is not None:
            loss += student_loss(self.sheets.fitted(poses.tags).squares, 6)
        if self.mounts is not None and self.mounts.sigmas is not None:
            loss += 0.5 * float((self.mounts.information * self.mounts.off(poses.mounts) ** 2).sum())
        return loss

    def add_to(self, kept: Kept, poses: Poses, is_robust: bool) -> None:
        """Add the information on tags, then on mounts, linearised at `poses`; exact poses keep the full weight."""
        count, off, known = len(self.tags), self.off(poses.tags), self.information
        if self.joint is not None:
            kept.cells[:count, :count] += self.joint.reshape(count, 6, count, 6).transpose(0, 2, 1, 3)
            kept.right[:count] -= (self.joint @ off.ravel()).reshape(count, 6)
        else:
            weights = student_weight(np.where(self.exact, 0.0, self.squares(off)), 6) if is_robust else 1.0
            kept.add(slice(count), known * np.reshape(weights, (-1, 1)), off)
        if (sheets := self.sheets) is not None:
            fit = sheets.fitted(poses.tags)
            weights = fit.weights if is_robust else np.ones(len(sheets.tag))
            kept.add(sheets.tag, sheets.information * weights[:, None], fit.off)
            one, other = sheets.pairs
            np.subtract.at(kept.cells, (sheets.tag[one], sheets.tag[other]), sheets.couplings(weights))
        if self.mounts is not None and self.mounts.sigmas is not None:
            own = slice(count, count + len(self.mounts.poses) - 1)
            kept.add(own, self.mounts.information, self.mounts.off(poses.mounts))
