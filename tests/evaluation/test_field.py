"""An FRC field against a count of its own: pinhole formulas and lines of shapely, no code of the library."""

import json
import math
import shlex
from pathlib import Path

import cv2
import numpy as np
import pytest
import shapely
from scipy.spatial.transform import Rotation
from support import composing
from support.processes import ROOT

from lmd.evaluation.accuracy import accuracy_metrics, errors_along
from lmd.evaluation.validation import Sample, validation_metrics
from lmd.geometry.squares import corners
from pipelines.app import CONF
from pipelines.building import build_problem

HALF, SIDE = 0.1651 / 2.0, 8  # metres; modules along the black square
FOCAL, WIDTH, HEIGHT, EYE = 2.8 / 0.003, 1280, 800, 0.5
ROBOT = 0.4
POSES = 1500
LAYOUTS = Path(CONF, "experiment")
FIELD = LAYOUTS / "2025-reefscape-welded.json"
# By FIRST's drawing, metres: the field without the corners behind the coral stations, and one of two reefs.
OUTLINE = [(1.7577, -0.0038), (15.7905, -0.0038), (17.548, 1.2727), (17.548, 6.7791), (15.7905, 8.0556),
           (1.7577, 8.0556), (0.0, 6.7791), (0.0, 1.2727)]  # fmt: skip
REEF = [[5.321, 4.5061], [4.4893, 4.9863], [3.6576, 4.5061], [3.6576, 3.5457], [4.4893, 3.0655], [5.321, 3.5457]]
OTHER = [[x + 8.5696, y] for x, y in REEF]


def composed(*overrides):
    more = "experiment=frc_field", "objective=paper", "objective.thold_p=0.5", f"deployment.path={FIELD}"
    return composing.composed("evaluate", *more, *overrides)


def tags(layout=FIELD):
    """Places, normals and corners in a file of WPILib."""
    for tag in json.loads(layout.read_text())["tags"]:
        place = np.array([tag["pose"]["translation"][axis] for axis in "xyz"])
        turn = Rotation.from_quat([tag["pose"]["rotation"]["quaternion"][axis] for axis in "XYZW"]).as_matrix()
        normal, side, up = turn.T
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
    return not any(shapely.LineString([eye[:2], corner[:2]]).intersects(reefs) for corner in square)


def test_two_tags_are_in_view_as_often_as_counted_by_hand():
    problem = build_problem(composed(f"room.path={FIELD}"))
    figures = validation_metrics(problem, problem.draw(np.random.default_rng(0)), 0, Sample(8, 64, 24))
    solid = shapely.union_all([shapely.Polygon(hole) for hole in (REEF, OTHER)])
    free = shapely.Polygon(OUTLINE).buffer(-ROBOT).difference(solid.buffer(ROBOT))
    reefs, hung, rng, counted = solid.buffer(-1e-2), list(tags()), np.random.default_rng(0), []
    while len(counted) < POSES:
        x, y, yaw = rng.uniform([0.0, 0.0, 0.0], [17.6, 8.1, 2.0 * np.pi])
        if free.contains(shapely.Point(x, y)):
            ahead, right = np.array([np.cos(yaw), np.sin(yaw), 0.0]), np.array([np.sin(yaw), -np.cos(yaw), 0.0])
            seen = sum(reads(*tag, np.array([x, y, EYE]), ahead, right, reefs) for tag in hung)
            counted.append(seen >= 2)
    error = np.std(counted) / np.sqrt(POSES)
    assert abs(figures["grid_free_average_coverage_probability"] - np.mean(counted)) < 3.0 * error


def test_tags_that_rounding_puts_into_a_reef_touch_it_and_deeper_ones_are_named(capsys):
    plan = "room.path=null", f"room.outline={[[0, 0], [17.55, 0], [17.55, 8.06], [0, 8.06]]}", "room.keep_out=[]"
    problem = build_problem(composed(*plan, f"room.holes=[{REEF}]"))
    hung = problem.draw(np.random.default_rng(0))
    assert problem.scene.room.contains(corners(hung.positions, hung.normals, hung.ups, problem.scene.tag.size)).all()
    assert "no camera sees" not in capsys.readouterr().err
    centre = np.mean(REEF, axis=0)
    build_problem(composed(*plan, f"room.holes=[{(centre + 1.2 * (np.array(REEF) - centre)).round(3).tolist()}]"))
    assert "where no camera sees them: 17, 18, 19, 20" in capsys.readouterr().err


def hub(x, y):
    return shapely.box(x, y, x + 1.1938, y + 1.1938)


@pytest.mark.parametrize(
    ("name", "wanted"),
    [
        ("2025-reefscape-welded", shapely.Polygon(OUTLINE, [REEF, OTHER])),
        # The hubs are 47 inches wide by the manual, and their tags stand out by some millimetres.
        ("2026-rebuilt-welded", shapely.box(0, 0, 16.541, 8.069) - hub(4.0284, 3.4376) - hub(11.3187, 3.4376)),
        ("2026-rebuilt-andymark", shapely.box(0, 0, 16.518, 8.043) - hub(4.0149, 3.4247) - hub(11.3092, 3.4247)),
    ],
)
def test_a_layout_is_a_field_with_the_bodies_of_its_season(name, wanted, tmp_path):
    layout = json.loads((LAYOUTS / f"{name}.json").read_text())
    new = {"season": name[:4], "field-dimensions": layout["field"], "field-tags": layout["tags"]}  # for 2027
    for i, text in enumerate((layout, new)):
        (path := tmp_path / f"{i}.json").write_text(json.dumps(text))
        plan = build_problem(composed(f"room.path={path}", f"deployment.path={path}")).scene.room.plan
        assert shapely.Polygon(plan.outline, plan.holes).symmetric_difference(wanted).area < 0.1  # of 140 m^2


def test_along_a_path_tags_are_counted_and_errors_predicted_as_by_hand():
    """The sightings of each pose by the formulas above, and the errors of OpenCV's poses from noisy corners."""
    drive = f"poses.path={ROOT / 'examples/frc/bump.path'}"
    problem = build_problem(composing.composed("evaluate", "experiment=frc_path", drive))
    deployment = problem.draw(np.random.default_rng(0))
    along, hung = errors_along(problem, deployment), list(tags(LAYOUTS / "2026-rebuilt-welded.json"))
    hubs = shapely.union_all([shapely.Polygon(hole).buffer(-1e-2) for hole in problem.scene.room.plan.holes])
    poses, rng, noise = problem.scene.recorded.records.poses, np.random.default_rng(1), problem.objective.pixel_noise
    seen = [[tag for tag in hung if reads(*tag, pose[:3, 3], pose[:3, 2], pose[:3, 0], hubs)] for pose in poses]
    counts = np.array([len(each) for each in seen])
    assert ((counts >= 2) == along.covered).all()
    ratios = []
    for k in np.flatnonzero((counts >= 2) & np.isfinite(along.predicted_error))[::8]:
        points, turn = np.concatenate([square for *_, square in seen[k]]), poses[k, :3, :3].T
        matrix = np.array([[FOCAL, 0.0, WIDTH / 2], [0.0, FOCAL, HEIGHT / 2], [0.0, 0.0, 1.0]])
        start = cv2.Rodrigues(turn)[0], -turn @ poses[k, :3, 3]
        image = cv2.projectPoints(points, *start, matrix, None)[0]
        for _ in range(40):
            noisy = image + rng.normal(0.0, noise, image.shape)
            _, turned, moved = cv2.solvePnP(points, noisy, matrix, None, *map(np.copy, start), useExtrinsicGuess=True)
            found = -cv2.Rodrigues(turned)[0].T @ moved.ravel()
            ratios.append(np.sum((found - poses[k, :3, 3]) ** 2) / along.predicted_error[k] ** 2)
    assert np.sqrt(np.mean(ratios)) == pytest.approx(1.0, abs=0.08)  # a few per cent are the prediction's
    figures = accuracy_metrics(problem, deployment, 0)
    seconds, near = along.seconds.sum(), along.predicted_error <= 0.05
    assert figures["covered_share"] == pytest.approx(along.seconds[along.covered == 1].sum() / seconds)
    assert figures["localised_share_50mm"] == pytest.approx(along.seconds[near].sum() / seconds)
    runs = (along.covered != along.covered.shift()).cumsum()
    longest = along[along.covered == 0].groupby(runs).seconds.sum().max()
    assert figures["longest_uncovered_seconds"] == pytest.approx(longest)


def test_the_commands_of_the_page_build_their_problems():
    block = (ROOT / "docs" / "frc.md").read_text().split("```sh\n")[1].split("```")[0].replace("\\\n", "")
    for line in block.replace("LAYOUT.json", str(FIELD)).replace(".path=", f".path={ROOT}/examples/frc/").splitlines():
        _, _, module, *words = shlex.split(line.replace(f"{ROOT}/examples/frc/{FIELD}", str(FIELD)), comments=True)
        own = [word.split()[-1].rstrip("']") for word in words if word.startswith("deployments=")]
        shared = [word for word in words if not word.startswith(("deployments=", "varies="))]
        problem = build_problem(composing.composed(module.removeprefix("pipelines."), *shared, *own))
        assert len(problem.draw(np.random.default_rng(0))) == 22
