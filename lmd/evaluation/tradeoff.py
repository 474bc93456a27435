"""Trade-off between the number or size of landmarks and a figure. Searches start from deployments at neighbouring
points.

The deployment of K landmarks is the best of three searches. One begins from the start of the problem. One begins from
the deployment with fewer landmarks, after adding landmarks with the largest gain. One begins from the deployment with
more landmarks, after removing landmarks with the least loss.

All tags have one size.
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
    """Result of a search."""

    deployment: Deployment
    """K landmarks."""
    fitness: float
    """Fitness of `deployment`."""
    way: str
    """Origin of the result: a search from the start (`anew`), or from the deployment of `fewer` or `more` landmarks."""


def started(problem: Problem, deployment: Deployment) -> Problem:
    """Return the problem with a deployment of all its landmarks as its start."""
    given = GivenDeployment(problem.free(replace(deployment, labels=None, surveyed=None)))
    return Problem(problem.scene, problem.objective, given, problem.evaluator.threads, problem.fixed)


def grown(problem: Problem, deployment: Deployment) -> Deployment:
    """Add landmarks to a deployment, chosen greedily by the objective's selection, up to the number of `problem`.

    If the grid of poses has no room for all landmarks, the rest stay as in the start of the problem.
    """
    footprints, tag, start = problem.scene.footprints, problem.scene.tag, problem.draw(np.random.default_rng(0))
    poses = candidates(footprints, np.array([np.nan]), GRID_SPACING)
    selection = selectable(problem.objective).selection(problem.evaluator, problem.relevance)
    stock = Tags(tag.filled(np.full(problem.count - len(deployment), np.nan)), tag)
    chosen, _ = select(selection, poses, stock, footprints, fixed=deployment)
    more = deployment + poses[chosen] if len(chosen) else deployment
    return more if len(more) == problem.count else problem.separated(more + start[len(more) :]) or start


def shrunk(problem: Problem, deployment: Deployment) -> Deployment:
    """Remove landmarks of a deployment, the least loss first, down to the number of `problem`; fixed ones stay."""
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
    """For chosen numbers of landmarks, search again from the neighbouring deployments; keep the better deployment.

    Args:
        known: deployments by their number of landmarks; adjacent entries are neighbours.
        chosen: numbers to search for, upwards and then downwards.
        problem_of: function that makes the problem for a number of landmarks.
        search: function that searches from the start of a problem; called with the number, the problem and the name of
            the start.
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
    """Medians of `figures` over the seeds, and the least and greatest value of the first figure.

    Args:
        points: a row for each `edge`, `count` and `seed`.
        figures: columns of `points`.

    Returns:
        table indexed by edge and count, with the columns `least` and `greatest` after the figures.
    """
    groups = points.groupby([CURVE, COUNT])
    medians, first = groups[figures].median(), groups[figures[0]]
    return medians.assign(least=first.min(), greatest=first.max())


def fewest(points: pd.DataFrame, figure: str, wanted: float) -> pd.DataFrame:
    """Least number of landmarks at which `figure` is at least `wanted`.

    Args:
        points: as for `front`.
        figure: a column of `points`.
        wanted: value of the figure.

    Returns:
        table indexed by the edge. Column `count`: least number at which the median over the seeds reaches `wanted`;
        `least` and `greatest`: extremes over the seeds of each seed's least number. Infinite if no number reaches
        `wanted`.
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
    """For each edge, find the number of landmarks that halves the gap between the least number that reaches `wanted`
    and the next smaller number; edges without a gap are left out.

    Args:
        points, figure, wanted: as for `fewest`.

    Returns:
        pairs of the edge and the number.
    """
    halves = []
    for edge, row in fewest(points, figure, wanted).iterrows():
        reached = row[COUNT]
        below = points.loc[(points[CURVE] == edge) & (points[COUNT] < reached), COUNT].max()
        if np.isfinite(reached) and reached - below >= 2:  # NaN if no number is below
            halves.append((float(str(edge)), int(below + reached) // 2))
    return halves
