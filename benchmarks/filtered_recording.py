"""Does a filter know its pose as well as it says on a real recording?

python benchmarks/filtered_recording.py FOLDER EDGE

FOLDER has `detections.csv` and `cameras.yaml` of one camera, EDGE is that of the tags, metres. The reference is the
survey of all tags. For `--drives` random choices of `--tags` tags, estimators see these tags alone, with the corners as
they were detected, and odometry made of the reference with a slow drift. Prints the share of the frames
in which the position is within several tolerances, predicted by the covariances of the estimators and reached, for the
noise of corners by the survey, as measured beside the reference, `lasting_noise`, and the default of the objective
`filtered`.
"""

import argparse
from dataclasses import replace
from pathlib import Path

import numpy as np

from lmd.adjust.sightings import SQUARE
from lmd.core.checks import FloatArray
from lmd.detection.corner_errors import CORNER_ERRORS
from lmd.estimation.estimators import errors_of
from lmd.estimation.fusion import FixedLagSmoother, InvariantKalmanFilter
from lmd.estimation.recording import Odometry, Recording
from lmd.estimation.sensors import observation
from lmd.formats.calibrations import calibrated_camera
from lmd.formats.detection_formats import read_detections
from lmd.geometry.projection import project
from lmd.geometry.se3 import act, exp
from lmd.geometry.trajectory import Trajectory
from lmd.scene.tag import Tag
from lmd.survey.knowledge import PriorKnowledge
from lmd.survey.survey import Survey, survey

SLOW = Odometry(0.001, 0.005)
START = 0.1, 0.05  # standard deviations of the first estimate, metres and rad
TOLERANCES = (0.005, 0.01, 0.02)  # metres
DEFAULT = 0.5  # pixel_noise of the objective
ALIKE_FRAMES = 10  # number of later images with which errors of corners are compared
LAGS = (1, 2, 5, 10, 20, 50)  # frames


def surveyed(folder: Path, edge: float) -> tuple[Survey, FloatArray]:
    """Survey of all detections, and the times of the frames, seconds."""
    detected = read_detections(folder / "detections.csv")
    camera = calibrated_camera(str(folder / "cameras.yaml"), "cam0")
    found = survey(detected, [camera], Tag(edge), CORNER_ERRORS["apriltag"], PriorKnowledge())
    return found, np.array([float(time) for time in detected.times])


def recorded(found: Survey, times: FloatArray, tags: int, drives: int, seed: int) -> Recording:
    """Recording with a run for each random choice of tags that were seen in at least a tenth of the frames."""
    some, rng = found.found.sightings, np.random.default_rng(seed)
    known = np.flatnonzero(np.isfinite(found.found.poses.frames[:, 0, 0]))
    camera, poses = found.found.calibrated[0].found, found.found.poses.frames[known]
    often = np.flatnonzero(found.placed & (some.counts() > len(known) / 10))
    place = np.full(some.frames, -1)
    place[known] = np.arange(len(known))
    path = Trajectory(times[known] - times[known[0]], poses)
    parts, chosen, twists = [], [], []
    for _ in range(drives):
        own = rng.choice(often, tags, replace=False)
        column = np.full(len(some.ids), -1)
        column[own] = np.arange(tags)
        rows = np.flatnonzero((column[some.tag] >= 0) & (place[some.frame] >= 0))
        rows = rows[np.lexsort((column[some.tag[rows]], some.frame[rows]))]
        seen = np.zeros((len(known), tags), dtype=np.bool_)
        seen[place[some.frame[rows]], column[some.tag[rows]]] = True
        noise = CORNER_ERRORS["apriltag"].independent_sigma(some.pitch[rows])
        parts.append(observation(camera, some.edges[own], seen, some.image[rows], np.hypot(noise, found.found.floor)))
        chosen.append(own)
        twists.append(SLOW.measured(path.twists, np.diff(path.time), rng))
    corners = act(found.found.poses.tags[chosen], 0.5 * some.edges[chosen][..., None, None] * SQUARE)
    return Recording(
        path.time, np.repeat(poses[None], drives, axis=0), np.stack(twists), SLOW,
        found.found.poses.tags[chosen][..., :3, 3], camera,
        np.stack([part.seen for part in parts]), np.stack([part.points for part in parts]),
        np.concatenate([part.noise for part in parts]), np.concatenate([part.covariance for part in parts]),
        corners, np.concatenate([part.corners for part in parts if part.corners is not None]),
    )  # fmt: skip


def corner_errors(recording: Recording) -> FloatArray:
    """Errors of the corners, pixels, `(S, T, K, 4, 2)`; NaN for tags that are not seen."""
    assert recording.tags is not None
    assert recording.corners is not None
    error = np.full((*recording.seen.shape, 4, 2), np.nan)
    for own, seen, poses, tags in zip(error, recording.seen, recording.poses, recording.tags, strict=True):
        own[seen] = project(recording.camera, poses, tags.reshape(-1, 3)).reshape(own.shape)[seen]
    error[recording.seen] = recording.corners - error[recording.seen]
    return error


def correlation(error: FloatArray, lag: int) -> float:
    """Correlation of the errors of a corner with those `lag` frames later."""
    return float(np.nanmean(error[:, : error.shape[1] - lag] * error[:, lag:]) / np.nanmean(error**2))


def lasting_noise(error: FloatArray) -> float:
    """Noise of corners, pixels, that would leave as much in a mean over seconds if it were independent in each image.

    sigma (1 + 2 sum rho)^1/2 with the correlations rho of the errors `(S, T, ...)` over up to `ALIKE_FRAMES` images.
    """
    rho = [correlation(error, lag) for lag in range(1, ALIKE_FRAMES + 1)]
    return float(np.sqrt(np.nanmean(error**2) * (1.0 + 2.0 * sum(rho))))


def within(covariances: FloatArray, limit: float) -> FloatArray:
    """Probability of a position error of at most a limit, metres, for covariances `(..., 3, 3)`; 0 for NaN."""
    known = np.isfinite(covariances).all(axis=(-2, -1))
    squares = np.random.default_rng(0).standard_normal((2000, 3)) ** 2
    found = np.zeros(known.shape)
    parts = np.array_split(np.linalg.eigvalsh(covariances[known]), 100)
    found[known] = np.concatenate([(part @ squares.T <= limit**2).mean(axis=1) for part in parts])
    return found


def shares(values: FloatArray) -> str:
    """Mean over the runs `(S, T)`, per cent, with its standard error."""
    by_run = 100.0 * values.mean(axis=1)
    return f"{by_run.mean():.1f} +- {by_run.std(ddof=1) / np.sqrt(len(by_run)):.1f}"


def main() -> None:
    """Run the command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("edge", type=float)
    parser.add_argument("--tags", type=int, default=3)
    parser.add_argument("--drives", type=int, default=40)
    given = parser.parse_args()
    found, times = surveyed(given.folder, given.edge)
    recording = recorded(found, times, given.tags, given.drives, 0)
    error, time = corner_errors(recording), recording.time
    size = float(np.sqrt(np.nanmean(error**2)))
    alike = ", ".join(f"{lag}: {correlation(error, lag):.2f}" for lag in LAGS)
    print(f"{given.drives} choices of {given.tags} tags, {len(time)} frames in {time[-1]:.0f} s, "
          f"{(recording.visible_counts > 0).mean():.0%} with a tag; corners off by {size:.2f} pixels, "
          f"correlation after {alike} frames\n")  # fmt: skip
    print(f"| noise, pixels | | {' | '.join(f'within {1e3 * limit:g} mm, %' for limit in TOLERANCES)} | NEES / dof |")
    print(f"| ---: | --- |{' ---: |' * (len(TOLERANCES) + 1)}")
    rng = np.random.default_rng(1)
    first = recording.poses[:, 0] @ exp(np.repeat([START[1], START[0]], 3) * rng.standard_normal((given.drives, 6)))
    estimators = {
        "IEKF": InvariantKalmanFilter(START[1], START[0], measured="corners"),
        "smoother": FixedLagSmoother(START[1], START[0]),
    }
    for label, noise in (
        ("survey", recording.noise),
        ("measured", size),
        ("lasting", lasting_noise(error)),
        ("objective", DEFAULT),
    ):
        assumed = replace(recording, noise=np.broadcast_to(noise, recording.noise.shape))
        text = f"{np.median(assumed.noise):.2f} ({label})"
        for name, estimator in estimators.items():
            runs = [list(estimator.run(assumed, s, start)) for s, start in enumerate(first)]
            errors = errors_of(assumed, first, lambda _, s, start, runs=runs: iter(runs[s]))  # noqa: ARG005 # already run
            covariances = np.array([[covariance[3:, 3:] for _, covariance in run] for run in runs])
            told = [shares(within(covariances, limit)) for limit in TOLERANCES]
            reached = [shares(errors.position <= limit) for limit in TOLERANCES]
            assert errors.squares is not None
            print(f"| {text} | {name}, predicted | {' | '.join(told)} | |")
            nees = np.nanmean(errors.squares[..., 2]) / 3.0
            print(f"| {text} | {name} | {' | '.join(reached)} | {nees:.2f} |", flush=True)


if __name__ == "__main__":
    main()
