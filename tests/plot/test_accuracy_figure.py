import numpy as np
from matplotlib.image import imread
from support.paper import paper_room, paper_scene

from lmd.evaluation.accuracy import plan_of_errors, predicted_errors
from lmd.objectives.coverage import Coverage
from lmd.plot.plans import save_accuracy_figure
from lmd.problem import Problem
from lmd.scene import pdf
from lmd.scene.deployment_sources import UniformDeployment
from lmd.scene.scene import Scene
from lmd.scene.tag import Tag


def problem_of(count, n=2):
    scene = paper_scene(room=paper_room(spacing=1.5), orientations=pdf.grid_of_cells(6))
    tagged = Scene(scene.room, scene.camera, scene.pdf, scene.visibility, Tag(0.1))
    return Problem(tagged, Coverage(n, 0.5), UniformDeployment(count), threads=1)


def drawn(problem):
    return problem, problem.draw(np.random.default_rng(0))


def test_the_plan_has_the_median_of_all_heights_and_orientations():
    problem, deployment = drawn(problem_of(90))
    plan = plan_of_errors(problem, deployment)
    positions = problem.evaluator.positions
    errors, _ = predicted_errors(problem, deployment, problem.evaluator)
    assert len(plan) * 3 == len(positions)  # three heights
    assert np.isfinite(plan.predicted_error_median).any()
    for x, y, median in plan.to_numpy():
        here = np.sort(errors[np.isclose(positions[:, :2], (x, y)).all(axis=1)].ravel())  # of equal weight
        assert median in (here[len(here) // 2 - 1], here[len(here) // 2])


def test_where_few_views_see_enough_there_is_no_median():
    assert np.isinf(plan_of_errors(*drawn(problem_of(6))).predicted_error_median).all()


def test_the_picture_has_a_panel_for_each_deployment(tmp_path):
    subjects = {f"K = {count}": drawn(problem_of(count)) for count in (60, 90, 6)}
    deployments = {name: (*subject, plan_of_errors(*subject)) for name, subject in subjects.items()}
    save_accuracy_figure(tmp_path / "three.png", deployments, "T")
    save_accuracy_figure(tmp_path / "one.png", {"K = 6": deployments["K = 6"]}, "T")
    three, one = (imread(tmp_path / f"{name}.png") for name in ("three", "one"))
    assert (three.shape[1] - 100) == 3 * (one.shape[1] - 100)
    many, few = (len(np.unique(image[..., :3] @ [1.0, 256.0, 65536.0])) for image in (three, one))  # colours
    assert many > few
