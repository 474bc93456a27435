"""Lazy greedy selection on a submodular stand-in, then a local search on the true objective.

The stand-in is the objective's `selection`. Adding the pose of the largest gain, one after the other, comes within
1 - 1/e of the best choice of poses for it. Gains only ever shrink, which is what makes the lazy variant (Minoux 1978)
exact: a pose needs evaluating again only while its last known gain is the largest.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from lmd.checks import InputError, integer, real
from lmd.deployment import Deployment
from lmd.objectives.base import Objective, Selection
from lmd.optimisers.annealing import Annealing, Stage
from lmd.optimisers.annealing.stage import changed
from lmd.plates import Plates
from lmd.problem import Problem
from lmd.scene import Scene
from lmd.sight.evaluator import Evaluator
from lmd.sight.poses import candidate_poses
from lmd.space.space import Space

BATCH = 32  # poses whose gains are brought up to date together
SPACING = 0.25  # of the grid of poses, metres
REFINED = Stage(temperature=(4e-5, 2e-5), width=(0.02, 0.006), step=(0.3, 0.05), margin=0.002, share=0.1)


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
    """`candidate_poses`, coarsened until there are no more than `most`."""
    poses = candidate_poses(room, spacing)
    while len(poses) > max(most, len(room.surfaces())):
        spacing *= 1.3
        poses = candidate_poses(room, spacing)
    return poses


class Greedy(Annealing):
    """Greedy selection from a grid of wall poses, refined by a cool walk with the rest of the budget.

    Poses of the grid are far enough apart that plates do not cover each other. Evaluating the gain of one pose costs
    as much of the budget as moving one landmark.

    Args:
        spacing: of the grid, metres; coarsened if the budget could not pay for it.
        single: conditions of the refinement, or what differs from the default ones, see `Annealing`.
        seed: see `Optimiser`.

    Raises:
        InputError: the spacing is not positive.
    """

    def __init__(
        self, spacing: float = SPACING, single: Stage | Mapping[str, Any] | None = None, seed: int = 0
    ) -> None:
        single = changed("single", REFINED, single)
        super().__init__(stacked=single, single=single, sampled=single, given=single, stacked_share=0.0, seed=seed)
        self.spacing = real("spacing", spacing, above=0.0)

    def _begin(self, problem: Problem, stack: int, limit: float) -> int:
        """Build the start greedily; what the budget cannot pay for stays where the problem's start has it."""
        super()._begin(problem, stack, limit)
        plates, count = problem.scene.plates, problem.count
        allowance = (limit - count) / 2
        poses = _poses_within(plates.hanging, self.spacing, allowance / 2)
        selection = problem.objective.selection(problem.fitness_evaluator, problem.fitness_relevance)
        chosen, spent = select(selection, poses, count, plates, allowance)
        if len(chosen):
            rest = self.start[len(chosen) :] if len(chosen) < count else None
            found = plates.apart(poses[chosen] if rest is None else poses[chosen] + rest)
            if found is not None:
                self.start = self.here = found
        return spent


@dataclass(frozen=True)
class GreedyDeployment:
    """The greedy selection as a start for any optimiser, or something to score (`deployment=greedy`).

    Building it is not charged to the budget of the optimiser that starts from it.

    Args:
        count: K.
        scene: where they hang.
        objective: what they are for.
        spacing: of the grid of poses, metres.
        threads: worker threads, all processors by default; the result does not depend on it.

    Raises:
        InputError: a value is out of range.
    """

    count: int
    scene: Scene
    objective: Objective
    spacing: float = SPACING
    threads: int | None = None
    varies = False

    def __post_init__(self) -> None:
        integer("count", self.count, low=1)
        real("spacing", self.spacing, above=0.0)

    @cached_property
    def _deployment(self) -> Deployment:
        evaluator = Evaluator(self.scene, threads=self.threads)
        plates = self.scene.plates
        room = plates.hanging
        spacing, poses = self.spacing, candidate_poses(room, self.spacing)
        while len(poses) < self.count:
            spacing /= 1.3
            poses = candidate_poses(room, spacing)
        relevance = room.relevance.weights(evaluator.positions)
        chosen, _ = select(self.objective.selection(evaluator, relevance), poses, self.count, plates)
        if len(chosen) < self.count:
            raise InputError(
                f"spacing = {spacing:.4g} leaves room for {len(chosen)} plates of {plates.edge:.4g} m, too few for "
                f"{self.count}.",
                "spacing",
            )
        return poses[chosen]

    def draw(self, room: Space, rng: np.random.Generator) -> Deployment:
        """See `DeploymentSource.draw`; nothing here is random."""
        return self._deployment
