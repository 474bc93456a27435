"""Time of a hall: `python benchmarks/hall.py [--picture docs/results/images/hall.png]`.

Prints a Markdown table: one evaluation, one moved landmark and the memory of its state in the paper's room, there with
the tags, camera and PDF of `experiment=hall`, and in that hall from a sixteenth of its floor to the whole, tags at the
same density. Times are those of the processor, on one thread, from one run. Landmarks and positions out of range of
each other should cost next to nothing: then the time of an evaluation per position, and that of a move, do not grow
with the hall.
"""

import argparse
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from time import process_time
from typing import NamedTuple

import numpy as np
from hydra import compose, initialize_config_dir
from speed import COUNT, STEPS, N, best_of, move_all, paper_scene

from lmd.incremental.coverage_field import coverage_field
from lmd.pipelines.app import CONF
from lmd.pipelines.building import build_problem
from lmd.problem import Problem
from lmd.scene.deployment_sources import RandomDeployment
from lmd.scene.scene import Scene
from lmd.sight.evaluator import Evaluator

SIDES = (1 / 4, 1 / 2, 1 / np.sqrt(2.0), 1.0)  # of the whole hall's
MOVES = 400
MIB = 2**20


class Costs(NamedTuple):
    """Numbers of positions and landmarks; microseconds of an evaluation per position and of moves; bytes of a state."""

    positions: int
    landmarks: int
    evaluated: float
    bounded: float
    tried: float
    carried_out: float
    memory: int


def hall(*overrides: str) -> Problem:
    """`experiment=hall`, changed by `overrides`."""
    with initialize_config_dir(CONF, version_base="1.3"):
        return build_problem(compose("optimise", ["experiment=hall", *overrides]))


def part_of(scene: Scene, side: float) -> Scene:
    """The scene in a hall with sides so many times as long."""
    room = scene.room
    length, width, height = room.size
    reachable = length * side - 1.0, width * side - 1.0, room.reachable_size[2]
    return replace(scene, room=replace(room, size=(length * side, width * side, height), reachable_size=reachable))


def costs(scene: Scene, count: int) -> Costs:
    """Measure with `count` landmarks hung at random."""
    rng, evaluator = np.random.default_rng(0), Evaluator(scene, threads=1)
    start, targets = (scene.footprints.draw(RandomDeployment(size), rng) for size in (count, MOVES))
    landmarks = start.positions[None], start.normals[None]
    evaluated = best_of(5, lambda: evaluator.units(*landmarks, N), process_time)
    field = coverage_field(evaluator, N)
    state = field.state(start)
    scratch, poses = field.scratch(state), np.hstack([targets.positions, targets.normals])
    moved = (
        best_of(5, lambda: move_all(poses, targets.surfaces, field, state, scratch, steps), process_time) / MOVES  # noqa: B023
        for steps in range(1, len(STEPS) + 1)
    )
    memory = sum(array.nbytes for array in _arrays(state)) + sum(array.nbytes for array in _arrays(scratch))
    positions = len(evaluator.positions)
    return Costs(positions, count, 1e6 * evaluated / positions, *(1e6 * seconds for seconds in moved), memory)


def _arrays(parts: tuple[object, ...]) -> Iterator[np.ndarray]:
    """The arrays of nested tuples."""
    for part in parts:
        if isinstance(part, tuple):
            yield from _arrays(part)
        elif isinstance(part, np.ndarray):
            yield part


def plot(room: Costs, parts: list[Costs], picture: Path) -> None:
    """Times of parts of the hall against their number of landmarks, as multiples of those of the paper's room."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot as plt
    from matplotlib.ticker import FixedLocator, NullLocator

    figure, panel = plt.subplots(figsize=(5.6, 3.6), layout="constrained")
    counts = [part.landmarks for part in parts]
    labels = "an evaluation, per position", *(f"a move, {step}" for step in STEPS)
    for label, base, times in zip(labels, room[2:6], zip(*(part[2:6] for part in parts), strict=True), strict=True):
        panel.loglog(counts, [time / base for time in times], "o-", label=label)
    panel.loglog(counts, [count / counts[0] for count in counts], ":", color="grey", label="proportional")
    panel.set_xlabel("landmarks, at the same number per square metre of floor")
    panel.set_ylabel("multiple of the paper's room")
    panel.xaxis.set_major_locator(FixedLocator(counts))
    panel.yaxis.set_major_locator(FixedLocator([0.5, 1, 2, 5, 10, 20]))
    for axis in (panel.xaxis, panel.yaxis):
        axis.set_major_formatter("{x:g}")
        axis.set_minor_locator(NullLocator())
    panel.grid(alpha=0.3)
    panel.legend()
    figure.savefig(picture, dpi=90)
    plt.close(figure)


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description="Measure what a hall costs; prints Markdown.")
    parser.add_argument("--picture", type=Path, help="where to write the plot of the growth")
    picture = parser.parse_args().picture
    problem, room = hall(), costs(paper_scene(), COUNT)
    same = hall("room=paper_simulation", f"deployment.count={COUNT}")
    cases = {"the paper's room": room, "the paper's room, the hall's tags and robot": costs(same.scene, COUNT)}
    for side in SIDES:
        scene = part_of(problem.scene, side)
        cases[f"{side**2:.4g} of the hall"] = costs(scene, round(problem.count * side**2))
    print("| | positions | landmarks | evaluation, us per position | bounded, us | tried, us | carried out, us | MiB |")
    print("| --- | --- | --- | --- | --- | --- | --- | --- |")
    for name, case in cases.items():
        times = " | ".join(f"{time:.2f} ({time / base:.2f})" for time, base in zip(case[2:6], room[2:6], strict=True))
        print(f"| {name} | {case.positions:,} | {case.landmarks} | {times} | {case.memory / MIB:.0f} |")
    if picture:
        plot(room, list(cases.values())[2:], picture)


if __name__ == "__main__":
    main()
