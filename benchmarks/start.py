"""Measure the cost of a start and of small jobs, against another checkout: `python benchmarks/start.py ../before`.

Both checkouts are timed in turn by the same Python. Prints a Markdown table of processor seconds, those of all
processes of a command together: first of a run with an empty cache, then of commands whose kernels are compiled and
whose tracking store is there, the least of some rounds.
"""

import argparse
import os
import resource
import subprocess
import sys
import tempfile
from pathlib import Path

HERE = Path(__file__).resolve().parents[1]
QUICK = ("validate=false", "localisation=false")
SWEEP = ("optimise", "-m", "seed=0,1,2,3,4,5,6,7,8,9", "budget.evaluations=30", "validate=false")
STORE = "tracking.uri=sqlite:///../mlflow.db"  # the first round makes it
COMMANDS = {
    "one evaluation, untracked": ("evaluate", *QUICK, "tracking=none"),
    "one evaluation, untracked, without losses": ("evaluate", *QUICK, "tracking=none", "++losses=false"),
    "one evaluation, tracked": ("evaluate", *QUICK, STORE),
    "a sweep of ten jobs of 30 evaluations, untracked": (*SWEEP, "tracking=none"),
    "a sweep of ten jobs of 30 evaluations, tracked": (*SWEEP, STORE),
}
FIRST = ("optimise", "budget.evaluations=60", "validate=false", "tracking=none")


def processor_seconds(checkout: Path, cache: Path, pipeline: str, *arguments: str) -> float:
    """What a command of a checkout takes, in a working directory of its own."""
    cache.mkdir(exist_ok=True)
    environment = os.environ | {"PYTHONPATH": str(checkout), "NUMBA_CACHE_DIR": str(cache)}
    environment["PYTHONDONTWRITEBYTECODE"] = ""  # what Python compiles of modules is kept, as by default
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    with tempfile.TemporaryDirectory(dir=cache) as cwd:
        command = [sys.executable, "-m", f"pipelines.{pipeline}", *arguments]
        subprocess.run(command, cwd=cwd, env=environment, check=True, capture_output=True)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("before", type=Path, help="the checkout to compare with")
    parser.add_argument("--rounds", type=int, default=3, help="each command is timed so often")
    parser.add_argument("--only", default="", help="of the commands after the first run those whose label has this")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        checkouts = (options.before.resolve(), HERE)
        caches = [Path(folder) / str(i) for i in range(len(checkouts))]
        pairs = list(zip(checkouts, caches, strict=True))
        print("| command | before, s | now, s | now / before |\n| --- | --- | --- | --- |")
        first = [processor_seconds(*pair, *FIRST) for pair in pairs]  # compiles for all the others
        print_row("first run, with an empty cache", *first)
        for label, command in COMMANDS.items():
            if options.only not in label:
                continue
            rounds = [[processor_seconds(*pair, *command) for pair in pairs] for _ in range(options.rounds)]
            print_row(label, *(min(column) for column in zip(*rounds, strict=True)))


def print_row(label: str, before: float, now: float) -> None:
    """Print a row of the table."""
    print(f"| {label} | {before:.1f} | {now:.1f} | {now / before:.2f} |", flush=True)


if __name__ == "__main__":
    main()
