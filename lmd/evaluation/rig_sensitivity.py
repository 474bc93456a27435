"""Figures of a rig with a failed camera, or with landmarks that are not detected in some images.

All figures use the same poses: the landmarks in each image are found once, then some are removed.

For a single camera, `lmd.evaluation.sensitivity` computes these figures with the bit sets of a compiled field, and the
mean of P_n exactly. For a rig, a random draw decides which landmarks are missed.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import combinations
from typing import Any

import numpy as np

from lmd.core.checks import BoolArray, FloatArray
from lmd.objectives.localisation.rig import RigImages, covers, images_of, located
from lmd.scene.deployment import Deployment
from lmd.sight.evaluator import Evaluator


@dataclass(frozen=True)
class RigMoments:
    """Moments of an evaluator over a deployment, and the conditions under which a moment is localised."""

    evaluator: Evaluator
    """Evaluator of a rig."""
    deployment: Deployment
    """K landmarks."""
    n: int
    """Number of landmarks that must be covered."""
    precision: Any
    """Required precision, see `lmd.objectives.localisation.information`."""

    @cached_property
    def moments(self) -> RigImages:
        """All N moments, with the landmarks in the image of each camera."""
        return images_of(self.evaluator, self.deployment)

    @property
    def share(self) -> FloatArray:
        """Share of each moment, `(N,)`, sum 1."""
        weight = self.moments.weight
        return np.asarray(weight / weight.sum())

    def decided(self, moments: RigImages, seen: BoolArray) -> BoolArray:
        """Masks `(2, M)` of the moments with landmarks `seen` that are localised, and of the moments that cover n
        landmarks.
        """
        found = located(self.evaluator, self.deployment, moments._replace(seen=seen), self.n, self.precision)
        return np.stack([found, covers(seen, self.n)])

    def without_cameras(self) -> FloatArray:
        """Means of L and P_n without each camera, `(C, 2)`."""
        seen, shares = self.moments.seen, []
        for c in range(len(seen)):
            left = seen.copy()
            left[c] = False
            shares.append(self.decided(self.moments, left) @ self.share)
        return np.array(shares)

    def missed(self, probabilities: Sequence[float], rng: np.random.Generator) -> FloatArray:
        """Means of L and P_n if an image misses each landmark that it shows with one of M probabilities, `(M, 2)`.

        All probabilities share the draw, so that a landmark missed at one probability is missed at all greater
        probabilities.
        """
        seen = self.moments.seen
        draw = rng.random(seen.shape, dtype=np.float32)
        return np.array([self.decided(self.moments, seen & (draw >= p)) @ self.share for p in probabilities])

    def lost(self) -> FloatArray:
        """Means of L and P_n without landmarks i and j, which still hide others, `(2, K, K)`; without landmark i on the
        diagonal.
        """
        seen, share = self.moments.seen, self.share
        shown = np.asarray(seen.any(axis=0))  # (N, K)
        whole, count = self.decided(self.moments, seen).astype(np.float64), seen.shape[2]

        def lose(*landmarks: int) -> FloatArray:
            """Change by the loss of landmarks in the moments that show all these landmarks; 0 in other moments, `(2,
            N)`.
            """
            which: BoolArray = np.asarray(shown[:, landmarks].all(axis=1))
            left = seen[:, which]
            left[:, :, landmarks] = False
            change = np.zeros_like(whole)
            decided = self.decided(self.moments.some(which), left).astype(np.float64)
            change[:, which] = share[which] * (decided - whole[:, which])
            return change

        alone = np.stack([lose(k) for k in range(count)], axis=1)  # (2, K, N)
        only = alone @ (~shown)  # change by k in the moments that do not show the other landmark, (2, K, K)
        change = only + np.swapaxes(only, 1, 2)
        for i, j in combinations(range(count), 2):
            change[:, i, j] = change[:, j, i] = change[:, i, j] + lose(i, j).sum(axis=1)
        one = list(range(count))
        change[:, one, one] = alone.sum(axis=2)
        return np.asarray((whole @ share)[:, None, None] + change)
