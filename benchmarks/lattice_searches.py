"""Compare the searches over `milp`'s program: `python benchmarks/lattice_searches.py [PROBLEM ...] [--seeds N]`.

Prints a table in Markdown: of small problems of `benchmarks/milp.py` what each search finds with as many evaluations,
and its processor seconds.
"""

import argparse
import time
from collections.abc import Callable

import numpy as np
from milp import CASES, Case

from lmd.optimisers.adaptive_lattice import AdaptiveLattice
from lmd.optimisers.annealing import Annealing
from lmd.optimisers.base import Optimiser
from lmd.optimisers.gradient_ascent import GradientAscent
from lmd.optimisers.ledger import Budget
from lmd.optimisers.neighbourhoods import LargeNeighbourhoods

EVALUATIONS = 150  # of each run
MARGIN = 0.03  # of a program's threshold, where it has one
SEARCHES: dict[str, Callable[[int], Optimiser]] = {
    "milp_adaptive": lambda seed: AdaptiveLattice(seed=seed),
    f"milp_adaptive, margin {MARGIN:g}": lambda seed: AdaptiveLattice(margin=MARGIN, seed=seed),
    "milp_neighbourhoods": lambda seed: LargeNeighbourhoods(patience=10, seed=seed),
    f"milp_neighbourhoods, margin {MARGIN:g}": lambda seed: LargeNeighbourhoods(patience=10, margin=MARGIN, seed=seed),
    "gradient_ascent": lambda seed: GradientAscent(seed=seed),
    "annealing": lambda seed: Annealing(seed=seed),
}


def row(case: Case, name: str, seeds: int) -> str:
    """What a search finds: median and range over the seeds."""
    began = time.process_time()
    found = [SEARCHES[name](seed).run(case.problem(), Budget(EVALUATIONS)) for seed in range(seeds)]
    fitness, spent = [each.fitness for each in found], [each.evaluations for each in found]
    seconds = (time.process_time() - began) / seeds
    told = f"{np.median(fitness):.1%} ({min(fitness):.1%} to {max(fitness):.1%})"
    return f"| {case.name} | `{name}` | {told} | {np.median(spent):.0f} | {seconds:.0f} |"


def main() -> None:
    """Run and print."""
    parser = argparse.ArgumentParser(description="Compare searches over an integer program; prints Markdown.")
    names = [case.name for case in CASES]
    parser.add_argument("problems", nargs="*", metavar="PROBLEM", help=f"some of {', '.join(names)}; all by default")
    parser.add_argument("--seeds", type=int, default=3, help="runs of each search")
    options = parser.parse_args()
    if unknown := set(options.problems) - set(names):
        parser.error(f"there is no problem {min(unknown)}, only {', '.join(names)}")
    print("| problem | search | fitness: median (range) | evaluations | processor seconds of a run |")
    print("|" + 5 * " --- |")
    for case in CASES:
        if not options.problems or case.name in options.problems:
            for name in SEARCHES:
                print(row(case, name, options.seeds), flush=True)


if __name__ == "__main__":
    main()
