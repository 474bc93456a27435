import numpy as np
import pandas as pd
from matplotlib.image import imread
from support.paper import paper_scene

from lmd.objectives.coverage import Coverage
from lmd.plot.charts import save_heat_map
from lmd.plot.scenes import save_deployments_figure
from lmd.problem import Problem
from lmd.scene.deployment_sources import UniformDeployment
from lmd.space.cuboid import Cuboid

ROOM = Cuboid(size=(3.0, 2.0, 2.5), reachable_size=(2.0, 1.0, 1.5), spacing=0.8)
GREEN_BALL = (72, 171, 103)  # green at 80 % on white


def share(picture, *colour, within=6):
    """Share of the pixels that have a colour."""
    return (np.abs(picture[..., :3] * 255 - colour) <= within).all(axis=-1).mean()


def test_each_panel_shows_its_own_deployment_as_its_own_problem_scores_it(tmp_path):
    path = tmp_path / "panels.png"
    scene, start = paper_scene(room=ROOM), UniformDeployment(7)
    deployment = start.draw(ROOM, np.random.default_rng(0))
    never, always = (Problem(scene, Coverage(n, p), start, threads=1) for n, p in ((7, 1.0), (1, 0.0)))
    panels = {name: (problem, deployment) for name, problem in zip("abcd", (never, always, always, never), strict=True)}
    save_deployments_figure(path, panels, "T")
    picture = imread(path)
    half, middle = picture.shape[0] // 2 - 20, picture.shape[1] // 2
    shares = [
        share(picture[rows, columns], *GREEN_BALL)
        for rows in (slice(40, half), slice(half + 40, 2 * half - 40))
        for columns in (slice(middle), slice(middle, None))
    ]
    assert [s > 0.001 for s in shares] == [False, True, True, False]


def test_the_heat_map_is_dark_where_the_ratio_is_high_and_empty_where_there_is_no_run(tmp_path):
    table = pd.DataFrame([[0.0, 1.0], [np.nan, 1.0]], index=[2, 3], columns=[0.5, 0.65])
    save_heat_map(tmp_path / "heat.png", {"a": table, "b": table}, "T", "ratio")
    picture = imread(tmp_path / "heat.png")
    assert share(picture, 0, 68, 27) > 0.2  # the end of matplotlib's Greens
    save_heat_map(tmp_path / "heat.png", {"a": table * 0.0, "b": table * 0.0}, "T", "ratio")
    assert share(imread(tmp_path / "heat.png"), 0, 68, 27) < 0.01
