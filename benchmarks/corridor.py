"""Maps of drives of which images show mostly one tag, beside the truth or beside the map of all detections.

PYTHONPATH=tests python benchmarks/corridor.py simulated [--seeds 4] [--length 70] [--tags 48]   # a corridor
python benchmarks/corridor.py thinned FOLDER EDGE [--seeds 3]   # one sighting in each frame of a recording, at random

The folder has `detections.csv` and `cameras.yaml`, and for odometry the trajectories `reference_tf_map_rig.tum` and
`reference_tf_rig_cam0.tum`, to which a drift of 1 % and 0.5 degrees is added (after a metre, standard deviations).
"""

import argparse
import time
from dataclasses import replace
from pathlib import Path

import numpy as np

from lmd.core.checks import FloatArray, InputError, IntArray
from lmd.detection.corner_errors import CORNER_ERRORS, CornerErrors
from lmd.formats.calibrations import calibrated_camera, read_cameras
from lmd.formats.detection_formats import read_detections
from lmd.formats.detections import DetectedTags
from lmd.formats.trajectories import TrajectoryFile
from lmd.geometry.camera import Camera
from lmd.geometry.se3 import act, exp, inverse, rigid_alignment, skew
from lmd.geometry.trajectory import Trajectory
from lmd.scene.tag import Tag
from lmd.survey.knowledge import PriorKnowledge
from lmd.survey.survey import Survey, survey

HEADER = (
    "| seed | by | tags placed | largest group | groups | off, median / 90 % / largest, mm | stated, median, mm | "
    "off / stated, root mean square | beside the nearest group, mm | s |\n| " + " | ".join(["---"] * 10) + " |"
)
Given = tuple[DetectedTags, list[Camera], Tag, CornerErrors]
NEAREST = 6  # number of tags of other groups beside which a tag is compared
DRIFT = (0.01, 0.0087)  # metres and rad after a metre


def row(seed: int, by: str, found: Survey, ids: IntArray, places: FloatArray, seconds: float) -> None:
    """Print how far the tags of a map are from the places `(K, 3)` of tags `ids`, and how well they should be known."""
    groups = np.bincount(found.found.group[found.found.group >= 0])
    some = np.flatnonzero(found.placed & np.isin(found.ids, ids))
    here, there = found.found.poses.tags[some, :3, 3], places[np.searchsorted(ids, found.ids[some])]
    text = ["-"] * 3
    if len(some) > 2:
        off = np.linalg.norm(act(rigid_alignment(here, there), here) - there, axis=1)
        sigma = found.found.sigmas[some]
        text = [
            " / ".join(f"{1e3 * x:.1f}" for x in np.quantile(off, [0.5, 0.9, 1.0])),
            f"{1e3 * np.median(sigma):.1f}",
            f"{np.sqrt(np.mean((off / sigma) ** 2)):.2f}",
        ]
    beside = f"{1e3 * np.median(between):.1f}" if (between := beside_groups(found)) else "-"
    counts = [str(found.placed.sum()), str(groups.max()), str(len(groups))]
    print(f"| {' | '.join([str(seed), by, *counts, *text, beside, f'{seconds:.1f}'])} |", flush=True)


def beside_groups(found: Survey) -> list[float]:
    """Standard deviation of each group that only motion joins beside the nearest tag of another, metres."""
    tags, covariance, best = found.found.poses.tags, found.found.covariance, {}
    for k in np.flatnonzero(found.joined >= 0).tolist():
        others = np.flatnonzero((found.joined >= 0) & (found.joined != found.joined[k]))
        near = others[np.argsort(np.linalg.norm(tags[others, :3, 3] - tags[k, :3, 3], axis=1))[:NEAREST]]
        for other in near.tolist():
            between = inverse(tags[k]) @ tags[other]
            slope = np.hstack([skew(between[:3, 3]), -np.eye(3), np.zeros((3, 3)), between[:3, :3]])
            rows = np.r_[6 * k : 6 * k + 6, 6 * other : 6 * other + 6]
            square = slope @ covariance[np.ix_(rows, rows)] @ slope.T
            sigma = float(np.sqrt(np.linalg.eigvalsh(square)[-1]))
            best[found.joined[k]] = min(best.get(found.joined[k], np.inf), sigma)
    return list(best.values())


def attempt(seed: int, by: str, known: PriorKnowledge, ids: IntArray, places: FloatArray, given: Given) -> None:
    """Map a drive, and print what came of it."""
    began = time.process_time()
    try:
        found = survey(*given, known)
    except InputError as error:
        print(f"| {seed} | {by} | {error} |", flush=True)
        return
    row(seed, by, found, ids, places, time.process_time() - began)


def simulated(seeds: int, length: float, tags: int) -> None:
    """Drives down a corridor whose truth is known."""
    from support import drives, walks  # of the tests

    print(HEADER)
    for seed in range(seeds):
        rng = np.random.default_rng(seed)
        driven = drives.drive(length, tags, rng)
        given = (driven.detected, [drives.CAMERA], Tag(drives.EDGE), walks.constant_errors(0.2))
        odometry = drives.odometry(driven, rng)
        leaning = drives.odometry(driven, rng, lean=(0.01, 0.003))
        for by, known in (
            ("images alone", PriorKnowledge(steady=False)),
            ("constant velocity", PriorKnowledge()),
            ("odometry", PriorKnowledge(odometry=odometry)),
            ("odometry, 1 % and 3 mrad/m off", PriorKnowledge(odometry=leaning)),
        ):
            attempt(seed, by, known, np.arange(tags), driven.tags[:, :3, 3], given)


def drifting(folder: Path, rng: np.random.Generator) -> Trajectory:
    """The path of the camera by another program, with a drift."""
    rig = TrajectoryFile(str(folder / "reference_tf_map_rig.tum")).trajectory
    camera = TrajectoryFile(str(folder / "reference_tf_rig_cam0.tum")).trajectory.poses[0]
    path = rig.poses @ camera
    steps = inverse(path[:-1]) @ path[1:]
    away = np.sqrt(np.linalg.norm(steps[:, :3, 3], axis=1))[:, None]
    poses = [path[0]]
    for step in steps @ exp(rng.normal(size=(len(steps), 6)) * away * np.repeat(DRIFT[::-1], 3)):
        poses.append(poses[-1] @ step)
    return Trajectory(rig.time, np.stack(poses))


def thinned(folder: Path, edge: float, seeds: int) -> None:
    """One sighting in each frame of the first camera, beside the map of all of that camera."""
    every = read_detections(folder / "detections.csv")
    path = str(folder / "cameras.yaml")
    cameras = [calibrated_camera(path, next(iter(read_cameras(path))) or None)]
    detected = replace(every.of(np.flatnonzero(every.camera == 0)), cameras=every.cameras[:1])
    tag, errors = Tag(edge), CORNER_ERRORS["apriltag"]
    whole = survey(detected, cameras, tag, errors, PriorKnowledge(steady=False))
    ids, places = whole.ids[whole.placed], whole.found.poses.tags[whole.placed, :3, 3]
    print(HEADER)
    for seed in range(seeds):
        rng = np.random.default_rng(seed)
        order = np.lexsort((rng.uniform(size=len(detected)), detected.frame))
        alone = detected.of(np.sort(order[np.flatnonzero(np.diff(detected.frame[order], prepend=-1))]))
        for by, known in (
            ("images alone", PriorKnowledge(steady=False)),
            ("constant velocity", PriorKnowledge()),
            ("odometry", PriorKnowledge(odometry=drifting(folder, rng))),
        ):
            attempt(seed, by, known, ids, places, (alone, cameras, tag, errors))


def main() -> None:
    """See above."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    commands = parser.add_subparsers(dest="command", required=True)
    truth = commands.add_parser("simulated")
    truth.add_argument("--seeds", type=int, default=4)
    truth.add_argument("--length", type=float, default=70.0, help="metres")
    truth.add_argument("--tags", type=int, default=48)
    real = commands.add_parser("thinned")
    real.add_argument("folder", type=Path)
    real.add_argument("edge", type=float, help="of the tags, metres")
    real.add_argument("--seeds", type=int, default=3)
    given = parser.parse_args()
    if given.command == "simulated":
        simulated(given.seeds, given.length, given.tags)
    else:
        thinned(given.folder, given.edge, given.seeds)


if __name__ == "__main__":
    main()
