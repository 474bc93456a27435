"""The planner without a browser."""

import json
from dataclasses import replace

import numpy as np
import pytest
from floor_plans import L_SHAPE
from meshes import mesh_room
from paper import paper_scene
from small import problem

from lmd.core.checks import InputError
from lmd.formats.trajectories import read_recorded_poses
from lmd.objectives.coverage import Coverage
from lmd.optimisers.ledger import Budget
from lmd.optimisers.random_search import RandomSearch
from lmd.planner.app import Planner
from lmd.planner.later import TO_COME
from lmd.planner.panel import Panel
from lmd.planner.picture import BALL_RADIUS, Picture
from lmd.planner.session import Session
from lmd.planner.surveyed import Found
from lmd.problem import Problem
from lmd.scene.deployment_sources import RandomDeployment
from lmd.space.floor_plan import FloorPlan

viser = pytest.importorskip("viser")


class Shown(KeyboardInterrupt):
    """What the panel shows at last; it ends the planner as Ctrl-C does."""


@pytest.fixture
def planner():
    """Makes planners."""
    made = []

    def make(planned):
        session = Session(planned, planned.draw(np.random.default_rng(0)))
        made.append(Planner(session, 0, lambda _: "", RandomSearch, Budget(1), seed=0))
        return made[0]

    yield make
    made[0].close()


def recorded(write):
    """Looks ahead at one place for 20 s, every third of which is held out."""
    path = write("time,x,y,z,yaw,pitch\n" + "".join(f"{t},2,2.5,3,1.5,0\n" for t in range(21)))
    poses = read_recorded_poses(
        path, spacing=0.5, bandwidth=0.2, direction_bandwidth=5.0, divisions=12, held_out=3, block=1.0
    )
    scene = paper_scene()
    scene = replace(scene, room=poses.visited(scene.room), pdf=poses.pdf, recorded=poses)
    return Problem(scene, Coverage(1, 0.3), RandomDeployment(6), threads=1)


def test_of_recorded_poses_it_shows_the_figures_held_out(planner, monkeypatch, write):
    def show(_, rows):
        if rows != TO_COME:
            raise Shown(rows)

    monkeypatch.setattr("lmd.planner.later.additions", lambda *_: None)
    monkeypatch.setattr(Panel, "show_off_grid", show)
    with pytest.raises(Shown) as shown:
        planner(recorded(write)).run()
    assert set(shown.value.args[0]) == {"held out", "optimised on"}


def test_what_cannot_be_worked_out_is_said(planner, monkeypatch):
    def fail(*_):
        raise InputError("that is too big.")

    def say(_, text, refused=False):
        if refused:
            raise Shown(text)

    monkeypatch.setattr("lmd.planner.later.additions", fail)
    monkeypatch.setattr(Panel, "say", say)
    with pytest.raises(Shown, match=r"^that is too big\.$"):
        planner(problem()).run()


def test_positions_of_one_layer_are_balls_of_a_share_of_their_distance(tmp_path):
    room = mesh_room(tmp_path / "room.glb", FloorPlan(L_SHAPE, 2.5), height=(0.9, 1.1), spacing=0.5)
    scene = replace(paper_scene(), room=room)
    layer = Problem(scene, Coverage(1, 0.3), RandomDeployment(6), threads=1)
    positions = room.grid()
    assert np.ptp(positions[:, 2]) == 0.0
    away = np.linalg.norm(positions[1:] - positions[0], axis=1).min()
    server = viser.ViserServer(host="127.0.0.1", port=0, verbose=False)
    try:
        ball = Picture(server, layer).balls.vertices
    finally:
        server.stop()
    assert np.linalg.norm(ball, axis=1) == pytest.approx(BALL_RADIUS * away)


def survey_of(folder, deployment, photographs):
    """Files of a survey that found all tags 5 mm above their plan."""
    lifted = replace(deployment, positions=deployment.positions + np.array([0.0, 0.0, 0.005]))
    lifted.to_csv(folder / "map.csv")
    (folder / "survey.json").write_text(json.dumps({"next_photographs": photographs}))
    return folder


def test_a_survey_is_drawn_beside_the_plan(tmp_path):
    planned = problem()
    session = Session(planned, planned.draw(np.random.default_rng(0)))
    asked = [{"position": [1.0, 2.0, 1.5], "direction": [0.0, 1.0, 0.0]}]
    found = Found.read(survey_of(tmp_path, session.deployment, asked))
    lines = found.offsets(session.deployment, 20.0)
    np.testing.assert_allclose(np.diff(lines, axis=1)[:, 0], [[0.0, 0.0, 0.1]] * len(lines), atol=1e-6)
    assert len(lines) == len(session.deployment)
    planner = Planner(session, 0, lambda _: "", RandomSearch, Budget(1), None, found)
    planner.close()


def test_a_folder_that_is_no_survey_is_refused(tmp_path):
    with pytest.raises(InputError, match=r"map\.csv"):
        Found.read(tmp_path)
    planned = problem()
    folder = survey_of(tmp_path, planned.draw(np.random.default_rng(0)), [{"position": [1.0]}])
    with pytest.raises(InputError, match=r"^survey: .* holds no survey\.json of a survey\.$"):
        Found.read(folder)
