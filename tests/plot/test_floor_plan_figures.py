"""The parts of a floor plan in figures."""

import numpy as np
from matplotlib.figure import Figure
from support.paper import paper_scene
from support.rooms import lab

from lmd.objectives.coverage import Coverage
from lmd.plot.plans import save_room_figure
from lmd.plot.scenes import save_scene_figure
from lmd.problem import Problem
from lmd.scene import pdf
from lmd.scene.deployment_sources import RandomDeployment
from lmd.space.cuboid import Cuboid


def test_figures_show_obstacles_and_keep_outs(tmp_path, monkeypatch):
    saved, save = [], Figure.savefig
    monkeypatch.setattr(Figure, "savefig", lambda figure, path: (saved.append(figure), save(figure, path)))
    for room, shown in [
        (lab(spacing=1.0), ["room", "obstacles", "nothing hangs here", "reachable area"]),
        (Cuboid((4, 3, 2.5), (3, 2, 1.5), 1.0), ["room", "reachable area"]),
    ]:
        problem = Problem(paper_scene(room, orientations=pdf.grid_with_ends(4)), Coverage(2, 0.5), RandomDeployment(9))
        deployment = problem.draw(np.random.default_rng(0))
        save_scene_figure(tmp_path / "scene.png", problem, deployment, "a lab")
        legends = [text.get_text() for legend in saved[-1].legends for text in legend.get_texts()]
        assert legends[: len(shown)] == shown
        assert (tmp_path / "scene.png").stat().st_size > 10_000


def test_the_outline_is_the_floor_plan():
    room = lab(clearance=0.25)
    outline = room.outline()
    assert {name: len(edges) for name, edges in outline.items()} == {
        "room": 3 * (6 + 4),
        "obstacles": 12,
        "nothing hangs here": 4,
        "reachable area": 3 * (8 + 4),  # the rack takes a corner away
    }
    corners = outline["nothing hangs here"].reshape(-1, 3)
    assert corners.min(axis=0).tolist() == [4.5, 0.0, 0.0]
    assert corners.max(axis=0).tolist() == [5.5, 0.0, 2.0]


def test_a_picture_of_a_room_names_its_walls_and_all_its_marks(tmp_path, monkeypatch):
    saved = []
    monkeypatch.setattr("matplotlib.figure.Figure.savefig", lambda figure, *_: saved.append(figure))
    monkeypatch.setattr("lmd.plot.plans.shrink", lambda _: None)
    for room in (lab(spacing=1.0, surfaces=None), Cuboid((4, 3, 2.5), (3, 2, 1.5), 1.0)):
        save_room_figure(tmp_path / "room.png", room, "a room")
        (axes,), (legend,) = saved[-1].axes, saved[-1].legends
        walls = {surface.name for surface in room.surfaces() if surface.is_upright}
        assert {text.get_text() for text in axes.texts} == walls
        labels = {text.get_text() for text in legend.texts}
        assert labels > {*room.outline(), "position of the camera"}
        assert any(label.startswith("landmarks may hang here") for label in labels)
