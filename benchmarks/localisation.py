"""Compare the cost of localisation with that of coverage: `python benchmarks/localisation.py`.

Prints a Markdown table of times of coverage and of localisation, and their ratios, from one run in the paper's room on
one thread: 90 tags of 10 cm, at least two of which must be seen, 20 mm. Moves are jumps to anywhere and steps of 10 cm.
The last row is `experiment=hall` with 1,000 tags and no tolerance, where both find the same.
"""

import math
import time
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
from hydra import compose, initialize_config_dir
from numba import njit

from lmd.incremental.field import bound, placed, settle
from lmd.objectives.coverage import Coverage
from lmd.objectives.localisation import Localisation
from lmd.pipelines.app import CONF
from lmd.pipelines.building import build_problem
from lmd.scene.deployment import Deployment
from lmd.scene.deployment_sources import RandomDeployment
from lmd.scene.scene import Scene
from lmd.scene.tag import Tag
from lmd.sight.evaluator import Evaluator

COUNT, MOVES, STEP = 90, 400, 0.1


def best_of(repeats: int, work: Callable[[], object]) -> float:
    """Processor seconds of the fastest of several runs, after one that may compile."""
    work()
    times = []
    for _ in range(repeats):
        began = time.process_time()
        work()
        times.append(time.process_time() - began)
    return min(times)


@njit(nogil=True)
def try_all(poses, surfaces, field, state, scratch):  # type: ignore[no-untyped-def]
    """Try to move the landmarks in turn to each of the poses `(M, 6)`."""
    for i in range(len(poses)):
        k = i % len(placed(state).surfaces)
        bound(field, k, poses[i], surfaces[i], state, scratch)
        settle(field, k, state, scratch)


def times(objective: Any, scene: Scene, start: Deployment, moves: list[Deployment]) -> list[float]:
    """Seconds of an evaluation, and of a move of each kind that is only tried."""
    evaluator = Evaluator(scene, threads=1)
    field = objective.field(evaluator)
    state = field.state(start)
    scratch = field.scratch(state)
    landmarks = start.positions[None], start.normals[None]
    seconds = [best_of(5, lambda: objective.values(evaluator, *landmarks))]
    for targets in moves:
        poses = np.hstack([targets.positions, targets.normals])
        args = poses, targets.surfaces, field, state, scratch
        seconds.append(best_of(3, lambda args=args: try_all(*args)) / MOVES)  # type: ignore[misc]
    return seconds


def in_hall() -> list[float]:
    """Seconds of an evaluation of 1,000 tags in `experiment=hall`: coverage, and localisation that asks nothing."""
    with initialize_config_dir(CONF, version_base="1.3"):
        scene = build_problem(compose("optimise", ["experiment=hall"])).scene
    evaluator, tags = (
        Evaluator(scene, threads=1),
        scene.footprints.draw(RandomDeployment(1000), np.random.default_rng(0)),
    )
    landmarks = tags.positions[None], tags.normals[None]
    objectives: list[Any] = [Coverage(2, 0.65), Localisation(tolerance=math.inf)]
    found = [objective.values(evaluator, *landmarks) for objective in objectives]
    np.testing.assert_array_equal(*found)
    return [best_of(5, lambda one=one: one.values(evaluator, *landmarks)) for one in objectives]  # type: ignore[misc]


def main() -> None:
    """Print the table."""
    with initialize_config_dir(CONF, version_base="1.3"):
        scene = replace(build_problem(compose("optimise")).scene, tag=Tag(0.1))
    rng = np.random.default_rng(0)
    start, jumps = (RandomDeployment(size).draw(scene.room, rng) for size in (COUNT, MOVES))
    moved = start[np.arange(MOVES) % COUNT]
    step = rng.normal(0.0, STEP, (MOVES, 3)) * (moved.normals == 0.0)
    steps = Deployment(np.clip(moved.positions + step, 0.0, scene.room.size), moved.normals, moved.surfaces)
    rows = [times(objective, scene, start, [jumps, steps]) for objective in (Coverage(2, 0.65), Localisation())]
    print("| work | coverage, ms | localisation, ms | ratio |\n| --- | --- | --- | --- |")
    named = list(zip(("one evaluation", "a jump, tried", "a step, tried"), *rows, strict=True))
    for name, counting, locating in [*named, ("one evaluation in the hall", *in_hall())]:
        print(f"| {name} | {1e3 * counting:.3f} | {1e3 * locating:.3f} | {locating / counting:.1f} |")


if __name__ == "__main__":
    main()
