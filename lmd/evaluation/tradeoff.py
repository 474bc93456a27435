"""How many, how big: deployments of different numbers of landmarks, each made from its neighbours, and the fewest.

A deployment of K landmarks is found anew, or made from that of fewer, with landmarks added where they help most, or
from that of more, without those that are missed least; whichever is best after the same search.

Where paper or cost is limited in place of K, and tags may have any of several sizes, so is that of a limit: what is
added, or missed least, is judged by what it takes of the limit. So neighbours also find other mixtures of sizes.
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
from lmd.optimisers.composition import stock_of_sizes
from lmd.optimisers.selection import GRID_SPACING, ROUNDING, Tags, candidates, select
from lmd.problem import Problem
from lmd.scene.deployment import Deployment
from lmd.scene.deployment_sources import GivenDeployment

SAMPLE = Sample(groups=16, positions=512, divisions=23)  # smaller than that of a single run: there are many points
FEWER, MORE = "fewer", "more"  # whence a search has set out; `ANEW` is the start of the problem
ANEW = "anew"
ALONE = "alone"  # a mixture of sizes is worse than one size alone, and so has become that
Key = TypeVar("Key", int, float)  # of a point along its curve: a number of landmarks, or a limit


@dataclass(frozen=True)
class Found:
    """What a search has found.

    Args:
        deployment: K landmarks.
        fitness: of it.
        way: whence it set out: `anew`, or from the deployment of `fewer` or `more` landmarks or paper; or `alone`.
    """

    deployment: Deployment
    fitness: float
    way: str


class Axis(NamedTuple):
    """What the points of a trade-off lie along, as columns of their table."""

    curve: str = "edge"
    """Tells curves apart: the edge of tags, 0 for landmarks that are points, or which sizes may be mixed."""
    along: str = "count"
    """Number of landmarks, or what limits them."""
    step: float = 1
    """The least difference along a curve that can make one of what is found."""


COUNTS = Axis()
MIXED = "+"  # between the edges, metres, of a curve along limits
COUNT_OF = "count_"  # columns of points along limits: how many landmarks have each edge, metres


def started(problem: Problem, deployment: Deployment) -> Problem:
    """The same problem, started from a deployment of all its landmarks."""
    given = GivenDeployment(problem.free(replace(deployment, labels=None, surveyed=None)))
    return Problem(problem.scene, problem.objective, given, problem.evaluator.threads, problem.fixed)


def grown(problem: Problem, deployment: Deployment) -> Deployment:
    """The landmarks of a deployment and more, chosen greedily by the objective's selection, as many as `problem` has.

    Where the grid of poses has no room for all, the others hang as the start of the problem has them. Where the problem
    has a limit, there are as many as that suffices for, of any of its sizes.
    """
    plates, tag, start = problem.scene.plates, problem.scene.tag, problem.draw(np.random.default_rng(0))
    poses = candidates(plates, np.array([np.nan] if tag.limit is None else tag.edges), GRID_SPACING)
    selection = selectable(problem.objective).selection(problem.evaluator, problem.relevance)
    limit, prices = _priced(problem, deployment)
    left = limit - prices.sum()
    stock = stock_of_sizes(tag, plates, left) if tag.limit else Tags(tag.filled(np.full(int(left), np.nan)), tag)
    chosen, _ = select(selection, poses, stock, plates, fixed=deployment)
    more = deployment + poses[chosen] if len(chosen) else deployment
    if len(more) == problem.count or tag.limit is not None:
        return more
    return problem.apart(more + start[len(more) :]) or start


def shrunk(problem: Problem, deployment: Deployment) -> Deployment:
    """The landmarks of a deployment without those that are missed least, one after the other; fixed ones stay.

    Where the problem has a limit, they are missed by what they take of it, and what is left of it is used again.
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
    """The limit of a problem, and what each landmark of a deployment that does not hang already takes of it."""
    free, tag = problem.free(deployment), problem.scene.tag
    if tag.limit is None:
        return problem.free_count, np.ones(len(free))
    return tag.limit * (1.0 + ROUNDING), stock_of_sizes(tag, problem.scene.plates, tag.limit).prices(free)


def improved(
    known: Mapping[Key, Found],
    chosen: Iterable[Key],
    problem_of: Callable[[Key], Problem],
    search: Callable[[Key, Problem, str], Found],
) -> dict[Key, Found]:
    """The deployments of the chosen numbers of landmarks, or what a search from a neighbour's finds, if it is better.

    Args:
        known: by the number of landmarks, or the limit; each is the neighbour of the next larger and the next smaller.
        chosen: those that are looked at, upwards and then downwards.
        problem_of: the problem of so many landmarks.
        search: climbs from the start of the problem of so many landmarks, which is called what the last argument says.
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
    """The median of `figures`, and the least and greatest of the first, over the seeds.

    Args:
        points: a row for each curve, point along it, and `seed`.
        figures: its columns.
        axis: names the columns of the curve and of the point.

    Returns:
        indexed by these two, with columns `least` and `greatest` behind the figures.
    """
    groups = points.groupby([axis.curve, axis.along])
    medians, first = groups[figures].median(), groups[figures[0]]
    return medians.assign(least=first.min(), greatest=first.max())


def mixtures(points: pd.DataFrame, axis: Axis) -> pd.Series | None:
    """How many tags of each edge, metres, the seed of the greatest fitness has at each point, such as `51 of 0.06`.

    Args:
        points, axis: as for `front`.

    Returns:
        indexed as `front`; None where the points do not say it.
    """
    each = [str(name) for name in points if str(name).startswith(COUNT_OF)]
    if not each:
        return None
    best = points.loc[points.groupby([axis.curve, axis.along])["fitness"].idxmax()].set_index([axis.curve, axis.along])
    return best[each].apply(
        lambda row: ", ".join(f"{n:g} of {name.removeprefix(COUNT_OF)}" for name, n in row.items() if n), axis="columns"
    )


def fewest(points: pd.DataFrame, figure: str, wanted: float, axis: Axis = COUNTS) -> pd.DataFrame:
    """The least number of landmarks, or the least limit, whose `figure` is at least `wanted`.

    Args:
        points, axis: as for `front`.
        figure: one of its columns.

    Returns:
        indexed by the curve: in the column `axis.along` the least number at which the median over the seeds reaches it;
        `least` and `greatest`, of the least numbers of the single seeds. Infinite where none reaches it.
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
    """For each curve the number of landmarks, if any, that halves the gap below the least one that reaches `wanted`.

    Args:
        points, figure, wanted, axis: as for `fewest`.

    Returns:
        pairs of the curve and the number, which is by whole steps above the one below the gap.
    """
    halves = []
    for curve, row in fewest(points, figure, wanted, axis).iterrows():
        reached = float(row[axis.along])
        below = points.loc[(points[axis.curve] == curve) & (points[axis.along] < reached), axis.along].max()
        if np.isfinite(reached) and reached - below >= 2 * axis.step:  # NaN where nothing is below
            halves.append((curve, below.item() + max(int((reached - below) / 2 / axis.step), 1) * axis.step))
    return halves
