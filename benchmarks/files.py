"""Which files of others are read: `python benchmarks/files.py FOLDER`, with `--counts` only how many, and why not.

The folder has the folders calibration, trajectories and layouts.
It prints a table in Markdown: each file, and what was read or the sentence that refused it.
"""

import sys
from collections import Counter
from collections.abc import Callable
from pathlib import Path

from lmd.core.checks import InputError
from lmd.formats.calibrations import calibrated_camera, read_cameras
from lmd.formats.tag_maps import read_deployment
from lmd.formats.trajectories import TrajectoryFile


def calibration(path: str) -> str:
    """The cameras of a file."""
    return "; ".join(_camera(path, name or None) for name in list(read_cameras(path))[:MOST])


def _camera(path: str, name: str | None) -> str:
    camera = calibrated_camera(path, name)
    lens = "no distortion" if camera.lens is None else f"{camera.lens.model} of {len(camera.lens.coefficients)}"
    return f"{camera.image_width:g} x {camera.image_height:g} pixels, {lens}"


def trajectory(path: str) -> str:
    """The poses of a file."""
    file = TrajectoryFile(path)
    time = file.trajectory.time
    note = f"; {file.note.partition(' of ')[0]} left out" if file.note else ""
    return f"{len(time)} poses, {time[-1] - time[0]:.0f} s{note}"


def layout(path: str) -> str:
    """The tags of a map."""
    return f"{len(read_deployment(path))} tags"


MOST = 2  # cameras of a file that are tried
READERS: dict[str, Callable[[str], str]] = {"calibration": calibration, "trajectories": trajectory, "layouts": layout}


def main(folder: str, counts: bool) -> None:
    """Try every file."""
    rows, reasons = [], {}
    for kind, read in READERS.items():
        paths = [path for path in sorted(Path(folder, kind).iterdir()) if path.suffix != ".md"]
        reasons[kind] = (len(paths), refused := Counter[str]())
        for path in paths:
            try:
                outcome = read(str(path))
            except InputError as error:
                reason = str(error).replace(str(path), path.name)
                refused[reason.replace(f"{path.name}: ", "").replace(path.name, "FILE")] += 1
                outcome = f"refused: {reason}"
            rows.append(f"| {kind}/{path.name} | {outcome} |")
    if not counts:
        print("| file | outcome |\n| --- | --- |", *rows, sep="\n")
        return
    print("| kind | files | read | refused |\n| --- | --- | --- | --- |")
    for kind, (count, refused) in reasons.items():
        why = "; ".join(f"{times}: {reason}" for reason, times in refused.most_common())
        print(f"| {kind} | {count} | {count - refused.total()} | {why} |")


if __name__ == "__main__":
    main(sys.argv[1], "--counts" in sys.argv)
