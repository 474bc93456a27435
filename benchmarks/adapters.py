"""Cost of the adapters of the suite: time of a call from a library's side over that of the evaluation itself, of as
many candidates at a time.

    python benchmarks/adapters.py [problem]

Each pair of times is measured alternately, so that both meet the same load of the machine; medians of the ratios.
"""

import sys
import time
from collections.abc import Callable
from statistics import median
from typing import Any

import numpy as np

import lmd.suite

ROUNDS, BATCH = 60, 20


def seconds(call: Callable[[], Any]) -> float:
    """Processor time of a call."""
    began = time.process_time()
    call()
    return time.process_time() - began


def main() -> None:
    """Print a ratio for each adapter."""
    name = sys.argv[1] if len(sys.argv) > 1 else "lab_localisation"
    box = lmd.suite.problem(name)
    genes = np.random.default_rng(0).random((BATCH, box.dim))
    fitness = box.genome.fitness_of_genes
    pymoo, nevergrad = lmd.suite.pymoo_problem(box), lmd.suite.nevergrad_function(box)
    wrapped, scipy = lmd.suite.ioh_problem(box), lmd.suite.scipy_function(box)
    each = {
        "lmd.suite, a batch": lambda: box(genes),
        "lmd.suite, one by one": lambda: [box(row) for row in genes],
        "pymoo": lambda: pymoo.evaluate(genes),
        "nevergrad": lambda: [nevergrad(row) for row in genes],
        "ioh": lambda: [wrapped(row) for row in genes],
        "scipy, vectorized": lambda: scipy(genes.T),
    }
    batched = {"lmd.suite, a batch", "pymoo", "scipy, vectorized"}

    def alone() -> None:
        for row in genes:
            fitness(row[None])

    for call in (*each.values(), alone):
        call()
    print(f"{name}: {1e3 * seconds(lambda: fitness(genes)) / BATCH:.3f} ms for an evaluation")
    for label, call in each.items():
        plain = (lambda: fitness(genes)) if label in batched else alone
        ratios = [seconds(call) / seconds(plain) for _ in range(ROUNDS)]
        print(f"{label:24} {median(ratios):.3f}")


if __name__ == "__main__":
    main()
