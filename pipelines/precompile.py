"""Compile what the commands use as they are configured by default: `python -m pipelines.precompile`.

Compiled code is kept beside the modules, or where `NUMBA_CACHE_DIR` says. Without this, the first run that needs
something compiles it.
"""

import subprocess
import sys
import tempfile
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from importlib.util import find_spec
from pathlib import Path

from .app import PACKAGE

SMALL = ("tracking=none", "threads=1")
RUNS = (  # the longest first
    ("optimise", "budget.evaluations=200"),  # enough for stacks, plates that grow, and plates of their size
    ("optimise", "budget.evaluations=60", "experiment=lab"),
    ("optimise", "budget.evaluations=60", "objective=localisation", "tag=printed"),
    ("optimise", "budget.evaluations=60", "experiment=lab_l_shape"),
    ("optimise", "budget.evaluations=60", "experiment=lab", "room=mesh", "room.path={folder}/box.obj"),
    ("evaluate",),
    ("observe", "deployment=uniform", "seeds=1", "trajectory.duration=2"),
)
# A room of 6 x 4 x 2.8 m as a mesh.
BOX = """\
v 0 0 0
v 6 0 0
v 6 4 0
v 0 4 0
v 0 0 2.8
v 6 0 2.8
v 6 4 2.8
v 0 4 2.8
f 1 2 3 4
f 8 7 6 5
f 1 5 6 2
f 2 6 7 3
f 3 7 8 4
f 4 8 5 1
"""


def main() -> None:
    """Do a small run of each kind, in processes of their own; exit with 1 if one fails."""
    from lmd.sight.evaluator import available_threads

    print("compiling; this takes a few minutes, once", file=sys.stderr)
    with tempfile.TemporaryDirectory() as folder, ThreadPoolExecutor(available_threads()) as pool:
        (Path(folder) / "box.obj").write_text(BOX, encoding="utf-8")
        possible = [run for run in RUNS if "room=mesh" not in run or find_spec("trimesh")]
        runs = [[word.format(folder=folder) for word in run] for run in possible]
        outputs = [f"hydra.run.dir={Path(folder) / str(i)}" for i in range(len(runs))]
        failed = [message for message in pool.map(_run, runs, outputs) if message]
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
