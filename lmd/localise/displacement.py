"""Displacement of each tag of a map, beside all other tags, from the normal equations of an adjustment.

Let u be the twists of the tags from the map. The *trusted* tags r, which were not moved, have the prior N(0, S). Other
tags, cameras and shapes of tags are the rest, o. The sightings have the information M and the gradient g, from which
frames are eliminated. Eliminating the rest gives H and b = H u_r + g_r - M_ro M_oo^-1 g_o. As the map as a whole cannot
be off, S is singular, and its inverse is avoided: trusted tags have the covariance C = S (I + H S)^-1 and twists C b.

- If a trusted tag k was moved by t, its prior holds for u_k - t. The derivative of the loss by t is f_k, with
  f = (I + H S)^-1 b, and the information on t is Q_kk, with Q = H (I + S H)^-1. So t = Q_kk^-1 f_k with the covariance
  Q_kk^-1.
- Another tag of the map has the twist u_k and the covariance P_k = M_oo^-1 + G C G^T, with G = -M_oo^-1 M_or. The map
  expects the twist S_kr f beside the trusted tags. So t = u_k - S_kr f, with the covariance
  P_k + S_kk - A - A^T - S_kr Q S_rk, where A = G (I + S H)^-1 S_rk.

If errors of tags in the map are independent, this compares the pose of tag k in the map with that by all other tags.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from lmd.core.checks import FloatArray, IntArray
from lmd.geometry.se3 import inverse, log
from lmd.localise.fixed_map import rows_of
from lmd.survey.adjustment import Adjustment
from lmd.survey.residuals import Poses

MOST_VARIANCE = 1.0  # variance of a displacement, rad^2 or m^2, above which a tag is not compared


@dataclass(frozen=True)
class LinearMap:
    """Linearised adjustment of K tags."""

    covariance: FloatArray
    """Covariance of the tags in the map, `(6 K, 6 K)`; 0 for tags that the map lacks."""
    trusted: IntArray
    """Rows of the trusted tags, `(6 n,)`."""
    others: IntArray
    """Rows of the other tags that were seen, `(6 m,)`."""
    twists: FloatArray
    """Twists of all tags from the map at the linearisation, `(6 K,)`."""
    information: FloatArray
    """H, `(6 n, 6 n)`."""
    right: FloatArray
    """b, `(6 n,)`."""
    inverse: FloatArray
    """Rows of the other tags of M_oo^-1, `(6 m, 6 m)`."""
    gain: FloatArray
    """G of the other tags, `(6 m, 6 n)`."""
    step: FloatArray
    """M_oo^-1 g_o of the other tags, `(6 m,)`."""

    @classmethod
    def of(
        cls,
        adjustment: Adjustment,
        poses: Poses,
        floor: float,
        covariance: FloatArray,
        weight: float | None,
    ) -> "LinearMap":
        """Linearise an adjustment with nuisance parameters.

        Args:
            adjustment: adjustment, whose prior has the covariance of the trusted tags, and no other tag.
            poses, floor, weight: see `SchurSystem.schur_system`.
            covariance: see the class.
        """
        prior = adjustment.prior
        matrix, gradient, _ = adjustment.schur_system(poses, floor, 0.0, weight)
        right, size = gradient.ravel(), 6 * len(prior.tags)
        if prior.joint is not None:
            matrix[:size, :size] -= prior.joint
            right[:size] += prior.joint @ prior.off(poses.tags).ravel()
        seen = np.diag(matrix) > 0.0
        trusted = rows_of(np.flatnonzero(prior.information.any(axis=1)))
        rest = np.setdiff1d(np.flatnonzero(seen), trusted)
        tags = rest < size
        whole = np.asarray(np.linalg.inv(matrix[np.ix_(rest, rest)]), dtype=np.float64)
        gain, step = -whole @ matrix[np.ix_(rest, trusted)], whole @ right[rest]
        information = matrix[np.ix_(trusted, trusted)] + matrix[np.ix_(trusted, rest)] @ gain
        twists, posed = np.zeros((len(prior.tags), 6)), np.isfinite(poses.tags[:, 0, 0])
        twists[posed] = log(inverse(prior.tags[posed]) @ poses.tags[posed])
        pull = right[trusted] - matrix[np.ix_(trusted, rest)] @ step + information @ twists.ravel()[trusted]
        own = whole[np.ix_(tags, tags)]
        return cls(covariance, trusted, rest[tags], twists.ravel(), information, pull, own, gain[tags], step[tags])

    @cached_property
    def _prior(self) -> FloatArray:
        """S, `(6 n, 6 n)`."""
        return self.covariance[np.ix_(self.trusted, self.trusted)]

    @cached_property
    def _damped(self) -> FloatArray:
        """(I + S H)^-1, `(6 n, 6 n)`."""
        return np.asarray(np.linalg.inv(np.eye(len(self.trusted)) + self._prior @ self.information))

    @cached_property
    def covariances(self) -> FloatArray:
        """Covariance of each tag after the adjustment, `(K, 6, 6)`; NaN for tags that were not seen."""
        whole = np.full(self.covariance.shape, np.nan)
        found = self._damped @ self._prior
        whole[np.ix_(self.trusted, self.trusted)] = (found + found.T) / 2.0
        whole[np.ix_(self.others, self.others)] = self.inverse + self.gain @ found @ self.gain.T
        count = len(whole) // 6
        return np.stack([whole[6 * k : 6 * k + 6, 6 * k : 6 * k + 6] for k in range(count)])

    @cached_property
    def _scores(self) -> tuple[FloatArray, FloatArray]:
        """Q, and f."""
        return self.information @ self._damped, self._damped.T @ self.right

    @cached_property
    def _moved(self) -> FloatArray:
        """Twists of the other tags after the adjustment, `(6 m,)`."""
        trusted = self._damped @ (self._prior @ self.right)
        return self.twists[self.others] + self.step + self.gain @ (trusted - self.twists[self.trusted])

    def displacement(self, tag: int) -> tuple[FloatArray, FloatArray] | None:
        """Displacement of a tag of the map, `(6,)`, and its covariance if it was not moved, `(6, 6)`.

        Returns:
            None if nothing else tells where the tag is.
        """
        own = slice(6 * tag, 6 * tag + 6)
        if (at := np.flatnonzero(self.trusted == own.start)).size:
            rows = slice(at[0], at[0] + 6)
            information, force = self._scores
            square = (information[rows, rows] + information[rows, rows].T) / 2.0
            if np.linalg.eigvalsh(square)[0] <= 1.0 / MOST_VARIANCE:
                return None
            covariance = np.asarray(np.linalg.inv(square), dtype=np.float64)
            return covariance @ force[rows], covariance
        at = np.flatnonzero(self.others == own.start)
        if not at.size:
            return None
        rows = slice(at[0], at[0] + 6)
        beside, (information, force) = self.covariance[self.trusted, own], self._scores
        common = self.gain[rows] @ self._damped @ beside
        covariance = self.covariances[tag] + self.covariance[own, own] - common - common.T
        covariance -= beside.T @ information @ beside
        if np.linalg.eigvalsh(covariance)[-1] >= MOST_VARIANCE:
            return None
        return self._moved[rows] - beside.T @ force, covariance
