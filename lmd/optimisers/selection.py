"""Lazy greedy selection of poses from a grid on the surfaces.

What is climbed is an objective's `selection`, a monotone submodular stand-in. Adding the pose of the largest gain, one
after the other, comes within 1 - 1/e of the best choice of poses for it. Gains only ever shrink, which is what makes
the lazy variant (Minoux 1978) exact: a pose needs evaluating again only while its last known gain is the largest.
"""

import numpy as np

from lmd.deployment import Deployment
from lmd.objectives.base import Selection
from lmd.plates import Plates
from lmd.problem import Problem
from lmd.sight.poses import candidate_poses
from lmd.space.space import Space

BATCH = 32  # poses whose gains are brought up to date together
SPACING = 0.25  # of the grid of poses, metres


def select(
    selection: Selection, poses: Deployment, count: int, plates: Plates | None = None, allowance: float = np.inf
) -> tuple[np.ndarray, int]:
    """Choose up to `count` of the `poses`, each at most once, and none whose plate would overlap another's.

    Args:
        selection: what is climbed, with nothing chosen yet.
        poses: N candidates.
        count: K.
        plates: of the tags; None for landmarks that are points.
        allowance: how many gains may be evaluated; fewer poses are chosen if it does not suffice.

    Returns:
        indices of the chosen poses in the order of choice, and the number of gains evaluated.
    """
    known, taken = np.full(len(poses), np.inf), np.zeros(len(poses), dtype=bool)
    chosen: list[int] = []
    spent = 0
    while len(chosen) < count and not taken.all():
        fresh = np.zeros(len(poses), dtype=bool)
        while not fresh[best := int(np.argmax(known))]:
            stale = np.flatnonzero(~fresh & ~taken)
            # At first nothing is known about any pose, afterwards a few at the top decide.
            batch = stale[np.argsort(-known[stale], kind="stable")[: BATCH if chosen else len(poses)]]
            if spent + len(batch) > allowance:
                return np.array(chosen, dtype=int), spent
            known[batch] = selection.gains(poses[batch])
            fresh[batch] = True
            spent += len(batch)
        chosen.append(best)
        gone = plates.touched(poses, poses[best : best + 1]) if plates and plates.edge else best
        known[gone], taken[gone] = -np.inf, True
        selection.add(poses[best : best + 1])
    return np.array(chosen, dtype=int), spent


def _poses_within(room: Space, spacing: float, most: float) -> Deployment:
    """`candidate_poses`, coarsened until there are no more than `most`, or one for each piece of a surface."""
    poses, pieces = candidate_poses(room, spacing), sum(len(surface.pieces) for surface in room.surfaces())
    while len(poses) > max(most, pieces):
        spacing *= 1.3
        poses = candidate_poses(room, spacing)
    return poses


def greedy_start(problem: Problem, start: Deployment, spacing: float, allowance: float) -> tuple[Deployment, int]:
    """As many poses as an allowance pays for, chosen greedily; what it cannot pay for stays as in `start`.

    Args:
        problem: its objective must have a selection.
        start: K landmarks.
        spacing: of the grid of poses, metres; coarsened if the allowance could not pay for it.
        allowance: how many gains may be evaluated.

    Returns:
        the deployment, and the number of gains evaluated.
    """
    plates, count = problem.scene.plates, problem.count
    poses = _poses_within(plates.hanging, spacing, allowance / 2)
    selection = problem.objective.selection(problem.fitness_evaluator, problem.fitness_relevance)
    chosen, spent = select(selection, poses, count, plates, allowance)
    if not len(chosen):
        return start, spent
    rest = start[len(chosen) :] if len(chosen) < count else None
    return plates.apart(poses[chosen] if rest is None else poses[chosen] + rest) or start, spent
