"""Measure the cost of obstacles: `python benchmarks/obstacles.py [--rounds 5]`.

The paper's room, all of it between 0.75 and 5.25 m reachable, as a cuboid, the same with ten boxes and two pillars, and
as a mesh: with the ten boxes, and with these and balls of some 10,000 and 100,000 triangles. What an evaluation and a
move of a single landmark take per position. All are timed in turn, on one thread; the least of the rounds counts.
"""

import argparse
import tempfile
import time
from collections.abc import Callable

import numpy as np
import trimesh

from lmd.core.compiled import kernel
from lmd.formats.meshes import read_mesh_room
from lmd.geometry.camera import Camera
from lmd.incremental.coverage_field import coverage_field
from lmd.incremental.field import bound, settle
from lmd.scene import pdf
from lmd.scene.criteria import Criteria
from lmd.scene.deployment_sources import RandomDeployment
from lmd.scene.scene import Scene
from lmd.scene.tag import Tag
from lmd.sight.evaluator import Evaluator
from lmd.sight.models.fiducial import Fiducial
from lmd.sight.models.paper import Visibility
from lmd.space.cuboid import Cuboid
from lmd.space.floor_plan import FloorPlan
from lmd.space.parts import Reachable
from lmd.space.prism import Prism
from lmd.space.space import Space

CAMERA = Camera(
    focal_length=5.0, pixel_width=0.0058, pixel_height=0.0058, principal_point=(800, 600), image_width=1600,
    image_height=1200, aperture=10.0, focus_distance=1778.0,
)  # fmt: skip
SIZE = np.array([7.5, 5.0, 6.0])
COUNT, MOVES, BATCH = 90, 200, 5


@kernel
def bound_one(field, k, pose, surface, state, scratch):  # type: ignore[no-untyped-def]
    """See `lmd.incremental.field.bound`."""
    bound(field, k, pose, surface, state, scratch)


@kernel
def settle_one(field, k, state, scratch):  # type: ignore[no-untyped-def]
    """See `lmd.incremental.field.settle`."""
    settle(field, k, state, scratch)


def rooms() -> dict[str, Space]:
    """The paper's room, empty and full."""
    rng = np.random.default_rng(0)
    low = rng.uniform(0.0, 0.8, (10, 3)) * SIZE * [1.0, 0.4, 0.3] + [0.0, 2.5, 0.0]
    high = np.minimum(low + rng.uniform(0.3, 1.2, (10, 3)), SIZE)
    boxes = [{"low": a.tolist(), "high": b.tolist()} for a, b in zip(low, high, strict=True)]
    pillars = [[[x, 2.0], [x + 0.4, 2.0], [x + 0.4, 2.4], [x, 2.4]] for x in (2.0, 5.0)]
    walls = [[0.0, 0.0], [7.5, 0.0], [7.5, 5.0], [0.0, 5.0]]
    plan = FloorPlan(walls, 6.0, holes=pillars, obstacles=boxes)
    shell = trimesh.creation.box(bounds=[np.zeros(3), SIZE])
    things = [shell, *(trimesh.creation.box(bounds=[box["low"], box["high"]]) for box in boxes)]
    balls = [trimesh.creation.icosphere(4, 0.4).apply_translation(at * SIZE) for at in rng.uniform(0.1, 0.9, (20, 3))]
    meshes = {"boxes": things, "boxes, 2 balls": things + balls[:2], "boxes, 20 balls": things + balls}
    return {
        "empty": Cuboid((7.5, 5.0, 6.0), (7.5, 5.0, 4.5), 0.5),
        "ten boxes, two pillars": Prism(plan, Reachable((0.75, 5.25), 0.0), 0.5),
        **{f"mesh: {name}": as_mesh(parts) for name, parts in meshes.items()},
    }


def as_mesh(parts: list[trimesh.Trimesh]) -> Space:
    """The room of some meshes."""
    whole = trimesh.util.concatenate(parts)
    with tempfile.NamedTemporaryFile(suffix=".stl") as file:
        whole.export(file.name)
        return read_mesh_room(file.name, {"height": [0.75, 5.25]}, 0.5, up="z")


def tasks(room: Space, visibility: Criteria) -> tuple[int, dict[str, Callable[[], object]]]:
    """How many positions there are, and what is timed."""
    scene = Scene(room, CAMERA, pdf.grid_with_ends(), visibility)
    rng, evaluator = np.random.default_rng(1), Evaluator(scene, threads=1)
    drawn = [RandomDeployment(COUNT).draw(room, rng) for _ in range(BATCH)]
    positions, normals = np.stack([d.positions for d in drawn]), np.stack([d.normals for d in drawn])
    field = coverage_field(evaluator, 2)
    state = field.state(drawn[0])
    scratch = field.scratch(state)

    def moves(finish: bool) -> None:
        for i in range(MOVES):
            k = i % COUNT
            pose = np.concatenate([drawn[1].positions[k], drawn[1].normals[k]])
            bound_one(field, k, pose, drawn[1].surfaces[k], state, scratch)
            if finish:
                settle_one(field, k, state, scratch)

    evaluate = evaluator.units
    return len(evaluator.positions), {
        "evaluation": lambda: evaluate(positions, normals, 2),
        "bounded move": lambda: moves(False),
        "tried move": lambda: moves(True),
    }


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rounds", type=int, default=5)
    rounds = parser.parse_args().rounds
    models = {"paper": Visibility(thold=0.28), "fiducial": Fiducial(Tag(0.1))}
    named = {(model, name): tasks(room, models[model]) for model in models for name, room in rooms().items()}
    least: dict[tuple[tuple[str, str], str], float] = {}
    for turn in range(rounds + 1):  # the first compiles
        for name, (size, todo) in named.items():
            for task, work in todo.items():
                began = time.process_time()
                work()
                each = (time.process_time() - began) / size / (BATCH if task == "evaluation" else MOVES)
                least[name, task] = min(least.get((name, task), np.inf), each if turn else np.inf)
    print("| visibility | room | positions | evaluation | bounded move | tried move |\n|" + 6 * " --- |")
    for name, (size, todo) in named.items():
        empty = name[0], "empty"
        cells = [f"{1e9 * least[name, task]:.3g} ns ({least[name, task] / least[empty, task]:.2f})" for task in todo]
        print(f"| {name[0]} | {name[1]} | {size} | {' | '.join(cells)} |")


if __name__ == "__main__":
    main()
