"""`visibility.crowd` on the command line."""

import importlib

import numpy as np
import pytest
from composing import composed

from lmd.core.checks import InputError
from lmd.detection.frames import draw_crowd, draw_poses
from pipelines.building import build_problem

LAB = "experiment=lab", "deployment=uniform", "room.spacing=1.5"


def crowd_of(*overrides):
    return build_problem(composed("evaluate", *LAB, *overrides)).scene.crowd


def test_a_number_is_short_for_a_crowd():
    short, long = crowd_of("visibility.crowd=3"), crowd_of("visibility.crowd={number: 3}")
    assert short.crowd == long.crowd
    np.testing.assert_array_equal(short.people, long.people)
    assert short.people.shape == (20, 3, 5)


@pytest.mark.parametrize("nobody", ["visibility.crowd=null", "visibility.crowd=0"])
def test_nobody_may_be_in_the_way(nobody):
    assert crowd_of(nobody) is None


@pytest.mark.parametrize(
    ("override", "said"),
    [
        ("visibility.crowd=-1", "visibility.crowd.number"),
        ("visibility.crowd={radius: 0.3}", "visibility.crowd.number"),
        ("visibility.crowd={number: 3, weight: 80}", "visibility.crowd.weight is no setting that is known"),
        ("visibility.crowd={number: 3, height: 0}", "visibility.crowd.height"),
        ("visibility.crowd={number: 500, states: 1}", "visibility.crowd.number = 500 cylinders find no free floor"),
    ],
)
def test_what_makes_no_crowd_is_refused(override, said):
    with pytest.raises(InputError) as refused:
        crowd_of(override)
    assert str(refused.value).startswith(said)


def test_settings_of_a_run_name_its_crowd():
    problem = build_problem(composed("evaluate", *LAB, "visibility.crowd={number: 2, states: 4}"))
    assert problem.settings()["crowd"]["states"] == 4
    assert "crowd" not in build_problem(composed("evaluate", *LAB)).settings()


def test_each_frame_has_people_of_its_own():
    scene = build_problem(composed("evaluate", *LAB, "visibility.crowd={number: 5, states: 2}")).scene
    poses = draw_poses(scene, 30, 0)
    drawn, people = draw_crowd(scene, poses[:, :3, 3], 0)
    assert len(drawn.crowd) == len(people) == 30
    assert 0 < 5 * 30 - sum(map(len, people)) < 30  # those around the camera are left out


@pytest.mark.parametrize(
    ("module", "function", "more"),
    [
        ("uncertainty", "uncertainty", []),
        ("view", "view", []),
        ("place_cameras", "place_cameras", ["body.boxes=[{low: [-0.1, -0.1, 0], high: [0.1, 0.1, 0.1]}]"]),
        ("evaluate", "evaluate", ["camera.rig=[{}, {yaw: 3.1}]"]),
    ],
)
def test_commands_that_know_no_crowd_say_so(module, function, more):
    cfg = composed(module, *LAB, "visibility.crowd=2", *more)
    with pytest.raises(InputError, match=r"visibility\.crowd"):
        getattr(importlib.import_module(f"pipelines.{module}"), function)(cfg)
