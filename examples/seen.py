"""How often at least n landmarks are in view, on average over the positions."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import NamedTuple

from lmd.core.checks import FloatArray
from lmd.incremental.coverage_field import CoverageField, coverage_field
from lmd.incremental.field import contribution, smoothed
from lmd.objectives.base import AtLeast, Headline
from lmd.sight.evaluator import Evaluator
from lmd.sight.kernels import PROBABILITY_ONE


@dataclass(frozen=True)
class MeanSeen(AtLeast):
    """The mean of P_n; `n`, `thold_p`, which positions are good enough and what is refused come from `AtLeast`."""

    sampling = None
    headline = Headline("seen", "seen")
    value_label = "probability of seeing enough landmarks"

    @property
    def name(self) -> str:
        """For titles."""
        return f"n={self.n}"

    def values(self, evaluator: Evaluator, positions: FloatArray, normals: FloatArray) -> FloatArray:
        """P_n at each position, `(B, P)`."""
        values: FloatArray = evaluator.units(positions, normals, self.n) / PROBABILITY_ONE
        return values

    def fitness(self, values: FloatArray, relevance: FloatArray) -> FloatArray:
        """What optimisers maximise."""
        fitness: FloatArray = (values * relevance).sum(axis=-1) / relevance.sum()
        return fitness

    def shares(self, values: FloatArray) -> Mapping[str, FloatArray]:
        """Figures that are means over positions."""
        return {"seen": values}

    def figures(self, values: FloatArray, relevance: FloatArray) -> dict[str, float]:
        """All figures."""
        return {"seen": float(values.mean())}

    def describe(self, figures: Mapping[str, float], positions: int, count: int) -> dict[str, str]:
        """The figures for the terminal."""
        return {"seen": f"{figures['seen']:.2%} of views have at least {self.n} of {count} landmarks"}

    def describe_validation(self, figures: Mapping[str, float]) -> dict[str, str]:
        """The figures off the grid."""
        return {"off the grid": f"{figures['grid_free_seen']:.2%} of views"}

    def field(self, evaluator: Evaluator) -> CoverageField:
        """For `annealing`: the values, updated as one landmark moves."""
        return coverage_field(evaluator, self.n)

    def target(self, relevance: FloatArray) -> "Mean":
        """For `annealing`: the fitness of the values."""
        return Mean(relevance)


class Mean(NamedTuple):
    """The mean with weights."""

    relevance: FloatArray


@smoothed.register(Mean)
def _smoothed(target, p, units, margin, width, share):  # type: ignore[no-untyped-def]
    return (1.0 + share) * target.relevance[p] * units / PROBABILITY_ONE


@contribution.register(Mean)
def _contribution(target, p, units):  # type: ignore[no-untyped-def]
    return target.relevance[p] * units / PROBABILITY_ONE
