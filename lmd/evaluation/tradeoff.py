"""Trade-off between a metric and the number or size of landmarks. Searches also start from the best deployments with
neighbouring numbers of landmarks.

The deployment for K landmarks is the best result of three searches. The first search begins from the start of the
problem. The second begins from the deployment for the next smaller number, after adding landmarks with the largest
gain. The third begins from the deployment for the next larger number, after removing landmarks with the least loss.

All tags of a deployment have one size here.
"""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
import pandas as pd

from lmd.evaluation.validation import Sample
from lmd.objectives.base import selectable
from lmd.optimisers.selection import GRID_SPACING, Tags, candidates, select
from lmd.problem import Problem
from lmd.scene.deployment import Deployment
from lmd.scene.deployment_sources import GivenDeployment

SAMPLE = Sample(groups=16, positions=512, divisions=23)  # smaller than for a single run, as there are many points
FEWER, MORE = "fewer", "more"  # starts of a search: the deployment with fewer or with more landmarks
ANEW = "anew"  # start of the problem
CURVE, COUNT = "edge", "count"  # columns of a table of points: the edge of the tags, 0 for points, and K


@dataclass(frozen=True)
class Found:
    """Best result of the searches for one number of landmarks."""

    deployment: Deployment
    """K landmarks."""
    fitness: float
    """Fitness of `deployment`."""
    way: str
    """Search that gave the result: from the start of the problem (`anew`), or from the deployment with `fewer` or
    `more` landmarks.
    """


def started(problem: Problem, deployment: Deployment) -> Problem:
    """Copy of the problem, with the given deployment as its start; the deployment must have all landmarks of the
    problem, fixed ones included.
    """
    given = GivenDeployment(problem.free(replace(deployment, labels=None, surveyed=None)))
    return Problem(problem.scene, problem.objective, given, problem.evaluator.threads, problem.fixed)


def grown(problem: Problem, deployment: Deployment) -> Deployment:
    """Add landmarks to a deployment up to the number of `problem`, chosen greedily by the objective's surrogate
    (`selection`).

    If the grid of poses has no room for all landmarks, the remaining landmarks keep their poses in the start of the
    problem.
    """
    footprints, tag, start = problem.scene.footprints, problem.scene.tag, problem.draw(np.random.default_rng(0))
    poses = candidates(footprints, np.array([np.nan]), GRID_SPACING)
    selection = selectable(problem.objective).selection(problem.evaluator, problem.relevance)
    stock = Tags(tag.filled(np.full(problem.count - len(deployment), np.nan)), tag)
    chosen, _ = select(selection, poses, stock, footprints, fixed=deployment)
    more = deployment + poses[chosen] if len(chosen) else deployment
    return more if len(more) == problem.count else problem.separated(more + start[len(more) :]) or start


def shrunk(problem: Problem, deployment: Deployment) -> Deployment:
    """Remove landmarks of a deployment down to the number of `problem`, in each step the landmark with the least loss;
    fixed landmarks are kept.
    """
    while (count := len(deployment)) > problem.count:
        rests = [deployment[np.delete(np.arange(count), k)] for k in range(problem.fixed_count, count)]
        whole = problem.fitness_of(deployment)
        deployment = rests[int(np.argmin([whole - problem.fitness_of(rest) for rest in rests]))]
    return deployment


def improved(
    known: Mapping[int, Found],
    chosen: Iterable[int],
    problem_of: Callable[[int], Problem],
    search: Callable[[int, Problem, str], Found],
) -> dict[int, Found]:
    """Search again for each chosen number of landmarks, starting from the deployments for neighbouring numbers; keep
    the best deployment for each number.

    Args:
        known: results, keyed by the number of landmarks; adjacent numbers are neighbours.
        chosen: numbers of landmarks to search for, first in ascending and then in descending order.
        problem_of: function that makes the problem for a number of landmarks.
        search: function that searches from the start of a problem; it is called with the number of landmarks, the
            problem and the name of the start.
    """
    best, chosen = dict(known), set(chosen)
    for order, made, way in ((sorted(known), grown, FEWER), (sorted(known, reverse=True), shrunk, MORE)):
        for neighbour, count in pairwise(order):
            if count in chosen:
                problem = problem_of(count)
                found = search(count, started(problem, made(problem, best[neighbour].deployment)), way)
                best[count] = max(best[count], found, key=lambda each: each.fitness)
    return {count: best[count] for count in chosen}


def front(points: pd.DataFrame, figures: list[str]) -> pd.DataFrame:
    """For each edge length and number of landmarks: the median over the seeds of each metric in `figures`, and the
    least and greatest value of the first metric.

    Args:
        points: table with a row for each `edge`, `count` and `seed`.
        figures: names of the metrics, columns of `points`.

    Returns:
        table indexed by edge length and count, with the columns `least` and `greatest` after the metrics.
    """
    groups = points.groupby([CURVE, COUNT])
    medians, first = groups[figures].median(), groups[figures[0]]
    return medians.assign(least=first.min(), greatest=first.max())


def fewest(points: pd.DataFrame, figure: str, wanted: float) -> pd.DataFrame:
    """Least number of landmarks at which the metric `figure` is at least `wanted`, for each edge length.

    Args:
        points: table with a row for each `edge`, `count` and `seed`.
        figure: name of the metric, a column of `points`.
        wanted: value that the metric is to reach.

    Returns:
        table indexed by the edge length. Column `count` is the least number at which the median over the seeds reaches
        `wanted`. For each seed there is a least number at which the seed reaches `wanted`; `least` and `greatest` are
        the smallest and the largest of these. A value is infinite if no number reaches `wanted`.
    """
    rows = {}
    for edge, same in points.groupby(CURVE):
        reaching = same[same[figure] >= wanted].groupby("seed")[COUNT].min().reindex(same.seed.unique())
        medians = same.groupby(COUNT)[figure].median()
        at = medians.index[medians >= wanted]
        each = reaching.fillna(np.inf)
        rows[edge] = {COUNT: at.min() if len(at) else np.inf, "least": each.min(), "greatest": each.max()}
    return pd.DataFrame.from_dict(rows, orient="index").rename_axis(CURVE)


def between(points: pd.DataFrame, figure: str, wanted: float) -> list[tuple[float, int]]:
    """For each edge length, find a number of landmarks to examine next: midway between the least number that reaches
    `wanted` and the next smaller examined number. Edge lengths with no number between these two are left out.

    Args:
        points: table with a row for each `edge`, `count` and `seed`.
        figure: name of the metric, a column of `points`.
        wanted: value that the metric is to reach.

    Returns:
        pairs of the edge length and the number.
    """
    halves = []
    for edge, row in fewest(points, figure, wanted).iterrows():
        reached = row[COUNT]
        below = points.loc[(points[CURVE] == edge) & (points[COUNT] < reached), COUNT].max()
        if np.isfinite(reached) and reached - below >= 2:  # NaN if no number is below
            halves.append((float(str(edge)), int(below + reached) // 2))
    return halves
