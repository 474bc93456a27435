"""Localisation in a fixed map where the truth is known, and on a real recording.

python benchmarks/localise.py real FOLDER EDGE            # map of one half of the frames, the other half localised
python benchmarks/localise.py own FOLDER EDGE [--cameras 2]   # the frames of a survey in its own map, beside the survey
PYTHONPATH=tests python benchmarks/localise.py speed      # 2,000 frames of 5 tags: seconds of one processor
PYTHONPATH=tests python benchmarks/localise.py changes [--drives 100] [--moved 20]   # false alarms and misses
PYTHONPATH=tests python benchmarks/localise.py truth [--seeds 40]   # errors beside those stated, in rooms by OpenCV

FOLDER has `detections.csv` and `cameras.yaml`, with cameras `cam0`, `cam1`, ...
"""

import argparse
import sys
import time
from pathlib import Path

import numpy as np

from lmd.adjust.gauge import align_tags
from lmd.core.checks import BoolArray, FloatArray
from lmd.detection.corner_errors import CORNER_ERRORS
from lmd.formats.calibrations import calibrated_camera
from lmd.formats.detection_formats import read_detections
from lmd.formats.detections import DetectedTags
from lmd.geometry.camera import Camera
from lmd.geometry.se3 import camera_pose, inverse, log
from lmd.localise.fixed_map import LEAST_SIGMA, FixedMap
from lmd.localise.localise import Drive, localise
from lmd.scene.tag import Tag
from lmd.survey.knowledge import PriorKnowledge
from lmd.survey.results import map_covariance
from lmd.survey.survey import Survey, survey


def map_of_survey(found: Survey) -> FixedMap:
    """Map of a survey, with its covariance."""
    ids, _, covariance = map_covariance(found)
    placed = np.searchsorted(found.ids, ids)
    sigmas = np.maximum(np.sqrt(np.diag(covariance)).reshape(-1, 6), LEAST_SIGMA)
    return FixedMap(
        ids, found.found.poses.tags[placed], found.found.sightings.present_edges[placed], sigmas, covariance
    )


def squares(frames: FloatArray, covariances: FloatArray, true: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Errors of poses, twists `(n, 6)`, and squared normalised errors, `(n,)`."""
    known = np.isfinite(frames[:, 0, 0]) & np.isfinite(true[:, 0, 0])
    off = log(inverse(frames[known]) @ true[known])
    return off, np.einsum("ni,nij,nj->n", off, np.linalg.inv(covariances[known]), off)


def line(name: str, off: FloatArray, square: FloatArray) -> str:
    """Row of a table."""
    away, turn = np.linalg.norm(off[:, 3:], axis=1), np.linalg.norm(off[:, :3], axis=1)
    cells = [f"{np.median(1e3 * away):.2f}, {np.quantile(1e3 * away, 0.9):.2f}", f"{np.median(1e3 * turn):.2f}"]
    cells += [f"{np.median(square) / 5.348:.2f}", f"{square.mean() / 6.0:.2f}", f"{(square <= 16.81).mean():.1%}"]
    return f"| {name} | {len(off)} | {' | '.join(cells)} |"


def real(folder: Path, edge: float) -> None:
    """Map a part of the frames, localise the others, and compare with the survey of all, and of the others alone."""
    detected = read_detections(folder / "detections.csv")
    camera, tag, errors = calibrated_camera(str(folder / "cameras.yaml"), "cam0"), Tag(edge), CORNER_ERRORS["apriltag"]

    def mapped(own: BoolArray) -> Survey:
        return survey(detected.of(np.flatnonzero(own)), [camera], tag, errors, PriorKnowledge())

    whole = mapped(detected.frame >= 0)
    third = detected.frame // (len(detected.times) // 15) % 3
    parts = {"the first half": detected.frame < len(detected.times) // 2, "odd frames": detected.frame % 2 == 1}
    parts |= {"the second half": ~parts["the first half"], "even frames": ~parts["odd frames"]}
    parts |= {f"stretches {k + 1} of 3": third != k for k in range(3)}
    print("| map of | beside | poses | frames | off, median, 90 %, mm | turn, mrad | chi², median | mean | 99 % |")
    print("| --- |" + " --- |" * 8)
    told = []
    for name, own in parts.items():
        half, other = mapped(own), mapped(~own)
        known = map_of_survey(half)
        began = time.process_time()
        result = localise(detected.of(np.flatnonzero(~own)), [half.found.calibrated[0].found], tag, errors, known)
        seconds = time.process_time() - began
        for beside, truth in (("all", whole), ("the others", other)):
            both = np.flatnonzero(truth.placed & np.isin(truth.ids, known.ids))
            own_tags = known.poses[np.searchsorted(known.ids, truth.ids[both])]
            motion = align_tags(own_tags, truth.found.poses.tags[both])
            assert motion is not None
            true, smoothed = inverse(motion) @ truth.found.poses.frames, result.smoothed
            row = f"{name} | {beside}"
            print(line(f"{row} | single", *squares(result.found.poses.frames, result.found.frame_covariances, true)))
            if smoothed is not None:
                print(
                    line(f"{row} | smoothed", *squares(smoothed.poses.frames, smoothed.frame_covariances, true)),
                    flush=True,
                )
        moved = [one for one in result.changes if one.kind == "moved"]
        named = (f"{one.tag} by {1e3 * np.linalg.norm(one.shift):.1f} mm, chi² {one.chi_square:.0f}" for one in moved)
        told.append(
            f"map of {name}: {len(moved)} of {np.isfinite(result.comparison.squares).sum()} moved: {', '.join(named)}; "
            f"{result.comparison.contradicted} contradict; inflation {result.found.inflation:.1f}; {seconds:.1f} s"
        )
    print("\n".join(told))


def own(folder: Path, edge: float, cameras: int) -> None:
    """Localise the frames of a survey in its own map, with its cameras and mounts, and compare the poses."""
    detected, tag, errors = read_detections(folder / "detections.csv"), Tag(edge), CORNER_ERRORS["apriltag"]
    given = [calibrated_camera(str(folder / "cameras.yaml"), f"cam{number}") for number in range(cameras)]
    surveyed = survey(detected, given, tag, errors, PriorKnowledge())
    known, whole = map_of_survey(surveyed), surveyed.found
    drive = Drive(whole.poses.mounts if cameras > 1 else None)
    result = localise(detected, [one.found for one in whole.calibrated], tag, errors, known, drive)
    print("| poses | frames | off, mm: median, 90 %, greatest | stated, mm | chi²/6, mean | within 3 sigma |")
    print("| --- |" + " --- |" * 5)
    for name, found in (("single images", result.found), ("smoothed", result.smoothed)):
        if found is None:
            continue
        both = found.poses.known_frames & whole.poses.known_frames
        stated = (found.frame_covariances + whole.frame_covariances)[both]
        off, square = squares(found.poses.frames[both], stated, whole.poses.frames[both])
        away, sigma = np.linalg.norm(off[:, 3:], axis=1), np.sqrt(np.trace(stated[:, 3:, 3:], axis1=1, axis2=2))
        most = ", ".join(f"{1e3 * value:.2f}" for value in np.quantile(away, (0.5, 0.9, 1.0)))
        cells = (
            f"{most} | {1e3 * np.median(sigma):.2f} | {square.mean() / 6.0:.3f} | {(away <= 3.0 * sigma).mean():.1%}"
        )
        print(f"| {name} | {both.sum()} | {cells} |")


def speed(frames: int, tags: int, each: int) -> None:
    """Time of one processor, everything but reading files."""
    from support import walks

    rng = np.random.default_rng(0)
    true = walks.spaced_tags(tags, rng)
    place = rng.uniform([1.2, 1.0, 1.0], [3.8, 3.0, 1.7], (frames // 50, 3))
    corners = np.repeat(place, 50, axis=0) + rng.normal(0.0, 0.05, (frames // 50 * 50, 3))
    yaw = np.cumsum(rng.normal(0.0, 0.1, len(corners)))
    poses = camera_pose(corners, yaw, rng.normal(0.0, 0.1, len(corners)), rng.normal(0.0, 0.1, len(corners)))
    wide = Camera(3.2, 0.0048, 0.0048, (800.0, 600.0), 1600, 1200, 0.0)
    seen = walks.photographed(true, poses, rng, 0.2, wide)
    order = np.lexsort((rng.uniform(size=len(seen)), seen.frame))
    rank = np.arange(len(order)) - np.searchsorted(seen.frame[order], seen.frame[order])
    some = seen.of(np.sort(order[rank < each]))
    times = tuple(f"{0.05 * k:.3f}" for k in range(len(some.times)))
    some = DetectedTags(times, some.cameras, some.frame, some.camera, some.ids, some.corners, in_order=True)
    known = FixedMap(np.arange(tags), true, np.full(tags, walks.EDGE), np.full((tags, 6), 1e-3))
    began = time.process_time()
    result = localise(some, [wide], Tag(walks.EDGE), walks.constant_errors(0.2), known)
    took = time.process_time() - began
    assert result.smoothed is not None
    print(f"{len(times)} frames, {len(some)} sightings of {tags} tags: {took:.1f} s of one processor, "
          f"{result.found.poses.known_frames.sum()} localised")  # fmt: skip


def changes(drives: int, moved: float) -> None:
    """False alarms and misses of simulated walks; in every other walk a tag was moved in a random direction."""
    from support import localisations

    alarms = compared = found = tried = 0
    off: list[float] = []
    for seed in range(drives):
        rng = np.random.default_rng(1000 + seed)
        way, tag = rng.normal(size=3), int(rng.integers(16))
        shift = np.r_[np.zeros(3), moved / 1e3 * way / np.linalg.norm(way)]
        walk = localisations.walked(seed, moved={tag: shift} if seed % 2 else None)
        result = localisations.localised(walk)
        named = {one.tag: float(np.linalg.norm(one.shift)) for one in result.changes if one.kind == "moved"}
        if seed % 2:
            tried += 1
            if tag in named:
                found += 1
                off.append(abs(1e3 * named.pop(tag) - moved))
        alarms, compared = alarms + len(named), compared + np.isfinite(result.comparison.squares).sum()
    print(f"{drives} walks: {alarms} false alarms of {compared} tags; "
          f"moved by {moved:g} mm: found {found} of {tried}, "
          f"distance off by at most {max(off, default=np.nan):.1f} mm")  # fmt: skip


def truth(seeds: int) -> None:
    """Errors of smoothed poses beside those stated, of each scenario of `tests/localise/opencv_rooms.py`."""
    sys.path.append(str(Path(__file__).parents[1] / "tests" / "localise"))
    import opencv_rooms

    print("| scenario | walks | failed | chi²/6, 10, 50, 90, 100 % | in .2 to 3 | off, mm | stated, mm | localised |")
    print("| --- |" + " --- |" * 7)
    for name in opencv_rooms.NAMES:
        rows = []
        for seed in range(seeds):
            walk = opencv_rooms.scenario(name, seed)
            result = walk.localised()
            if result.smoothed is not None:
                rows.append((*opencv_rooms.figures(walk, result), float(result.smoothed.poses.known_frames.mean())))
        square, off, stated, localised = np.array(rows).T
        levels = ", ".join(f"{level:.2f}" for level in np.quantile(square, (0.1, 0.5, 0.9, 1.0)))
        cells = [levels, f"{((square > 0.2) & (square < 3.0)).mean():.0%}"]
        cells += [f"{1e3 * np.median(off):.2f}", f"{1e3 * np.median(stated):.2f}", f"{localised.mean():.1%}"]
        print(f"| {name} | {seeds} | {seeds - len(rows)} | {' | '.join(cells)} |", flush=True)


def main() -> None:
    """Read the command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parts = parser.add_subparsers(dest="part", required=True)
    part = parts.add_parser("real")
    part.add_argument("folder", type=Path)
    part.add_argument("edge", type=float)
    part = parts.add_parser("own")
    part.add_argument("folder", type=Path)
    part.add_argument("edge", type=float)
    part.add_argument("--cameras", type=int, default=1)
    part = parts.add_parser("speed")
    part.add_argument("--frames", type=int, default=2000)
    part.add_argument("--tags", type=int, default=30)
    part.add_argument("--each", type=int, default=5)
    part = parts.add_parser("changes")
    part.add_argument("--drives", type=int, default=100)
    part.add_argument("--moved", type=float, default=20.0)
    part = parts.add_parser("truth")
    part.add_argument("--seeds", type=int, default=40)
    args = vars(parser.parse_args())
    {"real": real, "own": own, "speed": speed, "changes": changes, "truth": truth}[args.pop("part")](**args)


if __name__ == "__main__":
    main()
