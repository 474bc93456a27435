"""Greedy choice of landmarks one by one, each where it adds most to a surrogate of the objective (`selection`)."""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from typing_extensions import override

from lmd.core.checks import Checked, InputError, Positive, real
from lmd.objectives.base import Objective, selectable
from lmd.optimisers.annealing import Annealing, Stage
from lmd.optimisers.annealing.moves import REFINING_STAGE, changed
from lmd.optimisers.selection import GRID_SPACING, Tags, candidates, select
from lmd.problem import Problem
from lmd.scene.deployment import Deployment
from lmd.scene.deployment_sources import POINT, LandmarkCount
from lmd.scene.scene import Scene
from lmd.scene.tag import Tag
from lmd.sight.evaluator import Evaluator
from lmd.space.space import Space


class Greedy(Annealing):
    """Greedy selection from a grid of poses on the surfaces, refined by annealing at a low temperature.

    Landmarks are chosen one by one, each at the pose with the largest gain of a surrogate of the objective
    (`selection`). The landmarks' footprints do not overlap. Evaluating the gain at one pose costs as much of the budget
    as moving one landmark. The rest of the budget is spent on the annealing.

    Args:
        spacing: spacing of the grid, metres; enlarged if the budget does not suffice.
        single: conditions of the annealing: a `Stage`, or a mapping of the fields that differ from the default stage.
        seed: see `Optimiser`.

    Raises:
        InputError: the spacing is not positive.
    """

    def __init__(
        self, spacing: float = GRID_SPACING, single: Stage | Mapping[str, Any] = REFINING_STAGE, seed: int = 0
    ) -> None:
        single = changed("single", REFINING_STAGE, single)
        super().__init__(single, single, single, single, single, single, stacked_share=0.0, seed=seed)
        self.spacing = real("spacing", spacing, above=0.0)

    @override
    def check(self, problem: Problem) -> None:
        super().check(problem)
        selectable(problem.objective)

    @override
    def _is_greedy(self, problem: Problem, stack: int) -> bool:
        return True


@dataclass(frozen=True)
class GreedyDeployment(Checked):
    """Deployment chosen greedily, to be evaluated or to start any optimiser (`deployment=greedy`).

    The choice costs none of the budget of an optimiser that starts from this deployment.

    Args:
        count: number of landmarks.
        scene: the scene.
        objective: objective that has a surrogate for greedy choice (`selection`).
        spacing: spacing of the grid of poses, metres.
        threads: number of worker threads; None for all processors. The result does not depend on this number.
        fixed: landmarks that exist already, with their surfaces; landmarks are added until there are `count`.

    Raises:
        InputError: a value is out of range.
    """

    count: LandmarkCount
    scene: Scene
    objective: Objective
    spacing: Positive = GRID_SPACING
    threads: int | None = None
    fixed: Deployment | None = None
    varies = False

    @cached_property
    def _deployment(self) -> Deployment:
        evaluator = Evaluator(self.scene, threads=self.threads)
        footprints, edges = self.scene.footprints, self.scene.tag.edges_in_order(self.count)
        spacing, poses = self.spacing, candidates(footprints, edges, self.spacing)
        while len(poses) < self.count:
            spacing /= 1.3
            poses = candidates(footprints, edges, spacing)
        relevance = self.scene.room.relevance.weights(evaluator.positions)
        selection = selectable(self.objective).selection(evaluator, relevance)
        stock = Tags(self.scene.tag.filled(edges), self.scene.tag)
        chosen, _ = select(selection, poses, stock, footprints, fixed=self.fixed)
        if len(chosen) < self.count:
            raise InputError(
                f"spacing = {spacing:.4g} leaves room for {len(chosen)} footprints of {footprints.edge:.4g} m, too few "
                f"for {self.count}.",
                "spacing",
            )
        return poses[chosen]

    def draw(self, room: Space, rng: np.random.Generator, tag: Tag = POINT) -> Deployment:
        """See `DeploymentSource.draw`; nothing here is random."""
        return self._deployment
