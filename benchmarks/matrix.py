"""Supported combinations: `python benchmarks/matrix.py [--seconds S] [--workers W] [PART OF A CELL ...]`.

Runs every command in every cell of {what is seen} x {objective} x {room} x {poses} x {camera} with tiny budgets, and
writes docs/matrix.md. What has been run is kept in docs/results/matrix.csv, one line each, and not run again; delete
lines to do so. Cells that differ from the first in one thing come first, then those that differ in two, and so on.
`--seconds` limits the time, and the page names the cells not run; `--workers` run at the same time, each one command.
"""

import argparse
import contextlib
import csv
import gc
import itertools
import multiprocessing
import os
import sys
import tempfile
import time
from collections.abc import Iterator
from dataclasses import dataclass
from importlib import import_module
from multiprocessing.connection import wait
from multiprocessing.context import ForkProcess
from pathlib import Path
from typing import Self

ROOT = Path(__file__).resolve().parents[1]
KEPT, PAGE = ROOT / "docs" / "results" / "matrix.csv", ROOT / "docs" / "matrix.md"
WORKS, LIMIT = "works", 300.0  # seconds that a command may take
BOX = "".join(f"v {x} {y} {z}\n" for z in (0, 3) for y in (0, 4) for x in (0, 6))
BOX += "f 1 3 4 2\nf 5 6 8 7\nf 1 2 6 5\nf 3 7 8 4\nf 1 5 7 3\nf 2 4 8 6\n"
POSES = "time,x,y,z,yaw,pitch\n" + "".join(f"{t},{2.5 + 0.02 * t},1,1.2,{0.1 * t},0\n" for t in range(60))
RIG = "camera.rig=[{translation: [0.1, 0, 0]}, {translation: [-0.1, 0, 0], yaw: 3.1416}]"

# The options of each part of a cell, with their overrides; the first ones are the cell that others are compared with.
PARTS: dict[str, dict[str, tuple[str, ...]]] = {
    "seen": {"fiducial": ("visibility=fiducial",), "paper": ("visibility=paper",)},
    "objective": {
        "coverage": ("objective=paper",),
        "robust": ("objective=robust", "objective.sampling.positions=2", "objective.sampling.divisions=4"),
        "localisation": ("objective=localisation",),
        "mixed": ("objective=localisation", "objective.coverage_weight=0.5"),
    },
    "room": {
        "cuboid": ("room=lab",),
        "floor plan": ("room=floor_plan",),
        "mesh": ("room=mesh", "room.path=box.obj", "room.up=z"),
    },
    "poses": {
        "grid": ("pdf=yaw", "pdf.divisions=4"),
        "recorded": ("pdf=recorded", "poses=recorded", "poses.path=poses.csv"),
    },
    "camera": {
        "one": (),
        "distorted": ("camera.distortion=[-0.1,0.01,0.001,-0.001]",),
        "Kannala-Brandt": ("camera.distortion_model=equidistant", "camera.distortion=[0.01,0,0,0]"),
        "rig": (RIG,),
    },
}
COMMON = (
    "camera=lab", "room.spacing=2", "tag.edge=0.15", "tracking=none", "threads=1", "hydra.run.dir=run",
)  # fmt: skip
PLAN = "deployment=uniform", "deployment.count=8"
SEARCH = "deployment.count=8", "validate=false", "picture=false"
LISTED = "deployments=[uniform]", "deployment.count=8"
COMMANDS: dict[str, tuple[str, ...]] = {
    "optimise": (*SEARCH, "budget.evaluations=20"),
    "optimise: black box": (*SEARCH, "optimiser=random_search", "budget.evaluations=4"),
    "evaluate": (*PLAN, "validate=false", "picture=false"),
    "evaluate: sensitivity": (*PLAN, "validate=false", "picture=false", "localisation=false", "sensitivity=true"),
    "evaluate: mounting": (
        *PLAN, "validate=false", "picture=false", "localisation=false", "losses=false",
        "deployment.mounting_error.position=0.01", "deployment.mounting_error.draws=2",
    ),
    "evaluate: observe": (
        "studies=[observe]", *LISTED, "seeds=1", "trajectory.duration=1", "trajectory.pace.frame_rate=20",
        "estimator=[observer,iekf,smoother,pnp,bound]",
    ),
    "evaluate: detect": ("studies=[detect]", *LISTED, "frames=2", "pictures=1", "workers=1"),
    "evaluate: accuracy": ("studies=[accuracy]", *LISTED),
    "evaluate: bound": ("studies=[bound]", "deployment.count=8", "bound.spacing=1", "bound.iterations=10"),
    "tradeoff": ("counts=[6,8]", "seeds=1", "budget.evaluations=10", "workers=1", "kept=kept"),
    "compare": ("deployment.count=8", "optimisers=[random_search,sga]", "seeds=2", "budget.evaluations=4", "workers=1"),
    "optimise: cameras": (
        "varies=cameras", *PLAN, "validate=false", "picture=false", "budget.evaluations=4",
        "body.boxes=[{low: [-0.1,-0.1,0], high: [0.1,0.1,0.2]}]",
    ),
    "export": PLAN,
}  # fmt: skip
Cell = tuple[str, ...]


def cells() -> list[Cell]:
    """All cells, those that differ from the first in least things first."""
    first = [next(iter(options)) for options in PARTS.values()]
    every = itertools.product(*PARTS.values())
    return sorted(every, key=lambda cell: sum(a != b for a, b in zip(cell, first, strict=True)))


def overrides(cell: Cell, command: str) -> list[str]:
    """The command line of a command in a cell; later words win, of a room that has no such key none is given."""
    parts = [word for part, option in zip(PARTS, cell, strict=True) for word in PARTS[part][option]]
    words = [*COMMON, *parts, *COMMANDS[command]]
    if command == "optimise: cameras":  # which has its own number of cameras
        words = [word for word in words if word != RIG]
    return words


@dataclass(frozen=True)
class Running:
    """A command in a process and a folder of its own."""

    cell: Cell
    command: str
    folder: tempfile.TemporaryDirectory[str]
    process: ForkProcess
    ends: float  # when it has taken too long, on the monotonic clock

    @classmethod
    def start(cls, cell: Cell, command: str) -> Self:
        """Start a command and go on."""
        folder = tempfile.TemporaryDirectory()
        asked = command.partition(":")[0], overrides(cell, command), folder.name, Path(folder.name, "told")
        process = multiprocessing.get_context("fork").Process(target=_run, args=asked)
        process.start()
        return cls(cell, command, folder, process, time.monotonic() + LIMIT)

    def is_over(self) -> bool:
        """Return whether the command has ended or exceeded its time limit."""
        return not self.process.is_alive() or time.monotonic() > self.ends

    def outcome(self) -> str:
        """`works`, or the sentence that refuses it; stops it where it has taken too long, and removes its folder."""
        with self.folder as folder:
            if self.process.is_alive():
                self.process.kill()
                self.process.join()
                return f"more than {LIMIT:g} s"
            told = Path(folder, "told").read_text().splitlines()
            errors = [line for line in told if line.startswith("error: ")]
            if self.process.exitcode == 0:
                return WORKS
            if errors:
                return errors[-1].removeprefix("error: ").replace(folder + "/", "")
            return "traceback: " + (told or ["nothing"])[-1]


def _run(pipeline: str, words: list[str], folder: str, told: Path) -> None:
    """One command, in a process of its own."""
    os.chdir(folder)
    Path("box.obj").write_text(BOX)
    Path("poses.csv").write_text(POSES)
    with told.open("w") as file, contextlib.redirect_stderr(file), contextlib.redirect_stdout(file):
        os.dup2(file.fileno(), 2)
        os.dup2(file.fileno(), 1)
        sys.argv = [pipeline, *words]
        import_module(f"pipelines.{pipeline}").main()


def make_samples_tiny() -> None:
    """Samples off the grid are as small as can be: what they cost is not the question."""
    from lmd.evaluation.validation import Sample

    check = Sample.__post_init__

    def tiny(self: Sample) -> None:
        check(self)
        for name, most in (("groups", 2), ("positions", 4), ("divisions", 2)):
            object.__setattr__(self, name, min(getattr(self, name), most))

    Sample.__post_init__ = tiny  # type: ignore[method-assign]


def kept() -> dict[tuple[Cell, str], str]:
    """What has been run."""
    if not KEPT.exists():
        return {}
    with KEPT.open() as file:
        return {(tuple(row[part] for part in PARTS), row["command"]): row["outcome"] for row in csv.DictReader(file)}


def run(wanted: list[str], seconds: float, workers: int) -> None:
    """Run what has not been run, until it is done or the time is up."""
    make_samples_tiny()
    for command in COMMANDS:
        import_module(f"pipelines.{command.partition(':')[0]}")
    gc.freeze()
    known, ends = kept(), time.monotonic() + seconds
    if not known:
        KEPT.write_text(",".join([*PARTS, "command", "outcome"]) + "\n")
    waiting = [
        (cell, command)
        for cell, command in itertools.product(cells(), COMMANDS)
        if (cell, command) not in known and all(part in " ".join([*cell, command]) for part in wanted)
    ][::-1]
    running: list[Running] = []
    while True:
        while waiting and len(running) < workers and time.monotonic() < ends:
            running.append(Running.start(*waiting.pop()))
        if not running:
            return
        wait([one.process.sentinel for one in running], max(0.0, running[0].ends - time.monotonic()))
        for one in [one for one in running if one.is_over()]:
            running.remove(one)
            found = one.outcome()
            print(f"{' '.join([*one.cell, one.command])}: {found}", flush=True)
            with KEPT.open("a", newline="") as file:
                csv.writer(file).writerow([*one.cell, one.command, found])


def page(known: dict[tuple[Cell, str], str]) -> Iterator[str]:
    """The lines of docs/matrix.md."""
    reasons = list(dict.fromkeys(found for found in known.values() if found != WORKS))
    yield "# What works with what"
    yield ""
    yield "Each command was run with a tiny budget for every combination of these parts:"
    yield ""
    yield from (f"- {part}: {', '.join(options)}" for part, options in PARTS.items())
    yield f"- command: {', '.join(COMMANDS)}"
    yield ""
    works, every = sum(found == WORKS for found in known.values()), len(cells()) * len(COMMANDS)
    yield f"{works:,} of the {every:,} work. `docs/results/matrix.csv` has all outcomes. `python benchmarks/matrix.py`"
    yield "has the settings; it runs missing combinations. Optimisers are the default, random search and SGA; `milp`"
    yield "refuses some combinations, as it solves plain coverage with one camera."
    yield ""
    yield "Not among these: [people in the way](crowd.md#what-works-with-it), [tags for a"
    yield "filter](filtered.md#what-works-with-it)."
    if works == every:
        return
    yield "In other cells a number is the reason below, and an empty place has not been run."
    yield ""
    yield "| " + " | ".join([*PARTS, *COMMANDS]) + " |"
    yield "| " + " | ".join(["---"] * (len(PARTS) + len(COMMANDS))) + " |"
    for cell in cells():
        told = [known.get((cell, command)) for command in COMMANDS]
        if set(told) != {WORKS}:
            marks = ["" if t is None else "✓" if t == WORKS else str(1 + reasons.index(t)) for t in told]
            yield "| " + " | ".join([*cell, *marks]) + " |"
    yield ""
    yield from (f"{number}. {reason}" for number, reason in enumerate(reasons, 1))


def main() -> None:
    """See the module."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("wanted", nargs="*")
    parser.add_argument("--seconds", type=float, default=float("inf"))
    parser.add_argument("--workers", type=int, default=1)
    given = parser.parse_args()
    sys.path.insert(0, str(ROOT))  # commands run in folders of their own, and start others
    os.environ["PYTHONPATH"] = str(ROOT)
    run(given.wanted, given.seconds, given.workers)
    PAGE.write_text("\n".join(page(kept())) + "\n")


if __name__ == "__main__":
    main()
