"""Compile the kernels of the main job: `python -m pipelines.precompile`, which `make install` calls.

Compiled code is stored beside the modules, or in `NUMBA_CACHE_DIR`. The first run of another command compiles what it
needs besides.
"""

import subprocess
import sys
import tempfile

from .app import PACKAGE

MAIN = ("optimise", "budget.evaluations=60", "tracking=none", "threads=1")


def main() -> None:
    """Do a small run of the main job in a process of its own; exit with 1 if it fails."""
    pipeline, *overrides = MAIN
    with tempfile.TemporaryDirectory() as folder:
        command = [sys.executable, "-m", f"{PACKAGE}.{pipeline}", *overrides, f"hydra.run.dir={folder}/main"]
        process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True)
        assert process.stderr is not None, "it has a pipe"
        lines = []
        for line in process.stderr:
            lines.append(line)
            if "compiling" in line:
                print(line.rpartition("\r")[2].strip(), file=sys.stderr)
        if process.wait():
            sys.exit(f"{' '.join(command)}\n{''.join(lines)}")


if __name__ == "__main__":
    main()
