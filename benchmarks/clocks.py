"""Offsets of the camera's clock from the odometry's clock that are known, beside those that are found.

PYTHONPATH=tests python benchmarks/clocks.py simulated [--seeds 40] [--only NAME] [--picture FILE]   # simulated drives
python benchmarks/clocks.py recorded FOLDER EDGE [--seeds 4] [--only NAME]  # a recording, with simulated odometry

FOLDER has `detections.csv` and `cameras.yaml` of one camera. The last column has offsets found by scipy, from nothing
but the turns between single images.
"""

import argparse
import sys
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
from localise import map_of_survey
from scipy.interpolate import make_smoothing_spline
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation, Slerp

from lmd.adjust.estimate import Estimate
from lmd.adjust.motion import seconds_of
from lmd.core.checks import BoolArray, FloatArray
from lmd.detection.corner_errors import CORNER_ERRORS
from lmd.formats.calibrations import calibrated_camera
from lmd.formats.detection_formats import read_detections
from lmd.geometry.se3 import exp, inverse, log, pose_of
from lmd.geometry.trajectory import Trajectory
from lmd.localise.fixed_map import FixedMap
from lmd.localise.localise import Drive, localise
from lmd.scene.tag import Tag
from lmd.survey.knowledge import PriorKnowledge
from lmd.survey.survey import Survey, survey

INJECTED = (0.0, 0.03)  # offsets of clocks, seconds
DRIFT, BIAS = (0.005, 0.01), (0.002, 0.005)  # of simulated odometry after a metre: rad and metres
RATE = 50.0  # poses of simulated odometry a second


def drifting(time: FloatArray, poses: FloatArray, rng: np.random.Generator) -> Trajectory:
    """Odometry with random drift of every step, and a bias of every metre."""
    step = inverse(poses[:-1]) @ poses[1:]
    twists = np.abs(log(step)).reshape(-1, 2, 3)
    far = np.linalg.norm(twists[:, 1], axis=1, keepdims=True) + 0.3 * np.linalg.norm(twists[:, 0], axis=1)[:, None]
    off = rng.normal(size=(len(step), 6)) * np.sqrt(far) * np.repeat(DRIFT, 3)
    own = [np.eye(4)]
    for motion in step @ exp(off + far * rng.normal(size=6) * np.repeat(BIAS, 3)):
        own.append(own[-1] @ motion)
    return Trajectory(time, np.stack(own))


def by_turns(times: FloatArray, frames: FloatArray, odometry: Trajectory) -> float:
    """Offset at which odometry turns between images as single images do, by scipy alone, seconds."""
    there = np.isfinite(frames[:, 0, 0]) & (times > odometry.time[0] + 0.2) & (times < odometry.time[-1] - 0.2)
    turns, seconds = Rotation.from_matrix(frames[there, :3, :3]), times[there] - odometry.time[0]
    body = Slerp(odometry.time - odometry.time[0], Rotation.from_matrix(odometry.poses[:, :3, :3]))
    near = np.diff(seconds) < 1.0

    def off(offset: FloatArray) -> FloatArray:
        own = body(seconds + offset[0])
        apart = (own[:-1].inv() * own[1:]).inv() * (turns[:-1].inv() * turns[1:])
        return np.asarray(apart.as_rotvec()[near].ravel())

    fit = least_squares(off, [0.0], loss="soft_l1", f_scale=0.01, diff_step=0.005, x_scale=0.01, bounds=(-0.15, 0.15))
    return float(fit.x[0])


def print_clocks(
    name: str, seeds: Sequence[int], found_of: Callable[[int, float], tuple[Estimate, FloatArray | None, Trajectory]]
) -> None:
    """Print a row for each injected offset.

    Args:
        name: name of the scenario.
        seeds: seeds of the runs.
        found_of: estimate for a seed and an offset, poses by single images if there are any, and odometry.
    """
    for injected in INJECTED:
        rows = []
        for seed in seeds:
            (found, single, odometry), alone = found_of(seed, injected), np.nan
            assert found.clock is not None
            assert found.prior.motion is not None
            if single is not None:
                alone = by_turns(found.prior.motion.times, single, odometry)
            shown = found.clock.sigma < 0.05
            rows.append((found.clock.offset, found.clock.sigma, found.clock.is_corrected, shown, alone))
        offset, sigma, corrected, shown, alone = np.array(rows).T
        off, square = np.abs(offset - injected), ((offset - injected) / sigma) ** 2
        cells = [f"{1e3 * injected:.0f} ms", f"{shown.mean():.1%}", f"{corrected.mean():.1%}"]
        cells += [f"{(off <= 3.0 * sigma).mean():.1%}", f"{np.sqrt(square.mean()):.2f}"]
        cells += [f"{1e3 * np.median(value):.2f}" for value in (off, sigma, np.abs(alone - injected))]
        print(f"| {name} | {len(rows)} | {' | '.join(cells)} |", flush=True)
        DRAWN.append((f"{name}, {1e3 * injected:.0f} ms", injected, offset, sigma))


DRAWN: list[tuple[str, float, FloatArray, FloatArray]] = []  # name, offset, and estimates with standard deviations


def save_picture(path: Path) -> None:
    """Draw the estimated offsets of all drives with three standard deviations."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(8.0, 1.7 * len(DRAWN)), layout="constrained")
    panels = np.atleast_1d(figure.subplots(len(DRAWN), 1, sharex=True))
    for axes, (name, injected, offset, sigma) in zip(panels, DRAWN, strict=True):
        axes.errorbar(
            range(len(offset)), 1e3 * offset, 3e3 * sigma, fmt="o", markersize=3, linewidth=1, color="#1f6f8b"
        )
        axes.axhline(1e3 * injected, color="#c1440e", linewidth=1)
        axes.set_title(name, fontsize=9)
        axes.set_ylabel("offset, ms")
    panels[-1].set_xlabel("drive (bars: 3 sigma)")
    figure.savefig(path, dpi=100)


CLOCKS = (
    "| drives | seeds | injected | shown | corrected | in 3 sigma | error/sigma | off, ms | stated, ms | turns, ms |"
)


def simulated(seeds: int, only: str) -> None:
    """Offsets of the clock in simulated drives: a hand-held camera, a straight drive, and a cart."""
    from support import drives, walks

    sys.path.append(str(Path(__file__).parents[1] / "tests" / "localise"))
    import opencv_rooms

    tag, errors = Tag(drives.EDGE), walks.constant_errors(0.2)

    def driven(seed: int, injected: float, sway: float) -> tuple[drives.Drive, Trajectory]:
        rng = np.random.default_rng(seed)
        own = drives.drive(15.0, 12, rng, alone=0.5, dark=0.1, sway=sway)
        return own, drifting(own.times + injected, own.frames, rng)

    def corridor(seed: int, injected: float, sway: float = 1.0) -> tuple[Estimate, FloatArray, Trajectory]:
        own, odometry = driven(seed, injected, sway)
        known = FixedMap(np.arange(12), own.tags, np.full(12, drives.EDGE), np.full((12, 6), 1e-4))
        result = localise(own.detected, [drives.CAMERA], tag, errors, known, Drive(odometry=odometry))
        assert result.smoothed is not None
        return result.smoothed, result.found.poses.frames, odometry

    def mapped(seed: int, injected: float) -> tuple[Estimate, None, Trajectory]:
        own, odometry = driven(seed, injected, 1.0)
        return (
            survey(own.detected, [drives.CAMERA], tag, errors, PriorKnowledge(odometry=odometry)).found,
            None,
            odometry,
        )

    def cart(seed: int, injected: float) -> tuple[Estimate, FloatArray, Trajectory]:
        one = opencv_rooms.scenario("rig", seed)
        times = seconds_of(one.detected.times)
        odometry = drifting(times + injected, one.frames, np.random.default_rng(seed))
        result = one.localised(odometry=odometry)
        assert result.smoothed is not None
        return result.smoothed, result.found.poses.frames, odometry

    print(f"{CLOCKS}\n| --- |" + " --- |" * 9)
    every = {
        "hand-held, localise": corridor,
        "hand-held, survey": mapped,
        "rig on a cart, localise": cart,
        "straight, localise": lambda seed, injected: corridor(seed, injected, 0.0),
    }
    for name in every:
        if only in name:
            print_clocks(name, range(seeds), every[name])


def recorded(folder: Path, edge: float, seeds: int, only: str = "") -> None:
    """Offsets of the clock of a recording's odometry, which is simulated from smoothing splines through its poses."""
    detected, tag, errors = read_detections(folder / "detections.csv"), Tag(edge), CORNER_ERRORS["apriltag"]
    camera = calibrated_camera(str(folder / "cameras.yaml"), "cam0")

    def mapped(chosen: BoolArray, odometry: Trajectory | None = None) -> Survey:
        return survey(detected.of(np.flatnonzero(chosen)), [camera], tag, errors, PriorKnowledge(odometry=odometry))

    every = detected.frame >= 0
    even, frames, seconds = detected.frame % 2 == 0, mapped(every).found.poses.frames, seconds_of(detected.times)
    half = mapped(~even)
    known, refined = map_of_survey(half), half.found.calibrated[0].found
    there = np.isfinite(frames[:, 0, 0])
    turns = Rotation.from_matrix(frames[there, :3, :3]).as_quat()
    turns *= np.cumprod(np.append(1.0, np.sign((turns[1:] * turns[:-1]).sum(axis=1))))[:, None]
    own, first = seconds[there], seconds[there][0]
    splines = [make_smoothing_spline(own - first, x) for x in np.hstack([frames[there, :3, 3], turns]).T]
    dense = np.arange(first, own[-1], 1.0 / RATE)
    rows = np.stack([spline(dense - first) for spline in splines], axis=1)
    smooth = pose_of(Rotation.from_quat(rows[:, 3:]).as_matrix(), rows[:, :3])

    def localised(seed: int, injected: float) -> tuple[Estimate, FloatArray, Trajectory]:
        odometry = drifting(dense + injected, smooth, np.random.default_rng(seed))
        some, drive = detected.of(np.flatnonzero(even)), Drive(odometry=odometry)
        result = localise(some, [refined], tag, errors, known, drive)
        assert result.smoothed is not None
        return result.smoothed, result.found.poses.frames, odometry

    def surveyed(seed: int, injected: float) -> tuple[Estimate, None, Trajectory]:
        odometry = drifting(dense + injected, smooth, np.random.default_rng(seed))
        return mapped(every, odometry).found, None, odometry

    print(f"{CLOCKS}\n| --- |" + " --- |" * 9)
    for name, found_of in (("even frames, localise", localised), ("all frames, survey", surveyed)):
        if only in name:
            print_clocks(name, range(seeds), found_of)


def main() -> None:
    """Read the command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parts = parser.add_subparsers(dest="part", required=True)
    part = parts.add_parser("recorded")
    part.add_argument("folder", type=Path)
    part.add_argument("edge", type=float)
    for one, seeds in ((parts.add_parser("simulated"), 40), (part, 4)):
        one.add_argument("--seeds", type=int, default=seeds)
        one.add_argument("--only", default="", help="part of the name of a row")
        one.add_argument("--picture", type=Path)
    args = vars(parser.parse_args())
    picture = args.pop("picture")
    {"simulated": simulated, "recorded": recorded}[args.pop("part")](**args)
    if picture is not None:
        save_picture(picture)


if __name__ == "__main__":
    main()
