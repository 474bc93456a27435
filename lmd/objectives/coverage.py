"""Objective of the paper: the probability of at least n landmarks in view must reach a threshold."""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from typing_extensions import override

from lmd.core.checks import BoolArray, FloatArray
from lmd.incremental.coverage_field import CoverageField, coverage_field
from lmd.incremental.field import contribution, smoothed
from lmd.objectives.base import AtLeast, figure_of, with_error
from lmd.objectives.sampling import Sampling
from lmd.scene.criteria import TOLERANCE
from lmd.scene.deployment import Deployment
from lmd.sight.evaluator import Evaluator
from lmd.sight.kernels import PROBABILITY_ONE
from lmd.sight.poses import covered_amounts, gains

PRICE_BYTES = 24  # memory of a view while poses are selected, bytes: price, count of landmarks, and product of the two


class Threshold(NamedTuple):
    """Fitness that is the total weight of the positions whose value reaches a threshold; a `Target`."""

    threshold: int
    """Least quantised value of a qualified position."""
    relevance: FloatArray
    """`(Q,)` weights of the positions."""


@smoothed.register(Threshold)
def _smoothed(target, p, units, margin, width, share):  # type: ignore[no-untyped-def]
    above = (units - target.threshold) / PROBABILITY_ONE - margin
    return target.relevance[p] * (1.0 / (1.0 + math.exp(-above / width)) + share * units / PROBABILITY_ONE)


@contribution.register(Threshold)
def _contribution(target, p, units):  # type: ignore[no-untyped-def]
    return target.relevance[p] * (units >= target.threshold)


class Mean(NamedTuple):
    """Fitness that is the weighted mean of the positions' values; a `Target`."""

    relevance: FloatArray
    """`(Q,)` weights of the positions."""


@smoothed.register(Mean)
def _smoothed_mean(target, p, units, margin, width, share):  # type: ignore[no-untyped-def]
    return target.relevance[p] * (units / PROBABILITY_ONE)


@contribution.register(Mean)
def _worth_of_mean(target, p, units):  # type: ignore[no-untyped-def]
    return target.relevance[p] * (units / PROBABILITY_ONE)


@dataclass(frozen=True)
class Coverage(AtLeast):
    """Multiple coverage probability: the weighted fraction of the positions at which P_n reaches thold_p. P_n(p), the
    value of position p, is the probability that the camera covers at least n landmarks at p.

    This is Eq. argmaxH of the paper, normalised; the weights are the relevance of the positions.

    Args:
        n: least number of landmarks that the camera must see at the same time.
        thold_p: least P_n of a qualified position.
        sampling: random positions and orientations on which the fitness is computed; None for the room's grid and the
            orientations of the scene's PDF.

    Raises:
        InputError: n < 1 or thold_p outside [0, 1].
    """

    sampling: Sampling | None = None

    headline = figure_of("qualified_ratio")

    @property
    def name(self) -> str:
        """See `Objective.name`."""
        return f"n={self.n} p={self.thold_p:g}"

    @property
    def value_label(self) -> str:
        """See `Objective.value_label`."""
        return f"probability of seeing at least {self.n} landmark{'s' if self.n > 1 else ''}"

    def values(self, evaluator: Evaluator, positions: FloatArray, normals: FloatArray) -> FloatArray:
        """See `Objective.values`."""
        return np.asarray(evaluator.units(positions, normals, self.n) / PROBABILITY_ONE)

    def fitness(self, values: FloatArray, relevance: FloatArray) -> FloatArray:
        """See `Objective.fitness`."""
        # No matrix product: a sum over the last axis has an order that does not depend on the batch.
        return np.asarray((self.qualified(values) * relevance).sum(axis=-1) / relevance.sum())

    def shares(self, values: FloatArray) -> Mapping[str, FloatArray | BoolArray]:
        """See `Objective.shares`."""
        return {"qualified_ratio": self.qualified(values), "average_coverage_probability": values}

    def figures(self, values: FloatArray, relevance: FloatArray) -> dict[str, float]:
        """Metrics of the paper: three indices of coverage in [0, 1], and the cost H.

        The indices are the fraction of qualified positions, the mean of P_n and the maximum of P_n. H is the total
        relevance of the qualified positions (Eq. H2).
        """
        return {
            **{key: float(share.mean()) for key, share in self.shares(values).items()},
            "maximum_coverage_probability": float(values.max()),
            "cost": float((self.qualified(values) * relevance).sum()),
        }

    def describe(self, figures: Mapping[str, float], positions: int, count: int) -> dict[str, str]:
        """See `Objective.describe`."""
        return {
            "qualified ratio": f"{figures['qualified_ratio']:.2%} of {positions} positions see at least {self.n} of "
            f"{count} landmarks with probability {self.thold_p:g}",
            "average probability": f"{figures['average_coverage_probability']:.2%}",
            "maximum probability": f"{figures['maximum_coverage_probability']:.2%}",
        }

    def describe_validation(self, figures: Mapping[str, float]) -> dict[str, str]:
        """See `Objective.describe_validation`."""
        return {
            "off the grid": f"{with_error(figures, 'grid_free_qualified_ratio')} of random positions qualified, "
            f"average probability {with_error(figures, 'grid_free_average_coverage_probability')}",
            "on a finer grid": f"{self.headline.label} {figures[f'finer_grid_{self.headline.key}']:.2%}",
        }

    def field(self, evaluator: Evaluator) -> CoverageField:
        """See `Objective.field`."""
        return coverage_field(evaluator, self.n)

    def target(self, relevance: FloatArray) -> Threshold | Mean:
        """See `Objective.target`."""
        return Threshold(math.ceil((self.thold_p - TOLERANCE) * PROBABILITY_ONE), relevance)

    def selection(self, evaluator: Evaluator, relevance: FloatArray) -> "CappedCount":
        """See `Objective.selection`."""
        return CappedCount(evaluator, relevance, self.n)


@dataclass(frozen=True)
class MeanCoverage(Coverage):
    """Mean of P_n (see `Coverage`) over all positions, weighted by relevance.

    Arguments as in `Coverage`; `thold_p` affects only the metric "qualified ratio".
    """

    headline = figure_of("average_coverage_probability")

    @property
    @override
    def name(self) -> str:
        return f"mean n={self.n}"

    @override
    def fitness(self, values: FloatArray, relevance: FloatArray) -> FloatArray:
        return np.asarray((values * relevance).sum(axis=-1) / relevance.sum())

    @override
    def target(self, relevance: FloatArray) -> Mean:
        return Mean(relevance)


class CappedCount:
    """Weighted sum of min(number of covered landmarks, n) over positions and axes (orientations); a `Selection`.

    For n >= 2 the indicator of n covered landmarks is not submodular, because the first landmark gains nothing. The sum
    above is submodular if no landmark hides another.

    Args:
        evaluator: scene and positions.
        relevance: weights of the positions, `(P,)`.
        n: number of landmarks that should be covered at the same time.
    """

    label = "expected number of landmarks in view, as far as it is asked for"

    def __init__(self, evaluator: Evaluator, relevance: FloatArray, n: int) -> None:
        evaluator.check_memory(PRICE_BYTES)
        self._evaluator, self._n = evaluator, n
        self._prices = relevance[:, None] * evaluator.probability
        self._covered = np.zeros(self._prices.shape)

    def gains(self, poses: Deployment) -> FloatArray:
        """See `Selection.gains`."""
        return gains(self._evaluator, poses, self._prices * (self._covered < self._n))

    def add(self, pose: Deployment) -> None:
        """See `Selection.add`."""
        self._covered += covered_amounts(self._evaluator, pose, np.ones(1))
