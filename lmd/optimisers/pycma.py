"""Adapter that makes the CMA-ES of pycma an `AskTell` optimiser."""

from typing import Any

import numpy as np

from lmd.core.checks import FloatArray, choice, real
from lmd.core.optional import optional
from lmd.optimisers.wrapped import LibraryOptimiser, Wrapped


class PyCma(Wrapped):
    """Covariance matrix adaptation evolution strategy (CMA-ES) on the unit box.

    The mean of the distribution begins at the problem's start. Whenever CMA-ES ends by its own criterion before the
    budget is used up, it is restarted from the best genes.

    Args:
        variant: form of the covariance matrix that is learnt. `full` is the whole matrix, which takes about 100
            evaluations per gene to learn. `separable` is one variance per gene; `vkd` is one variance per gene and a
            few directions.
        step: initial standard deviation sigma_0 of each gene in [0, 1].
        encoding: see `AskTell`.
        seed: see `Optimiser`.

    Raises:
        InputError: a parameter is out of range.
    """

    def __init__(self, variant: str = "full", step: float = 0.1, encoding: str | None = None, seed: int = 0) -> None:
        optional("cma", "optimisers")
        import cma.restricted_gaussian_sampler  # noqa: F401 # it draws random numbers, so it is imported before these are seeded

        super().__init__(seed, encoding)
        self.variant = choice("variant", variant, ("full", "separable", "vkd"))
        self.step = real("step", step, above=0.0)

    def _open(self, start: FloatArray, rng: np.random.Generator) -> LibraryOptimiser:
        return _Strategy(self, start[0], rng)


class _Strategy:
    """Running CMA-ES, with the settings of `PyCma`."""

    def __init__(self, settings: PyCma, mean: FloatArray, rng: np.random.Generator) -> None:
        import cma
        from cma.restricted_gaussian_sampler import GaussVkDSampler

        options: dict[str, Any] = {"bounds": [0, 1], "seed": int(rng.integers(1, 2**31)), "verbose": -9, "verb_log": 0}
        if settings.variant == "separable":
            options["CMA_diagonal"] = True
        if settings.variant == "vkd":
            options = GaussVkDSampler.extend_cma_options(options)
        self.strategy = cma.CMAEvolutionStrategy(mean, settings.step, options)

    def ask(self) -> FloatArray | None:
        return None if self.strategy.stop() else np.array(self.strategy.ask())

    def tell(self, genes: FloatArray, losses: FloatArray) -> None:
        self.strategy.tell(list(genes), list(losses))
