"""Study of localisation: equal flights with each of several deployments, and tables of the localisation errors."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Annotated, Any

import numpy as np
import pandas as pd

from lmd.core.checks import Checked, FloatArray, InputError, IntArray, NotNegative, argument_of, real, returned
from lmd.core.memory import check_memory
from lmd.core.words import escaped, markdown_table
from lmd.estimation.estimators import DEGREES, Errors, Estimator, pose_errors
from lmd.estimation.flights import TrajectorySource
from lmd.estimation.recording import Each, Flight, Odometry, Recording, Sensor, record
from lmd.geometry.se3 import exp
from lmd.geometry.trajectory import Trajectory
from lmd.problem import Problem

# Separates the random numbers of flights from other uses of a seed.
FLIGHTS_STREAM = 0x666C79
# Numbers of landmarks in view whose share of time is reported, in addition to the n of the objective.
SHARES = (1, 2, 3, 4)
# Position errors for which the share of frames below is reported, metres.
ERROR_LIMITS = (0.01, 0.02, 0.05)
# Maximum Er of a settled estimate, relative to the initial Er.
SETTLED_SHARE = 0.01
# Quantiles over the seeds: lower end of the band, median, and upper end of the band.
QUANTILES = (0.1, 0.5, 0.9)
# Maximum number of points of a curve over time.
CURVE_WINDOWS = 300


@dataclass(frozen=True)
class InitialError(Checked):
    """Error of the first estimate, in random directions.

    Raises:
        InputError: a value is negative, or the attitude error is more than pi.
    """

    position: NotNegative
    """Position error, metres."""
    attitude: Annotated[float, partial(real, low=0.0, high=np.pi)]
    """Attitude error, rad."""

    def applied(self, pose: FloatArray, rng: np.random.Generator) -> FloatArray:
        """Draw a first estimate of a camera's pose, `(4, 4)`.

        The estimate differs from the true `pose` by the position error and the attitude error, in random directions.
        """
        directions = rng.normal(size=(2, 3))
        directions /= np.linalg.norm(directions, axis=1, keepdims=True)
        turn = np.concatenate([self.attitude * directions[0], np.zeros(3)])
        estimate = pose @ exp(turn)
        estimate[:3, 3] += self.position * directions[1]
        return np.asarray(estimate)


@dataclass(frozen=True)
class Flights:
    """S flights, one for each seed; they do not depend on the deployment."""

    seeds: Sequence[int]
    """S seeds."""
    trajectories: Sequence[Trajectory]
    """S trajectories with equal times."""
    start: FloatArray
    """First estimate of each flight's pose, `(S, 4, 4)`."""

    @classmethod
    def draw(cls, problem: Problem, source: TrajectorySource, initial: InitialError, seeds: Sequence[int]) -> "Flights":
        """Draw one flight for each seed in the scene of `problem`.

        Raises:
            InputError: there is no trajectory, or the trajectories do not fit into memory.
        """
        trajectories, start = [], []
        for seed in seeds:
            motion, error = np.random.default_rng([seed, FLIGHTS_STREAM]).spawn(2)
            trajectories.append(source.draw(problem.scene, motion))
            to_come = (len(seeds) - len(trajectories)) * trajectories[-1].poses.nbytes
            check_memory(to_come, f"seeds: the poses of {len(seeds)} flights", "seeds")
            start.append(initial.applied(trajectories[-1].poses[0], error))
        return cls(seeds, trajectories, np.stack(start))

    def over(self, problem: Problem, all_visible: bool = False) -> list[Flight]:
        """Make the S flights with the start deployment of `problem`.

        If this deployment is random, a new one is drawn for each seed. With `all_visible` every landmark is in view in
        all frames.
        """
        flights = []
        for seed, trajectory in zip(self.seeds, self.trajectories, strict=True):
            drawn, rng = problem.draw(np.random.default_rng(seed)), np.random.default_rng([seed, FLIGHTS_STREAM, 1])
            flights.append(Flight(problem.evaluator, drawn, trajectory, rng, all_visible))
        return flights


@dataclass(frozen=True)
class Outcome:
    """Results of S flights with one deployment."""

    counts: IntArray
    """Number of detected landmarks in each frame, `(S, T)`."""
    shares: Mapping[int, FloatArray]
    """Fraction of each flight's duration in which at least n landmarks are detected, `(S,)`, keyed by n."""
    errors: Mapping[str, Errors]
    """Errors of each estimator, keyed by its name."""


@dataclass(frozen=True)
class FlightStudy:
    """Results of equal flights with each of several deployments."""

    seeds: Sequence[int]
    """Seeds of the flights."""
    time: FloatArray
    """Times of the frames, seconds, `(T,)`."""
    initial: FloatArray
    """Error Er (see `Errors.frobenius`) of each flight's first estimate, `(S,)`."""
    outcomes: Mapping[str, Outcome]
    """Outcome of each deployment, keyed by its name."""

    def figures(self) -> pd.DataFrame:
        """Table of the localisation errors, with one row for each deployment, estimator and seed.

        Column `mean_visible` is the mean number of detected landmarks, and `share_visible_<n>` the fraction of the time
        with at least n detected landmarks. `mean_error` is the mean over the flight of Er, the squared Frobenius norm
        of the pose error (`Errors.frobenius`). `available` is the fraction of frames with an estimate. `settling_time`
        (s) is the time after which Er stays below 1 % of its initial value; infinite if there is no such time or a
        frame has no estimate. `position_error` (m) and `attitude_error` (rad) are medians over the second half of the
        flight. `within_<n>mm` is the fraction of frames in the second half with a position error of at most n mm;
        frames without an estimate count as larger errors. `nees_joint`, `nees_rotation` and `nees_position` are means,
        over the second half, of the normalised squared errors divided by their degrees of freedom. The means are about
        1 if the stated covariances are right, and NaN if no covariances are stated.
        """
        rows = []
        for name, outcome in self.outcomes.items():
            for estimator, errors in outcome.errors.items():
                columns = {
                    "mean_visible": outcome.counts.mean(axis=1),
                    **{f"share_visible_{n}": share for n, share in outcome.shares.items()},
                    **self._error_figures(errors),
                }
                for i, seed in enumerate(self.seeds):
                    values = {key: float(column[i]) for key, column in columns.items()}
                    rows.append({"deployment": name, "estimator": estimator, "seed": seed, **values})
        return pd.DataFrame(rows)

    def _error_figures(self, errors: Errors) -> dict[str, FloatArray]:
        half = len(self.time) // 2
        large = errors.frobenius > SETTLED_SHARE * self.initial[:, None]
        after = len(self.time) - large[:, ::-1].argmax(axis=1)  # the frame after the last frame with a large error
        settled = np.append(self.time - self.time[0], np.inf)[np.where(large.any(axis=1), after, 0)]
        settled = np.where(errors.available < 1.0, np.inf, settled)
        return {
            "mean_error": _each_run(np.mean, errors.frobenius),
            "settling_time": settled,
            "position_error": _each_run(np.median, errors.position[:, half:]),
            "attitude_error": _each_run(np.median, errors.attitude[:, half:]),
            **{name: (errors.position[:, half:] <= limit).mean(axis=1) for name, limit in within().items()},
            **self._nees(errors),
            "available": errors.available,
        }

    def _nees(self, errors: Errors) -> dict[str, FloatArray]:
        runs, half = len(errors.position), len(self.time) // 2
        squares = np.full((runs, 1, len(DEGREES)), np.nan) if errors.squares is None else errors.squares[:, half:]
        return {
            f"nees_{part}": _each_run(np.mean, own) / degrees
            for own, (part, degrees) in zip(np.moveaxis(squares, -1, 0), DEGREES.items(), strict=True)
        }

    def curves(self) -> pd.DataFrame:
        """Quantiles of the errors over time, in up to `CURVE_WINDOWS` windows of time.

        The quantiles are over the seeds and over the frames in a window. Columns: `deployment`, `estimator`, and `time`
        (s, middle of the window). There are three errors: `error` (Er, see `Errors.frobenius`), `position` (m) and
        `attitude` (rad). Each has three columns, with the suffixes `_low`, `_median` and `_high`: the 10, 50 and 90 %
        quantiles, NaN without an estimate.
        """
        windows = np.array_split(np.arange(len(self.time)), min(CURVE_WINDOWS, len(self.time)))
        time = [float(self.time[window].mean()) for window in windows]
        parts = []
        for name, outcome in self.outcomes.items():
            for estimator, errors in outcome.errors.items():
                columns: dict[str, FloatArray] = {}
                for label in ("frobenius", "position", "attitude"):
                    bands = np.array([_band(getattr(errors, label)[:, window]) for window in windows])
                    short = "error" if label == "frobenius" else label
                    columns |= {f"{short}_{part}": bands[:, i] for i, part in enumerate(("low", "median", "high"))}
                parts.append(pd.DataFrame({"deployment": name, "estimator": estimator, "time": time, **columns}))
        return pd.concat(parts, ignore_index=True)

    @staticmethod
    def medians(figures: pd.DataFrame) -> dict[str, float]:
        """Medians of the columns of `figures` over the seeds, without the medians that are not finite, keyed by
        `<column>/<deployment>/<estimator>`.
        """
        medians = {}
        for (name, estimator), runs in figures.groupby(["deployment", "estimator"], sort=False):
            for key, value in runs.drop(columns="seed").median(numeric_only=True).items():
                if np.isfinite(value):
                    medians[f"{key}/{name}/{estimator}"] = float(value)
        return medians

    @staticmethod
    def over_time(curves: pd.DataFrame) -> dict[str, list[tuple[int, float, float]]]:
        """Median errors of `curves` over time, as points (time in ms, error, time in s), keyed by
        `<error>/<deployment>/<estimator>`.
        """
        found = {}
        for (name, estimator), curve in curves.groupby(["deployment", "estimator"], sort=False):
            for quantity in ("error", "position", "attitude"):
                values = curve[["time", f"{quantity}_median"]].dropna().to_numpy()
                points = [(round(1000 * time), float(value), float(time)) for time, value in values]
                found[f"{quantity}_over_time/{name}/{estimator}"] = points
        return found


def conduct(
    problems: Mapping[str, Problem],
    flights: Flights,
    detectors: Mapping[str, Sensor],
    estimators: Mapping[str, Estimator],
    all_visible: bool,
    odometry: Odometry | None = None,
    each: Each = map,
) -> FlightStudy:
    """Simulate flights with each deployment, and let each estimator localise the camera.

    Args:
        problems: problem of each deployment, keyed by the deployment's name; all share one scene.
        flights: flights to localise, equal for all deployments.
        detectors: simulated detectors, with noise and missed detections, keyed by the name of the deployment.
        estimators: estimators, keyed by name.
        all_visible: True to repeat the flights with all landmarks in view; the results have the name `<name> all
            visible`, with the name of the deployment.
        odometry: errors of the twists; None for exact twists.
        each: function that maps a slow function over jobs, possibly in parallel, see `lmd.estimation.recording.Each`.

    Raises:
        InputError: there is no estimator, or an estimator does not support the recording.
    """
    if not estimators:
        raise InputError("estimators must name at least one estimator.", "estimators")
    outcomes = {}
    for name, problem in problems.items():
        for everything in (False, True) if all_visible else (False,):
            recording = record(detectors[name], flights.over(problem, everything), odometry, each)
            outcomes[f"{name} all visible" if everything else name] = Outcome(
                recording.visible_counts,
                {n: recording.share_visible(n) for n in sorted({*SHARES, problem.objective.n})},
                _errors(estimators, recording, flights.start),
            )
    true = np.stack([trajectory.poses[:1] for trajectory in flights.trajectories])
    initial = pose_errors(true, flights.start[:, None]).frobenius[:, 0]
    return FlightStudy(flights.seeds, flights.trajectories[0].time, initial, outcomes)


def _errors(estimators: Mapping[str, Estimator], recording: Recording, start: FloatArray) -> dict[str, Errors]:
    errors = {}
    for name, estimator in estimators.items():
        with argument_of(f"estimators.{name}"):
            found = errors[name] = estimator.errors(recording, start)
            for key in ("frobenius", "position", "attitude"):
                returned(estimator, f"errors().{key}", getattr(found, key, None), len(start), len(recording.time))
    return errors


def to_markdown(figures: pd.DataFrame, n: int) -> str:
    """Format `FlightStudy.figures` as a Markdown table, with medians of errors and means of fractions over the seeds.

    Args:
        figures: one row for each deployment, estimator and seed.
        n: number n of landmarks that the objective requires. The table has the fractions of time with at least n, and
            with at least 3, detected landmarks, as 3 landmarks determine a pose.
    """
    head = ["deployment", "estimator", *(f"time with >= {m} in view" for m in sorted({n, 3}))]
    head += ["mean Er (10 to 90 %)", "settled after [s]", "position [mm]", "attitude [mrad]"]
    head += [f"NEES / dof: {', '.join(DEGREES)}", "available"]
    head.append(f"of all frames within {' / '.join(f'{1e3 * limit:g}' for limit in ERROR_LIMITS)} mm")
    rows = []
    for (name, estimator), runs in figures.groupby(["deployment", "estimator"], sort=False):
        middle = runs.median(numeric_only=True)
        low, high = runs.mean_error.quantile(QUANTILES[0]), runs.mean_error.quantile(QUANTILES[2])
        rows.append([
            escaped(name),
            escaped(estimator),
            *(f"{runs[f'share_visible_{m}'].mean():.2%}" for m in sorted({n, 3})),
            f"{middle.mean_error:.3g} ({low:.3g} to {high:.3g})",
            f"{middle.settling_time:.1f}" if np.isfinite(middle.settling_time) else "–",
            f"{1e3 * middle.position_error:.3g}",
            f"{1e3 * middle.attitude_error:.3g}",
            "–" if np.isnan(middle.nees_joint) else " / ".join(f"{middle[f'nees_{part}']:.3g}" for part in DEGREES),
            f"{runs.available.mean():.1%}",
            " / ".join(f"{100.0 * runs[name].mean():.1f}" for name in within()) + " %",
        ])  # fmt: skip
    return markdown_table(head, rows) + "\n"


def within() -> dict[str, float]:
    """Limits of the position error, metres, each keyed by its column `within_<n>mm` of `FlightStudy.figures`."""
    return {f"within_{1e3 * limit:g}mm": limit for limit in ERROR_LIMITS}


def _each_run(reduce: Callable[[FloatArray], Any], values: FloatArray) -> FloatArray:
    """Call the function `reduce` with the finite values in each row (run) of `values`; return an array of the results,
    NaN for a row without finite values.
    """
    rows = [row[np.isfinite(row)] for row in values]
    return np.array([reduce(row) if row.size else np.nan for row in rows])


def _band(values: FloatArray) -> FloatArray:
    """Quantiles of the finite values in `values`, at the probabilities `QUANTILES`; NaN if no value is finite."""
    finite = values[np.isfinite(values)]
    return np.quantile(finite, QUANTILES) if finite.size else np.full(len(QUANTILES), np.nan)
