"""Judge estimators by their own covariances, from far starts and with a biased gyro: `python benchmarks/estimators.py`.

S flights (`--flights`) in the paper's room over 90 uniform tags of 0.10 m, corners with the errors of ArUco, odometry
`fast`. Prints a Markdown table for each gyro, unbiased and with a bias of `BIAS` rad/s:

- NEES over its degrees of freedom after `SETTLED` seconds, jointly, of rotation and of position, and the share of
  moments in which the mean over the flights is within its 99 % chi-square interval;
- from 60 degrees and 2 m: the median over the flights of the joint NEES, the number of flights below `SOUND`, the
  number of flights that converge, and their median time;
- errors, and the cost for each frame over that of `iekf`.

With `--points`, landmarks are points with three measured numbers whose errors are normal, as the filters assume.
`--picture FILE` draws the NEES over time. Two minutes of a processor for 30 flights.
"""

import argparse
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from hydra import compose, initialize_config_dir
from scipy.stats import chi2

from lmd.core.checks import BoolArray, FloatArray
from lmd.core.words import markdown_table
from lmd.estimation.estimators import DEGREES, pose_errors, squares
from lmd.estimation.flights import Pace, RandomMotion
from lmd.estimation.fusion import CameraPoints, FixedLagSmoother, InvariantKalmanFilter, Uncertainty
from lmd.estimation.gyro_bias import EquivariantFilter
from lmd.estimation.observer import Observer
from lmd.estimation.pnp import PerspectiveNPoint
from lmd.estimation.recording import Flight, Odometry, Recording, record
from lmd.estimation.sensors import PointDetector, TagDetector
from lmd.estimation.study import InitialError
from lmd.geometry.se3 import act, adjoint_matrix, exp, inverse, skew
from lmd.pipelines.app import CONF
from lmd.pipelines.building import build_problem
from lmd.plot.common import new_figure, shrink

EDGE, COUNT, SECONDS, RATE = 0.10, 90, 20.0, 10.0
BIAS, WALK = 0.02, 0.0005  # rad/s, rad/s per root second
NEAR, FAR = 0.1, InitialError(2.0, np.radians(60.0))
SETTLED = 5.0  # seconds after which errors and NEES count
# Errors from which on an estimate has converged, if it keeps them for `KEPT` seconds.
CLOSE_M, CLOSE_RAD, KEPT = 0.2, 0.1, 2.0
SOUND = 2.0  # joint NEES over its degrees of freedom below which a flight from afar is consistent
WITHOUT_START = ("pnp", "smoother")  # begin with the first frame that determines the pose alone

Run = Callable[[Recording, int, FloatArray], Iterator[tuple[FloatArray, FloatArray]]]


@dataclass(frozen=True)
class Contender:
    """Estimator with the covariances that it states."""

    estimator: Any
    """The estimator, whose cost is measured."""
    run: Run
    """Poses and covariances of a run."""


def contenders(attitude: float, position: float) -> dict[str, Contender]:
    """Estimators that assume standard deviations of the first estimate, rad and metres."""
    given = attitude, position
    found: dict[str, Any] = {
        "iekf": InvariantKalmanFilter(*given),
        "eqf": EquivariantFilter(*given),
        "smoother": FixedLagSmoother(*given),
        "pnp": PerspectiveNPoint(),
    }
    listed = {name: Contender(one, one.run) for name, one in found.items()}
    for name, form in (("observer", "right"), ("left_observer", "left")):
        observer = Observer(form)
        listed[name] = Contender(observer, partial(with_covariances, observer, found["iekf"]))
    return listed


def interval(degrees: int, count: float, probability: float = 0.99) -> tuple[float, float]:
    """Chi-square interval of the mean of `count` independent squares over their degrees of freedom."""
    tails = np.array([1.0 - probability, 1.0 + probability]) / 2.0
    low, high = chi2.ppf(tails, degrees * count) / (degrees * count)
    return float(low), float(high)


def with_covariances(
    observer: Observer, assumed: Uncertainty, recording: Recording, s: int, start: FloatArray
) -> Iterator[tuple[FloatArray, FloatArray]]:
    """Estimates of run s, `(4, 4)` each, and the covariances of their errors as body twists, `(6, 6)`, to first order.

    The observer states no covariance, but its gains are known. With the error X = Xh exp(x), landmarks move by y_i =
    yh_i + H_i x + n_i with H_i = [[yh_i]x  -I], and a correction is xi = sum G_i (yh_i - y_i) with

    - left-invariant:   G_i = (k_i [yh_i]x / l^2, (k_i + k_0 / m) I),
    - right-invariant:  G_i = Ad_Xh^-1 (k_i [C_i]x R / l^2, k_i R) + (0, k_0 / m I),

    so that x <- (I + h sum G_i H_i) x + h sum G_i n_i. A step of odometry has x <- Ad_exp(-h U) x + n.

    Args:
        observer: observer with its gains.
        assumed: uncertainty of the first estimate, and lower bounds on the noise.
        recording, s, start: as in `lmd.estimation.fusion.InvariantKalmanFilter.run`.
    """
    centroid = recording.landmarks[s].mean(axis=0)
    density, covariance = np.diag(assumed.drift(recording) ** 2), np.diag(assumed.initial**2)
    pose = start.copy()
    pose[:3, 3] -= centroid
    landmarks = recording.landmarks[s] - centroid
    for t, step in enumerate([0.0, *np.diff(recording.time)]):
        if t > 0:
            motion = exp(step * recording.twists[s, t - 1])
            pose, moved = pose @ motion, adjoint_matrix(inverse(motion))
            covariance = moved @ covariance @ moved.T + step * density
            seen = recording.seen[s, t]
            if seen.any():
                correction = observer.correction(pose, landmarks, recording.points[s, t], seen)
                gains = step * _gains(observer, pose, landmarks, recording.points[s, t], seen)
                places = CameraPoints.of(recording, s, t, assumed)
                kept = np.eye(6) + gains @ places._replace(landmarks=landmarks[seen]).predicted(pose)[1]
                covariance = kept @ covariance @ kept.T + gains @ places.covariance @ gains.T
                pose = pose @ exp(step * correction)
        there = pose.copy()
        there[:3, 3] += centroid
        yield there, covariance


def _gains(
    observer: Observer, pose: FloatArray, landmarks: FloatArray, measured: FloatArray, seen: BoolArray
) -> FloatArray:
    """Gains G_i of the m landmarks in view, `(6, 3 m)`."""
    k = float(observer.landmark_gain(landmarks, measured, seen))
    m, places = int(seen.sum()), landmarks[seen]
    if observer.form == "left":
        arms, turn, moved = act(inverse(pose), places), np.eye(3), np.eye(6)
    else:
        arms, turn, moved = places, pose[:3, :3], adjoint_matrix(inverse(pose))
    blocks = np.concatenate([k / observer.length**2 * skew(arms), np.broadcast_to(k * np.eye(3), (m, 3, 3))], axis=1)
    gains = moved @ blocks @ turn
    gains[:, 3:] += observer.damping / m * np.eye(3)
    return np.asarray(gains.transpose(1, 0, 2).reshape(6, 3 * m))


def recordings(odometry: Odometry, points: bool, flights: int) -> Recording:
    """Record the flights."""
    with initialize_config_dir(CONF, version_base="1.3"):
        settings = ["deployment=uniform", f"deployment.count={COUNT}", f"tag.edge={EDGE}", "threads=1"]
        problem = build_problem(compose("evaluate", settings))
    tags, motion = problem.draw(np.random.default_rng(0)), RandomMotion(SECONDS, Pace(1.0, 1.0, RATE))
    rngs = [np.random.default_rng([seed, 1]) for seed in range(flights)]
    flown = [
        Flight(problem.evaluator, tags, motion.draw(problem.scene, np.random.default_rng(seed)), rng)
        for seed, rng in enumerate(rngs)
    ]
    return record(PointDetector(0.5) if points else TagDetector(problem.scene.tag, "aruco"), flown, odometry)


def converged(recording: Recording, poses: FloatArray) -> FloatArray:
    """Seconds after which each run `(S, T, 4, 4)` keeps close to the truth; infinite if it never does, `(S,)`."""
    errors, kept = pose_errors(recording.poses, poses), round(KEPT * RATE)
    close = (errors.position < CLOSE_M) & (errors.attitude < CLOSE_RAD)
    windows = np.lib.stride_tricks.sliding_window_view(close, kept, axis=1).all(axis=-1)
    return np.where(windows.any(axis=1), recording.time[windows.argmax(axis=1)], np.inf)


def figures(name: str, recording: Recording, near: FloatArray, far: FloatArray) -> tuple[dict[str, Any], FloatArray]:
    """Figures of an estimator, and its squares `(S, T, 3)` from near starts."""
    close, vague = contenders(NEAR, NEAR)[name], contenders(FAR.attitude, FAR.position)[name]
    began = time.process_time()
    errors = close.estimator.errors(recording, near)
    cost = (time.process_time() - began) / errors.position.size
    runs = [list(close.run(recording, s, near[s])) for s in range(len(near))]
    nees = np.stack([squares(run, true) for run, true in zip(runs, recording.poses, strict=True)])
    found: dict[str, Any] = {"cost": cost}
    first = round(SETTLED * RATE)
    if name not in WITHOUT_START:
        away = [list(vague.run(recording, s, far[s])) for s in range(len(far))]
        found["seconds"] = converged(recording, np.array([[pose for pose, _ in run] for run in away]))
        distant = np.stack([squares(run, true) for run, true in zip(away, recording.poses, strict=True)])
        found["far"] = np.nanmean(distant[:, first:, 0], axis=1) / DEGREES["joint"]
    for i, (part, degrees) in enumerate(DEGREES.items()):
        counts = np.isfinite(nees[:, first:, i]).sum(axis=0)
        moments = np.nanmean(nees[:, first:, i], axis=0) / degrees
        bounds = np.array([interval(degrees, max(int(count), 1)) for count in counts])
        found[part] = float(np.nanmean(nees[:, first:, i])) / degrees
        found[f"{part}_within"] = float(((moments > bounds[:, 0]) & (moments < bounds[:, 1]))[counts > 0].mean())
    found["position_rmse"] = float(np.sqrt(np.nanmean(errors.position[:, first:] ** 2)))
    found["rotation_rmse"] = float(np.sqrt(np.nanmean(errors.attitude[:, first:] ** 2)))
    return found, nees


def table(judged: dict[str, dict[str, Any]]) -> str:
    """Markdown table of the figures by estimator."""
    rows = []
    for name, found in judged.items():
        rows.append([
            f"`{name}`",
            *(f"{found[part]:.2f} ({100 * found[f'{part}_within']:.0f} %)" for part in DEGREES),
            f"{np.median(found['far']):.2f}, {(found['far'] < SOUND).sum()}" if "far" in found else "",
            f"{1e3 * found['position_rmse']:.1f}",
            f"{1e3 * found['rotation_rmse']:.1f}",
            _converging(found["seconds"]) if "seconds" in found else "needs no start",
            f"{found['cost'] / judged['iekf']['cost']:.2f}",
        ])  # fmt: skip
    head = [
        "estimator",
        *(f"NEES {part}" for part in DEGREES),
        "from afar",
        "RMSE, mm",
        "mrad",
        "converge",
        "cost",
    ]
    return markdown_table(head, rows)


def _converging(seconds: FloatArray) -> str:
    there = np.isfinite(seconds)
    return f"{there.sum()} of {len(there)}" + (f", {np.median(seconds[there]):.1f} s" if there.any() else "")


def save_picture(path: str, nees: dict[str, dict[str, FloatArray]]) -> None:
    """Draw the mean joint NEES over its degrees of freedom over time, for each gyro, with its 99 % interval."""
    figure: Any = new_figure((11.0, 4.5), "NEES over 6 degrees of freedom, mean over the flights; grey: 99 % interval")
    panels = figure.subplots(1, len(nees), sharey=True)
    for axes, (gyro, found) in zip(panels, nees.items(), strict=True):
        for i, (name, one) in enumerate(found.items()):
            seconds = np.arange(one.shape[1]) / RATE
            known = np.isfinite(one[..., 0]).any(axis=0)
            mean = np.nanmean(one[:, known, 0], axis=0) / DEGREES["joint"]
            axes.plot(seconds[known], mean, color=f"C{i}", lw=1.2, label=name)
        axes.axhspan(*interval(DEGREES["joint"], len(one)), color="0.8", zorder=0)
        axes.set(title=gyro, xlabel="time [s]", yscale="log")
    panels[0].legend(frameon=False, ncols=2, loc="upper center")
    figure.savefig(path, dpi=110)
    shrink(path)


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--flights", type=int, default=30)
    parser.add_argument("--points", action="store_true")
    parser.add_argument("--picture")
    given = parser.parse_args()
    drawn: dict[str, dict[str, FloatArray]] = {}
    for gyro, bias in {"unbiased gyro": {}, "biased gyro": {"gyro_bias": BIAS, "gyro_walk": WALK}}.items():
        recording, rng = (
            recordings(Odometry(0.005, 0.02, **bias), given.points, given.flights),
            np.random.default_rng(1),
        )
        near = recording.poses[:, 0] @ exp(NEAR * rng.normal(size=(given.flights, 6)))
        far = np.stack([FAR.applied(pose, rng) for pose in recording.poses[:, 0]])
        judged, drawn[gyro] = {}, {}
        for name in contenders(NEAR, NEAR):
            judged[name], drawn[gyro][name] = figures(name, recording, near, far)
        intervals = ", ".join(
            "{} {:.2f} to {:.2f}".format(part, *interval(n, given.flights)) for part, n in DEGREES.items()
        )
        print(f"{gyro}; 99 % interval of a moment: {intervals}\n\n{table(judged)}\n", flush=True)
    if given.picture:
        save_picture(given.picture, drawn)


if __name__ == "__main__":
    main()
