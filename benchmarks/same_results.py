"""Compare the results of runs with those of another commit: `python benchmarks/same_results.py COMMIT`.

Each configuration is run by a checkout of the commit and by this one. Prints a Markdown table with the digest of the
landmarks, and exits with 1 if any differ by a byte.
"""

import argparse
import hashlib
import os
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

HERE = Path(__file__).resolve().parents[1]
COMMON = ("tracking=none", "validate=false", "threads=2")
TAGS = ("visibility=fiducial", "tag=printed", "tag.edge=0.16", "objective.thold_p=0.3", "room.spacing=1.0")
SIZES = ("tag.edges=[0.16,0.3]", "deployment.count=[20,10]")
RIG = "camera.rig=[{translation: [0, 0.1, 0], yaw: 0.0}, {translation: [0, -0.1, 0], yaw: 3.1}]"
CONFIGURATIONS = {
    "annealing": ("budget.evaluations=600",),
    "annealing, n = 1": ("budget.evaluations=200", "objective.n=1"),
    "annealing, n = 4": ("budget.evaluations=200", "objective.n=4"),
    "annealing, one walker": ("budget.evaluations=200", "+optimiser.walkers=1"),
    "annealing, given start": ("budget.evaluations=200", "deployment=uniform"),
    "annealing, line of sight": ("budget.evaluations=200", "visibility.occlusion=line_of_sight"),
    "annealing, robust": ("budget.evaluations=150", "objective=robust"),
    "annealing, tags": ("budget.evaluations=100", *TAGS),
    "annealing, two sizes": ("budget.evaluations=100", *TAGS, *SIZES),
    "annealing, two sizes, localisation": ("budget.evaluations=60", *TAGS, *SIZES, "objective=localisation"),
    "greedy, two sizes": ("budget.evaluations=60", *TAGS, *SIZES, "optimiser=greedy"),
    "EGA, two sizes": ("budget.evaluations=200", *TAGS, *SIZES, "optimiser=ega"),
    "annealing, localisation": ("budget.evaluations=60", *TAGS, "objective=localisation"),
    "annealing, floor plan with furniture": ("budget.evaluations=100", "experiment=lab_l_shape"),
    "annealing, a rig": ("budget.evaluations=60", "room.spacing=1.5", "pdf.divisions=6", RIG),
    "EGA": ("budget.evaluations=600", "optimiser=ega"),
    "SGA": ("budget.evaluations=600", "optimiser=sga"),
    "greedy": ("budget.evaluations=100", "optimiser=greedy"),
    "pymoo's GA": ("budget.evaluations=300", "optimiser=pymoo_ga"),
    "CMA-ES": ("budget.evaluations=300", "optimiser=cma_es"),
}


@contextmanager
def checkout(commit: str) -> Iterator[Path]:
    """A folder with the files of a commit, while this is entered."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "before"
        subprocess.run(["git", "-C", HERE, "worktree", "add", "--quiet", "--detach", path, commit], check=True)
        try:
            yield path
        finally:
            subprocess.run(["git", "-C", HERE, "worktree", "remove", "--force", path], check=True)


def digest(code: Path, cache: Path, overrides: tuple[str, ...]) -> str:
    """The digest of the landmarks that a run of a checkout ends with."""
    environment = os.environ | {"PYTHONPATH": str(code), "NUMBA_CACHE_DIR": str(cache)}
    with tempfile.TemporaryDirectory() as cwd:
        command = [sys.executable, "-m", "pipelines.optimise", *overrides, *COMMON, "hydra.run.dir=run"]
        done = subprocess.run(command, cwd=cwd, env=environment, capture_output=True, text=True, check=False)
        if done.returncode:
            sys.exit(f"{' '.join(command)}\n{done.stderr}")
        return hashlib.sha256((Path(cwd) / "run" / "landmarks.csv").read_bytes()).hexdigest()[:12]


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description="Compare the results of a dozen configurations with another commit's.")
    parser.add_argument("commit")
    parser.add_argument("--only", default="", help="of the configurations those whose label has this")
    options, differ = parser.parse_args(), 0
    commit = options.commit
    print(f"| run | {commit} | now | same |\n| --- | --- | --- | --- |")
    with checkout(commit) as before, tempfile.TemporaryDirectory() as caches:
        for label, overrides in CONFIGURATIONS.items():
            if options.only not in label:
                continue
            there, here = (digest(code, Path(caches) / code.name, overrides) for code in (before, HERE))
            differ += there != here
            print(f"| {label} | {there} | {here} | {'yes' if there == here else 'NO'} |", flush=True)
    sys.exit(differ > 0)


if __name__ == "__main__":
    main()
