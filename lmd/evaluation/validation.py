"""Validation: metrics of a deployment at poses off the grid on which it was optimised.

A position is qualified if the value of the objective there reaches a threshold. An optimiser lifts values just above
the threshold, but only at the positions and orientations of its grid. So the qualified ratio, the fraction of qualified
positions, is biased upwards on this grid. Three metrics use other positions and orientations:

- the qualified ratio on a finer grid, with half the spacing and half the step of the orientations. This ratio has a
  standard error only if the grid is too large for a model without compiled code, so that a sample of its positions is
  taken.
- the grid-free qualified ratio: at random positions, spread evenly over the reachable box, with orientations drawn from
  the continuous distribution that the PDF represents.
- the grid-free average coverage probability, over the random poses of the same sample.

Like `qualified_ratio`, these metrics weigh all positions equally, without the relevance.

The random poses are drawn in groups, see `Sample`. With a crowd, each group has newly drawn crowd states, as many as
the problem has, and equal positions in all states; the finer grid has the states of the problem. The main metric
(headline) is also computed for the worst crowd states of a group.

For a recording, the metrics are computed at the recorded poses: at the poses used for the optimisation, and at the
held-out poses.
"""

import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING, Annotated

import numpy as np

from lmd.core.bits import BITS
from lmd.core.checks import BoolArray, Checked, Count, FloatArray, integer, returned
from lmd.core.compiled import PYTHON
from lmd.geometry.frames import angles_of
from lmd.objectives.base import SelfValidating, with_error
from lmd.objectives.crowd import WORST, seeks_worst
from lmd.problem import Problem
from lmd.scene.deployment import Deployment
from lmd.scene.pdf import OrientationPdf
from lmd.scene.scene import Scene
from lmd.sight.evaluator import Evaluator

if TYPE_CHECKING:
    from lmd.scene.recorded_poses import RecordedPoses, Records

# Separates the random numbers of the sample from other uses of the seed.
VALIDATION_STREAM = 0x76616C
FINER = "on a finer grid"  # label of the figure on the finer grid, in objectives that have one
# Least number of positions in each crowd state of a group.
POSITIONS_IN_A_STATE = 256
# Criteria without a compiled half are evaluated for a few seconds, at fewer positions: the work is counted, as the
# time would depend on the machine. A unit is a pair of an orientation and a landmark; a call of `covered` costs more.
MOST_WORK, CALL_WORK = 10**8, 5000
FINEST_OF_A_RIG = 8  # largest `divisions` for a rig with such criteria, which take a call for each orientation


@dataclass(frozen=True)
class Sample(Checked):
    """Size of a sample of random poses: `groups` times `positions` positions, each with many orientations.

    The positions of a group are spread evenly, from a random shift. All positions of a group have the same
    orientations: one in each of 2 `divisions` x `divisions` cells of equal probability, fewer for a PDF of the yaw
    alone. Each group has its own shift and orientations, so errors average out, and the differences between groups give
    the standard error.

    The estimate of the coverage probability P_n is unbiased. With thousands of orientations, its noise lifts as many
    positions above the threshold of qualified positions as it drops below.

    Raises:
        InputError: a number is too small.
    """

    groups: Annotated[int, partial(integer, low=2)] = 16
    """Number of groups, at least 2."""
    positions: Count = 4096
    """Number of positions in each group."""
    divisions: Count = 32
    """Number of orientation cells into which half a turn is divided; there are 2 `divisions` x `divisions` cells."""


def validation_metrics(
    problem: Problem,
    deployment: Deployment,
    seed: int,
    sample: Sample | None = None,
    between: Callable[[], None] = lambda: None,
) -> dict[str, float]:
    """Metrics of a deployment off the grid, fractions in [0, 1]; they do not depend on the number of threads.

    A share is a metric that is a mean over positions (`Objective.shares`). The main share (headline) is computed on the
    finer grid, and all shares at random poses (grid-free). Standard errors come from the differences between groups of
    random poses. If the problem has recorded poses, the metrics are those of `held_out_metrics`.

    Args:
        problem: the problem.
        deployment: K landmarks.
        seed: seed of the random poses.
        sample: number of random poses; None for the default.
        between: function called before each group; it may raise an error to end the validation.
    """
    scene, objective = problem.scene.sized(deployment.edges), problem.objective
    if isinstance(objective, SelfValidating):
        return objective.off_grid(problem.evaluator.sized(deployment.edges), deployment)
    if scene.recorded is not None:
        return held_out_metrics(problem, deployment, scene.recorded)
    finer, threads = replace(scene, room=scene.room.finer(), pdf=scene.pdf.finer()), problem.evaluator.threads
    landmarks, places = (deployment.positions[None], deployment.normals[None]), finer.room.grid()
    most, key = affordable_positions(finer, len(deployment)), objective.headline.key
    if is_part := len(places) > most:
        places = np.random.default_rng([seed, VALIDATION_STREAM]).permutation(places)[:most]
    values = objective.values(Evaluator(finer, places, threads), *landmarks)[0]
    on_finer_grid = returned(objective, f"shares()[{key!r}]", objective.shares(values).get(key), *values.shape)
    metrics = {f"finer_grid_{key}": float(on_finer_grid.mean())}
    if is_part:
        metrics[f"finer_grid_{key}_standard_error"] = float(on_finer_grid.std() / math.sqrt(most))
    sampled = sampled_values(problem, deployment, seed, sample or Sample(), between)
    every = dict(objective.shares(sampled))
    if scene.crowd is not None:  # a state of a group has all positions of that group
        by_state = np.asarray(every[key]).reshape(len(sampled), len(scene.crowd), -1).mean(axis=-1)
        every[WORST + key] = np.sort(by_state, axis=1)[:, : scene.crowd.worst_count]
    for key, shares in every.items():
        metrics[f"grid_free_{key}"], metrics[f"grid_free_{key}_standard_error"] = _mean_and_error(shares)
    return metrics


def describe_validation(problem: Problem, figures: Mapping[str, float]) -> dict[str, str]:
    """Labelled sentences for the metrics of `validation_metrics`."""
    if problem.scene.recorded is not None:
        return describe_held_out(figures)
    rows = dict(problem.objective.describe_validation(figures))
    error = figures.get(f"finer_grid_{problem.objective.headline.key}_standard_error")
    if error is not None and FINER in rows:
        rows[FINER] += f", +- {error:.2%} as only some of its positions were taken"
    key = f"grid_free_{WORST}{problem.objective.headline.key}"
    if key in figures and problem.scene.crowd is not None:
        rows["worst crowds off the grid"] = (
            f"{with_error(figures, key)} in the worst "
            f"{problem.scene.crowd.worst_count} of {problem.state_count} fresh states"
        )
    return rows


def _mean_and_error(shares: FloatArray | BoolArray) -> tuple[float, float]:
    """Mean over all positions of a sample, and its standard error. `shares` has a row for each group of the sample and
    a column for each position in it.
    """
    means = shares.mean(axis=1)
    return float(means.mean()), float(means.std(ddof=1) / np.sqrt(len(means)))


def headline_off_grid(problem: Problem) -> str:
    """Name of the main metric off the grid: the headline of the objective at random poses.

    For recorded poses, this metric is a mean over the held-out time, or over all time if no time is held out.
    """
    recorded = problem.scene.recorded
    if recorded is None:
        worst = WORST if seeks_worst(problem.evaluator) else ""
        return f"grid_free_{worst}{problem.objective.headline.key}"
    return "held_out_share" if len(recorded.kept_back) else "recorded_share"


def sampled_values(
    problem: Problem, deployment: Deployment, seed: int, sample: Sample, between: Callable[[], None] = lambda: None
) -> FloatArray:
    """Values of the objective at the random positions of a sample, `(groups, positions)`.

    Args:
        problem: the problem.
        deployment: K landmarks.
        seed: seed of the random poses.
        sample: number of random poses.
        between: function called before each group; it may raise an error to end the computation.
    """
    landmarks = deployment.positions[None], deployment.normals[None]
    values = []
    scene = problem.scene.sized(deployment.edges)
    for evaluator in sampled_evaluators(scene, problem.count, seed, sample, problem.evaluator.threads):
        between()
        values.append(problem.objective.values(evaluator, *landmarks)[0])
    return np.stack(values)


def affordable_positions(scene: Scene, count: int) -> float:
    """Number of positions at which `count` landmarks can be evaluated within a few seconds.

    The number is infinite if the visibility model has compiled code. With a crowd, the time of an evaluation is
    multiplied by the number of crowd states.
    """
    if scene.is_compiled:
        return math.inf
    axes, states = len(scene.orientations.axes) * len(scene.cameras), 1 if scene.crowd is None else len(scene.crowd)
    calls = 1 if scene.rig is None else axes
    return max(1, MOST_WORK // (states * (calls * CALL_WORK + axes * count)))


def sampled_evaluators(scene: Scene, count: int, seed: int, sample: Sample, threads: int) -> Iterator[Evaluator]:
    """Yield an evaluator for each group of a sample, with the positions of the group and the orientations that they
    share.

    If the criteria have no compiled code, evaluating `count` landmarks takes long, and the groups have fewer positions.
    """
    rng = np.random.default_rng([seed, VALIDATION_STREAM])
    by_reference = PYTHON and scene.rig is None  # kernels in plain Python would take hours
    size, states = sample.positions, 1 if scene.crowd is None else len(scene.crowd)
    divisions = sample.divisions if scene.rig is None or scene.is_compiled else min(sample.divisions, FINEST_OF_A_RIG)
    if states > 1:
        size = max(math.ceil(size / states), min(size, POSITIONS_IN_A_STATE))
    if not scene.is_compiled:
        alike = replace(scene, pdf=scene.pdf.stratified(divisions, np.random.default_rng(0)))
        size = int(min(size, max(1.0, affordable_positions(alike, count) / sample.groups)))
    for _ in range(sample.groups):
        positions = returned(scene.room, "sample_evenly", scene.room.sample_evenly(size, rng), size, 3)
        drawn = replace(scene, pdf=scene.pdf.stratified(divisions, rng))
        if scene.crowd is not None:
            drawn = replace(drawn, crowd=scene.crowd.crowd.drawn(scene.room, rng))
        yield Evaluator(drawn, positions, threads, by_reference)


def held_out_metrics(problem: Problem, deployment: Deployment, recorded: "RecordedPoses") -> dict[str, float]:
    """Shares of the recorded time, fractions in [0, 1], in which the view covers n landmarks or, for `Localisation`,
    localises the camera.

    `recorded_share` refers to the time that was used for the optimisation, `held_out_share` to the time that was held
    out, if any. The standard error assumes independent blocks of time, not independent records, and needs two blocks.

    Args:
        problem: problem with the scene and the objective.
        deployment: K landmarks.
        recorded: recorded poses.
    """
    metrics: dict[str, float] = {}
    for name, records in (("recorded", recorded.training), ("held_out", recorded.kept_back)):
        if not len(records):
            continue
        share, error = _share_and_error(exact_values(problem, deployment, records), records)
        metrics |= {f"{name}_share": share, f"{name}_seconds": float(records.seconds.sum())}
        if error is not None:
            metrics[f"{name}_share_standard_error"] = error
    return metrics


def describe_held_out(figures: Mapping[str, float]) -> dict[str, str]:
    """Labelled sentences for the metrics of `held_out_metrics`."""
    names = {"held_out": "held out", "recorded": "optimised on"}
    rows = {}
    for name, label in names.items():
        if f"{name}_share" in figures:
            share, seconds = with_error(figures, f"{name}_share"), figures[f"{name}_seconds"]
            rows[label] = f"{share} of {seconds:g} recorded seconds have such a view"
    return rows


def exact_values(problem: Problem, deployment: Deployment, records: "Records") -> FloatArray:
    """Value of the objective at each of R recorded poses, `(R,)`; with a crowd, the mean over its states.

    Only the recorded orientation counts at each recorded position.
    """
    landmarks = deployment.positions[None], deployment.normals[None]
    every = (recorded_evaluators(problem, deployment, records, state) for state in range(problem.state_count))
    values = [np.concatenate([problem.objective.values(one, *landmarks)[0] for one in each]) for each in every]
    return np.asarray(np.mean(values, axis=0))


def recorded_evaluators(
    problem: Problem, deployment: Deployment, records: "Records", state: int = 0
) -> Iterator[Evaluator]:
    """Yield an evaluator for each group of up to 64 recorded poses.

    The evaluator has a bit for each orientation, in words of 64 bits; a group fills one word. At each recorded
    position, the recorded orientation has the probability 1.

    Args:
        problem: problem with the scene.
        deployment: K landmarks.
        records: recorded poses.
        state: index of the crowd state, if the scene has a crowd.
    """
    for start in range(0, len(records), BITS):
        poses = records[start : start + BITS].poses
        yaw, pitch, roll = angles_of(np.swapaxes(poses[:, :3, :3], 1, 2))
        alike = np.full(len(poses), 1.0 / len(poses))
        pdf = OrientationPdf(yaw, pitch, alike, roll=roll, by_position=lambda positions: np.eye(len(positions)))
        scene = replace(problem.scene.sized(deployment.edges), pdf=pdf)
        states = None if scene.crowd is None else np.full(len(poses), state)
        yield Evaluator(scene, poses[:, :3, 3], problem.evaluator.threads, states=states)


def _share_and_error(values: FloatArray, records: "Records") -> tuple[float, float | None]:
    """Mean of `values` over the recorded time, and its standard error; None as error for a single block of time.

    `values` has a number for each recorded pose. The error is computed from the residuals of blocks of time.
    """
    seconds, good = records.seconds, records.seconds * values
    share = good.sum() / seconds.sum()
    _, block = np.unique(records.block, return_inverse=True)
    count = int(block.max()) + 1
    if count < 2:
        return float(share), None
    residual = np.bincount(block, weights=good - share * seconds)
    return float(share), float(np.sqrt(count / (count - 1) * (residual**2).sum()) / seconds.sum())
