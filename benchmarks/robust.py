"""Measure the value that the robust objective reaches: `python benchmarks/robust.py EVALUATIONS [OVERRIDE ...]`.

Optimises the paper's room with `objective=robust` on two threads for three seeds, and prints a Markdown table: seconds
of the search by the wall clock and of the processor, and the qualified ratio off the grid in per cent. That is measured
as by the validation of a run, but with four times the sample, and the same one for all seeds.
"""

import sys
from time import process_time

from hydra import compose, initialize_config_dir

from lmd.core.compiled import clock
from lmd.evaluation.validation import Sample, validation_metrics
from lmd.optimisers.ledger import Budget
from lmd.pipelines.app import CONF
from lmd.pipelines.building import build_optimiser, build_problem

SEEDS = range(3)
SAMPLE = Sample(groups=64)
SAMPLE_SEED = 1_000_000  # used by no run: the validation of a run would share a quarter of the sample


def main() -> None:
    """Print the table."""
    evaluations, overrides = int(sys.argv[1]), sys.argv[2:]
    with initialize_config_dir(CONF, version_base="1.3"):
        cfg = compose("optimise", ["objective=robust", "threads=2", *overrides])
    problem = build_problem(cfg)
    build_optimiser(cfg, 0).run(problem, Budget(60))  # compiles
    print("| seed | wall time, s | processor, s | off the grid | standard error |")
    print(f"{'| --- ' * 5}|")
    for seed in SEEDS:
        began, used = clock(), process_time()
        found = build_optimiser(cfg, seed).run(problem, Budget(evaluations)).deployment
        seconds, processor = clock() - began, process_time() - used
        metrics = validation_metrics(problem, found, SAMPLE_SEED, SAMPLE)
        ratio = metrics["grid_free_qualified_ratio"], metrics["grid_free_qualified_ratio_standard_error"]
        row = f"{seconds:.0f}", f"{processor:.0f}", *(f"{100.0 * value:.2f}" for value in ratio)
        print(f"| {seed} | {' | '.join(row)} |", flush=True)


if __name__ == "__main__":
    main()
