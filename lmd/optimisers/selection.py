"""Lazy greedy selection of poses from a grid on the surfaces.

What is climbed is an objective's `selection`, a monotone submodular stand-in. Adding the pose of the largest gain, one
after the other, comes within 1 - 1/e of the best choice of poses for it. Gains only ever shrink, which is what makes
the lazy variant (Minoux 1978) exact: a pose needs evaluating again only while its last known gain is the largest.

Where tags have several sizes, a candidate is a pose and a size, and what is left of a size says whether it may still be
chosen. Where only the paper or the cost of all is given, candidates compete by their gain per square metre or cost.
"""

import operator
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import reduce
from typing import Protocol

import numpy as np

from lmd.core.checks import BoolArray, FloatArray
from lmd.objectives.base import Selection, selectable
from lmd.problem import Problem
from lmd.scene.deployment import Deployment
from lmd.scene.deployment_sources import POINT
from lmd.scene.plates import Plates
from lmd.scene.tag import Tag
from lmd.sight.poses import candidate_poses

GAINS_BATCH = 32  # poses whose gains are brought up to date together
GRID_SPACING = 0.25  # of the grid of poses, metres
ROUNDING = 1e-9  # relative: paper that is used up to a rounding error


class Stock(Protocol):
    """What there is to hang."""

    def prices(self, poses: Deployment) -> FloatArray:
        """What each pose takes of it, `(N,)`: gains are divided by that."""

    def none_left(self, poses: Deployment, chosen: Sequence[int]) -> BoolArray:
        """For which of the poses nothing is left after those `chosen`, `(N,)`."""


@dataclass(frozen=True)
class Tags:
    """A number of landmarks of each size.

    Args:
        sizes: edges of the landmarks, `(K,)`, metres; zeros for points.
        tag: what hangs at poses without an edge of their own.
    """

    sizes: FloatArray
    tag: Tag

    def prices(self, poses: Deployment) -> FloatArray:
        """See `Stock.prices`."""
        return np.ones(len(poses))

    def none_left(self, poses: Deployment, chosen: Sequence[int]) -> BoolArray:
        """See `Stock.none_left`."""
        sizes, of = np.unique(poses.edges_of(self.tag), return_inverse=True)
        left = (self.sizes == sizes[:, None]).sum(axis=1) - np.bincount(of[list(chosen)], minlength=len(sizes))
        return np.asarray((left <= 0)[of])


@dataclass(frozen=True)
class Limited:
    """Tags of any size whose prices, square metres of paper or costs, may be `total` in all."""

    total: float
    prices_of: Callable[[Deployment], FloatArray]

    def prices(self, poses: Deployment) -> FloatArray:
        """See `Stock.prices`."""
        return self.prices_of(poses)

    def none_left(self, poses: Deployment, chosen: Sequence[int]) -> BoolArray:
        """See `Stock.none_left`."""
        prices = self.prices(poses)
        return np.asarray(prices > self.total * (1.0 + ROUNDING) - prices[list(chosen)].sum())


def stock_of(problem: Problem) -> Stock:
    """The landmarks that a problem has to place."""
    return Tags(problem.free_sizes, problem.scene.tag)


def select(
    selection: Selection,
    poses: Deployment,
    stock: int | Stock,
    plates: Plates | None = None,
    allowance: float = np.inf,
    fixed: Deployment | None = None,
) -> tuple[np.ndarray, int]:
    """Choose some of the `poses`, each at most once, and none whose plate would overlap another's.

    Args:
        selection: what is climbed, with nothing chosen yet.
        poses: N candidates.
        stock: what there is to hang, or the number of points.
        plates: of the tags; None for landmarks that are points.
        allowance: how many gains may be evaluated; fewer poses are chosen if it does not suffice.
        fixed: landmarks that are chosen before the first of the poses.

    Returns:
        indices of the chosen poses in the order of choice, and the number of gains evaluated.
    """
    stock = Tags(np.zeros(stock), POINT) if isinstance(stock, int) else stock
    known, taken, prices = np.full(len(poses), np.inf), np.zeros(len(poses), dtype=bool), stock.prices(poses)
    add_each(selection, fixed)
    if fixed is not None and plates and plates.edge:
        for k in range(len(fixed)):
            taken |= plates.touched(poses, fixed[k : k + 1])
    chosen: list[int] = []
    spent = 0
    while True:
        taken |= stock.none_left(poses, chosen)
        known[taken] = -np.inf
        if taken.all():
            return np.array(chosen, dtype=int), spent
        fresh = np.zeros(len(poses), dtype=bool)
        while not fresh[best := int(np.argmax(known))]:
            stale = np.flatnonzero(~fresh & ~taken)
            # At first nothing is known about any pose, afterwards a few at the top decide.
            batch = stale[np.argsort(-known[stale], kind="stable")[: GAINS_BATCH if chosen else len(poses)]]
            if spent + len(batch) > allowance:
                return np.array(chosen, dtype=int), spent
            known[batch] = selection.gains(poses[batch]) / prices[batch]
            fresh[batch] = True
            spent += len(batch)
        chosen.append(best)
        taken[plates.touched(poses, poses[best : best + 1]) if plates and plates.edge else best] = True
        selection.add(poses[best : best + 1])


def add_each(selection: Selection, fixed: Deployment | None) -> None:
    """Choose the landmarks that hang already, if there are any."""
    if fixed is not None:
        for k in range(len(fixed)):
            selection.add(fixed[k : k + 1])


def candidates(plates: Plates, edges: FloatArray, spacing: float) -> Deployment:
    """Poses of a grid where tags may hang, for each size of `edges` `(K,)`, metres, see `Deployment.edges`.

    The poses have an edge of their own if one of `edges` is known.
    """
    parts, own = [], not np.isnan(edges).all()
    for edge in np.unique(plates.tag.filled(edges)):
        poses = candidate_poses(plates.inset(plates.tag.paper_share * edge), spacing)
        parts.append(replace(poses, edges=np.full(len(poses), edge if own else np.nan)))
    return reduce(operator.add, parts)


def _candidates_within(plates: Plates, edges: FloatArray, spacing: float, most: float) -> Deployment:
    """`candidates`, coarsened until there are no more than `most`, or one of a size for each piece of a surface."""
    poses, widest = candidates(plates, edges, spacing), max(max(wall.extent) for wall in plates.room.surfaces())
    while len(poses) > most and spacing < widest:
        spacing *= 1.3
        poses = candidates(plates, edges, spacing)
    return poses


def greedy_start(problem: Problem, start: Deployment, spacing: float, allowance: float) -> tuple[Deployment, int]:
    """As many poses as an allowance pays for, chosen greedily; what it cannot pay for stays as in `start`.

    Args:
        problem: its objective must have a selection.
        start: K landmarks, the fixed ones first.
        spacing: of the grid of poses, metres; coarsened if the allowance could not pay for it.
        allowance: how many gains may be evaluated.

    Returns:
        the deployment, and the number of gains evaluated.
    """
    plates = problem.scene.plates
    poses = _candidates_within(plates, problem.free_edges, spacing, allowance / 2)
    selection = selectable(problem.objective).selection(problem.fitness_evaluator, problem.fitness_relevance)
    chosen, spent = select(selection, poses, stock_of(problem), plates, allowance, problem.hung)
    return problem.apart(_in_place(problem, start, poses[chosen])) or start if len(chosen) else start, spent


def _in_place(problem: Problem, start: Deployment, found: Deployment) -> Deployment:
    """The landmarks of `start` with those `found` in place of the first free ones of each size."""
    new = found.edges_of(problem.scene.tag)
    for edge in np.unique(new):
        these = np.flatnonzero(new == edge)
        free = problem.fixed_count + np.flatnonzero(problem.free_sizes == edge)
        start = start.put(free[: len(these)], found[these])
    return Deployment(start.positions, start.normals, start.surfaces)
