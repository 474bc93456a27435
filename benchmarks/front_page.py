"""Draw the picture of the README: `python benchmarks/front_page.py [FILE.png]`, as `make figures` does.

The L-shaped lab from above with 30 tags at even distances, and with 30 tags placed by `annealing`. Tags are drawn too
large, behind their surfaces. The share above each plan is at random poses, off the grid.
"""

import sys
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.collections import PatchCollection
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle

from lmd.evaluation.validation import validation_metrics
from lmd.optimisers.ledger import Budget
from lmd.pipelines import compose
from lmd.pipelines.building import build_optimiser, build_problem
from lmd.plot import common
from lmd.problem import Problem
from lmd.scene.deployment import Deployment
from lmd.scene.families import picture

FILE = Path(__file__).resolve().parents[1] / "docs" / "images" / "even_and_optimised.png"
SIZE, STEP = 0.2, 0.23  # edge of a drawn tag, and distance of those above each other, metres


def drawn_places(deployment: Deployment) -> np.ndarray:
    """Centres of the drawn tags, `(K, 2)`, metres: outside of the room, pushed apart where they would overlap."""
    places: list[np.ndarray] = []
    for at, normal in zip(deployment.positions[:, :2], deployment.normals[:, :2], strict=True):
        place = at - normal * 0.7 * STEP
        while any(np.abs(place - other).max() < STEP for other in places):
            place = place - normal * STEP / 4.0
        places.append(place)
    return np.array(places)


def draw(axes: Any, problem: Problem, deployment: Deployment, title: str) -> Any:
    """Draw a plan, and return what has its colours."""
    values, places = problem.by_place(problem.values(deployment)), problem.places[:, :2]
    side = 1.03 * common.spacing_of(problem.scene.room, problem.places)
    squares = [Rectangle(tuple(at - side / 2.0), side, side) for at in places]
    coloured = PatchCollection(squares, linewidths=0, zorder=0, cmap=common.COLOUR_MAP, clim=(0.0, 1.0))
    coloured.set_array(values)
    axes.add_collection(coloured)
    common.draw_plan(axes, problem.scene.room, lw=1.2)
    for number, (x, y) in enumerate(drawn_places(deployment)):
        axes.add_patch(
            Rectangle((x - SIZE / 2, y - SIZE / 2), SIZE, SIZE, facecolor="white", edgecolor="0.6", lw=0.5, zorder=3)
        )
        half = 0.4 * SIZE
        extent = (x - half, x + half, y - half, y + half)
        axes.imshow(picture("36h11", number), cmap="gray", extent=extent, interpolation="none", zorder=4)
    low, high = problem.scene.room.bounds()
    axes.set(aspect="equal", xlim=(low[0] - 0.8, high[0] + 0.65), ylim=(low[1] - 0.65, high[1] + 0.65))
    axes.set_axis_off()
    axes.set_title(title, fontsize=15)
    return coloured


def main(path: Path) -> None:
    """Optimise, score and draw."""
    cfg, uniform = (
        compose("optimise", "experiment=lab_l_shape", f"deployment={name}") for name in ("random", "uniform")
    )
    problem = build_problem(cfg)
    even = build_problem(uniform).draw(np.random.default_rng(0))
    found = build_optimiser(cfg, 0).run(problem, Budget(cfg.budget.evaluations)).deployment
    figure = Figure(figsize=(15.0, 6.2), dpi=100, facecolor="white")
    panels = figure.subplots(1, 2)
    figure.subplots_adjust(left=0.01, right=0.99, top=0.93, bottom=0.13, wspace=0.02)
    for axes, (name, deployment) in zip(
        panels, {"at even distances": even, "placed by lmd": found}.items(), strict=True
    ):
        share = validation_metrics(problem, deployment, 0)["grid_free_localised_share"]
        title = f"30 tags {name}: {share:.0%} of the camera's views localise"
        print(title, f"({share:.2%})")
        coloured = draw(axes, problem, deployment, title)
    bar = figure.colorbar(coloured, cax=figure.add_axes((0.25, 0.09, 0.5, 0.025)), orientation="horizontal")
    bar.set_label("share of the headings in which one image tells the position to 2 cm", fontsize=12)
    figure.savefig(path)
    common.shrink(path)


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else FILE)
