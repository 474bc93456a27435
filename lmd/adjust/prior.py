"""Prior of the unknowns of a bundle adjustment: tags, printed sheets, mounts, motion.

*Sheets* hold several tags. The poses of the tags on a sheet are known; the pose of the sheet is not. Tag k has the pose
R_k on its sheet (x to the right, y up, z out of the sheet) and the pose T_k = B R_k exp(d_k) in the world. B is the
pose of the sheet, and d_k a twist due to printing and bending. B is eliminated, so sheets are not unknowns of the
bundle adjustment. Let A be the stack of the matrices A_k = Ad(R_k^-1), and D the information matrix (inverse
covariance) of all twists d_k. Then the tags of a sheet have the joint information matrix D - D A (A' D A)^-1 A' D.
"""

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from lmd.adjust.corners import DEGREES_OF_FREEDOM, Poses, add_at, solved, student_loss, student_weight, sums_by
from lmd.adjust.motion import Motion
from lmd.core.checks import BoolArray, Checked, FloatArray, IntArray, Positive
from lmd.geometry.se3 import adjoint_matrix, exp, inverse, log

EXACT_SIGMA = 1e-6  # standard deviation of poses that count as exact, metres and rad
FEWEST = 2  # minimum number of tags of a sheet
STEPS = 6  # Gauss-Newton steps for the pose of a sheet


class Kept:
    """Normal equations of the kept unknowns (all but the frames' poses), initially 0. The unknowns form `count` blocks
    of six.
    """

    def __init__(self, count: int) -> None:
        self.matrix, self.right = np.zeros((6 * count, 6 * count)), np.zeros((count, 6))
        self.cells = self.matrix.reshape(count, 6, count, 6).transpose(0, 2, 1, 3)
        self.diagonal = np.zeros((count, 6, 6))  # added to the matrix last, so that it can be damped

    def add(self, index: IntArray | slice, information: FloatArray, off: FloatArray) -> None:
        """Add independent priors on the unknowns of the blocks with the indices `index` `(n,)`. `information` `(n, 6)`
        is the inverse variance of each unknown, and `off` `(n, 6)` its present value minus its expected value.
        """
        self.diagonal[index] += information[..., None] * np.eye(6)
        self.right[index] -= information * off


@dataclass(frozen=True)
class Sheets:
    """Printed sheets with several tags each. A survey has K tags, of which M are on sheets."""

    tag: IntArray
    """`(M,)` index of each of these tags among the K tags of the survey."""
    board: IntArray
    """`(M,)` index of the sheet on which each tag is."""
    poses: FloatArray
    """`(M, 4, 4)` poses R_k of the tags on their sheets."""
    information: FloatArray
    """`(6,)` inverse variances of the components of d_k."""

    def of(self, placed: BoolArray) -> "Sheets | None":
        """Sheets that have at least two tags in the mask `placed` `(K,)`. Tags outside the mask are removed from the
        sheets. None if there is no such sheet.
        """
        own = placed[self.tag]
        own &= np.bincount(self.board[own], minlength=self.board.max(initial=0) + 1)[self.board] >= FEWEST
        board = np.unique(self.board[own], return_inverse=True)[1]
        return Sheets(self.tag[own], board, self.poses[own], self.information) if own.any() else None

    @cached_property
    def turned(self) -> FloatArray:
        """Matrices A_k = Ad(R_k^-1) of the tags, `(M, 6, 6)`, where R_k is the pose of tag k on its sheet."""
        return adjoint_matrix(inverse(self.poses))

    @cached_property
    def pairs(self) -> tuple[IntArray, IntArray]:
        """Indices (first and second tag) of all pairs of tags that are on one sheet, including each tag with itself."""
        one, other = np.nonzero(self.board[:, None] == self.board)
        return one, other

    def fitted(self, tags: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Fit the pose of each sheet to the poses `tags` `(K, 4, 4)` of its tags.

        Each tag proposes a pose of its sheet; the fit starts with the proposal on which the tags of the sheet agree
        best.

        Returns:
            twist d_k of each tag, `(M, 6)`, from its expected pose on the fitted sheet to its pose in `tags`; chi^2 of
            each twist, `(M,)`.
        """

        def off(sheets: FloatArray, which: IntArray | slice) -> tuple[FloatArray, FloatArray]:
            twists = log(inverse(sheets @ self.poses[which]) @ tags[self.tag[which]])
            return twists, (self.information * twists**2).sum(axis=1)

        one, other = self.pairs
        proposed = tags[self.tag] @ inverse(self.poses)
        loss = np.bincount(one, np.log1p(off(proposed[one], other)[1] / DEGREES_OF_FREEDOM))
        order = np.lexsort((loss, self.board))
        sheets = proposed[order[np.unique(self.board[order], return_index=True)[1]]]
        for _ in range(STEPS):
            twists, squares = off(sheets[self.board], slice(None))
            scaled = self.information * student_weight(squares, 6)[:, None]
            right = self._summed(np.einsum("mij,mi->mj", self.turned, scaled * twists))
            sheets = sheets @ exp(solved(self._normal(scaled), right))
        return off(sheets[self.board], slice(None))

    def _normal(self, scaled: FloatArray) -> FloatArray:
        """Normal matrix A' D A for the pose of each of S sheets, `(S, 6, 6)`. A has the matrices `turned` of the
        sheet's tags. D is diagonal: `scaled` `(M, 6)` has the inverse variances of each tag's twist.
        """
        return self._summed(np.swapaxes(self.turned, 1, 2) @ (scaled[..., None] * self.turned))

    def _summed(self, values: FloatArray) -> FloatArray:
        """Sums of values `(M, ...)` over the tags of each sheet."""
        return sums_by(self.board, self.board.max() + 1)(values)

    def add_to(self, kept: Kept, tags: FloatArray, is_robust: bool) -> None:
        """Add the joint information on the tags of the sheets to the normal equations `kept`. The equations are
        linearised at the poses `tags` `(K, 4, 4)`, with robust weights if `is_robust`.
        """
        (twists, squares), (one, other) = self.fitted(tags), self.pairs
        scaled = self.information * (student_weight(squares, 6)[:, None] if is_robust else np.ones((len(squares), 1)))
        kept.add(self.tag, scaled, twists)
        wide, inverted = scaled[..., None] * self.turned, np.linalg.inv(self._normal(scaled))
        couplings = wide[one] @ inverted[self.board[one]] @ np.swapaxes(wide[other], 1, 2)
        add_at(kept.cells, self.tag[one], self.tag[other], -couplings)


@dataclass(frozen=True)
class Hanging(Checked):
    """Standard deviations of the difference between the true and the expected pose of a tag, along the axes of the tag.

    Raises:
        InputError: a standard deviation is not positive.
    """

    place: Positive = 0.02
    """Standard deviation of the shift in the plane of the wall, metres."""
    turn: Positive = 0.05
    """Standard deviation of the rotation in the plane of the wall, rad."""
    depth: Positive = 0.005
    """Standard deviation of the shift off the wall, metres."""
    tilt: Positive = 0.02
    """Standard deviation of the rotation out of the plane of the wall, rad."""

    @property
    def deviations(self) -> FloatArray:
        """Standard deviations of rotations about, and of shifts along, the x, y and z axes of a tag, `(6,)`."""
        return np.array([self.tilt, self.tilt, self.turn, self.place, self.place, self.depth])


@dataclass(frozen=True)
class Mounts:
    """Prior of the poses of C cameras on the body (mounts). The body's frame is that of the first camera."""

    poses: FloatArray
    """`(C, 4, 4)` expected poses, camera to body."""
    sigmas: tuple[float, float]
    """Standard deviations of rotation, rad, and position, metres."""

    @property
    def information(self) -> FloatArray:
        """Inverse variances of the twist of each unknown mount, that is, of every camera but the first,
        `(C - 1, 6)`.
        """
        return np.tile(np.repeat(self.sigmas, 3) ** -2.0, (len(self.poses) - 1, 1))

    def off(self, mounts: FloatArray) -> FloatArray:
        """Twists from the expected poses to `mounts` `(C, 4, 4)`, for all cameras but the first, `(C - 1, 6)`."""
        return log(inverse(self.poses[1:]) @ mounts[1:])


@dataclass(frozen=True)
class Prior:
    """Prior of the unknowns of a bundle adjustment."""

    tags: FloatArray
    """Expected poses of tags, `(K, 4, 4)`; arbitrary where `information` is 0."""
    information: FloatArray
    """Inverse variances of rotations about the axes of each tag and of shifts along them, `(K, 6)`; 0 for unknown
    rotations and shifts.
    """
    sheets: Sheets | None = None
    """Tags that were printed on common sheets; all these tags are placed."""
    mounts: Mounts | None = None
    """Prior of the mounts; None if nothing is known of them."""
    motion: Motion | None = None
    """Motion between the frames; None if frames are independent of each other."""
    joint: FloatArray | None = field(default=None, repr=False)
    """`(6 K, 6 K)` information (inverse covariance) on the twists of all tags from their expected poses, if the errors
    of different tags are correlated. The matrix replaces `information`, which then only tells which tags have a prior.
    None for independent tags.
    """

    @property
    def known(self) -> BoolArray:
        """Mask of the tags with a prior, `(K,)`."""
        return np.asarray(self.information.any(axis=1))

    @property
    def exact(self) -> BoolArray:
        """Mask of the tags whose pose is known exactly and hardly changes in an adjustment, `(K,)`."""
        return np.asarray((self.information >= 0.5 * EXACT_SIGMA**-2.0).all(axis=1))

    @property
    def is_posed(self) -> BoolArray:
        """Mask of the tags with a prior on their orientation, `(K,)`."""
        return np.asarray(self.information[:, :3].any(axis=1))

    def off(self, tags: FloatArray) -> FloatArray:
        """Twists from the expected poses to the poses `tags` `(K, 4, 4)`, `(K, 6)`; 0 for tags without a prior."""
        twists = np.zeros((len(tags), 6))
        twists[self.known] = log(inverse(self.tags[self.known]) @ tags[self.known])
        return twists

    def squares(self, off: FloatArray) -> FloatArray:
        """chi^2 of each tag, `(K,)`, from the twist `off` `(K, 6)` between the expected and the present pose."""
        return np.asarray((self.information * off**2).sum(axis=1))

    def loss(self, poses: Poses) -> float:
        """Sum of the losses of the priors on tags, sheets and mounts. The loss is quadratic for mounts, and for tags
        with exact poses or correlated errors. For all other tags and for sheets, the loss is robust.
        """
        off, exact = self.off(poses.tags), self.exact
        if self.joint is not None:
            loss = 0.5 * float(off.ravel() @ self.joint @ off.ravel())
        else:
            squares = self.squares(off)
            most = float(student_weight(np.zeros(1), 6)[0])
            loss = student_loss(squares[~exact], 6) + most / 2.0 * float(squares[exact].sum())
        if self.sheets is not None:
            loss += student_loss(self.sheets.fitted(poses.tags)[1], 6)
        if self.mounts is not None:
            loss += 0.5 * float((self.mounts.information * self.mounts.off(poses.mounts) ** 2).sum())
        return loss

    def add_to(self, kept: Kept, poses: Poses, is_robust: bool) -> None:
        """Add the priors on tags, sheets and mounts to the normal equations `kept`, linearised at `poses`. If
        `is_robust`, tags and sheets get robust weights, except tags with exact poses or correlated errors.
        """
        count, off = len(self.tags), self.off(poses.tags)
        if self.joint is not None:
            kept.cells[:count, :count] += self.joint.reshape(count, 6, count, 6).transpose(0, 2, 1, 3)
            kept.right[:count] -= (self.joint @ off.ravel()).reshape(count, 6)
        else:
            weights = student_weight(np.where(self.exact, 0.0, self.squares(off)), 6) if is_robust else np.ones(count)
            kept.add(slice(count), self.information * weights[:, None], off)
        if self.sheets is not None:
            self.sheets.add_to(kept, poses.tags, is_robust)
        if self.mounts is not None:
            own = slice(count, count + len(self.mounts.poses) - 1)
            kept.add(own, self.mounts.information, self.mounts.off(poses.mounts))
