"""Measure the speed-up of one run by a second processor: `python benchmarks/walkers.py [repetitions]`.

Optimises the paper's room by `annealing`, whose walkers share the processors, on one thread and on two: for the paper's
objective, the robust one, and localisation, beside one walker alone. Prints a Markdown table of wall times, the least
of so many repetitions that alternate. On any number of threads a run ends at the same deployment, which is checked.
"""

import sys
import time

import numpy as np
from hydra import compose, initialize_config_dir

from lmd.optimisers.ledger import Budget
from lmd.pipelines.app import CONF
from lmd.pipelines.building import build_optimiser, build_problem
from lmd.scene.deployment import Deployment

RUNS = {
    "paper": (12000, []),
    "robust": (600, ["objective=robust"]),
    "localisation": (400, ["objective=localisation", "tag.edge=0.10"]),
}


def run(overrides: list[str], evaluations: int, threads: int, *more: str) -> tuple[float, Deployment]:
    """Seconds of a run, and what it found."""
    with initialize_config_dir(CONF, version_base="1.3"):
        cfg = compose("optimise", [*overrides, *more, f"threads={threads}"])
        problem, optimiser = build_problem(cfg), build_optimiser(cfg, 0)
    began = time.perf_counter()
    found = optimiser.run(problem, Budget(evaluations)).deployment
    return time.perf_counter() - began, found


def main() -> None:
    """Print the table."""
    repetitions = int(sys.argv[1]) if len(sys.argv) > 1 else 1
    print(
        "| objective | evaluations | one walker, s | two, one thread, s | two, two threads, s | ratio to one walker |"
    )
    print(f"{'| --- ' * 6}|")
    for name, (evaluations, overrides) in RUNS.items():
        for more in ([], ["optimiser.walkers=1"]):
            run(overrides, 60, 1, *more)  # compiles
        times = []
        for _ in range(repetitions):
            single, _found = run(overrides, evaluations, 1, "optimiser.walkers=1")
            alone, first = run(overrides, evaluations, 1)
            shared, second = run(overrides, evaluations, 2)
            np.testing.assert_array_equal(first.positions, second.positions)
            times.append((single, alone, shared))
        single, alone, shared = np.min(times, axis=0)
        row = name, str(evaluations), f"{single:.1f}", f"{alone:.1f}", f"{shared:.1f}", f"{shared / single:.2f}"
        print(f"| {' | '.join(row)} |", flush=True)


if __name__ == "__main__":
    main()
