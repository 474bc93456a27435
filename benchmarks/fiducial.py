"""What it costs to see as a detector does: `python benchmarks/fiducial.py`.

Prints a Markdown table of times of the paper's criteria and of a detector's, and their ratios, from one run in the
paper's room on one thread: tags of 10 cm, hung at random without overlapping. Part of the ratio is no cost of the
criterion: tags of 10 cm are seen from nearly everywhere in the room, the paper's landmarks from less than half of it.
"""

import time
from collections.abc import Callable
from dataclasses import replace

import numpy as np
from hydra import compose, initialize_config_dir
from numba import njit

from lmd.deployment import RandomDeployment
from lmd.objectives.coverage_field import coverage_field
from lmd.pipelines.app import CONF, build_problem
from lmd.scene import Scene
from lmd.sight.evaluator import Evaluator
from lmd.sight.fiducial import Fiducial
from lmd.sight.incremental.move import state_of
from lmd.sight.incremental.state import scratch_of
from lmd.sight.incremental.trial import bound_move, finish_move
from lmd.tag import Tag

COUNT, N = 40, 2
MOVES = 400


def best_of(repeats: int, work: Callable[[], object]) -> float:
    """Seconds of the fastest of several runs, after one that may compile."""
    work()
    times = []
    for _ in range(repeats):
        began = time.perf_counter()
        work()
        times.append(time.perf_counter() - began)
    return min(times)


@njit(nogil=True)
def try_all(poses, surfaces, field, state, scratch):  # type: ignore[no-untyped-def]
    """Try to move the landmarks in turn to each of the poses `(M, 6)`."""
    for i in range(len(poses)):
        k = i % state.landmarks.shape[1]
        bound_move(k, poses[i], surfaces[i], field, state, scratch)
        finish_move(k, field, state, scratch)


def times(scene: Scene) -> tuple[float, float]:
    """Seconds of an evaluation, and of a move that is only tried."""
    rng, evaluator = np.random.default_rng(0), Evaluator(scene, threads=1)
    start, targets = (scene.plates.draw(RandomDeployment(size), rng) for size in (COUNT, MOVES))
    field = coverage_field(evaluator, N)
    state = state_of(field, start)
    args = np.hstack([targets.positions, targets.normals]), targets.surfaces, field, state, scratch_of(state)
    landmarks = start.positions[None], start.normals[None]
    return best_of(5, lambda: evaluator.units(*landmarks, N)), best_of(3, lambda: try_all(*args)) / MOVES


def main() -> None:
    """Print the table."""
    with initialize_config_dir(CONF, version_base="1.3"):
        paper = build_problem(compose("optimise")).scene
    tag = Tag(0.1)
    paper = replace(paper, tag=tag)
    rows = [times(paper), times(replace(paper, visibility=Fiducial(tag)))]
    print("| work | paper's, ms | detector's, ms | ratio |\n| --- | --- | --- | --- |")
    for name, ours, detectors in zip(("one evaluation", "one move, tried"), *rows, strict=True):
        print(f"| {name} | {1e3 * ours:.3f} | {1e3 * detectors:.3f} | {detectors / ours:.1f} |")


if __name__ == "__main__":
    main()
