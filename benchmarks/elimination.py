"""Worth of each part of the paper's genetic algorithm, from a tournament of its variants.

    python -m pipelines.compare suite=small suite_budgets=[3] seeds=5 hydra.run.dir=outputs/elimination \
        "optimisers=[$(python benchmarks/elimination.py variants)]"
    python benchmarks/elimination.py outputs/elimination

A difference is the mean over problems of the median fitness of a variant less that of `ega`, in per cent of the best
value known of the problem; its 95 % interval is bootstrapped over the seeds of each problem.
"""

import sys
from collections import defaultdict
from pathlib import Path

import numpy as np
import pandas as pd

import lmd.suite
from lmd.core.words import as_code, markdown_table

BASE = "ega"
VARIANTS = {
    "sga": "the baseline: no elimination, no survivor",
    "sga optimiser.survivors=1": "the baseline with a survivor",
    "ega optimiser.eliminated=0": "no elimination",
    "ega optimiser.eliminated=2": "2 of 30 eliminated, in place of 7",
    "ega optimiser.eliminated=15": "15 of 30 eliminated",
    "ega optimiser.acceptance=if_better": "a child replaces its parent only if it is no worse",
    "ega optimiser.recombination_min=0 optimiser.recombination_max=0": "no recombination",
    "ega optimiser.recombination_min=0 optimiser.recombination_max=0.1": "runs of up to a tenth of the genes",
    "ega optimiser.recombination_min=0 optimiser.recombination_max=1": "runs of any length",
    "ega optimiser.partner=survivor": "runs of the survivor's genes alone",
    "ega optimiser.mutation_probability=0.01": "a tenth of the mutations",
    "ega optimiser.population=10 optimiser.eliminated=2": "10 chromosomes",
    "ega encoding.kind=wall": "two genes for a landmark in place of five",
    "ega_tuned": "the tuned variant",
}
DRAWS = 2000


def read(folder: Path) -> dict[str, dict[str, list[float]]]:
    """Fitness of each seed, by variant and problem."""
    found: dict[str, dict[str, list[float]]] = defaultdict(lambda: defaultdict(list))
    for path in sorted(folder.glob("runs/*/*/history.csv")):
        name = path.parent.name.split(" seed=")[0].split(" ", 2)[2]
        found[name][path.parts[-3]].append(pd.read_csv(path).best_fitness.iloc[-1])
    return found


def main() -> None:
    """Print the variants, or the table of a tournament."""
    if sys.argv[1] == "variants":
        print(",".join(f"'{name}'" for name in (BASE, *VARIANTS)))
        return
    runs, rng = read(Path(sys.argv[1])), np.random.default_rng(0)
    problems = sorted(runs[BASE])
    best = {name: lmd.suite.document(name).best["value"] for name in problems}

    def drawn(name: str, problem: str) -> np.ndarray:
        values = np.array(runs[name][problem])
        return np.median(values[rng.integers(0, len(values), (DRAWS, len(values)))], axis=1) / best[problem]

    base = {problem: drawn(BASE, problem) for problem in problems}
    rows = []
    for name, what in VARIANTS.items():
        medians = [(np.median(runs[name][p]) - np.median(runs[BASE][p])) / best[p] for p in problems]
        low, high = np.quantile(np.mean([drawn(name, p) - base[p] for p in problems], axis=0), (0.025, 0.975))
        wins = sum(each > 0 for each in medians)
        cells = [
            f"{100 * np.mean(medians):+.1f}",
            f"{100 * low:+.1f} to {100 * high:+.1f}",
            f"{wins} of {len(problems)}",
        ]
        rows.append([as_code(name), what, *cells])
    print(f"problems: {', '.join(problems)}; {len(runs[BASE][problems[0]])} seeds\n")
    print(markdown_table(["variant", "what differs from `ega`", "difference, %", "95 % interval", "better on"], rows))


if __name__ == "__main__":
    main()
