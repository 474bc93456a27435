"""Optimisers of libraries, and of classes like theirs, for tests of their wrappers."""

from functools import partial
from importlib import import_module

import numpy as np

from lmd.optimisers.pymoo import Pymoo


def run(optimiser, batches, dim=12, fitness=lambda genes: -np.abs(genes - 0.3).sum(axis=1)):
    """Start or go on with an optimiser; returns the batches it asked for."""
    if not optimiser.ledger.evaluations:
        optimiser.dim, optimiser.rng, optimiser.start = dim, np.random.default_rng(0), np.full((1, dim), 0.6)
    asked = []
    for _ in range(batches):
        asked.append(optimiser.ask())
        optimiser.tell(asked[-1], fitness(asked[-1]))
    return asked


def pymoo(name, **parameters):
    modules = {"PatternSearch": "pattern", "MixedVariableGA": "core.mixed"}
    module = modules.get(name, name.lower())
    within = "pymoo." if "." in module else "pymoo.algorithms.soo.nonconvex."
    return Pymoo(partial(getattr(import_module(within + module), name), **parameters))


class OneByOne:
    """Proposes one set of genes at a time, is told pairs, and ends after five rounds, as the package cmaes does it."""

    def __init__(self, mean, step, seed, bounds):
        assert bounds.shape == (len(mean), 2)
        self.best, self.step, self.rng, self.rounds = (np.inf, mean), step, np.random.default_rng(seed), 0

    def ask(self):
        return self.best[1] + self.rng.normal(0.0, self.step, len(self.best[1]))

    def tell(self, pairs):
        self.rounds += 1
        assert len(pairs) == 4
        self.best = min([self.best, *((loss, genes) for genes, loss in pairs)], key=lambda pair: pair[0])

    def should_stop(self):
        return self.rounds >= 5
