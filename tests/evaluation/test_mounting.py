from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from support.paper import X, paper_room, paper_scene

from lmd.core.checks import InputError
from lmd.evaluation.mounting import VIEWS_PER_DRAW, MountingError, as_measured, mounted, off_grid_figures, read_measured
from lmd.evaluation.validation import Sample, validation_metrics
from lmd.objectives.coverage import Coverage
from lmd.objectives.localisation import Localisation
from lmd.problem import Problem
from lmd.scene import pdf
from lmd.scene.deployment import Deployment
from lmd.scene.deployment_sources import UniformDeployment
from lmd.scene.labels import Labels
from lmd.scene.tag import Tag

SAMPLE = Sample(groups=2, positions=20, divisions=4)
TAG = Tag(0.2)


def problem_of(tag=TAG, objective=None, threads=1, fixed=None, count=30):
    scene = replace(paper_scene(room=paper_room(spacing=1.5), orientations=pdf.grid_with_ends(6)), tag=tag)
    return Problem(scene, objective or Localisation(), UniformDeployment(count), threads, fixed)


def plan_of(problem):
    return problem.draw(np.random.default_rng(0))


def off_by(position=0.0, turn=0.0, tilt=0.0, draws=3):
    return MountingError(position, turn, tilt, draws)


def test_tags_are_off_by_what_was_said():
    problem = problem_of()
    plan, rng = plan_of(problem), np.random.default_rng(0)
    hung = [off_by(0.005, 0.02, 0.01).draw(problem, plan, rng) for _ in range(100)]
    right, up = np.cross(plan.ups, plan.normals), plan.ups
    way = np.stack([each.deployment.positions for each in hung]) - plan.positions
    normals = np.stack([each.deployment.normals for each in hung])
    ups = np.stack([each.ups for each in hung])
    for axis in (right, up):
        assert (way * axis).sum(axis=-1).std() == pytest.approx(0.005, rel=0.05)
        assert (normals * axis).sum(axis=-1).std() == pytest.approx(0.01, rel=0.05)
    assert (ups * right).sum(axis=-1).std() == pytest.approx(0.02, rel=0.05)
    np.testing.assert_allclose((way * plan.normals).sum(axis=-1), 0.0, atol=1e-12)  # nobody mounts into the air
    np.testing.assert_allclose((ups * normals).sum(axis=-1), 0.0, atol=1e-12)
    np.testing.assert_allclose(np.linalg.norm(ups, axis=-1), 1.0)


def test_papers_stay_on_their_walls_and_apart():
    edge = TAG.paper_edge
    side_by_side = Deployment([[0.0, edge * at, 3.0] for at in (0.5, 1.5, 2.5)], [X, X, X])
    problem = problem_of(count=3)
    plan = side_by_side.with_surfaces(problem.scene.footprints.hanging)
    for seed in range(20):
        hung = off_by(0.02).draw(problem, plan, np.random.default_rng(seed)).deployment
        problem.scene.footprints.check(hung)
        assert not np.allclose(hung.positions, plan.positions)


def test_what_hangs_already_stays_and_off_every_surface_makes_no_other_one_stay():
    fixed = Deployment(np.array([[0.02, 2.0, 3.0], [0.0, 3.0, 3.0]]), np.array([X, X]))
    problem = problem_of(fixed=fixed, count=5)
    plan = plan_of(problem)
    positions, surfaces = plan.positions.copy(), plan.surfaces.copy()
    surfaces[0] = -1  # as measured: it stands before its wall
    positions[2], surfaces[2] = (0.0, 3.05, 3.0), plan.surfaces[1]  # over the tag that is fixed
    normals = np.array([*plan.normals[:2], X, *plan.normals[3:]])
    over = replace(plan, positions=positions, normals=normals, surfaces=surfaces)
    for planned, error in ((plan, off_by(0.01, 0.1, 0.1)), (over, off_by(0.001))):
        hung = error.draw(problem, planned, np.random.default_rng(0)).deployment
        np.testing.assert_array_equal(hung.positions[:2], plan.positions[:2])
        np.testing.assert_allclose(hung.normals[:2], plan.normals[:2], atol=1e-15)
        assert (hung.positions[2:] != planned.positions[2:]).any(axis=1).all()
    problem.scene.footprints.check(hung)


def test_the_plan_is_scored_as_everywhere_and_every_draw_like_any_deployment():
    problem = problem_of(objective=Coverage(2, 0.5))
    plan = plan_of(problem)
    found = mounted(problem, plan, off_by(0.1, draws=4), seed=2, sample=SAMPLE)
    assert problem.metrics(plan).items() <= dict(found.planned).items()
    validated = validation_metrics(problem, plan, 2, SAMPLE)
    for key in ("qualified_ratio", "average_coverage_probability"):
        assert found.planned[f"grid_free_{key}"] == pytest.approx(validated[f"grid_free_{key}"], rel=1e-12)
    assert len(found.draws) == 4
    assert found.draws.fitness.nunique() > 1
    assert found.table.loc["fitness", "50 %"] == found.draws.fitness.median()
    assert found.metrics()["fitness/95"] == found.table.loc["fitness", "95 %"]
    assert found.views.draw.isin(range(4)).all()
    assert (found.views.tags >= 2).all()
    assert len(found.views) <= 4 * VIEWS_PER_DRAW
    assert "100 mm along their surface" in found.to_text()
    threaded, other = (
        mounted(problem_of(objective=Coverage(2, 0.5), threads=threads), plan, off_by(0.1, draws=4), seed, SAMPLE)
        for threads, seed in ((3, 2), (1, 1))
    )
    for name in ("draws", "views"):
        pd.testing.assert_frame_equal(getattr(found, name), getattr(threaded, name), check_exact=True)
        assert not getattr(found, name).equals(getattr(other, name))


def test_a_map_as_mounted_leaves_the_noise_alone():
    problem = problem_of()
    found = mounted(problem, plan_of(problem), off_by(0.02, tilt=0.02), 0, SAMPLE)
    assert found.views.position_mounted.median() < 0.5 * found.views.position_planned.median()


def measured_file(tmp_path, plan, order=slice(None)):
    path = tmp_path / "measured.csv"
    plan[order].to_csv(path)
    return path


def test_measured_tags_are_known_by_their_ids(tmp_path):
    problem = problem_of()
    plan = replace(plan_of(problem), labels=Labels(np.arange(30) * 3, {"note": [str(k) for k in range(30)]}))
    shift = np.zeros((30, 3))
    shift[4] = (0.0, 0.03, -0.04)
    path = measured_file(tmp_path, replace(plan, positions=plan.positions + shift), np.arange(30)[::-1])
    measured = read_measured(path, problem, plan)
    np.testing.assert_allclose(measured.positions, plan.positions + shift, atol=1e-15)
    assert measured.labels == plan.labels
    found = as_measured(problem, plan, measured, 0, SAMPLE, views=100)
    farthest = found.moved.iloc[0]
    assert (farthest["id"], farthest.moved) == (12, pytest.approx(0.05))
    assert (farthest.dy, farthest.dz) == (pytest.approx(0.03), pytest.approx(-0.04))
    assert (found.moved.moved.iloc[1:] == 0.0).all()
    assert found.figures.loc["fitness", "measured"] == problem.fitness_of(measured)
    expected = off_grid_figures(problem, [plan, measured], 0, SAMPLE)
    assert found.figures.loc["grid_free_localised_share"].tolist() == expected.grid_free_localised_share.tolist()
    assert found.metrics()["moved/greatest"] == pytest.approx(0.05)
    assert "at most 50.0 mm" in found.to_text()


def test_tags_that_hung_before_are_measured_too_and_a_tilt_by_the_normal(tmp_path):
    fixed = Deployment(np.array([[0.0, 2.0, 3.0], [0.0, 3.0, 3.0]]), np.array([X, X]))
    problem = problem_of(fixed=fixed, count=5)
    plan = plan_of(problem)
    positions, normals = plan.positions.copy(), plan.normals.copy()
    positions[0] = (0.0, 2.0, 3.5)
    normals[6] = np.cos(0.05) * normals[6] + np.sin(0.05) * plan.ups[6]
    path = measured_file(tmp_path, replace(plan, positions=positions, normals=normals))
    measured = read_measured(path, problem, plan)
    np.testing.assert_array_equal(measured.positions[:6], positions[:6])
    assert measured.labels.columns == {"fixed": list("1100000")}
    found = as_measured(problem, plan, measured, 0, SAMPLE, views=10)
    assert found.moved.set_index("id").tilted[plan.ids[6]] == pytest.approx(0.05)


@pytest.mark.parametrize(
    ("order", "factor", "message"),
    [
        (range(29), 1.0, "lacks the landmark 29 that is planned"),
        ([*range(30), 31], 1.0, "has a landmark 30 that is not"),
        (range(30), 1e3, r"^measured: .*measured.csv: landmark 0 at .* lies outside the room"),
    ],
)
def test_measured_tags_are_those_of_the_plan_and_inside_the_room(tmp_path, order, factor, message):
    problem = problem_of()
    plan = plan_of(problem_of(count=32) if len(order) > 30 else problem)
    path = measured_file(tmp_path, replace(plan, positions=factor * plan.positions), np.array(order))
    with pytest.raises(InputError, match=message):
        read_measured(path, problem, plan_of(problem))
