"""Compile what the commands use as they are configured by default: `python -m pipelines.precompile`.

Compiled code is kept beside the modules, or where `NUMBA_CACHE_DIR` says. Without this, the first run that needs
something compiles it.
"""

import subprocess
import sys
import tempfile
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

from .app import PACKAGE

SMALL = ("tracking=none", "threads=1")
RUNS = (  # the longest first
    ("optimise", "budget.evaluations=200"),  # enough for stacks, plates that grow, and plates of their size
    ("optimise", "budget.evaluations=60", "experiment=lab"),
    ("optimise", "budget.evaluations=60", "objective=localisation", "tag=printed"),
    ("optimise", "budget.evaluations=60", "experiment=lab_l_shape"),
    ("optimise", "budget.evaluations=60", "objective=robust"),
    ("evaluate",),
    ("observe", "deployment=uniform", "seeds=1", "trajectory.duration=2"),
)


def main() -> None:
    """Do a small run of each kind, in processes of their own; exit with 1 if one fails."""
    from lmd.threads import available_threads

    print("compiling; this takes a few minutes, once", file=sys.stderr)
    with tempfile.TemporaryDirectory() as folder, ThreadPoolExecutor(available_threads()) as pool:
        outputs = [f"hydra.run.dir={Path(folder) / str(i)}" for i in range(len(RUNS))]
        failed = [message for message in pool.map(_run, RUNS, outputs) if message]
    if failed:
        sys.exit("\n".join(failed))


def _run(run: Sequence[str], output: str) -> str:
    """Do a run; returns what it said if it failed."""
    pipeline, *overrides = run
    command = [sys.executable, "-m", f"{PACKAGE}.{pipeline}", *overrides, *SMALL, output]
    done = subprocess.run(command, capture_output=True, text=True)
    return f"{' '.join(command)}\n{done.stderr}" if done.returncode else ""


if __name__ == "__main__":
    main()
