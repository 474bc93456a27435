"""Measure the cost of a rig: `python benchmarks/rig.py [--rounds 5] [--objective coverage|localisation|...]`.

The paper's room and camera, alone, with another one back to back in the same place, and with both 10 cm from the body's
origin: what an evaluation and a move of a single landmark take, by default for coverage and for localisation, of tags
of 10 cm. All are timed in turn, on one thread, by the time of the processor; the least of the rounds counts.
"""

import argparse
import itertools
import math
import time
from collections.abc import Callable

import numpy as np

from lmd.core.compiled import kernel
from lmd.geometry.camera import Camera
from lmd.incremental.field import accept, bound, settle, undo
from lmd.objectives.coverage import Coverage
from lmd.objectives.localisation import Localisation
from lmd.scene import pdf
from lmd.scene.deployment_sources import RandomDeployment
from lmd.scene.pdf import OrientationPdf
from lmd.scene.rig import Mount, Rig
from lmd.scene.scene import Scene
from lmd.scene.tag import Tag
from lmd.sight.evaluator import Evaluator
from lmd.sight.models.paper import Visibility
from lmd.space.cuboid import Cuboid

CAMERA = Camera(
    focal_length=5.0, pixel_width=0.0058, pixel_height=0.0058, principal_point=(800, 600), image_width=1600,
    image_height=1200, aperture=10.0, focus_distance=1778.0,
)  # fmt: skip
COUNT, MOVES = 90, 20
OBJECTIVES: dict[str, Coverage | Localisation] = {
    "coverage": Coverage(2, 0.65),
    "localisation": Localisation(),
    "n = 1, ambiguity ignored": Localisation(1, ambiguity="ignored"),
    "n = 1, ambiguity resolved": Localisation(1),
}
BOUNDED, SETTLED, ACCEPTED = range(3)
TASKS = {"bounded move": BOUNDED, "tried move": SETTLED, "carried out and back": ACCEPTED}


@kernel
def moves(field, poses, state, scratch, end):  # type: ignore[no-untyped-def]
    """Try moves of one landmark after the other, as far as `end` says."""
    for k in range(len(poses)):
        bound(field, k, poses[k], -1, state, scratch)
        if end >= SETTLED:
            settle(field, k, state, scratch)
        if end == ACCEPTED:
            accept(field, k, state, scratch)
            undo(field, k, state, scratch)


def cameras() -> dict[str, Camera | Rig]:
    """One camera, and two back to back."""
    back = math.pi
    return {
        "one camera": CAMERA,
        "two in one place": Rig((Mount(CAMERA), Mount(CAMERA, yaw=back))),
        "two, 20 cm apart": Rig((Mount(CAMERA, (0.1, 0.0, 0.0)), Mount(CAMERA, (-0.1, 0.0, 0.0), yaw=back))),
    }


def tasks(camera: Camera | Rig, orientations: OrientationPdf, name: str) -> dict[str, Callable[[], object]]:
    """What is timed, for an objective of this name."""
    room, objective = Cuboid((7.5, 5.0, 6.0), (6.0, 3.5, 4.5), 0.5), OBJECTIVES[name]
    scene = Scene(room, camera, orientations, Visibility(thold=0.28), Tag(0.1))
    rng, evaluator = np.random.default_rng(0), Evaluator(scene, threads=1)
    here, there = (RandomDeployment(count).draw(scene.room, rng) for count in (COUNT, MOVES))
    field = objective.field(evaluator)
    state, poses = field.state(here), np.hstack([there.positions, there.normals])
    scratch = field.scratch(state)

    def tried(end: int) -> Callable[[], object]:
        return lambda: moves(field, poses, state, scratch, end)

    landmarks = here.positions[None], here.normals[None]
    moved = {task: tried(end) for task, end in TASKS.items()}
    return {"evaluation": lambda: objective.values(evaluator, *landmarks)} | moved


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--objective", choices=list(OBJECTIVES), nargs="*", default=list(OBJECTIVES)[:2])
    options = parser.parse_args()
    drawn = {"yaw, 72": pdf.level_flight(36), "grid_325": pdf.grid_with_ends()}
    every = itertools.product(options.objective, drawn, cameras())
    named = {(goal, name, rig): tasks(cameras()[rig], drawn[name], goal) for goal, name, rig in every}
    least: dict[tuple[tuple[str, str, str], str], float] = {}
    for turn in range(options.rounds + 1):  # the first compiles
        for subject, todo in named.items():
            for task, work in todo.items():
                began = time.process_time()
                work()
                each = (time.process_time() - began) / (1 if task == "evaluation" else MOVES)
                least[subject, task] = min(least.get((subject, task), np.inf), each if turn else np.inf)
    print(f"| objective | PDF | cameras | evaluation | {' | '.join(TASKS)} |\n|" + 7 * " --- |")
    for (goal, name, rig), todo in named.items():
        alone = goal, name, "one camera"
        cells = [f"{1e3 * (t := least[(goal, name, rig), x]):.3g} ms ({t / least[alone, x]:.1f})" for x in todo]
        print(f"| {goal} | {name} | {rig} | {' | '.join(cells)} |")


if __name__ == "__main__":
    main()
