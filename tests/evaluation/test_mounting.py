from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from matplotlib.image import imread
from support.paper import X, paper_room, paper_scene

from lmd.core.checks import InputError
from lmd.evaluation.mounting import VIEWS_PER_DRAW, MountingError, as_measured, mounted, off_grid_figures, read_measured
from lmd.evaluation.validation import Sample, validation_metrics
from lmd.objectives.coverage import Coverage
from lmd.objectives.localisation import Localisation
from lmd.plot.pose_errors import save_map_figure
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
    side_by_side = Deployment(
        np.array([[0.0, edge / 2.0, 3.0], [0.0, 1.5 * edge, 3.0], [0.0, 2.5 * edge, 3.0]]), np.array([X, X, X])
    )
    problem = problem_of(count=3)
    plan = side_by_side.with_surfaces(problem.scene.footprints.hanging)
    for seed in range(20):
        hung = off_by(0.02).draw(problem, plan, np.random.default_rng(seed)).deployment
        problem.scene.footprints.check(hung)
        assert not np.allclose(hung.positions, plan.positions)


def test_what_hangs_already_stays():
    fixed = Deployment(np.array([[0.0, 2.0, 3.0], [0.0, 3.0, 3.0]]), np.array([X, X]))
    problem = problem_of(fixed=fixed, count=5)
    plan = plan_of(problem)
    hung = off_by(0.01, 0.1, 0.1).draw(problem, plan, np.random.default_rng(0))
    np.testing.assert_array_equal(hung.deployment.positions[:2], plan.positions[:2])
    np.testing.assert_allclose(hung.deployment.normals[:2], plan.normals[:2], atol=1e-15)
    assert (hung.deployment.positions[2:] != plan.positions[2:]).any(axis=1).all()


def test_a_fixed_tag_off_every_surface_makes_no_other_one_stay():
    fixed = Deployment(np.array([[0.02, 2.0, 3.0], [0.0, 3.0, 3.0]]), np.array([X, X]))
    problem = problem_of(fixed=fixed, count=5)
    plan = plan_of(problem)
    surfaces = plan.surfaces.copy()
    surfaces[0] = -1  # as measured: it stands before its wall
    positions = plan.positions.copy()
    positions[2], surfaces[2] = (0.0, 3.05, 3.0), plan.surfaces[1]  # over the tag that is fixed
    over = replace(plan, positions=positions, normals=np.array([*plan.normals[:2], X, *plan.normals[3:]]),
                   surfaces=surfaces)  # fmt: skip
    hung = off_by(0.001).draw(problem, over, np.random.default_rng(0)).deployment
    np.testing.assert_array_equal(hung.positions[:2], plan.positions[:2])
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
    table = found.table
    assert table.loc["fitness", "50 %"] == found.draws.fitness.median()
    assert found.metrics()["fitness/95"] == table.loc["fitness", "95 %"]
    assert found.views.draw.isin(range(4)).all()
    assert (found.views.tags >= 2).all()
    assert len(found.views) <= 4 * VIEWS_PER_DRAW
    assert "100 mm along their surface" in found.to_text()


def test_the_number_of_threads_does_not_matter_but_the_seed_does():
    one, three, other = (
        mounted(problem_of(threads=threads), plan_of(problem_of()), off_by(0.01, tilt=0.01), seed, SAMPLE)
        for threads, seed in ((1, 0), (3, 0), (1, 1))
    )
    for name in ("draws", "views"):
        pd.testing.assert_frame_equal(getattr(one, name), getattr(three, name), check_exact=True)
        assert not getattr(one, name).equals(getattr(other, name))


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


def test_a_tilt_is_measured_by_the_normal(tmp_path):
    problem = problem_of()
    plan = plan_of(problem)
    normals = plan.normals.copy()
    normals[0] = np.cos(0.05) * normals[0] + np.sin(0.05) * plan.ups[0]
    measured = read_measured(measured_file(tmp_path, replace(plan, normals=normals)), problem, plan)
    found = as_measured(problem, plan, measured, 0, SAMPLE, views=10)
    assert found.moved.set_index("id").tilted[plan.ids[0]] == pytest.approx(0.05)


def test_tags_that_hung_before_are_measured_too(tmp_path):
    fixed = Deployment(np.array([[0.0, 2.0, 3.0], [0.0, 3.0, 3.0]]), np.array([X, X]))
    problem = problem_of(fixed=fixed, count=5)
    plan = plan_of(problem)
    positions = plan.positions.copy()
    positions[0] = (0.0, 2.0, 3.5)
    measured = read_measured(measured_file(tmp_path, replace(plan, positions=positions)), problem, plan)
    np.testing.assert_array_equal(measured.positions, positions)
    assert measured.labels.columns == {"fixed": list("1100000")}


@pytest.mark.parametrize(
    ("order", "message"),
    [(slice(0, 29), "lacks the landmark 29 that is planned"), ([*range(30), 31], "has a landmark 30 that is not")],
)
def test_measured_tags_are_those_of_the_plan(tmp_path, order, message):
    problem, larger = problem_of(), problem_of(count=32)
    path = measured_file(tmp_path, plan_of(problem if isinstance(order, slice) else larger), np.r_[order])
    with pytest.raises(InputError, match=message):
        read_measured(path, problem, plan_of(problem))


def test_measured_tags_are_inside_the_room(tmp_path):
    problem = problem_of()
    plan = plan_of(problem)
    path = measured_file(tmp_path, replace(plan, positions=1e3 * plan.positions))
    with pytest.raises(InputError, match=r"measured: .*measured.csv: landmark 0 at .* lies outside the room"):
        read_measured(path, problem, plan)


def test_the_picture_has_its_size(tmp_path):
    views = pd.DataFrame({"tags": [2, 3], "position_planned": [0.01, np.nan], "position_mounted": [0.02, 0.03]})
    save_map_figure(tmp_path / "a.png", views, "T")
    assert imread(tmp_path / "a.png").shape[:2] == (500, 800)
