"""Measure the cost of compilation: `python benchmarks/compiling.py [--against COMMIT] [--rounds N]`.

Prints a Markdown table of processor seconds and peak memory of tiny runs: the first on an empty cache, and the second.
Rows are this checkout, with numba as it comes (`LMD_PLAIN_NUMBA=1`) too, and a commit of it. Then the lines of code of
`lmd/core`.
"""

import argparse
import os
import sys
import tempfile
from collections.abc import Iterator, Mapping
from contextlib import ExitStack
from pathlib import Path

from same_results import HERE, TAGS, checkout

TINY = ("optimise", "budget.evaluations=60", "validate=false", "tracking=none")
PROBLEMS = {"paper's problem": TINY, "localisation": (*TINY, *TAGS, "objective=localisation")}


def run(code: Path, cache: Path, variables: Mapping[str, str], pipeline: str, *overrides: str) -> tuple[float, float]:
    """Processor seconds and peak memory, MB, of a command of a checkout, in a working directory of its own."""
    environment = os.environ | {"PYTHONPATH": str(code), "NUMBA_CACHE_DIR": str(cache)} | variables
    with tempfile.TemporaryDirectory() as cwd, open(os.devnull, "w") as nowhere:
        command = [sys.executable, "-m", f"pipelines.{pipeline}", *overrides, "hydra.run.dir=run"]
        streams = [(os.POSIX_SPAWN_DUP2, nowhere.fileno(), number) for number in (1, 2)]
        before = os.getcwd()
        os.chdir(cwd)
        try:
            child = os.posix_spawn(sys.executable, command, environment, file_actions=streams)
        finally:
            os.chdir(before)
        _, status, used = os.wait4(child, 0)
    if status:
        sys.exit(f"{' '.join(command)} in {code} ended with {os.waitstatus_to_exitcode(status)}")
    return used.ru_utime + used.ru_stime, used.ru_maxrss * 1024 / 1e6


def rows(checkouts: Mapping[str, tuple[Path, Mapping[str, str]]], rounds: int) -> Iterator[str]:
    """The table; each figure is the least of the rounds, in which all rows take turns."""
    columns = [f"{name}: {what}" for name in PROBLEMS for what in ("first run, s", "second run, s", "peak memory, MB")]
    yield f"| | {' | '.join(columns)} |\n| --- |{' --- |' * len(columns)}"
    least: dict[str, list[float]] = {}
    for _ in range(rounds):
        for label, (code, variables) in checkouts.items():
            found: list[float] = []
            for command in PROBLEMS.values():
                with tempfile.TemporaryDirectory() as cache:
                    (first, memory), (second, _) = (run(code, Path(cache), variables, *command) for _ in range(2))
                found += [first, second, memory]
            least[label] = [min(pair) for pair in zip(least.get(label, found), found, strict=True)]
    for label, figures in least.items():
        yield f"| {label} | {' | '.join(f'{figure:.1f}' for figure in figures)} |"


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--against", help="a commit to compare with")
    parser.add_argument("--rounds", type=int, default=2)
    options = parser.parse_args()
    with ExitStack() as stack:
        checkouts: dict[str, tuple[Path, Mapping[str, str]]] = {}
        if options.against:
            before = stack.enter_context(checkout(options.against))
            checkouts[options.against] = (before, {})
            checkouts[f"{options.against}, numba as it comes"] = (before, {"LMD_PLAIN_NUMBA": "1"})
        checkouts["now"] = (HERE, {})
        checkouts["now, numba as it comes"] = (HERE, {"LMD_PLAIN_NUMBA": "1"})
        for row in rows(checkouts, options.rounds):
            print(row, flush=True)
        for label, (code, variables) in checkouts.items():
            if not variables:
                lines = sum(len(path.read_text().splitlines()) for path in (code / "lmd" / "core").glob("*.py"))
                print(f"\n`lmd/core`, {label}: {lines:,} lines.")


if __name__ == "__main__":
    main()
