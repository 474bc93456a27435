"""Compare the results of runs with those of another commit: `python benchmarks/same_results.py COMMIT`.

Each configuration is run by a checkout of the commit and by this one. Prints a Markdown table with the digest of the
tables, without times, and exits with 1 if any differ by a byte.
"""

import argparse
import hashlib
import os
import re
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

HERE = Path(__file__).resolve().parents[1]
COMMON = ("validate=false", "threads=2")
TAGS = ("visibility=fiducial", "tag.edge=0.16", "objective.thold_p=0.3", "room.spacing=1.0")
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
SMALL = ("room.spacing=2.0", "deployment.count=20", "picture=false")
PRINTED = ("tag.edge=0.2", "visibility=fiducial")
BOTH = "deployments=[uniform,random]"
# One run of each command and study.
STUDIES = {
    "score": ("evaluate", *SMALL, "sensitivity=true", "deployment.mounting_error=0.01"),
    "accuracy": ("evaluate", *SMALL, *PRINTED, "studies=[accuracy]", BOTH),
    "bound": ("evaluate", *SMALL, "studies=[bound]", "bound.seconds=null", "bound.iterations=5", "bound.spacing=1.0"),
    "uncertainty": ("evaluate", *SMALL, *PRINTED, "studies=[uncertainty]", "uncertainty.corners=objective"),
    "detect": ("evaluate", *SMALL, *PRINTED, "studies=[detect]", "frames=20", "pictures=0", BOTH),
    "observe": ("evaluate", *SMALL, *PRINTED, "studies=[observe]", "seeds=2", BOTH),
    "cameras": (
        *("optimise", "varies=cameras", "deployment=uniform", *SMALL, *PRINTED, "objective=mean", "validate=false"),
        *("budget.evaluations=60", "body.boxes=[{low: [-0.1, -0.1, 0.0], high: [0.1, 0.1, 0.2]}]"),
    ),
    "compare": ("compare", *SMALL, "optimisers=[ega,random_search]", "seeds=2", "budget.evaluations=60"),
    "tradeoff": ("tradeoff", "room.spacing=2.0", "counts=[10,20]", "seeds=1", "budget.evaluations=30", "kept=kept"),
    "orientations": ("estimate_pdf", "simulate={}"),
    "limits of a detector": ("calibrate_detector", *SMALL, "frames=5", "views.count=300"),
    "export": ("export", "deployment=uniform", *SMALL, *PRINTED, "formats=[wpilib,apriltag_ros,tagslam,aruco,csv]"),
}
TABLES = (".csv", ".json", ".yaml", ".java", ".py")
TIMED = re.compile(rb'"(wall_time|seconds)": [\d.e-]+')
LEFT_OUT = ("history.csv", "comparison.csv")  # they hold times


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


def digest(code: Path, cache: Path, line: tuple[str, ...]) -> str:
    """The digest of the tables that a command line of a checkout writes."""
    environment = os.environ | {"PYTHONPATH": str(code), "NUMBA_CACHE_DIR": str(cache)}
    with tempfile.TemporaryDirectory() as cwd:
        command = [sys.executable, "-m", f"pipelines.{line[0]}", *line[1:], "tracking=none", "hydra.run.dir=run"]
        done = subprocess.run(command, cwd=cwd, env=environment, capture_output=True, text=True, check=False)
        if done.returncode:
            sys.exit(f"{' '.join(command)}\n{done.stderr}")
        run, found = Path(cwd) / "run", hashlib.sha256()
        for file in sorted(run.rglob("*")):
            if file.suffix in TABLES and ".hydra" not in file.parts and file.name not in LEFT_OUT:
                found.update(file.name.encode() + TIMED.sub(b"", file.read_bytes()))
        return found.hexdigest()[:12]


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description="Compare the results of a dozen configurations with another commit's.")
    parser.add_argument("commit")
    parser.add_argument("--only", default="", help="of the configurations those whose label has this")
    options, differ = parser.parse_args(), 0
    commit = options.commit
    print(f"| run | {commit} | now | same |\n| --- | --- | --- | --- |")
    with checkout(commit) as before, tempfile.TemporaryDirectory() as caches:
        searches = {label: ("optimise", *overrides, *COMMON) for label, overrides in CONFIGURATIONS.items()}
        for label, line in (searches | STUDIES).items():
            if options.only not in label:
                continue
            there, here = (digest(code, Path(caches) / code.name, line) for code in (before, HERE))
            differ += there != here
            print(f"| {label} | {there} | {here} | {'yes' if there == here else 'NO'} |", flush=True)
    sys.exit(differ > 0)


if __name__ == "__main__":
    main()
