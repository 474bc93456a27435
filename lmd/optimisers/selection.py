"""Lazy greedy selection of poses from a grid on the surfaces of the room.

An objective's surrogate (its `selection`) is monotone and submodular. If in each step the pose with the largest gain is
added, the surrogate reaches at least 1 - 1/e of its value for the best choice of poses. The gain of a pose never
increases when other poses are added, so the lazy variant (Minoux 1978) is exact: a pose is evaluated again only while
its last known gain is the largest.

For tags of several sizes, a candidate is a pose with a size, and may be chosen while unplaced tags of this size remain.
If instead the area of paper or the cost of all tags is limited, candidates are compared by their gain divided by their
area or cost, their "price".
"""

import operator
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import reduce
from typing import TypeAlias

import numpy as np

from lmd.core.checks import BoolArray, FloatArray, InputError, IntArray
from lmd.objectives.base import Objective, Selection, selectable
from lmd.problem import Problem
from lmd.scene.deployment import Deployment
from lmd.scene.deployment_sources import POINT
from lmd.scene.footprints import Footprints
from lmd.scene.scene import Scene
from lmd.scene.tag import Tag
from lmd.sight.evaluator import Evaluator
from lmd.sight.poses import candidate_poses

GAINS_BATCH = 32  # poses whose gains are evaluated together
AT_ONCE = 4 * GAINS_BATCH  # poses evaluated between two checks of the time limit
GRID_SPACING = 0.25  # spacing of the grid of poses, metres
ROUNDING = 1e-9  # relative tolerance of a limit


@dataclass(frozen=True)
class Tags:
    """Supply of landmarks for a selection, with a given number for each size."""

    sizes: FloatArray
    """Edge length of each of the K landmarks, `(K,)`, metres; zeros for points."""
    tag: Tag
    """Tag that applies to poses without an edge length of their own."""

    def prices(self, poses: Deployment) -> FloatArray:
        """Price of a landmark at each of N poses, `(N,)`. The selection compares poses by their gain divided by this
        price.
        """
        return np.ones(len(poses))

    def none_left(self, poses: Deployment, chosen: Sequence[int]) -> BoolArray:
        """Mask `(N,)` of the poses for whose size no landmark is left.

        `chosen` are the indices of the poses that have been chosen; each of them has used up one landmark of its size.
        """
        sizes, of = np.unique(poses.edges_of(self.tag), return_inverse=True)
        left = (self.sizes == sizes[:, None]).sum(axis=1) - np.bincount(of[list(chosen)], minlength=len(sizes))
        return np.asarray((left <= 0)[of])


@dataclass(frozen=True)
class Limited:
    """Supply of landmarks for a selection with a limit on the total price of the tags, which may have any size."""

    total: float
    """Limit on the total price: square metres of paper, or cost."""
    prices_of: Callable[[Deployment], FloatArray]
    """Function that returns the price of each pose, `(N,)`."""

    def prices(self, poses: Deployment) -> FloatArray:
        """See `Tags.prices`."""
        return self.prices_of(poses)

    def none_left(self, poses: Deployment, chosen: Sequence[int]) -> BoolArray:
        """Mask `(N,)` of the poses whose price exceeds the rest of the limit.

        `chosen` are the indices of the poses that have been chosen and use up a part of the limit.
        """
        prices = self.prices(poses)
        return np.asarray(prices > self.total * (1.0 + ROUNDING) - prices[list(chosen)].sum())


Stock: TypeAlias = Tags | Limited  # landmarks that can be chosen


def select(
    selection: Selection,
    poses: Deployment,
    stock: int | Stock,
    footprints: Footprints | None = None,
    allowance: float = np.inf,
    fixed: Deployment | None = None,
    stop: Callable[[], bool] = bool,
) -> tuple[IntArray, int]:
    """Choose poses greedily, by gain divided by price, each at most once, so that no footprints overlap.

    Args:
        selection: surrogate without landmarks; fixed and chosen landmarks are added to it in place.
        poses: N candidate poses.
        stock: supply of landmarks, or the number of landmarks if these are points.
        footprints: footprints of the tags; None for landmarks that are points.
        allowance: largest number of gains that may be evaluated; fewer poses are chosen if this number does not
            suffice.
        fixed: fixed landmarks, which are added before the first of the poses.
        stop: function that is called from time to time, and returns True to end the choice early.

    Returns:
        indices of the chosen poses in the order of choice, and the number of gains evaluated.
    """
    stock = Tags(np.zeros(stock), POINT) if isinstance(stock, int) else stock
    known, taken, prices = np.full(len(poses), np.inf), np.zeros(len(poses), dtype=bool), stock.prices(poses)
    add_each(selection, fixed)
    if fixed is not None and footprints and footprints.edge:
        for k in range(len(fixed)):
            taken |= footprints.touched(poses, fixed[k : k + 1])
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
            # At first all gains are unknown and evaluated; later only the largest are evaluated again.
            batch = stale[np.argsort(-known[stale], kind="stable")[: GAINS_BATCH if chosen else len(poses)]]
            if spent + len(batch) > allowance:
                return np.array(chosen, dtype=int), spent
            for first in range(0, len(batch), AT_ONCE):
                if stop():
                    return np.array(chosen, dtype=int), spent
                part = batch[first : first + AT_ONCE]
                known[part] = selection.gains(poses[part]) / prices[part]
                spent += len(part)
            fresh[batch] = True
        chosen.append(best)
        taken[footprints.touched(poses, poses[best : best + 1]) if footprints and footprints.edge else best] = True
        selection.add(poses[best : best + 1])


def add_each(selection: Selection, fixed: Deployment | None) -> None:
    """Add the `fixed` landmarks to a selection in place, one after the other; None adds no landmark."""
    if fixed is not None:
        for k in range(len(fixed)):
            selection.add(fixed[k : k + 1])


def candidates(footprints: Footprints, edges: FloatArray, spacing: float) -> Deployment:
    """Candidate poses for landmarks: a grid of the places where tags may hang, for each edge length.

    The poses have edge lengths of their own if any of `edges` is not NaN.

    Args:
        footprints: footprints of the tags, and the surfaces on which they may hang.
        edges: edge lengths of K tags, `(K,)`, metres; NaN for the edge length of the scene's tag.
        spacing: spacing of the grids, metres.
    """
    parts, own = [], not np.isnan(edges).all()
    for edge in np.unique(footprints.tag.filled(edges)):
        poses = candidate_poses(footprints.inset(footprints.tag.paper_share * edge), spacing)
        parts.append(replace(poses, edges=np.full(len(poses), edge if own else np.nan)))
    return reduce(operator.add, parts)


def _candidates_within(footprints: Footprints, edges: FloatArray, spacing: float, most: float) -> Deployment:
    """Candidate poses (`candidates`) on a grid whose `spacing`, metres, is enlarged so that there are at most `most`.

    The spacing is not enlarged further than to one pose of each size on each piece of a surface.
    """
    poses, widest = candidates(footprints, edges, spacing), max(max(wall.extent) for wall in footprints.room.surfaces())
    while len(poses) > most and spacing < widest:
        spacing *= 1.3
        poses = candidates(footprints, edges, spacing)
    return poses


def greedy_start(
    problem: Problem, start: Deployment, spacing: float, allowance: float, stop: Callable[[], bool]
) -> tuple[Deployment, int]:
    """Choose landmarks greedily until an allowance is used up or `stop` returns True.

    Landmarks that are not chosen keep their poses in `start`.

    Args:
        problem: problem whose objective has a selection.
        start: K landmarks; fixed landmarks come first.
        spacing: spacing of the grid of poses, metres; larger if the allowance does not suffice for the grid.
        allowance: largest number of gains to evaluate.
        stop: function that is called from time to time, and returns True to end the choice early.

    Returns:
        the deployment, and the number of gains evaluated.
    """
    footprints = problem.scene.footprints
    poses = _candidates_within(footprints, problem.free_edges, spacing, allowance / 2)
    selection = selectable(problem.objective).selection(problem.fitness_evaluator, problem.fitness_relevance)
    stock = Tags(problem.free_sizes, problem.scene.tag)
    chosen, spent = select(selection, poses, stock, footprints, allowance, problem.fixed_with_edges, stop)
    return problem.separated(_in_place(problem, start, poses[chosen])) or start if len(chosen) else start, spent


def _in_place(problem: Problem, start: Deployment, found: Deployment) -> Deployment:
    """Copy of `start` in which the landmarks of `found` replace free landmarks of equal size.

    Of each size, the first free landmarks of `start` are replaced.
    """
    new = found.edges_of(problem.scene.tag)
    for edge in np.unique(new):
        these = np.flatnonzero(new == edge)
        free = problem.fixed_count + np.flatnonzero(problem.free_sizes == edge)
        start = start.put(free[: len(these)], found[these])
    return Deployment(start.positions, start.normals, start.surfaces)


def composition(
    scene: Scene, objective: Objective, threads: int | None = None, fixed: Deployment | None = None
) -> tuple[int, ...]:
    """Choose the number of tags of each edge length by greedy selection.

    Candidate poses are compared by their gain divided by their price.

    Args:
        scene: scene whose tag has several edge lengths, and a limit on the area of paper or on the cost.
        objective: objective that has a surrogate for greedy choice (`selection`).
        threads: number of worker threads; None for all processors. The result does not depend on this number.
        fixed: fixed landmarks, with their surfaces.

    Raises:
        InputError: the limit does not suffice for one tag, or the objective has no selection.
    """
    tag, footprints = scene.tag, scene.footprints
    edges, stock = np.array(tag.edges), stock_of_sizes(tag, footprints, tag.limit or 0.0)
    evaluator = Evaluator(scene.sized(edges), threads=threads)
    relevance = scene.room.relevance.weights(evaluator.positions)
    hung = None if fixed is None else replace(fixed, edges=fixed.edges_of(tag))
    poses = candidates(footprints, edges, GRID_SPACING)
    chosen, _ = select(selectable(objective).selection(evaluator, relevance), poses, stock, footprints, fixed=hung)
    if not len(chosen):
        least = float(stock.prices(poses).min())
        if tag.budget is not None:
            raise InputError(f"budget = {tag.budget:g} is too little: the cheapest tag costs {least:.3g}.", "budget")
        raise InputError(f"paper = {tag.paper:g} m2 is too little: the smallest tag takes {least:.3g} m2.", "paper")
    found = poses.edges[chosen]
    return tuple(int((found == edge).sum()) for edge in edges)


def stock_of_sizes(tag: Tag, footprints: Footprints, limit: float) -> Stock:
    """Supply of tags with any of the edge lengths of `tag`. The limit is on the total cost if the tag has a budget,
    else on the total area of paper, square metres.
    """
    if tag.budget is None:
        return Limited(limit, lambda poses: footprints.papers(poses) ** 2)
    costs = dict(zip(tag.edges or (), tag.costs or (), strict=True))  # a tag with a budget has edges and costs
    return Limited(limit, lambda poses: np.array([costs[edge] for edge in poses.edges_of(tag).tolist()]))
