"""What several processors are worth to one run: `python benchmarks/walkers.py`.

Optimises the paper's room for localisation by `annealing`, whose four walkers share the processors, on one thread and
on two. Prints a Markdown table of wall times and their ratio, from one run; both end at the same deployment, which is
checked.
"""

import time

import numpy as np
from hydra import compose, initialize_config_dir

from lmd.deployment import Deployment
from lmd.optimisers.base import Budget
from lmd.pipelines.app import CONF, build_optimiser, build_problem

EVALUATIONS = 400


def run(threads: int, evaluations: int) -> tuple[float, Deployment]:
    """Seconds of a run, and what it found."""
    with initialize_config_dir(CONF, version_base="1.3"):
        cfg = compose("optimise", ["objective=localisation", "tag.edge=0.10", f"threads={threads}"])
        problem, optimiser = build_problem(cfg), build_optimiser(cfg, 0)
    began = time.perf_counter()
    found = optimiser.run(problem, Budget(evaluations)).deployment
    return time.perf_counter() - began, found


def main() -> None:
    """Print the table."""
    run(1, 40)  # compiles
    (alone, first), (shared, second) = (run(threads, EVALUATIONS) for threads in (1, 2))
    np.testing.assert_array_equal(first.positions, second.positions)
    print("| evaluations | one thread, s | two threads, s | ratio |\n| --- | --- | --- | --- |")
    print(f"| {EVALUATIONS} | {alone:.1f} | {shared:.1f} | {shared / alone:.2f} |")


if __name__ == "__main__":
    main()
