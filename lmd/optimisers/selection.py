"""Lazy greedy selection of poses from a grid on the surfaces.

What is climbed is an objective's `selection`, a monotone submodular stand-in. Adding the pose of the largest gain, one
after the other, comes within 1 - 1/e of the best choice of poses for it. Gains only ever shrink, which is what makes
the lazy variant (Minoux 1978) exact: a pose needs evaluating again only while its last known gain is the largest.
"""

import numpy as np

from lmd.objectives.base import Selection, selectable
from lmd.problem import Problem
from lmd.scene.deployment import Deployment
from lmd.scene.plates import Plates
from lmd.sight.poses import candidate_poses
from lmd.space.space import Space

GAINS_BATCH = 32  # poses whose gains are brought up to date together
GRID_SPACING = 0.25  # of the grid of poses, metres


def select(
    selection: Selection,
    poses: Deployment,
    count: int,
    plates: Plates | None = None,
    allowance: float = np.inf,
    fixed: Deployment | None = None,
) -> tuple[np.ndarray, int]:
    """Choose up to `count` of the `poses`, each at most once, and none whose plate would overlap another's.

    Args:
        selection: what is climbed, with nothing chosen yet.
        poses: N candidates.
        count: K.
        plates: of the tags; None for landmarks that are points.
        allowance: how many gains may be evaluated; fewer poses are chosen if it does not suffice.
        fixed: landmarks that are chosen before the first of the poses.

    Returns:
        indices of the chosen poses in the order of choice, and the number of gains evaluated.
    """
    known, taken = np.full(len(poses), np.inf), np.zeros(len(poses), dtype=bool)
    add_each(selection, fixed)
    if fixed is not None and plates and plates.edge:
        for k in range(len(fixed)):
            taken |= plates.touched(poses, fixed[k : k + 1])
        known[taken] = -np.inf
    chosen: list[int] = []
    spent = 0
    while len(chosen) < count and not taken.all():
        fresh = np.zeros(len(poses), dtype=bool)
        while not fresh[best := int(np.argmax(known))]:
            stale = np.flatnonzero(~fresh & ~taken)
            # At first nothing is known about any pose, afterwards a few at the top decide.
            batch = stale[np.argsort(-known[stale], kind="stable")[: GAINS_BATCH if chosen else len(poses)]]
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


def add_each(selection: Selection, fixed: Deployment | None) -> None:
    """Choose the landmarks that hang already, if there are any."""
    if fixed is not None:
        for k in range(len(fixed)):
            selection.add(fixed[k : k + 1])


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
        start: K landmarks, the fixed ones first.
        spacing: of the grid of poses, metres; coarsened if the allowance could not pay for it.
        allowance: how many gains may be evaluated.

    Returns:
        the deployment, and the number of gains evaluated.
    """
    plates = problem.scene.plates
    poses = _poses_within(plates.hanging, spacing, allowance / 2)
    selection = selectable(problem.objective).selection(problem.fitness_evaluator, problem.fitness_relevance)
    chosen, spent = select(selection, poses, problem.free_count, plates, allowance, problem.fixed)
    if not len(chosen):
        return start, spent
    begun = problem.complete(poses[chosen])
    return problem.apart(begun if len(begun) == problem.count else begun + start[len(begun) :]) or start, spent
