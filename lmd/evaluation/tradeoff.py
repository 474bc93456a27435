"""How many, how big: deployments of different numbers of landmarks, each made from its neighbours, and the fewest.

A deployment of K landmarks is found anew, or made from that of fewer, with landmarks added where they help most, or
from that of more, without those that are missed least; whichever is best after the same search.
"""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
import pandas as pd

from lmd.evaluation.validation import Sample
from lmd.objectives.base import selectable
from lmd.optimisers.selection import GRID_SPACING, select
from lmd.problem import Problem
from lmd.scene.deployment import Deployment
from lmd.scene.deployment_sources import GivenDeployment
from lmd.sight.poses import candidate_poses

SAMPLE = Sample(groups=16, positions=512, divisions=23)  # smaller than that of a single run: there are many points
FEWER, MORE = "fewer", "more"  # whence a search has set out; `ANEW` is the start of the problem
ANEW = "anew"


@dataclass(frozen=True)
class Found:
    """What a search has found.

    Args:
        deployment: K landmarks.
        fitness: of it.
        way: whence it set out: `anew`, or from the deployment of `fewer` or `more` landmarks.
    """

    deployment: Deployment
    fitness: float
    way: str


Search = Callable[[Problem, str], Found]


def started(problem: Problem, deployment: Deployment) -> Problem:
    """The same problem, started from a deployment of all its landmarks."""
    given = GivenDeployment(problem.free(replace(deployment, labels=None, surveyed=None)))
    return Problem(problem.scene, problem.objective, given, problem.evaluator.threads, problem.fixed)


def grown(problem: Problem, deployment: Deployment) -> Deployment:
    """The landmarks of a deployment and more, chosen greedily by the objective's selection, as many as `problem` has.

    Where the grid of poses has no room for all, the others hang as the start of the problem has them.
    """
    plates, start = problem.scene.plates, problem.draw(np.random.default_rng(0))
    poses = candidate_poses(plates.hanging, GRID_SPACING)
    selection = selectable(problem.objective).selection(problem.evaluator, problem.relevance)
    chosen, _ = select(selection, poses, problem.count - len(deployment), plates, fixed=deployment)
    more = deployment + poses[chosen] if len(chosen) else deployment
    if len(more) == problem.count:
        return more
    return problem.apart(more + start[len(more) :]) or start


def shrunk(problem: Problem, deployment: Deployment) -> Deployment:
    """The landmarks of a deployment without those that are missed least, one after the other; fixed ones stay."""
    while (count := len(deployment)) > problem.count:
        rests = np.array([np.delete(np.arange(count), k) for k in range(problem.fixed_count, count)])
        fitness = problem.fitness(deployment.positions[rests], deployment.normals[rests])
        deployment = deployment[rests[int(fitness.argmax())]]
    return deployment


def improved(
    known: Mapping[int, Found], chosen: Iterable[int], problem_of: Callable[[int], Problem], search: Search
) -> dict[int, Found]:
    """The deployments of the chosen numbers of landmarks, or what a search from a neighbour's finds, if it is better.

    Args:
        known: by the number of landmarks; each is the neighbour of the next larger and the next smaller.
        chosen: those that are looked at, upwards and then downwards.
        problem_of: the problem of so many landmarks.
        search: climbs from the start of a problem.
    """
    best, chosen = dict(known), set(chosen)
    for order, made, way in ((sorted(known), grown, FEWER), (sorted(known, reverse=True), shrunk, MORE)):
        for neighbour, count in pairwise(order):
            if count in chosen:
                problem = problem_of(count)
                found = search(started(problem, made(problem, best[neighbour].deployment)), way)
                best[count] = max(best[count], found, key=lambda each: each.fitness)
    return {count: best[count] for count in chosen}


def front(points: pd.DataFrame, figures: list[str]) -> pd.DataFrame:
    """The median of `figures`, and the least and greatest of the first, over the seeds.

    Args:
        points: a row for each `edge`, `count` and `seed`; the edge is 0 for landmarks that are points.
        figures: its columns.

    Returns:
        indexed by `edge` and `count`, with columns `least` and `greatest` behind the figures.
    """
    groups = points.groupby(["edge", "count"])
    medians, first = groups[figures].median(), groups[figures[0]]
    return medians.assign(least=first.min(), greatest=first.max())


def fewest(points: pd.DataFrame, figure: str, wanted: float) -> pd.DataFrame:
    """The least number of landmarks whose `figure` is at least `wanted`.

    Args:
        points: as for `front`.
        figure: one of its columns.

    Returns:
        indexed by `edge`: `count`, the least number at which the median over the seeds reaches it; `least` and
        `greatest`, of the least numbers of the single seeds. Infinite where none reaches it.
    """
    rows = {}
    for edge, same in points.groupby("edge"):
        reaching = same[same[figure] >= wanted].groupby("seed")["count"].min().reindex(same.seed.unique())
        medians = same.groupby("count")[figure].median()
        at = medians.index[medians >= wanted]
        each = reaching.fillna(np.inf)
        rows[edge] = {"count": at.min() if len(at) else np.inf, "least": each.min(), "greatest": each.max()}
    return pd.DataFrame.from_dict(rows, orient="index").rename_axis("edge")


def between(points: pd.DataFrame, figure: str, wanted: float) -> list[tuple[float, int]]:
    """For each edge the number of landmarks, if any, that halves the gap below the least one that reaches `wanted`.

    Args:
        points, figure, wanted: as for `fewest`.

    Returns:
        pairs of the edge and the number.
    """
    halves = []
    for row in fewest(points, figure, wanted).reset_index().to_dict("records"):
        edge, reached = float(row["edge"]), float(row["count"])
        below = points.loc[(points.edge == edge) & (points["count"] < reached), "count"].max()
        if np.isfinite(reached) and reached - below > 1:  # NaN where nothing is below
            halves.append((edge, int(reached + below) // 2))
    return halves
