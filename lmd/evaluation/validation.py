"""How good a deployment is off the grid it was optimised on.

An optimiser pushes the positions it is scored at just past the threshold, for the orientations it is scored with:
the qualified ratio on that grid flatters it. Three figures do not depend on that grid:

- the qualified ratio on a finer grid: half the spacing, half the step of the orientations. It is computed in full
  and has no standard error;
- the grid-free qualified ratio: at random positions, spread evenly over the reachable box, with orientations drawn
  from the continuous distribution the PDF stands for;
- the grid-free average coverage probability, over the random poses of the same sample.

Like `qualified_ratio`, all of them count every position alike, whatever its relevance.
"""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace

import numpy as np

from lmd.core.checks import BoolArray, FloatArray, integer
from lmd.core.compiled import PYTHON
from lmd.evaluation.held_out import describe_held_out, held_out_metrics
from lmd.problem import Problem
from lmd.scene.deployment import Deployment
from lmd.scene.rig import Rig
from lmd.scene.scene import Scene
from lmd.sight.evaluator import Evaluator

# Keeps the sample apart from every other use of the same seed.
VALIDATION_STREAM = 0x76616C
MOST_OF_A_RIG = 64, 8  # positions in a group, and divisions, where a rig's criteria have no compiled half


@dataclass(frozen=True)
class Sample:
    """The random poses of a validation: `groups` times `positions` positions, each seen in many orientations.

    The positions of a group are spread evenly, from a random shift. They share their orientations, one in each of
    2 `divisions` x `divisions` cells of equal probability, or fewer of the yaw alone. With thousands of these P_n is
    without bias, and its noise moves as many positions over the threshold as below it. Another group has another shift
    and other orientations, so errors average out, and the spread of the groups shows what is left.

    Args:
        groups: at least 2.
        positions: in each group.
        divisions: of half a turn.

    Raises:
        InputError: a number is too small.
    """

    groups: int = 16
    positions: int = 4096
    divisions: int = 32

    def __post_init__(self) -> None:
        for name, low in (("groups", 2), ("positions", 1), ("divisions", 1)):
            object.__setattr__(self, name, integer(name, getattr(self, name), low=low))


def validation_metrics(
    problem: Problem,
    deployment: Deployment,
    seed: int,
    sample: Sample | None = None,
    between: Callable[[], None] = lambda: None,
) -> dict[str, float]:
    """The figures of this module, fractions in [0, 1], the same for any number of threads.

    They are the means over positions that the objective names in `shares`: its headline on the finer grid, all of them
    grid-free. Their standard errors come from the spread of the groups, which covers the positions and the
    orientations.

    Where the poses were recorded, the figures are those of `lmd.evaluation.held_out` instead.

    Args:
        problem: the scene, n and thold_p.
        between: called before each group; it may raise to give up.
    """
    scene, objective = problem.scene.sized(deployment.edges), problem.objective
    if scene.recorded is not None:
        return held_out_metrics(problem, deployment, scene.recorded)
    finer = Evaluator(replace(scene, room=scene.room.finer(), pdf=scene.pdf.finer()), threads=problem.evaluator.threads)
    landmarks = deployment.positions[None], deployment.normals[None]
    on_finer_grid = objective.shares(objective.values(finer, *landmarks)[0])
    key = objective.headline.key
    metrics = {f"finer_grid_{key}": float(on_finer_grid[key].mean())}
    sampled = sampled_values(problem, deployment, seed, sample or Sample(), between)
    for key, shares in objective.shares(sampled).items():
        metrics[f"grid_free_{key}"], metrics[f"grid_free_{key}_standard_error"] = _mean_and_error(shares)
    return metrics


def describe_validation(problem: Problem, figures: Mapping[str, float]) -> dict[str, str]:
    """The figures of `validation_metrics` as labelled sentences."""
    recorded = problem.scene.recorded is not None
    return describe_held_out(figures) if recorded else problem.objective.describe_validation(figures)


def _mean_and_error(shares: FloatArray | BoolArray) -> tuple[float, float]:
    """The mean of a sample `(groups, positions)` and its standard error."""
    means = shares.mean(axis=1)
    return float(means.mean()), float(means.std(ddof=1) / np.sqrt(len(means)))


def headline_off_grid(problem: Problem) -> str:
    """The one of these figures that says how good a deployment is: what the objective is about, where it was not made.

    With recorded poses it is the share of the time that was held out, or of all if none was.
    """
    recorded = problem.scene.recorded
    if recorded is None:
        return f"grid_free_{problem.objective.headline.key}"
    return "held_out_share" if len(recorded.kept_back) else "recorded_share"


def sampled_values(
    problem: Problem,
    deployment: Deployment,
    seed: int,
    sample: Sample,
    between: Callable[[], None] = lambda: None,
) -> FloatArray:
    """The objective's value at the positions of a sample, `(groups, positions)`. Args as in `validation_metrics`."""
    landmarks = deployment.positions[None], deployment.normals[None]
    values = []
    scene = problem.scene.sized(deployment.edges)
    for evaluator in sampled_evaluators(scene, seed, sample, problem.evaluator.threads):
        between()
        values.append(problem.objective.values(evaluator, *landmarks)[0])
    return np.stack(values)


def sampled_evaluators(scene: Scene, seed: int, sample: Sample, threads: int) -> Iterator[Evaluator]:
    """An evaluator at the random positions of each group of a sample, with the orientations that these share.

    Of a rig whose criteria have no compiled half each orientation is asked by itself: of it the groups are smaller.
    """
    if isinstance(scene.camera, Rig) and not scene.is_compiled:
        most, finest = MOST_OF_A_RIG
        sample = Sample(sample.groups, min(sample.positions, most), min(sample.divisions, finest))
    rng = np.random.default_rng([seed, VALIDATION_STREAM])
    by_reference = PYTHON and not isinstance(scene.camera, Rig)  # kernels as plain Python would take hours
    for _ in range(sample.groups):
        positions = scene.room.sample_evenly(sample.positions, rng)
        drawn = replace(scene, pdf=scene.pdf.stratified(sample.divisions, rng))
        yield Evaluator(drawn, positions, threads, by_reference)
