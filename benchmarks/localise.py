"""Localisation in a fixed map where the truth is known, and on a real recording.

python benchmarks/localise.py real FOLDER EDGE            # map of one half of the frames, the other half localised
PYTHONPATH=tests python benchmarks/localise.py speed      # 2,000 frames of 5 tags: seconds of one processor
PYTHONPATH=tests python benchmarks/localise.py changes [--drives 100] [--moved 20]   # false alarms and misses

FOLDER has `detections.csv` and `cameras.yaml` of one camera.
"""

import argparse
import time
from pathlib import Path

import numpy as np

from lmd.core.checks import FloatArray
from lmd.detection.corner_errors import CORNER_ERRORS
from lmd.formats.calibrations import calibrated_camera
from lmd.formats.detection_formats import read_detections
from lmd.formats.detections import DetectedTags
from lmd.geometry.camera import Camera
from lmd.geometry.se3 import camera_pose, inverse, log
from lmd.localise.fixed_map import LEAST_SIGMA, FixedMap
from lmd.localise.localise import localise
from lmd.scene.tag import Tag
from lmd.survey.gauge import align_tags
from lmd.survey.prior import PriorKnowledge
from lmd.survey.survey import Survey, survey


def map_of_survey(found: Survey) -> FixedMap:
    """Map of a survey, with its standard deviations."""
    placed = np.flatnonzero(found.placed)
    squares = np.diagonal(found.found.gauge_free_covariances[placed], axis1=1, axis2=2)
    sigmas = np.maximum(np.sqrt(np.maximum(squares, 0.0)), LEAST_SIGMA)
    return FixedMap(found.ids[placed], found.found.poses.tags[placed], found.found.sightings.edges[placed], sigmas)


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
    """Map half of the frames, localise the others, and compare with the survey of all."""
    detected = read_detections(folder / "detections.csv")
    camera, tag, errors = calibrated_camera(str(folder / "cameras.yaml"), "cam0"), Tag(edge), CORNER_ERRORS["apriltag"]
    first = detected.frame < len(detected.times) // 2
    print("| map of | poses | frames | off, median, 90 %, mm | off, median, mrad | chi², median | mean | within 99 % |")
    print("| --- |" + " --- |" * 7)
    whole = survey(detected, [camera], tag, errors, PriorKnowledge())
    for name, own in (("the first half", first), ("the second half", ~first), ("odd frames", detected.frame % 2 == 1)):
        half = survey(detected.of(np.flatnonzero(own)), [camera], tag, errors, PriorKnowledge())
        known = map_of_survey(half)
        began = time.process_time()
        rest = detected.of(np.flatnonzero(~own))
        result = localise(rest, [half.calibrated[0].found], tag, errors, known)
        seconds = time.process_time() - began
        both = np.flatnonzero(whole.placed & np.isin(whole.ids, known.ids))
        there = whole.found.poses.tags[both]
        motion = align_tags(known.poses[np.searchsorted(known.ids, whole.ids[both])], there)
        assert motion is not None
        true = inverse(motion) @ whole.found.poses.frames
        for kind, poses in (("single images", result.found), ("smoothed", result.smoothed)):
            if poses is None:
                continue
            frames = result.found.poses.frames if kind == "single images" else poses.frames  # type: ignore[union-attr]
            print(line(f"{name} | {kind}", *squares(frames, poses.covariances, true)), flush=True)
        told = f"{len(result.changes.moved)} of {len(result.changes.compared)} moved"
        moved = ", ".join(f"{one.tag} by {1e3 * one.metres:.1f} mm" for one in result.changes.moved)
        refused = sum(state.name not in ("LOCALISED", "NO_TAG") for state in result.found.states)
        print(f"{told}: {moved or 'none'}; {result.changes.contradicted} contradict; "
              f"vanished: {result.vanished or 'none'}; "
              f"inflation {result.changes.inflation:.1f}; refused {refused}; {seconds:.1f} s", flush=True)  # fmt: skip


def speed(frames: int, tags: int, each: int) -> None:
    """Time of one processor, everything but reading files."""
    import walks

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
          f"{result.found.localised.sum()} localised")  # fmt: skip


def changes(drives: int, moved: float) -> None:
    """False alarms and misses of simulated walks; in every other walk a tag was moved in a random direction."""
    import localise_drives

    alarms = compared = found = tried = gone = 0
    off: list[float] = []
    for seed in range(drives):
        rng = np.random.default_rng(1000 + seed)
        way, tag = rng.normal(size=3), int(rng.integers(16))
        shift = np.r_[np.zeros(3), moved / 1e3 * way / np.linalg.norm(way)]
        walk = localise_drives.walked(seed, moved={tag: shift} if seed % 2 else None)
        result = localise_drives.localised(walk)
        named = {one.tag: one.metres for one in result.changes.moved}
        if seed % 2:
            tried += 1
            if tag in named:
                found += 1
                off.append(abs(1e3 * named.pop(tag) - moved))
        alarms, gone = alarms + len(named), gone + len(result.vanished)
        compared += len(result.changes.compared)
    print(f"{drives} walks: {alarms} false alarms of {compared} tags, {gone} taken for vanished; "
          f"moved by {moved:g} mm: found {found} of {tried}, "
          f"distance off by at most {max(off, default=np.nan):.1f} mm")  # fmt: skip


def main() -> None:
    """Read the command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parts = parser.add_subparsers(dest="part", required=True)
    own = parts.add_parser("real")
    own.add_argument("folder", type=Path)
    own.add_argument("edge", type=float)
    own = parts.add_parser("speed")
    own.add_argument("--frames", type=int, default=2000)
    own.add_argument("--tags", type=int, default=30)
    own.add_argument("--each", type=int, default=5)
    own = parts.add_parser("changes")
    own.add_argument("--drives", type=int, default=100)
    own.add_argument("--moved", type=float, default=20.0)
    args = vars(parser.parse_args())
    {"real": real, "speed": speed, "changes": changes}[args.pop("part")](**args)


if __name__ == "__main__":
    main()
