"""The field of FRC 2025 against a count of its own: pinhole formulas and lines of shapely, no code of the library."""

import csv
import math
from pathlib import Path

import numpy as np
import shapely
from support import composing

from lmd.evaluation.validation import Sample, validation_metrics
from lmd.geometry.squares import corners
from pipelines.app import CONF
from pipelines.building import build_problem

HALF, SIDE = 0.1651 / 2.0, 8  # metres; modules along the black square
FOCAL, WIDTH, HEIGHT, EYE = 2.8 / 0.003, 1280, 800, 0.5
ROBOT = 0.4
POSES = 1500


def composed(*overrides):
    return composing.composed("evaluate", "experiment=frc_2025", "objective=paper", "objective.thold_p=0.5", *overrides)


def tags():
    """Places, normals and corners by FIRST's drawing, inches and degrees."""
    with Path(CONF, "experiment/frc_2025.csv").open() as file:
        for _, *place, yaw, pitch in list(csv.reader(file))[1:]:
            a, b = math.radians(float(yaw)), math.radians(float(pitch))
            normal = [math.cos(a) * math.cos(b), math.sin(a) * math.cos(b), -math.sin(b)]
            place, normal = np.array(place, dtype=float) * 0.0254, np.array(normal)
            side = np.cross([0.0, 0.0, 1.0], normal) / np.hypot(*normal[:2])
            up = np.cross(normal, side)
            square = [place + HALF * (i * side + j * up) for i, j in ((-1, -1), (1, -1), (1, 1), (-1, 1))]
            yield place, normal, np.array(square)


def reads(place, normal, square, eye, ahead, right, reefs):
    """Whether a camera with AprilTag reads a tag: the limits are those of the model, the geometry is not."""
    offset = eye - place
    if normal @ offset <= math.cos(math.radians(85.0)) * np.linalg.norm(offset):
        return False
    seen = square - eye
    depth = seen @ ahead
    if (depth <= 0.05).any():
        return False
    u, v = WIDTH / 2 + FOCAL * (seen @ right) / depth, HEIGHT / 2 - FOCAL * seen[:, 2] / depth
    if u.min() < 0 or u.max() > WIDTH or v.min() < 0 or v.max() > HEIGHT:
        return False
    image = np.stack([u, v])
    per_module = np.stack(
        [image[:, [1, 2]].sum(1) - image[:, [0, 3]].sum(1), image[:, [2, 3]].sum(1) - image[:, [0, 1]].sum(1)]
    )
    pitch = np.linalg.svd(per_module / 2.0 / SIDE, compute_uv=False)[1]
    far = 1000.0 * float(-offset @ ahead)
    disc = abs(far - 3000.0) / (far * (3000.0 - 2.8)) * 1.0 * FOCAL  # of a thin lens of 1 mm, focused at 3 m, pixels
    if pitch < math.hypot(0.9, 1.6 * math.hypot(0.5, disc / 4.0)):
        return False
    return not shapely.LineString([eye[:2], place[:2]]).intersects(reefs)


def test_two_tags_are_in_view_as_often_as_counted_by_hand():
    problem = build_problem(composed())
    figures = validation_metrics(problem, problem.draw(np.random.default_rng(0)), 0, Sample(8, 64, 24))
    plan = composed().room
    solid = shapely.union_all([shapely.Polygon(hole) for hole in plan.holes])
    free = shapely.Polygon(plan.outline).buffer(-ROBOT).difference(solid.buffer(ROBOT))
    reefs, hung, rng, counted = solid.buffer(-1e-3), list(tags()), np.random.default_rng(0), []
    while len(counted) < POSES:
        x, y, yaw = rng.uniform([0.0, 0.0, 0.0], [17.6, 8.1, 2.0 * np.pi])
        if free.contains(shapely.Point(x, y)):
            ahead, right = np.array([np.cos(yaw), np.sin(yaw), 0.0]), np.array([np.sin(yaw), -np.cos(yaw), 0.0])
            seen = sum(reads(*tag, np.array([x, y, EYE]), ahead, right, reefs) for tag in hung)
            counted.append(seen >= 2)
    error = np.std(counted) / np.sqrt(POSES)
    assert abs(figures["grid_free_average_coverage_probability"] - np.mean(counted)) < 3.0 * error


REEF = [[5.321, 4.5061], [4.4893, 4.9863], [3.6576, 4.5061], [3.6576, 3.5457], [4.4893, 3.0655], [5.321, 3.5457]]


def test_tags_that_rounding_puts_into_a_reef_touch_it_and_deeper_ones_are_named(capsys):
    problem = build_problem(composed(f"room.holes=[{REEF}]"))
    hung = problem.draw(np.random.default_rng(0))
    assert problem.scene.room.contains(corners(hung.positions, hung.normals, hung.ups, problem.scene.tag.size)).all()
    assert "no camera sees" not in capsys.readouterr().err
    centre = np.mean(REEF, axis=0)
    build_problem(composed(f"room.holes=[{(centre + 1.2 * (np.array(REEF) - centre)).round(3).tolist()}]"))
    assert "where no camera sees them: 17, 18, 19, 20" in capsys.readouterr().err
