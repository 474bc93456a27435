"""Measure the accuracy of the figures off the grid: `python benchmarks/validation.py [evaluations]`.

Optimises the paper's room for the robust objective with so few evaluations (400), and draws samples of the qualified
ratio of the result: from independent positions and from ones that are spread evenly, with more and fewer orientations,
and in the cells of the grid as for the objective's design. Prints two Markdown tables: the standard deviation of a
sample, what that makes for all positions of a validation, and the processor time that a position takes beside the first
row; and how far fewer orientations shift the ratio at the same positions.
"""

import sys
import time
from collections.abc import Callable
from dataclasses import replace

import numpy as np
from hydra import compose, initialize_config_dir

from lmd.core.checks import FloatArray
from lmd.evaluation.validation import Sample
from lmd.optimisers.ledger import Budget
from lmd.pipelines.app import CONF
from lmd.pipelines.building import build_optimiser, build_problem
from lmd.problem import Problem
from lmd.scene.deployment import Deployment
from lmd.sight.evaluator import Evaluator

VALIDATION = Sample()
SAMPLES = 32
DIVISIONS = 92, 46, VALIDATION.divisions, 23
REPEATS = 7  # positions in each cell of the grid


def ratio(
    problem: Problem, found: Deployment, positions: FloatArray, divisions: int, rng: np.random.Generator
) -> float:
    """The share of positions that qualify, with orientations drawn anew, per cent."""
    scene = replace(problem.scene, pdf=problem.scene.pdf.stratified(divisions, rng))
    values = problem.objective.values(
        Evaluator(scene, positions, threads=1), found.positions[None], found.normals[None]
    )[0]
    return 100.0 * float(problem.objective.shares(values)[problem.objective.headline.key].mean())


def main() -> None:
    """Print the tables."""
    with initialize_config_dir(CONF, version_base="1.3"):
        cfg = compose("optimise", ["objective=robust"])
        problem, optimiser = build_problem(cfg), build_optimiser(cfg, 0)
    found = optimiser.run(problem, Budget(int(sys.argv[1]) if len(sys.argv) > 1 else 400)).deployment
    room, rng = problem.scene.room, np.random.default_rng(0)
    many, every = VALIDATION.positions, VALIDATION.groups * VALIDATION.positions
    rows: list[tuple[str, Callable[[], FloatArray], int]] = [
        ("512 independent", lambda: room.sample(512, rng), 46),
        ("512 spread evenly", lambda: room.sample_evenly(512, rng), 46),
        *((f"{many:,} spread evenly", lambda: room.sample_evenly(many, rng), divisions) for divisions in DIVISIONS[1:]),
        (
            f"{REPEATS} in each cell, independent",
            lambda: np.vstack([room.jittered_grid(1, rng) for _ in range(REPEATS)]),
            23,
        ),
        (f"{REPEATS} in each cell, spread", lambda: room.jittered_grid(REPEATS, rng), 23),
    ]
    print(f"| positions | orientations | standard deviation | error of {every:,} | time |")
    print(f"{'| --- ' * 5}|")
    first = 0.0
    for name, draw, divisions in rows:
        began = time.process_time()
        drawn = [draw() for _ in range(SAMPLES)]
        ratios = [ratio(problem, found, positions, divisions, rng) for positions in drawn]
        size = len(drawn[0])
        each = (time.process_time() - began) / (SAMPLES * size)
        first = first or each
        spread = np.std(ratios, ddof=1)
        error = spread * np.sqrt(size / every)
        print(f"| {name} | {2 * divisions**2:,} | {spread:.2f} | {error:.3f} | {each / first:.2f} |", flush=True)
    print(f"\n| orientations | ratio less that with {2 * DIVISIONS[0] ** 2:,} at the same positions |\n| --- | --- |")
    places = [room.sample_evenly(many, rng) for _ in range(SAMPLES)]
    by_divisions = [np.array([ratio(problem, found, at, divisions, rng) for at in places]) for divisions in DIVISIONS]
    for divisions, ratios in zip(DIVISIONS[1:], by_divisions[1:], strict=True):
        less = ratios - by_divisions[0]
        error = less.std(ddof=1) / np.sqrt(SAMPLES)
        print(f"| {2 * divisions**2:,} | {less.mean():+.3f} +- {error:.3f} |", flush=True)


if __name__ == "__main__":
    main()
