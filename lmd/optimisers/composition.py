"""How many tags of each size, where only their paper or their cost is given."""

from dataclasses import replace

import numpy as np

from lmd.core.checks import InputError
from lmd.objectives.base import Objective, selectable
from lmd.optimisers.selection import GRID_SPACING, Limited, Stock, candidates, select
from lmd.scene.deployment import Deployment
from lmd.scene.plates import Plates
from lmd.scene.scene import Scene
from lmd.scene.tag import Tag
from lmd.sight.evaluator import Evaluator


def composition(
    scene: Scene,
    objective: Objective,
    threads: int | None = None,
    fixed: Deployment | None = None,
) -> tuple[int, ...]:
    """How many tags of each of the edges of a scene's tag greedy selection by gain per price takes.

    Args:
        scene: its tag has several edges, and says how much paper they may take or what they may cost.
        objective: what they are for; it must have a selection.
        threads: worker threads, all processors by default; the result does not depend on it.
        fixed: landmarks that hang already, with their surfaces.

    Raises:
        InputError: that does not suffice for one tag, or the objective has no selection.
    """
    tag, plates = scene.tag, scene.plates
    edges, stock = np.array(tag.edges), stock_of_sizes(tag, plates, tag.limit or 0.0)
    evaluator = Evaluator(scene.sized(edges), threads=threads)
    relevance = scene.room.relevance.weights(evaluator.positions)
    hung = None if fixed is None else replace(fixed, edges=fixed.edges_of(tag))
    poses = candidates(plates, edges, GRID_SPACING)
    chosen, _ = select(selectable(objective).selection(evaluator, relevance), poses, stock, plates, fixed=hung)
    if not len(chosen):
        least = float(stock.prices(poses).min())
        if tag.budget is not None:
            raise InputError(f"budget = {tag.budget:g} is too little for a tag: it costs {least:.3g}.", "budget")
        raise InputError(f"paper = {tag.paper:g} square metres is too little for a tag: it takes {least:.3g}.", "paper")
    found = poses.edges[chosen]
    return tuple(int((found == edge).sum()) for edge in edges)


def stock_of_sizes(tag: Tag, plates: Plates, limit: float) -> Stock:
    """Tags of any of the edges of `tag`, as many as `limit` of paper suffices for, or of cost if it has a budget."""
    if tag.budget is None:
        return Limited(limit, lambda poses: plates.papers(poses) ** 2)
    costs = dict(zip(tag.edges or (), tag.costs or (), strict=True))  # a budget comes with both
    return Limited(limit, lambda poses: np.array([costs[edge] for edge in poses.edges_of(tag).tolist()]))
