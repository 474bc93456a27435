"""Measure the cost of a checkpoint: `python benchmarks/checkpoints.py`.

Full runs with the paper's 90 landmarks in a coarse room, whose evaluations take little, so that the optimisers' own
time shows. Prints a Markdown table: what a run takes, what saving its checkpoint at the end takes, the least of a few
times, how large that is, and what it takes to go on from it.
"""

import tempfile
import time
from pathlib import Path

from hydra import compose, initialize_config_dir
from omegaconf import DictConfig

from lmd.optimisers.checkpoint import CHECKPOINT_FILE, Checkpoint
from lmd.optimisers.ledger import Budget
from lmd.pipelines.app import CONF
from lmd.pipelines.building import build_optimiser, build_problem

NAMES = ("annealing", "ega", "sga", "cma_es", "pymoo_ga", "pymoo_one_gene", "one_plus_one")
COARSE = ("room.spacing=1.5", "pdf.divisions=6", "threads=1")
SAVES = 5


def configured(name: str) -> DictConfig:
    """The configuration of a run."""
    with initialize_config_dir(CONF, version_base="1.3"):
        return compose("optimise", [f"optimiser={name}", *COARSE])


def main() -> None:
    """Print the table."""
    print("| `optimiser=` | run, s | save, ms | size, kB | go on, s |\n| --- | --- | --- | --- | --- |")
    problem = build_problem(configured(NAMES[0]))
    for name in NAMES:
        cfg, saves = configured(name), []
        optimiser = build_optimiser(cfg, 0)
        began = time.perf_counter()
        optimiser.run(problem, Budget(cfg.budget.evaluations))
        run = time.perf_counter() - began
        with tempfile.TemporaryDirectory() as folder:
            for _ in range(SAVES):
                began = time.perf_counter()
                Checkpoint(optimiser, {}).save(Path(folder))
                saves.append(time.perf_counter() - began)
            size = (Path(folder) / CHECKPOINT_FILE).stat().st_size
            again = Checkpoint(build_optimiser(cfg, 0), {})
            began = time.perf_counter()
            again.resume(folder, problem)
            goes_on = time.perf_counter() - began
        print(f"| `{name}` | {run:.1f} | {1e3 * min(saves):.1f} | {size / 1e3:.0f} | {goes_on:.2f} |", flush=True)


if __name__ == "__main__":
    main()
