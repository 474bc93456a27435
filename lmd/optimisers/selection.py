"""Greedy selection of landmark poses from a grid on the surfaces of the room.

The objective is replaced by a surrogate (its `selection`), a function of the set of chosen poses. The *gain* of a pose
is the increase of the surrogate when the pose is added. In each step the pose with the largest gain is added. The
surrogate is monotone and submodular, so the choice reaches at least 1 - 1/e of the largest possible value. The gain of
a pose never increases when other poses are added. So the gain is computed again only while its last known value is the
largest, which does not change the result (lazy variant, Minoux 1978).

For tags of several sizes, a candidate is a pose with a size. A candidate may be chosen while unplaced tags of this size
remain. If instead the paper area or the cost of all tags is limited, candidates are compared by their gain divided by
their *price*: the area or cost of one tag.
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
    """Stock of landmarks from which a greedy selection chooses, with a given number of landmarks of each size."""

    sizes: FloatArray
    """Edge length of each of the K landmarks, `(K,)`, metres; zeros for points."""
    tag: Tag
    """Tag whose edge length applies to poses that have none."""

    def prices(self, poses: Deployment) -> FloatArray:
        """Price of a landmark at each of N poses, `(N,)`; here 1, as only the number of landmarks is limited.

        The selection compares poses by their gain divided by this price.
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
    """Stock of tags from which a greedy selection chooses: any number of each size, up to a total price."""

    total: float
    """Limit on the total price: square metres of paper, or cost."""
    prices_of: Callable[[Deployment], FloatArray]
    """Function that returns the price of each pose, `(N,)`."""

    def prices(self, poses: Deployment) -> FloatArray:
        """See `Tags.prices`."""
        return self.prices_of(poses)

    def none_left(self, poses: Deployment, chosen: Sequence[int]) -> BoolArray:
        """Mask `(N,)` of the poses whose price exceeds the rest of the limit.

        The rest is the limit minus the prices of the poses that have been chosen, which have the indices `chosen`.
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
    """Choose poses greedily: in each step the pose with the largest ratio of gain to price.

    A pose is chosen at most once, and no footprints of tags overlap.

    Args:
        selection: surrogate of the objective, which gives the gain of adding a landmark. The surrogate contains no
            landmarks at first; fixed and chosen landmarks are added in place.
        poses: N candidate poses.
        stock: landmarks that may be chosen, and their prices; a number of landmarks if these are points.
        footprints: footprints of the tags; None for landmarks that are points.
        allowance: largest number of gains that may be computed; fewer poses are chosen if this number does not suffice.
        fixed: fixed landmarks, which are added before any pose is chosen.
        stop: function that is called from time to time, and returns True to end the choice early.

    Returns:
        indices of the chosen poses in the order of choice, and the number of computed gains.
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
    """Add the `fixed` landmarks to `selection`, the surrogate of an objective, in place; None adds no landmark."""
    if fixed is not None:
        for k in range(len(fixed)):
            selection.add(fixed[k : k + 1])


def candidates(footprints: Footprints, edges: FloatArray, spacing: float) -> Deployment:
    """Candidate poses, from which a greedy selection chooses: a grid on all surfaces for each edge length of tags.

    A tag at any of these poses is within the region where tags may hang.

    Args:
        footprints: footprints of the tags, and the surfaces on which they may hang.
        edges: edge lengths of K tags, `(K,)`, metres; NaN for the edge length of the scene's tag.
        spacing: spacing of the grids, metres.

    Returns:
        deployment with one landmark for each candidate pose, and with the edge lengths of the landmarks. If all of
        `edges` are NaN, the edge lengths are NaN.
    """
    parts, own = [], not np.isnan(edges).all()
    for edge in np.unique(footprints.tag.filled(edges)):
        poses = candidate_poses(footprints.inset(footprints.tag.paper_share * edge), spacing)
        parts.append(replace(poses, edges=np.full(len(poses), edge if own else np.nan)))
    return reduce(operator.add, parts)


def _candidates_within(footprints: Footprints, edges: FloatArray, spacing: float, most: float) -> Deployment:
    """Candidate poses as returned by `candidates`, with a larger spacing if there would be more than `most` poses.

    If the spacing reaches the extent of the largest surface, it is not increased further.
    """
    poses, widest = candidates(footprints, edges, spacing), max(max(wall.extent) for wall in footprints.room.surfaces())
    while len(poses) > most and spacing < widest:
        spacing *= 1.3
        poses = candidates(footprints, edges, spacing)
    return poses


def greedy_start(
    problem: Problem, start: Deployment, spacing: float, allowance: float, stop: Callable[[], bool]
) -> tuple[Deployment, int]:
    """Replace the free landmarks of `start` by greedily chosen landmarks, as far as `allowance` and `stop` permit.

    Landmarks that are not replaced keep their poses.

    Args:
        problem: problem whose objective has a surrogate for greedy choice (`selection`).
        start: K landmarks; fixed landmarks come first.
        spacing: spacing of the grid of poses, metres; larger if the allowance does not suffice for the grid.
        allowance: largest number of gains that may be computed; a gain is the increase of the surrogate by a landmark.
        stop: function that is called from time to time, and returns True to end the choice early.

    Returns:
        the new deployment, and the number of computed gains.
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
    """Return the number of tags of each edge length, in the order of the tag's `edges`, chosen by greedy selection.

    A candidate is a pose with an edge length. In each step the candidate with the largest ratio of gain to price (paper
    area or cost) is chosen.

    Args:
        scene: scene whose tag has several edge lengths, and a limit on the area of paper or on the cost.
        objective: objective that has a surrogate for greedy choice (`selection`).
        threads: number of worker threads; None for all processors. The result does not depend on this number.
        fixed: fixed landmarks, with their surfaces.

    Raises:
        InputError: the limit does not suffice for one tag, or the objective has no surrogate.
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
    """Stock of tags with any of the edge lengths of `tag`, for a greedy selection.

    `limit` is the limit on the total cost if the tag has a budget, else on the total area of paper, square metres.
    """
    if tag.budget is None:
        return Limited(limit, lambda poses: footprints.papers(poses) ** 2)
    costs = dict(zip(tag.edges or (), tag.costs or (), strict=True))  # a tag with a budget has edges and costs
    return Limited(limit, lambda poses: np.array([costs[edge] for edge in poses.edges_of(tag).tolist()]))
