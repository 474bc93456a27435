"""What is left of a rig's figures where a camera fails, or its images miss landmarks that it covers.

All is measured in the same moments: what the cameras see of them is known once, and left out in parts.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import combinations
from typing import Any

import numpy as np

from lmd.core.checks import BoolArray, FloatArray
from lmd.objectives.localisation.rig import Images, covers, images_of, located
from lmd.scene.deployment import Deployment
from lmd.sight.evaluator import Evaluator


@dataclass(frozen=True)
class RigMoments:
    """The moments of an evaluator over a deployment, and what makes one of them localised.

    Args:
        evaluator: of a rig.
        deployment: K landmarks.
        n: landmarks that must be covered.
        precision: what is asked besides, see `lmd.objectives.localisation.information`.
    """

    evaluator: Evaluator
    deployment: Deployment
    n: int
    precision: Any

    @cached_property
    def moments(self) -> Images:
        """All of them, with what each camera sees."""
        return images_of(self.evaluator, self.deployment)

    @property
    def share(self) -> FloatArray:
        """The share of each moment, `(N,)`; the sum is 1."""
        weight = self.moments.weight
        return np.asarray(weight / weight.sum())

    def decided(self, moments: Images, seen: BoolArray) -> BoolArray:
        """Whether moments are localised, and whether they cover n landmarks, with this `seen`, `(2, M)`."""
        found = located(self.evaluator, self.deployment, moments._replace(seen=seen), self.n, self.precision)
        return np.stack([found, covers(seen, self.n)])

    def without_cameras(self) -> FloatArray:
        """The means of L and P_n without each camera, `(C, 2)`."""
        seen, shares = self.moments.seen, []
        for c in range(len(seen)):
            left = seen.copy()
            left[c] = False
            shares.append(self.decided(self.moments, left) @ self.share)
        return np.array(shares)

    def missed(self, probabilities: Sequence[float], rng: np.random.Generator) -> FloatArray:
        """The means of L and P_n if each image misses a landmark that it shows with such a probability, `(M, 2)`.

        The draw is the same for all probabilities, so that what is missed with one is missed with all greater.
        """
        seen = self.moments.seen
        draw = rng.random(seen.shape, dtype=np.float32)
        return np.array([self.decided(self.moments, seen & (draw >= p)) @ self.share for p in probabilities])

    def lost(self) -> FloatArray:
        """The means of L and P_n without landmarks i and j, `(2, K, K)`. They still hide others; i = j is one alone."""
        seen, share = self.moments.seen, self.share
        shown = np.asarray(seen.any(axis=0))  # (N, K)
        whole, count = self.decided(self.moments, seen).astype(np.float64), seen.shape[2]

        def lose(*landmarks: int) -> FloatArray:
            """What the loss of landmarks changes in the moments that show all of them; 0 in others, `(2, N)`."""
            which: BoolArray = np.asarray(shown[:, landmarks].all(axis=1))
            left = seen[:, which]
            left[:, :, landmarks] = False
            change = np.zeros_like(whole)
            decided = self.decided(self.moments.some(which), left).astype(np.float64)
            change[:, which] = share[which] * (decided - whole[:, which])
            return change

        alone = np.stack([lose(k) for k in range(count)], axis=1)  # (2, K, N)
        only = alone @ (~shown)  # of k where the other one is not shown, (2, K, K)
        change = only + np.swapaxes(only, 1, 2)
        for i, j in combinations(range(count), 2):
            change[:, i, j] = change[:, j, i] = change[:, i, j] + lose(i, j).sum(axis=1)
        one = list(range(count))
        change[:, one, one] = alone.sum(axis=2)
        return np.asarray((whole @ share)[:, None, None] + change)
