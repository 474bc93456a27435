"""How fast the exact paths are: `python benchmarks/coverage.py`.

Prints times and their ratio to the reference, all measured in one run on the paper's problem: 756 positions, 325
orientations, 90 landmarks, the paper's occlusion test.
"""

import time
from collections.abc import Callable

import numpy as np
from hydra import compose, initialize_config_dir

from lmd.coverage import reference
from lmd.coverage.evaluator import Evaluator, available_threads
from lmd.coverage.incremental import fixed_of, move, scratch_of, state_of
from lmd.coverage.poses import candidate_poses, gains
from lmd.deployment import RandomDeployment
from pipelines.app import CONF, build_problem

DEPLOYMENTS = 20
MOVES = 2000


def best_of(repeats: int, work: Callable[[], object]) -> float:
    """Seconds of the fastest of several runs, after one that may compile."""
    work()
    times = []
    for _ in range(repeats):
        began = time.perf_counter()
        work()
        times.append(time.perf_counter() - began)
    return min(times)


def main() -> None:
    """Measure and print."""
    with initialize_config_dir(CONF, version_base="1.3"):
        problem = build_problem(compose("optimise"))
    scene, rng = problem.scene, np.random.default_rng(0)
    drawn = [RandomDeployment(90).draw(scene.room, rng) for _ in range(DEPLOYMENTS)]
    positions, normals = np.stack([d.positions for d in drawn]), np.stack([d.normals for d in drawn])
    rows = [("reference, one evaluation", best_of(3, lambda: reference.counts(scene, drawn[0])))]
    for threads in sorted({1, available_threads()}):
        evaluator = Evaluator(scene, threads=threads)
        seconds = best_of(5, lambda e=evaluator: e.units(positions, normals, 2)) / DEPLOYMENTS
        rows.append((f"kernels, one evaluation, {threads} thread{'s' * (threads > 1)}", seconds))
    fixed = fixed_of(Evaluator(scene, threads=1), 2)
    state = state_of(fixed, drawn[0])
    scratch, units = scratch_of(state), np.empty_like(state.units)
    targets = RandomDeployment(MOVES).draw(scene.room, rng)
    for name, commit in (("tried", False), ("carried out", True)):

        def moves(commit: bool = commit) -> None:
            for i in range(MOVES):
                move(i % 90, *targets.positions[i], *targets.normals[i], fixed, state, scratch, units, commit)

        rows.append((f"one landmark moved, {name}", best_of(3, moves) / MOVES))
    poses = candidate_poses(scene.room, 0.25)
    evaluator = Evaluator(scene)
    prices = np.ones((len(evaluator.positions), evaluator.axes.shape[1]))
    seconds = best_of(3, lambda: gains(evaluator, poses, prices))
    rows.append((f"gain of each of {len(poses)} poses, {evaluator.threads} threads", seconds))
    print("| work | milliseconds | reference / this |\n| --- | --- | --- |")
    for name, seconds in rows:
        print(f"| {name} | {1e3 * seconds:.3f} | {rows[0][1] / seconds:.1f} |")


if __name__ == "__main__":
    main()
