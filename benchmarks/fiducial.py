"""Measure the cost of the visibility model of a detector: `python benchmarks/fiducial.py`.

Prints a Markdown table of times of the paper's criteria and of a detector's, and their ratios, from one run in the
paper's room on one thread, in seconds of the processor: tags hung at random without overlapping. Part of the ratio is
no cost of the criterion: tags of 10 cm are seen from nearly everywhere in the room, the paper's landmarks from less
than half of it.

A second table has the detector's criteria through lenses that distort, against none. The fisheye shows as wide an angle
in its corners.
"""

import math
from dataclasses import replace
from time import process_time

import numpy as np
from speed import N, best_of, move_all, paper_scene

from lmd.incremental.coverage_field import coverage_field
from lmd.scene.deployment_sources import RandomDeployment
from lmd.scene.scene import Scene
from lmd.scene.tag import Tag
from lmd.sight.evaluator import Evaluator
from lmd.sight.models.fiducial import Fiducial

CASES = ((90, 0.1), (40, 0.1), (90, 0.05))  # how many tags, and their edge in metres
BARREL = (-0.12, 0.01, 0.002, -0.003)
RATIONAL = (0.15, -0.04, 0.001, 0.0, 0.004, 0.2, -0.07, 0.006, 0.001, 0.0, -0.002, 0.001)
FISHEYE = (0.003, 0.001, -0.002, 0.0002)
MOVES, TRIED = 400, 2  # moves that are bounded and made exact


def times(scene: Scene, count: int) -> tuple[float, float]:
    """What an evaluation takes, and of a move that is only tried, seconds."""
    rng, evaluator = np.random.default_rng(0), Evaluator(scene, threads=1)
    start, targets = (scene.footprints.draw(RandomDeployment(size), rng) for size in (count, MOVES))
    field = coverage_field(evaluator, N)
    state = field.state(start)
    args = np.hstack([targets.positions, targets.normals]), targets.surfaces, field, state, field.scratch(state), TRIED
    landmarks = start.positions[None], start.normals[None]
    evaluated = best_of(9, lambda: evaluator.units(*landmarks, N), process_time)
    return evaluated, best_of(5, lambda: move_all(*args), process_time) / MOVES


def through_lenses() -> None:
    """Print the table of lenses."""
    count, edge = CASES[0]
    scene = replace(paper_scene(), tag=Tag(edge), visibility=Fiducial(Tag(edge)))
    camera = scene.camera
    pixel = camera.pixel_width * camera.widest_angle / math.tan(camera.widest_angle)
    cameras = {
        "none": camera,
        "plumb bob": replace(camera, distortion=BARREL),
        "rational, thin prism": replace(camera, distortion=RATIONAL),
        "equidistant": replace(
            camera, distortion=FISHEYE, distortion_model="equidistant", pixel_width=pixel, pixel_height=pixel
        ),
    }
    print("\n| lens | one evaluation, ms | ratio | one move, tried, ms | ratio |\n| --- | --- | --- | --- | --- |")
    rows = {name: times(replace(scene, camera=camera), count) for name, camera in cameras.items()}
    for name, (evaluated, tried) in rows.items():
        ratios = evaluated / rows["none"][0], tried / rows["none"][1]
        print(f"| {name} | {1e3 * evaluated:.2f} | {ratios[0]:.2f} | {1e3 * tried:.3f} | {ratios[1]:.2f} |")


def main() -> None:
    """Print the tables."""
    print("| tags | work | paper's, ms | detector's, ms | ratio |\n| --- | --- | --- | --- | --- |")
    for count, edge in CASES:
        paper = replace(paper_scene(), tag=Tag(edge))
        rows = [times(paper, count), times(replace(paper, visibility=Fiducial(Tag(edge))), count)]
        for name, ours, detectors in zip(("one evaluation", "one move, tried"), *rows, strict=True):
            ratio = detectors / ours
            print(f"| {count} of {edge} m | {name} | {1e3 * ours:.3f} | {1e3 * detectors:.3f} | {ratio:.1f} |")
    through_lenses()


if __name__ == "__main__":
    main()
