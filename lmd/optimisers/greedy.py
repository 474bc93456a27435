"""Lazy greedy selection on a submodular stand-in, then a local search on the true objective.

Whether at least n landmarks are covered is not submodular for n >= 2: the first landmark gains nothing. The sum of
min(covered, n) over positions and axes is, if no landmark hides another; so adding the pose of the largest gain, one
after the other, comes within 1 - 1/e of the best choice of poses for that sum. Gains only ever shrink, which is what
makes the lazy variant (Minoux 1978) exact: a pose needs evaluating again only while its last known gain is the largest.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from lmd.checks import integer, real
from lmd.deployment import Deployment
from lmd.optimisers.annealing import Annealing, Stage
from lmd.problem import CoverageProblem, Objective
from lmd.scene import Scene
from lmd.sight.evaluator import Evaluator
from lmd.sight.poses import candidate_poses, covered_amounts, gains
from lmd.space.cuboid import Room

BATCH = 32  # poses whose gains are brought up to date together


def select(
    evaluator: Evaluator, poses: Deployment, relevance: np.ndarray, n: int, count: int, allowance: float = np.inf
) -> tuple[np.ndarray, int]:
    """Choose up to `count` of the `poses`, each at most once.

    Args:
        evaluator: the scene.
        poses: N candidates.
        relevance: weights of the positions, `(P,)`.
        n: landmarks that should be covered at the same time.
        count: K.
        allowance: how many gains may be evaluated; fewer poses are chosen if it does not suffice.

    Returns:
        indices of the chosen poses in the order of choice, and the number of gains evaluated.
    """
    prices = relevance[:, None] * (evaluator.weights / evaluator.weights.sum())
    covered = np.zeros(prices.shape)
    known, taken = np.full(len(poses), np.inf), np.zeros(len(poses), dtype=bool)
    chosen: list[int] = []
    spent = 0
    while len(chosen) < min(count, len(poses)):
        fresh = np.zeros(len(poses), dtype=bool)
        while not fresh[best := int(np.argmax(known))]:
            stale = np.flatnonzero(~fresh & ~taken)
            # At first nothing is known about any pose, afterwards a few at the top decide.
            batch = stale[np.argsort(-known[stale], kind="stable")[: BATCH if chosen else len(poses)]]
            if spent + len(batch) > allowance:
                return np.array(chosen, dtype=int), spent
            part = Deployment(poses.positions[batch], poses.normals[batch])
            known[batch] = gains(evaluator, part, prices * (covered < n))
            fresh[batch] = True
            spent += len(batch)
        chosen.append(best)
        known[best], taken[best] = -np.inf, True
        covered += covered_amounts(evaluator, Deployment(poses.positions[[best]], poses.normals[[best]]), np.ones(1))
    return np.array(chosen, dtype=int), spent


def _poses_within(room: Room, spacing: float, most: float) -> Deployment:
    """`candidate_poses`, coarsened until there are no more than `most`."""
    poses = candidate_poses(room, spacing)
    while len(poses) > max(most, len(room.walls)):
        spacing *= 1.3
        poses = candidate_poses(room, spacing)
    return poses


class Greedy(Annealing):
    """Greedy selection from a grid of wall poses, refined by a cool walk with the rest of the budget.

    Poses of the grid are far enough apart that plates do not cover each other. Evaluating the gain of one pose costs
    as much of the budget as moving one landmark.

    Args:
        spacing: of the grid, metres; coarsened if the budget could not pay for it.
        single: conditions of the refinement, see `Annealing`.
        seed: see `Optimiser`.

    Raises:
        InputError: the spacing is not positive.
    """

    def __init__(self, spacing: float, single: Stage, seed: int = 0) -> None:
        super().__init__(stacked=single, single=single, sampled=single, given=single, stacked_share=0.0, seed=seed)
        self.spacing = real("optimiser.spacing", spacing, above=0.0)

    def _begin(self, problem: CoverageProblem, limit: float) -> int:
        """Build the start greedily; what the budget cannot pay for stays where the problem's start has it."""
        super()._begin(problem, limit)
        room, count = problem.scene.room, problem.count
        allowance = (limit - count) / 2
        poses = _poses_within(room, self.spacing, allowance / 2)
        chosen, spent = select(
            problem.fitness_evaluator, poses, problem.fitness_relevance, problem.objective.n, count, allowance
        )
        rest = slice(len(chosen), count)
        self.start = self.here = Deployment(
            np.vstack([poses.positions[chosen], self.start.positions[rest]]),
            np.vstack([poses.normals[chosen], self.start.normals[rest]]),
        )
        return spent


@dataclass(frozen=True)
class GreedyDeployment:
    """The greedy selection as a start for any optimiser, or something to score (`deployment=greedy`).

    Building it is not charged to the budget of the optimiser that starts from it.

    Args:
        count: K.
        spacing: of the grid of poses, metres.
        scene: what the landmarks are for.
        objective: how many must be covered.
        threads: worker threads, all processors by default; the result does not depend on it.

    Raises:
        InputError: a value is out of range.
    """

    count: int
    spacing: float
    scene: Scene
    objective: Objective
    threads: int | None = None
    varies = False

    def __post_init__(self) -> None:
        integer("deployment.count", self.count, low=1)
        real("deployment.spacing", self.spacing, above=0.0)

    @cached_property
    def _deployment(self) -> Deployment:
        evaluator = Evaluator(self.scene, threads=self.threads)
        room = self.scene.room
        spacing, poses = self.spacing, candidate_poses(room, self.spacing)
        while len(poses) < self.count:
            spacing /= 1.3
            poses = candidate_poses(room, spacing)
        relevance = room.relevance.weights(evaluator.positions)
        chosen, _ = select(evaluator, poses, relevance, self.objective.n, self.count)
        return Deployment(poses.positions[chosen], poses.normals[chosen])

    def draw(self, room: Room, rng: np.random.Generator) -> Deployment:
        """See `DeploymentSource.draw`; nothing here is random."""
        return self._deployment
