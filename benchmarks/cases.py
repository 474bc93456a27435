"""Files of others through the documented commands: `python benchmarks/cases.py FOLDER [--against COMMIT]`.

The names of the files begin with what they are: `map_`, `traj_`, `cam_`, `room_`, `det_`; folders with a `plan.csv`
have detections of tags that hang as the plan says. Each file is put through the command that takes such files. Prints a
Markdown table: figures of what was read, with the notes, or the sentence that refused it. With a commit, it has what
that made of the same command, too.
"""

import argparse
import csv
import os
import re
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import NamedTuple

import numpy as np
from same_results import HERE, checkout

SECONDS, SHOWN = 300.0, 240  # of a command; characters of an outcome
HALL = ("room=floor_plan", "room.outline=[[-9,-9],[9,-9],[9,9],[-9,9]]", "room.holes=[]", "room.keep_out=[]")
ROOM = ("room=floor_plan", "room.outline=[[0,0],[6,0],[6,4],[0,4]]", "room.holes=[]", "room.keep_out=[]")
BAND = ("room.reachable.clearance=0.3", "room.reachable.height=[0.3,1.9]")
TAGS = ("tag.edge=0.15", "visibility=fiducial", "objective=mean")
DRIVE = ("poses=recorded", "poses.block=1", "poses.held_out=null", "pdf=recorded")
# Keys that a file takes for what it does not say.
ALIGNED = "poses.align=[2.5,1,0.7,-0.5,0.5,-0.5,0.5]"
KEYS = {
    "traj_ahead.tum": (ALIGNED,),
    "traj_same_body.tum": ("poses.frame=body",),
    "cam_fisheye_K_D.yaml": ("camera.image_size=[640,480]",),
}
SAID = re.compile(r"(note|warning|error): ")


class Case(NamedTuple):
    """A command, and the figures of what it leaves in a folder and prints."""

    name: str
    command: tuple[str, ...]
    figures: Callable[[Path, str], str]


def _tags(folder: Path, _: str) -> str:
    """The first places of the map that was written."""
    with (folder / "tags.csv").open() as file:
        rows = list(csv.DictReader(file))
    places = "; ".join(f"{row['id']} at {', '.join(f'{float(row[axis]):.4g}' for axis in 'xyz')}" for row in rows[:2])
    return f"{len(rows)} tags: {places}"


def _line(pattern: str) -> Callable[[Path, str], str]:
    return lambda _, printed: "; ".join(" ".join(found.split()) for found in re.findall(pattern, printed, re.MULTILINE))


def _off_plan(plan: Path) -> Callable[[Path, str], str]:
    """The way from where the tags hang to where the survey has them."""

    def figures(folder: Path, printed: str) -> str:
        by_id = [
            {row["id"]: np.array([float(row[axis]) for axis in "xyz"]) for row in csv.DictReader(path.open())}
            for path in (plan, folder / "map.csv")
        ]
        off = max(float(np.linalg.norm(place - by_id[0][tag])) for tag, place in by_id[1].items())
        return f"at most {1e3 * off:.3g} mm off; {_line(r'.*known to.*|.*turned.*')(folder, printed)}"

    return figures


def cases(folder: Path) -> Iterator[Case]:
    """The commands of the files of a folder."""
    drive = (*ROOM, *BAND, "deployment=file", f"deployment.path={folder / 'tags_east_wall.csv'}", *TAGS, *DRIVE)
    one_camera = ("camera=calibration", "tag.edge=0.15")
    for path in sorted(folder.iterdir()):
        kind = path.name.partition("_")[0]
        if kind == "map":
            read = ("deployment=file", f"deployment.path={path}", "deployment.free=true", "formats=[csv]")
            yield Case(path.name, ("export", *HALL, *read, "tag.edge=0.1"), _tags)
        elif kind == "traj":
            share = _line(r"^(?:pose determined|views localised to 50 mm).*")
            yield Case(path.name, ("evaluate", *drive, f"poses.path={path}", *KEYS.get(path.name, ())), share)
        elif kind == "cam":
            camera = ("size", *one_camera, f"camera.path={path}", *KEYS.get(path.name, ()))
            yield Case(path.name, camera, _line(r"^0 deg.*"))
        elif kind.startswith("room"):
            room = ("room=mesh", f"room.path={path}", "localisation=false", "validate=false")
            yield Case(path.name, ("evaluate", *room), _line(r"of (\d+ positions)"))
        elif kind == "det":
            seen = (f"detections={path}", f"camera.path={folder / 'upside_down' / 'camera.yaml'}", "tag.edge=0.15")
            yield Case(path.name, ("survey", *seen), _line(r".*known to.*"))
        elif (plan := path / "plan.csv").exists():
            camera = (f"camera.path={path / 'camera.yaml'}", "tag.edge=0.15")
            for seen_there in sorted(path.glob("detections_*.csv")):
                for key in ("deployment.fixed", "deployment.path"):
                    name = f"{path.name}/{seen_there.name}, {key}"
                    command = ("survey", f"detections={seen_there}", *camera, f"{key}={plan}")
                    yield Case(name, command, _off_plan(plan))


def outcome(case: Case, checkout: Path) -> str:
    """The figures and the notes, or the refusal."""
    with tempfile.TemporaryDirectory() as name:
        pipeline, *overrides = case.command
        tracking = () if pipeline in ("size", "survey") else ("tracking=none",)
        line = [sys.executable, "-m", f"pipelines.{pipeline}", *overrides, *tracking, "hydra.run.dir=run"]
        environment = os.environ | {"PYTHONPATH": str(checkout)}
        try:
            done = subprocess.run(
                line, cwd=name, env=environment, capture_output=True, text=True, timeout=SECONDS, check=False
            )
        except subprocess.TimeoutExpired:
            return f"over {SECONDS:.0f} s"
        if "Traceback" in done.stderr:
            return f"traceback: {done.stderr.strip().splitlines()[-1]}"
        said = [text for text in done.stderr.splitlines() if SAID.match(text)]
        found = [case.figures(Path(name, "run"), done.stdout)] if done.returncode == 0 else []
        return " / ".join(found + said) or f"exit {done.returncode}"


def cell(text: str, folder: Path) -> str:
    """A text in a table, without where the folder is."""
    plain = text.replace(f"{folder}/", "").replace("|", "/")
    return plain if len(plain) <= SHOWN else f"{plain[:SHOWN]}..."


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--against", help="a commit to compare with")
    parser.add_argument("--only", default="", help="a part of the names of files")
    options = parser.parse_args()
    folder = options.folder.resolve()
    with ExitStack() as stack:
        checkouts = [stack.enter_context(checkout(options.against))] if options.against else []
        print(f"| file | {'before | ' * len(checkouts)}now |\n|{' --- |' * (2 + len(checkouts))}")
        for case in cases(folder):
            if options.only in case.name:
                cells = [cell(outcome(case, code), folder) for code in (*checkouts, HERE)]
                print(f"| {case.name} | {' | '.join(cells)} |", flush=True)


if __name__ == "__main__":
    main()
