"""Compile the kernels of the commands with their defaults: `python -m pipelines.precompile [main]`.

Compiled code is stored beside the modules, or in `NUMBA_CACHE_DIR`. Without this command, the first run that needs a
kernel compiles it. `main` selects only the main job.
"""

import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from itertools import count
from pathlib import Path

from .app import PACKAGE, command_of

SMALL = ("tracking=none", "threads=1")
MAIN = ("optimise", "budget.evaluations=60")
OTHERS = (  # the longest first
    ("optimise", "budget.evaluations=60", "experiment=lab"),
    ("optimise", "budget.evaluations=60", "objective=localisation", "tag=printed"),
    ("optimise", "budget.evaluations=60", "objective=robust"),
    ("evaluate",),
    ("observe", "deployment=uniform", "seeds=1", "trajectory.duration=2"),
)


def main() -> None:
    """Do a small run of each kind, in processes of their own; exit with 1 if a run fails."""
    from lmd.core.threads import available_threads

    asked = sys.argv[1:]
    if asked not in ([], ["main"]):
        sys.exit(f"error: {command_of('precompile')} takes nothing or main, got {' '.join(asked)}.")
    with tempfile.TemporaryDirectory() as folder:
        if not asked:
            print("compiling what the commands use; this takes a minute or two, once", file=sys.stderr)
        failed = [_run(MAIN, Path(folder) / "main", shown=True)]
        if not asked and not failed[0]:  # the other jobs share the kernels of the main job
            done = count(1)

            def run(number: int) -> str:
                began = time.monotonic()
                problem = _run(OTHERS[number], Path(folder) / str(number), shown=False)
                took = f"took {time.monotonic() - began:.0f} s: {' '.join(OTHERS[number])}"
                print(f"compiling {next(done)} of {len(OTHERS)} {took}", file=sys.stderr)
                return problem

            with ThreadPoolExecutor(available_threads()) as pool:
                failed += pool.map(run, range(len(OTHERS)))
    if any(failed):
        sys.exit("\n".join(filter(None, failed)))


def _run(run: Sequence[str], output: Path, shown: bool) -> str:
    """Do a run; return its command and stderr if it failed, else an empty text.

    Args:
        run: pipeline and overrides.
        output: folder of the run.
        shown: True to print the kernels that the run compiles.
    """
    pipeline, *overrides = run
    command = [sys.executable, "-m", f"{PACKAGE}.{pipeline}", *overrides, *SMALL, f"hydra.run.dir={output}"]
    process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True)
    assert process.stderr is not None, "it has a pipe"
    lines = []
    for line in process.stderr:
        lines.append(line)
        if shown and "compiling" in line:
            print(line.rpartition("\r")[2].strip(), file=sys.stderr)
    return f"{' '.join(command)}\n{''.join(lines)}" if process.wait() else ""


if __name__ == "__main__":
    main()
