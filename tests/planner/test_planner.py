"""The planner and its picture without a browser."""

from dataclasses import replace

import numpy as np
import pytest
from support.small import problem

from lmd.core.checks import InputError
from lmd.geometry.projection import project
from lmd.geometry.se3 import pose_of
from lmd.optimisers.genetic import RandomSearch
from lmd.optimisers.ledger import Budget
from lmd.planner.panel import PlannerPanel
from lmd.planner.picture import offsets
from lmd.planner.server import Planner
from lmd.planner.session import PlanningSession
from lmd.planner.viewing import seen_by
from lmd.scene.deployment import Deployment
from lmd.scene.tag import Tag

viser = pytest.importorskip("viser")


class Shown(KeyboardInterrupt):
    """A text of the panel; ends the planner as Ctrl-C does."""


@pytest.fixture
def planner():
    """Makes planners."""
    made = []

    def make(planned):
        session = PlanningSession(planned, planned.draw(np.random.default_rng(0)))
        made.append(Planner(session, 0, lambda _: "", RandomSearch, Budget(1), seed=0))
        return made[0]

    yield make
    made[0].close()


def test_a_failure_of_background_work_is_shown(planner, monkeypatch):
    def fail(*_):
        raise InputError("that is too big.")

    def say(_, text, refused=False):
        if refused:
            raise Shown(text)

    monkeypatch.setattr("lmd.planner.background.additions", fail)
    monkeypatch.setattr(PlannerPanel, "say", say)
    with pytest.raises(Shown, match=r"^that is too big\.$"):
        planner(problem()).run()


def test_a_survey_is_drawn_beside_the_plan():
    planned = problem()
    session = PlanningSession(planned, planned.draw(np.random.default_rng(0)))
    plan = session.deployment
    found = replace(plan, positions=plan.positions + np.array([0.0, 0.0, 0.005]))
    np.testing.assert_allclose(np.diff(offsets(found, plan), axis=1)[:, 0], [[0.0, 0.0, 0.1]] * len(plan), atol=1e-6)
    planner = Planner(session, 0, lambda _: "", RandomSearch, Budget(1), None, found)
    planner.close()


def test_the_image_of_a_camera_shows_its_tags_where_they_are_projected():
    planned = problem(tag=Tag(0.6))
    place = np.array([[0.0, 2.0, 2.0]])  # on x_min, straight ahead of the camera, 0.2 m to its right
    one = Deployment(place, np.array([[1.0, 0.0, 0.0]])).with_surfaces(planned.scene.room)
    back, camera = np.array([[0.0, 0.0, -1.0], [1.0, 0.0, 0.0], [0.0, -1.0, 0.0]]), planned.scene.cameras[0]
    pose = pose_of(back, np.array([3.0, 1.8, 2.0]))
    image = seen_by(planned, one, camera, pose)
    assert image.shape == (240, 320)
    u, v = project(camera, pose, place)[0] * 320 / camera.image_width
    half = 0.3 / 3.0 * camera.focal_length / camera.pixel_width * 320 / camera.image_width
    border = [image[round(v), round(u + side * 0.93 * half)] for side in (-1, 1)]
    beside = [image[round(v), round(u + side * 1.12 * half)] for side in (-1, 1)]
    assert max(border) + 60 < min(beside)  # black within the corners, white paper beyond
    assert seen_by(problem(), one, camera, pose) is None
