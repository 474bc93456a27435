"""Trade-off between the number or size of landmarks and a figure. Searches start from deployments at neighbouring
points.

The deployment of K landmarks is the best of three searches. One begins from the start of the problem. One begins from
the deployment with fewer landmarks, after adding landmarks with the largest gain. One begins from the deployment with
more landmarks, after removing landmarks with the least loss.

If paper or cost is limited instead of K, and tags may have several sizes, gains and losses are divided by the paper or
the cost of the tag. So the searches also find other mixtures of sizes.
"""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any, NamedTuple, TypeVar

import numpy as np
import pandas as pd

from lmd.core.checks import FloatArray
from lmd.evaluation.validation import Sample
from lmd.objectives.base import selectable
from lmd.optimisers.selection import GRID_SPACING, ROUNDING, Tags, candidates, select, stock_of_sizes
from lmd.problem import Problem
from lmd.scene.deployment import Deployment
from lmd.scene.deployment_sources import GivenDeployment

SAMPLE = Sample(groups=16, positions=512, divisions=23)  # smaller than for a single run, as there are many points
FEWER, MORE = "fewer", "more"  # starts of a search: the deployment with fewer or with more landmarks
ANEW = "anew"  # start of the problem
ALONE = "alone"  # origin of a deployment of one size that is better than the mixture found
Key = TypeVar("Key", int, float)  # place of a point along its curve: number of landmarks, or a limit


@dataclass(frozen=True)
class Found:
    """Result of a search."""

    deployment: Deployment
    """K landmarks."""
    fitness: float
    """Fitness of `deployment`."""
    way: str
    """Origin of the result: a search from the start (`anew`), or from the deployment of `fewer` or `more` landmarks or
    paper; or `alone`.
    """


class Axis(NamedTuple):
    """Names of the columns that hold the place of each point in a trade-off."""

    curve: str = "edge"
    """Column that names the curve: the edge of tags, 0 for points, or the sizes that may be mixed."""
    along: str = "count"
    """Column with the number of landmarks, or with the limit."""
    step: float = 1
    """Least difference along a curve that can change a result."""


COUNTS = Axis()
MIXED = "+"  # separator of the edges, metres, in the name of a curve along limits
COUNT_OF = "count_"  # prefix of columns: number of landmarks with an edge, metres, at points along limits


def started(problem: Problem, deployment: Deployment) -> Problem:
    """Return the problem with a deployment of all its landmarks as its start."""
    given = GivenDeployment(problem.free(replace(deployment, labels=None, surveyed=None)))
    return Problem(problem.scene, problem.objective, given, problem.evaluator.threads, problem.fixed)


def grown(problem: Problem, deployment: Deployment) -> Deployment:
    """Add landmarks to a deployment, chosen greedily by the objective's selection, up to the number of `problem`.

    If the grid of poses has no room for all landmarks, the rest stay as in the start of the problem. With a limit on
    paper or cost, landmarks of any size are added until the limit is used up.
    """
    footprints, tag, start = problem.scene.footprints, problem.scene.tag, problem.draw(np.random.default_rng(0))
    poses = candidates(footprints, np.array([np.nan] if tag.limit is None else tag.edges), GRID_SPACING)
    selection = selectable(problem.objective).selection(problem.evaluator, problem.relevance)
    limit, prices = _priced(problem, deployment)
    left = limit - prices.sum()
    stock = stock_of_sizes(tag, footprints, left) if tag.limit else Tags(tag.filled(np.full(int(left), np.nan)), tag)
    chosen, _ = select(selection, poses, stock, footprints, fixed=deployment)
    more = deployment + poses[chosen] if len(chosen) else deployment
    if len(more) == problem.count or tag.limit is not None:
        return more
    return problem.separated(more + start[len(more) :]) or start


def shrunk(problem: Problem, deployment: Deployment) -> Deployment:
    """Remove landmarks from a deployment, the least loss first, down to the number of `problem`; fixed landmarks stay.

    With a limit of paper or cost, losses are divided by the share of the limit, and the released share is used again.
    """
    while True:
        limit, prices = _priced(problem, deployment)
        if prices.sum() <= limit:
            return deployment if problem.scene.tag.limit is None else grown(problem, deployment)
        count, whole = len(deployment), problem.fitness_of(deployment)
        rests = [deployment[np.delete(np.arange(count), k)] for k in range(problem.fixed_count, count)]
        missed = (whole - np.array([problem.fitness_of(rest) for rest in rests])) / prices
        deployment = rests[np.lexsort((-prices, missed))[0]]


def _priced(problem: Problem, deployment: Deployment) -> tuple[float, FloatArray]:
    """Limit of a problem, and the price of each landmark of a deployment that is not fixed."""
    free, tag = problem.free(deployment), problem.scene.tag
    if tag.limit is None:
        return problem.free_count, np.ones(len(free))
    return tag.limit * (1.0 + ROUNDING), stock_of_sizes(tag, problem.scene.footprints, tag.limit).prices(free)


def improved(
    known: Mapping[Key, Found],
    chosen: Iterable[Key],
    problem_of: Callable[[Key], Problem],
    search: Callable[[Key, Problem, str], Found],
) -> dict[Key, Found]:
    """For chosen numbers of landmarks, search again from the neighbouring deployments; keep the better deployment.

    Args:
        known: deployments by their number of landmarks, or their limit; adjacent entries are neighbours.
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


def front(points: pd.DataFrame, figures: list[str], axis: Axis = COUNTS) -> pd.DataFrame:
    """Medians of `figures` over the seeds, and the least and greatest value of the first figure.

    Args:
        points: a row for each curve, point along the curve, and `seed`.
        figures: columns of `points`.
        axis: names the columns of the curve and of the point.

    Returns:
        table indexed by curve and point, with the columns `least` and `greatest` after the figures.
    """
    groups = points.groupby([axis.curve, axis.along])
    medians, first = groups[figures].median(), groups[figures[0]]
    return medians.assign(least=first.min(), greatest=first.max())


def mixtures(points: pd.DataFrame, axis: Axis) -> pd.Series | None:
    """Numbers of tags by edge length, such as `51 of 0.06` (metres), for each point; with several seeds, for the best
    seed.

    Args:
        points, axis: as for `front`.

    Returns:
        series indexed like the result of `front`; None if the points have no columns with numbers of tags.
    """
    each = [str(name) for name in points if str(name).startswith(COUNT_OF)]
    if not each:
        return None
    best = points.loc[points.groupby([axis.curve, axis.along])["fitness"].idxmax()].set_index([axis.curve, axis.along])
    return best[each].apply(
        lambda row: ", ".join(f"{n:g} of {name.removeprefix(COUNT_OF)}" for name, n in row.items() if n), axis="columns"
    )


def fewest(points: pd.DataFrame, figure: str, wanted: float, axis: Axis = COUNTS) -> pd.DataFrame:
    """Least number of landmarks, or least limit, at which `figure` is at least `wanted`.

    Args:
        points, axis: as for `front`.
        figure: a column of `points`.
        wanted: value of the figure.

    Returns:
        table indexed by the curve. Column `axis.along`: least number at which the median over the seeds reaches
        `wanted`; `least` and `greatest`: extremes over the seeds of each seed's least number. Infinite if no number
        reaches `wanted`.
    """
    rows = {}
    for curve, same in points.groupby(axis.curve):
        reaching = same[same[figure] >= wanted].groupby("seed")[axis.along].min().reindex(same.seed.unique())
        medians = same.groupby(axis.along)[figure].median()
        at = medians.index[medians >= wanted]
        each = reaching.fillna(np.inf)
        rows[curve] = {axis.along: at.min() if len(at) else np.inf, "least": each.min(), "greatest": each.max()}
    return pd.DataFrame.from_dict(rows, orient="index").rename_axis(axis.curve)


def between(points: pd.DataFrame, figure: str, wanted: float, axis: Axis = COUNTS) -> list[tuple[Any, float]]:
    """For each curve, find the number of landmarks that halves the gap between the least number that reaches `wanted`
    and the next smaller number; curves without a gap are left out.

    Args:
        points, figure, wanted, axis: as for `fewest`.

    Returns:
        pairs of the curve and the number; numbers lie a whole number of steps above the lower end of the gap.
    """
    halves = []
    for curve, row in fewest(points, figure, wanted, axis).iterrows():
        reached = float(row[axis.along])
        below = points.loc[(points[axis.curve] == curve) & (points[axis.along] < reached), axis.along].max()
        if np.isfinite(reached) and reached - below >= 2 * axis.step:  # NaN if no number is below
            halves.append((curve, below.item() + max(int((reached - below) / 2 / axis.step), 1) * axis.step))
    return halves
