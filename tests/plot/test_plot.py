import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from matplotlib.image import imread
from support.paper import paper_scene
from support.processes import environment

from lmd.objectives.coverage import Coverage
from lmd.plot import common
from lmd.plot.charts import save_convergence_figure
from lmd.plot.scenes import save_scene_figure
from lmd.problem import Problem
from lmd.scene.deployment import Deployment
from lmd.scene.deployment_sources import RandomDeployment, UniformDeployment
from lmd.scene.labels import Labels
from lmd.sight.evaluator import Evaluator
from lmd.space.cuboid import Cuboid

ROOM = Cuboid(size=(3.0, 2.0, 2.5), reachable_size=(2.0, 1.0, 1.5), spacing=0.8)
PROBABILITY = np.linspace(0.0, 1.0, len(ROOM.grid()))
THOLD_P = 0.65
SCENE = paper_scene(room=ROOM)


class Shown(Problem):
    """A problem with values of our own choice."""

    def __init__(self, probability, count=7):
        super().__init__(SCENE, Coverage(min(2, count), THOLD_P), RandomDeployment(count), threads=1)
        self.probability = probability

    def values(self, deployment):
        return self.probability


@pytest.fixture(name="deployment")
def _deployment() -> Deployment:
    return UniformDeployment(7).draw(ROOM, np.random.default_rng(0))


def save(function, path: Path, deployment: Deployment, probability: np.ndarray = PROBABILITY, title: str = "T") -> None:
    function(path, Shown(probability), deployment, title)


def test_axes_have_a_tick_for_every_half_metre(tmp_path, deployment, monkeypatch):
    saved = []
    monkeypatch.setattr("matplotlib.figure.Figure.savefig", lambda figure, *_: saved.append(figure))
    save(save_scene_figure, tmp_path / "scene.png", deployment)
    panels = [axes for axes in saved[0].axes if axes.name == "3d"]
    assert len(panels) == 2
    for axes in panels:
        for axis in (axes.xaxis, axes.yaxis, axes.zaxis):
            assert np.diff(axis.get_majorticklocs())[0] == 0.5  # of a room of 3 m


def colours_in(picture: np.ndarray, red: int, green: int, blue: int) -> int:
    """Pixels within 6 levels of a colour."""
    return int((np.abs(picture[..., :3] * 255 - [red, green, blue]) <= 6).all(axis=-1).sum())


def test_scene_figure_has_the_stated_size_and_shows_qualified_positions_in_the_right_panel(tmp_path, deployment):
    shown = {}
    for name, probability in (("none", 0.0), ("all", 1.0)):
        path = tmp_path / f"{name}.png"
        save(save_scene_figure, path, deployment, np.full_like(PROBABILITY, probability))
        picture = imread(path)
        assert picture.shape[:2] == (750, 1500)
        assert 30_000 < path.stat().st_size < 500_000
        # Balls only, without the legend below: green at 80 % on white, and the red of the arrows.
        shown[name] = colours_in(picture[100:640, 750:], 72, 171, 103)
        assert colours_in(picture[100:640], 214, 39, 40) > 200
    assert shown["none"] == 0
    assert shown["all"] > 500


@pytest.mark.parametrize("size", [(3.0, 2.0), (9.0, 2.0)])
def test_a_scene_at_one_height_is_drawn_from_above_with_ids(size, tmp_path, monkeypatch):
    saved = []
    monkeypatch.setattr("matplotlib.figure.Figure.savefig", lambda figure, *_: saved.append(figure))
    room = Cuboid((*size, 2.5), (size[0] - 1.0, 1.0, 0.5), 0.8)
    problem = Problem(replace(SCENE, room=room), Coverage(2, THOLD_P), RandomDeployment(9), threads=1)
    values = np.linspace(0.0, 1.0, len(room.grid()))
    monkeypatch.setattr(problem, "values", lambda _: values)
    deployment = problem.draw(np.random.default_rng(0))
    save_scene_figure(tmp_path / "scene.png", problem, deployment, 20 * "a long title ")
    left, right, _ = saved[0].axes
    for axes in (left, right):
        assert sorted(int(n) for text in axes.texts for n in text.get_text().split(", ")) == list(range(9))
        assert len(axes.collections[0].get_paths()) == len(values)
    np.testing.assert_array_equal(left.collections[0].get_array(), values)
    assert (left.get_position().y0 > right.get_position().y0) == (size[0] > 2.0 * size[1])
    assert saved[0].get_suptitle().count("\n") == 1


def test_what_hung_already_is_blue_and_has_its_own_entry(tmp_path, deployment):
    hangs = replace(deployment[:3], labels=Labels(np.array([8, 9, 30])))
    problem = Problem(SCENE, Coverage(2, THOLD_P), RandomDeployment(4), threads=1, fixed=hangs)
    whole = problem.draw(np.random.default_rng(0))
    for name, shown in (("old", Shown(PROBABILITY)), ("beside", problem)):
        save_scene_figure(tmp_path / f"{name}.png", shown, whole, "T")
        drawn = imread(tmp_path / f"{name}.png")[100:640]
        assert colours_in(drawn, 214, 39, 40) > 100
        assert (colours_in(drawn, 31, 119, 180) > 100) == (name == "beside")


@pytest.mark.slow
def test_plotting_libraries_load_late_and_pyplot_never(tmp_path, deployment):
    deployment.to_csv(tmp_path / "deployment.csv")
    code = """if True:
        import sys
        import lmd.plot.charts, lmd.plot.scenes
        assert "matplotlib" not in sys.modules
        import numpy as np
        import lmd
        room = lmd.Cuboid((3.0, 2.0, 2.5), (2.0, 1.0, 1.5), 0.8)
        camera = lmd.Camera(5.0, 0.0058, 0.0058, (800, 600), 1600, 1200, 10.0)
        scene = lmd.Scene(room, camera, lmd.pdf.level_flight(), lmd.Visibility(0.28))
        start = lmd.FileDeployment("deployment.csv")
        problem = lmd.Problem(scene, lmd.Coverage(2, 0.65), start)
        lmd.save_scene_figure("a.png", problem, start.draw(room, np.random.default_rng()), "T")
        assert "matplotlib.pyplot" not in sys.modules
    """
    subprocess.run([sys.executable, "-c", code], cwd=tmp_path, env=environment(), check=True)


@pytest.mark.parametrize("probability", [0.0, 1.0])
def test_one_landmark_and_one_position(tmp_path, probability):
    one = Deployment(np.array([[0.0, 1.0, 1.0]]), np.array([[1.0, 0.0, 0.0]]))
    shown = Shown(np.array([probability]), count=1)
    shown.evaluator = Evaluator(SCENE, ROOM.grid()[:1])
    save_scene_figure(tmp_path / "scene.png", shown, one, "T")
    assert (tmp_path / "scene.png").stat().st_size > 30_000


@pytest.mark.parametrize("rows", [1, 4])
def test_convergence_figure(tmp_path, rows):
    history = {
        "evaluations": [30, 60, 90, 120], "best_fitness": [0.2, 0.5, 0.5, 0.9], "wall_time": [0.5, 40.0, 75.0, 3700.0]
    }  # fmt: skip
    shown = {key: values[:rows] for key, values in history.items()}
    path = tmp_path / "convergence.png"
    save_convergence_figure(path, shown, "Convergence")
    assert imread(path).shape[:2] == (500, 900)
    assert path.stat().st_size > 8_000


@pytest.mark.parametrize(
    ("low", "high"), [(11.0, 38.0), (4.1, 4.8), (0.3, 900.0), (19.9, 20.3), (1e-4, 1e4), (5.0, 5.0)]
)
def test_a_logarithmic_axis_has_a_few_round_numbers_within_it(low, high):
    ticks = common.logarithmic_ticks(low, high)
    assert all((ticks >= low) & (ticks <= high))
    assert (1 if low == high else 3) <= len(ticks) <= 9
    assert all(len(f"{tick:g}") <= 6 for tick in ticks)
