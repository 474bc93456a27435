"""People in the way, for docs/results/crowd.md: `python benchmarks/crowd.py PART [--folder DIR]`.

- `cost`: seconds of a tried move with and without a crowd, at an equal number of views, in one run;
- `lab`: deployments of `experiment=lab` that were optimised with several crowds, each scored with each crowd, on the
  grid and off it; writes a line of DIR/lab.csv for each, and the deployments. Some 12 minutes of a processor;
- `walls`: the same with tags on the four walls only, DIR/walls.csv;
- `table`: the Markdown tables of both;
- `rendered`: shares of 500 rendered frames with drawn crowds in which detectors see at least n tags, beside the
  predicted ones, for the uniform deployment and those of DIR. Some 5 minutes.
"""

import argparse
import csv
import time
from pathlib import Path

import numpy as np
import pandas as pd

from lmd.core.checks import FloatArray
from lmd.core.layers import layers
from lmd.detection.frames import detect_in_frames, draw_crowd, draw_poses, tagged_room
from lmd.evaluation.rendered_corners import READERS, imaging_of
from lmd.evaluation.validation import validation_metrics
from lmd.geometry.se3 import axis_and_right
from lmd.incremental.field import BOUND, NO_UNITS, SETTLE, perform
from lmd.objectives.reference_field import field_of
from lmd.optimisers.annealing import Annealing
from lmd.optimisers.ledger import Budget
from lmd.pipelines import compose
from lmd.pipelines.building import build_problem
from lmd.problem import Problem
from lmd.render.renderer import Renderer
from lmd.scene.deployment import Deployment
from lmd.scene.deployment_sources import RandomDeployment
from lmd.scene.scene import Scene
from lmd.sight.evaluator import Evaluator
from lmd.sight.views import visible_to_each

NOBODY = "0"
# Crowds that deployments are optimised with: number, fitness, and the number of seeds.
TRAINED = {"0": ("0", 3), "3": ("3", 3), "8": ("8", 3), "8 worst": ("{number: 8, fitness: worst}", 1)}
ROOMS = {"lab": (), "walls": ("room.walls=[x_min,x_max,y_min,y_max]",)}
SLOW = "worst"  # comes last
SCORED = ("0", "3", "8")
EVALUATIONS = 2000
FRAMES, MOST_TAGS = 500, 4
MOVES = 2000


def lab(crowd: str, *more: str) -> Problem:
    """The problem of `experiment=lab` with a crowd."""
    return build_problem(compose("evaluate", "experiment=lab", "deployment=random", f"visibility.crowd={crowd}", *more))


def score(folder: Path, name: str) -> None:
    """Optimise and score the deployments of a table; lines that it has are left out."""
    path, more = folder / f"{name}.csv", ROOMS[name]
    known = pd.read_csv(path, dtype={"trained": str, "scored": str}) if path.is_file() else None
    problems = {crowd: lab(crowd, *more) for crowd in SCORED}
    jobs = [(seed, trained) for trained, (_, seeds) in TRAINED.items() for seed in range(seeds)]
    for seed, trained in sorted(jobs, key=lambda job: (SLOW in job[1], job[0])):
        if known is not None and ((known.trained == trained) & (known.seed == seed)).any():
            continue
        began = time.process_time()
        problem = lab(TRAINED[trained][0], *more)
        found = Annealing(seed=seed).run(problem, Budget(EVALUATIONS)).deployment
        seconds = time.process_time() - began
        prefix = "" if name == "lab" else f"{name}_"
        problem.labelled(found).to_csv(folder / f"{prefix}{trained.replace(' ', '_')}_{seed}.csv", ups=True)
        for scored, other in problems.items():
            figures = other.metrics(found) | validation_metrics(other, found, 100 + seed)
            row = {"trained": trained, "seed": seed, "scored": scored, "seconds": seconds, **figures}
            with path.open("a", newline="", encoding="utf-8") as file:
                writer = csv.DictWriter(file, list(COLUMNS), extrasaction="ignore", restval="")
                if not file.tell():
                    writer.writeheader()
                writer.writerow(row)


FIGURES = {
    "localised_share": "on the grid",
    "grid_free_localised_share": "off the grid",
    "worst_crowd_localised_share": "worst state, on the grid",
    "grid_free_worst_crowd_localised_share": "worst state, off the grid",
}
COLUMNS = ("trained", "seed", "scored", "seconds", *FIGURES)


def tables(folder: Path) -> None:
    """Print means over seeds, and gains in points over the deployments that were optimised without a crowd."""
    for name in ROOMS:
        path = folder / f"{name}.csv"
        if not path.is_file():
            continue
        rows = pd.read_csv(path, dtype={"trained": str, "scored": str})
        print(f"\n{name}\n\n| people | optimised with | seeds | " + " | ".join(FIGURES.values()) + " |")
        print("| ---: | --- | ---: " + "| --- " * len(FIGURES) + "|")
        for scored, part in rows.groupby("scored"):
            base = part[part.trained == NOBODY].set_index("seed")
            for trained, each in part.groupby("trained"):
                cells = [gained(each.set_index("seed")[figure], base[figure]) for figure in FIGURES]
                print(f"| {scored} | {trained} | {len(each)} | " + " | ".join(cells) + " |")


def gained(shares: "pd.Series[float]", base: "pd.Series[float]") -> str:
    """Mean of shares by seed, and their gains over the base with equal seeds; empty without shares."""
    gain = (shares - base).dropna()
    if not len(gain):
        return ""
    if shares.equals(base):
        return f"{shares.mean():.2%}"
    return f"{shares.mean():.2%} ({100.0 * gain.mean():+.2f}, {(gain > 0).sum()} of {len(gain)} better)"


def tried_moves(scene: Scene, positions: FloatArray | None, objective: object, start: Deployment) -> float:
    """Processor seconds of a tried move of one tag to a random place, exact values included."""
    evaluator = Evaluator(scene, positions, threads=1)
    field = field_of(objective, evaluator)  # type: ignore[arg-type]
    state = field.state(start)
    scratches, rng = layers(field.scratch(state), 1), np.random.default_rng(1)
    targets = scene.footprints.draw(RandomDeployment(16), rng)
    poses = np.repeat(np.hstack([targets.positions, targets.normals]), MOVES // 16, axis=0)
    steps = np.zeros((len(poses), 2, 4), dtype=np.int64)
    steps[:, :, 0], steps[:, :, 1] = (BOUND, SETTLE), rng.integers(len(start), size=(len(poses), 1))
    args = steps.reshape(-1, 4), np.repeat(poses, 2, axis=0), field, state, scratches, NO_UNITS
    perform(*args)
    began = time.process_time()
    perform(*args)
    return (time.process_time() - began) / len(poses)


def cost() -> None:
    """Print the cost of a tried move with 3 and 8 people over that of as many views without a crowd."""
    print("| objective | people | views | without, us | with, us | ratio |\n| --- " + "| --- " * 5 + "|")
    for name in ("paper", "localisation"):
        for number in ("3", "8"):
            problem = lab(number, f"objective={name}")
            scene, tiled = problem.scene, problem.evaluator.positions
            start = problem.draw(np.random.default_rng(0))
            empty = lab("0", f"objective={name}").scene
            without, with_crowd = (
                min(tried_moves(*each, problem.objective, start) for _ in range(3))
                for each in ((empty, tiled), (scene, None))
            )
            views = len(tiled)
            print(f"| {name} | {number} | {views} | {1e6 * without:.0f} | {1e6 * with_crowd:.0f} | "
                  f"{with_crowd / without:.2f} |", flush=True)  # fmt: skip


def rendered(folder: Path) -> None:
    """Print predicted and detected shares of frames with at least n tags, and mean numbers of tags."""
    head = " | ".join(f"at least {n}" for n in range(1, MOST_TAGS + 1))
    print(
        f"| people | deployment | detector | {head} | mean tags | hidden |\n| --- " + "| --- " * (MOST_TAGS + 4) + "|"
    )
    for number in ("3", "8"):
        problem = lab(number)
        uniform = build_problem(compose("evaluate", "experiment=lab", "deployment=uniform"))
        drawn = {"uniform": uniform.draw(np.random.default_rng(0))}
        for path in sorted(folder.glob("[08]_0.csv")):
            given = compose("evaluate", "experiment=lab", "deployment=file", f"deployment.path={path}")
            drawn[f"optimised with {path.stem[0]}"] = build_problem(given).draw(np.random.default_rng(0))
        for name, tags in drawn.items():
            for row in compared(problem, tags):
                print(f"| {number} | {name} | {row} |", flush=True)


def compared(problem: Problem, tags: Deployment) -> list[str]:
    """Rows of a deployment, one for each detector."""
    poses = draw_poses(problem.scene, FRAMES, 7)
    scene, people = draw_crowd(problem.scene, poses[:, :3, 3], 7)
    at, axes = poses[:, :3, 3], axis_and_right(poses)
    evaluator = Evaluator(scene, at[:1], 1, states=np.zeros(1, dtype=np.int64))
    predicted = visible_to_each(evaluator, tags, at, axes, np.arange(FRAMES))[0]
    empty = lab(NOBODY)
    alone = visible_to_each(empty.evaluator, tags, at, axes)[0]
    renderer = Renderer(scene.cameras[0], tagged_room(scene.room, tags, scene.tag), imaging_of(problem))
    detectors = {name: READERS[name](scene.tag.family) for name in ("aruco", "apriltag")}
    found = detect_in_frames(renderer, detectors, poses, 0, 7, people)
    rows = []
    for name, seen in found.items():
        pairs = [(predicted.sum(1) >= n, seen.detected.sum(1) >= n) for n in range(1, MOST_TAGS + 1)]
        shares = " | ".join(f"{one.mean():.3f} / {two.mean():.3f}" for one, two in pairs)
        mean = f"{predicted.sum() / FRAMES:.3f} / {seen.detected.sum() / FRAMES:.3f}"
        rows.append(f"{name} | {shares} | {mean} | {1.0 - predicted.sum() / alone.sum():.1%}")
    return rows


def main() -> None:
    """Run one part of the benchmark."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("part", choices=("cost", *ROOMS, "table", "rendered"))
    parser.add_argument("--folder", type=Path, default=Path("outputs/crowd"))
    args = parser.parse_args()
    args.folder.mkdir(parents=True, exist_ok=True)
    parts = {"cost": cost, "table": lambda: tables(args.folder), "rendered": lambda: rendered(args.folder)}
    parts.get(args.part, lambda: score(args.folder, args.part))()


if __name__ == "__main__":
    main()
