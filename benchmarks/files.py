"""Which files of others are read: `python benchmarks/files.py FOLDER`.

The folder has the folders calibration, trajectories and layouts.
It prints a table in Markdown: each file, and what was read or the sentence that refused it.
"""

import sys
from collections.abc import Callable
from pathlib import Path

from lmd.core.checks import InputError
from lmd.scene.camera_calibration import calibrated_camera
from lmd.scene.tag_map_files import read_deployment
from lmd.scene.trajectory_files import TrajectoryFile


def calibration(path: str) -> str:
    """The cameras of a file: the only one, or those with the names that Kalibr gives."""
    try:
        return _camera(path, None)
    except InputError as error:
        if "cam0" not in str(error):
            raise
        return "; ".join(_camera(path, name) for name in ("cam0", "cam1"))


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


READERS: dict[str, Callable[[str], str]] = {"calibration": calibration, "trajectories": trajectory, "layouts": layout}


def main(folder: str) -> None:
    """Try every file."""
    print("| file | outcome |\n| --- | --- |")
    for kind, read in READERS.items():
        for path in sorted(Path(folder, kind).iterdir()):
            if path.suffix == ".md":
                continue
            try:
                outcome = read(str(path))
            except InputError as error:
                outcome = f"refused: {str(error).replace(str(path), path.name)}"
            print(f"| {kind}/{path.name} | {outcome} |")


if __name__ == "__main__":
    main(sys.argv[1])
