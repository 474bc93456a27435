"""How often at least n landmarks are in view, on average over the positions."""

from dataclasses import dataclass

import numpy as np
from typing_extensions import override

from lmd.core.checks import FloatArray
from lmd.objectives.base import Headline
from lmd.objectives.coverage import Coverage
from lmd.objectives.localisation.objective import Mean


@dataclass(frozen=True)
class MeanCoverage(Coverage):
    """The relevance-weighted mean of P_n: every view counts, not only those beyond a threshold.

    Arguments are those of `Coverage`; `thold_p` only says which positions the qualified ratio counts.
    """

    headline = Headline("average_coverage_probability", "average coverage probability")
    counted = "views"

    @property
    @override
    def name(self) -> str:
        return f"mean n={self.n}"

    @override
    def fitness(self, values: FloatArray, relevance: FloatArray) -> FloatArray:
        return np.asarray((values * relevance).sum(axis=-1) / relevance.sum())

    @override
    def target(self, relevance: FloatArray) -> Mean:  # type: ignore[override] # another target, as protocols allow
        return Mean(relevance)
