"""How many tags of each size, where only the paper is given."""

import numpy as np

from lmd.core.checks import InputError
from lmd.objectives.base import Objective, selectable
from lmd.optimisers.selection import GRID_SPACING, Paper, candidates, select
from lmd.scene.deployment import Deployment
from lmd.scene.scene import Scene
from lmd.sight.evaluator import Evaluator


def composition(
    scene: Scene,
    objective: Objective,
    area: float,
    threads: int | None = None,
    fixed: Deployment | None = None,
) -> tuple[int, ...]:
    """How many tags of each of the edges of a scene's tag greedy selection by gain per square metre of paper takes.

    Args:
        scene: its tag has several edges.
        objective: what they are for; it must have a selection.
        area: of all their papers, square metres.
        threads: worker threads, all processors by default; the result does not depend on it.
        fixed: landmarks that hang already, with their surfaces.

    Raises:
        InputError: the paper does not suffice for one tag, or the objective has no selection.
    """
    edges, plates = np.array(scene.tag.edges), scene.plates
    evaluator = Evaluator(scene.sized(edges), threads=threads)
    relevance = scene.room.relevance.weights(evaluator.positions)
    hung = (
        None
        if fixed is None
        else Deployment(fixed.positions, fixed.normals, fixed.surfaces, edges=fixed.edges_of(scene.tag))
    )
    poses = candidates(plates, edges, GRID_SPACING)
    chosen, _ = select(
        selectable(objective).selection(evaluator, relevance), poses, Paper(area, plates), plates, fixed=hung
    )
    if not len(chosen):
        smallest = plates.edge**2
        raise InputError(f"paper = {area:g} square metres is too little for a tag: it takes {smallest:.3g}.", "paper")
    assert poses.edges is not None, "candidates have sizes"
    found = poses.edges[chosen]
    return tuple(int((found == edge).sum()) for edge in edges)
