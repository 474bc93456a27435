"""How far is annealing from the proven best of a lattice, and what is leaving it worth? `python benchmarks/milp.py`.

Prints two tables in Markdown: of each small problem what the integer program proves on finer and finer lattices, and
what annealing finds, from random starts and from the best choice on the finest lattice.
"""

import time
from dataclasses import dataclass

import numpy as np

from lmd.geometry.camera import Camera
from lmd.objectives.coverage import Coverage
from lmd.optimisers.annealing import Annealing
from lmd.optimisers.ledger import Budget
from lmd.optimisers.milp import Milp
from lmd.problem import Problem
from lmd.scene import pdf
from lmd.scene.deployment_sources import DeploymentSource, GivenDeployment, RandomDeployment
from lmd.scene.scene import Scene
from lmd.sight.models.paper import Visibility
from lmd.space.cuboid import Cuboid

CAMERA = Camera(5.0, 0.0058, 0.0058, (800.0, 600.0), 1600, 1200, 10.0, 1778.0)  # the paper's
LATTICES = (1.0, 0.5, 0.25)  # metres
SECONDS = 60.0  # of the solver, for each
EVALUATIONS, SEEDS = 3000, 5  # of annealing


@dataclass(frozen=True)
class Case:
    """A problem in a room of 3 x 3 x 2.5 m, of which 2 x 2 x 1.5 m are reachable."""

    name: str
    count: int
    n: int
    thold_p: float
    spacing: float  # of the positions, metres
    orientations: pdf.OrientationPdf

    def problem(self, start: DeploymentSource | None = None) -> Problem:
        """The problem, by default with random starts."""
        room = Cuboid((3.0, 3.0, 2.5), (2.0, 2.0, 1.5), self.spacing)
        scene = Scene(room, CAMERA, self.orientations, Visibility(0.28, 0.05))
        return Problem(scene, Coverage(self.n, self.thold_p), start or RandomDeployment(self.count))


CASES = (
    Case("A", 5, 1, 0.5, 1.0, pdf.grid_with_ends(6)),
    Case("B", 8, 2, 0.4, 1.0, pdf.grid_with_ends(6)),
    Case("C", 10, 2, 0.5, 1.0, pdf.grid_with_ends(6)),
    Case("D", 8, 2, 0.65, 0.75, pdf.level_flight(12)),
)


def annealed(case: Case, start: DeploymentSource | None = None) -> str:
    """The median and the range of what annealing finds."""
    budget = Budget(EVALUATIONS)
    found = [Annealing(seed=seed).run(case.problem(start), budget).fitness for seed in range(SEEDS)]
    return f"{np.median(found):.1%} ({min(found):.1%} to {max(found):.1%})"


def main() -> None:
    """Solve and print."""
    solved = [
        "| problem | lattice | poses | best on the lattice | at most | pulled apart | seconds |",
        "|---" * 7 + "|",
    ]
    walked = ["| problem | positions, axes | annealing | annealing from the finest lattice |", "|---" * 4 + "|"]
    for case in CASES:
        for spacing in LATTICES:
            problem, milp, began = case.problem(), Milp(spacing, SECONDS), time.perf_counter()
            result = milp.run(problem, Budget(100_000))
            figures = milp.figures()
            solved.append(
                f"| {case.name} | {spacing:g} m | {round((result.evaluations - 2) * case.count)} "
                f"| {figures.get('lattice_found', 0.0):.1%} | {figures['lattice_bound']:.1%} | {result.fitness:.1%} "
                f"| {time.perf_counter() - began:.0f} |"
            )
            print(solved[-1], flush=True)
        size = f"{len(problem.relevance)}, {len(np.unique(problem.evaluator.axis_of))}"
        told = f"{case.name}: K = {case.count}, n = {case.n}, thold_p = {case.thold_p:g}"
        walked.append(f"| {told} | {size} | {annealed(case)} | {annealed(case, GivenDeployment(result.deployment))} |")
        print(walked[-1], flush=True)
    print("\n".join(["", *solved, "", *walked]))


if __name__ == "__main__":
    main()
