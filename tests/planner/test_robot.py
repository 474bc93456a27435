"""Cameras of a rig in the planner: moved like tags, with the figures of `Problem`, to allowed mounts only."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from support.paper import experiment_room, paper_camera, paper_scene

from lmd.cameras.body import Body
from lmd.cameras.mounts import MountSpace
from lmd.core.checks import InputError
from lmd.geometry.frames import roll_pitch_yaw
from lmd.geometry.se3 import axis_and_right, camera_pose
from lmd.objectives.coverage import Coverage
from lmd.optimisers.ledger import Budget
from lmd.optimisers.random_search import RandomSearch
from lmd.planner.server import Planner
from lmd.planner.session import PlanningSession
from lmd.problem import Problem
from lmd.scene import pdf
from lmd.scene.deployment_sources import RandomDeployment
from lmd.scene.rig import Mount, Rig

CAMERA, OTHER = paper_camera(), paper_camera(focal_length=6.0)  # two kinds, as in the contract of a criterion
RIG = Rig((Mount(CAMERA, (0.22, 0.0, 0.1)), Mount(OTHER, (-0.22, 0.05, 0.1), yaw=3.0, pitch=-0.2)))
BOX = {"low": [-0.2, -0.15, 0.0], "high": [0.2, 0.15, 0.2]}
KEPT_OUT = {"surface": "left", "from_left": [0.0, 0.2], "from_below": [0.0, 0.2]}
LEVEL = np.eye(3)


def space(apart=0.08, **body):
    return MountSpace(Body([BOX], **body), (CAMERA, OTHER), 2, (-np.pi, np.pi), (-1.5, 1.5), (-np.pi, np.pi), apart)


def session(where=None, rig=RIG):
    scene = paper_scene(experiment_room(spacing=0.9), rig, pdf.level_flight(4))
    planned = Problem(scene, Coverage(2, 0.5), RandomDeployment(12), threads=1)
    return PlanningSession(planned, planned.draw(np.random.default_rng(3)), where)


def check(planned):
    """Check that the figures are those of a new problem."""
    problem, deployment = session(rig=planned.rig).problem, planned.deployment
    np.testing.assert_array_equal(planned.values(), problem.values(deployment))
    assert planned.metrics() == problem.metrics(deployment)


def test_a_camera_is_moved_with_its_figures_and_back():
    planned = session()
    before, number = planned.metrics(), int(planned.deployment.ids[0])
    for angle in (0.4, 0.9):
        planned.mount(0, np.array([0.1, 0.0, 0.2004]), turned(angle))
    planned.drop()
    assert planned.rig.mounts[0] == Mount(CAMERA, (0.1, 0.0, 0.2), yaw=0.9)
    assert planned.rig.mounts[1] == RIG.mounts[1]
    check(planned)
    planned.drag(number, 0, np.array([0.5, 0.5]))
    check(planned)
    planned.undo()
    assert planned.rig.mounts[0].yaw == 0.9
    assert not planned.is_saved
    planned.undo()
    assert planned.rig == RIG
    assert planned.metrics() == before
    assert planned.is_saved
    planned.redo()
    assert planned.rig.mounts[0].yaw == 0.9
    check(planned)


def turned(yaw):
    return Mount(CAMERA, yaw=yaw).rotation


def test_on_a_body_a_camera_moves_to_the_nearest_allowed_mount():
    planned = session(space(keep_out=[KEPT_OUT]))
    planned.mount(0, np.array([0.3, 0.02, 0.15]), turned(0.1))
    assert planned.rig.mounts[0] == Mount(CAMERA, (0.22, 0.02, 0.15), yaw=0.1)
    planned.mount(0, np.array([0.05, 0.16, 0.1]), turned(1.5))  # overlaps the kept-out part
    assert planned.rig.mounts[0].translation == (-0.02, 0.17, 0.1)  # and its margin of 2 cm
    planned.mount(0, np.array([0.22, 0.0, 0.1]), turned(np.pi))  # turned away from its body
    assert planned.space.own_part(planned.rig.mounts[0]) == 0.0
    check(planned)


def test_forbidden_mounts_are_refused():
    planned = session(space(apart=0.3))
    plan = planned.plan
    for place, message in (
        ([-0.22, 0.0, 0.1], r"^camera 0 would be less than 0.3 m from another\.$"),
        ([np.nan, 0.0, 0.0], r"^a camera cannot be at"),
    ):
        with pytest.raises(InputError, match=message):
            planned.mount(0, np.array(place), LEVEL)
    with pytest.raises(InputError, match=r"^rig has a camera at"):  # outside the room
        session().mount(0, np.array([0.0, 0.0, 50.0]), LEVEL)
    assert planned.plan is plan
    inside = Rig((Mount(CAMERA, (0.0, 0.0, 0.1)), RIG.mounts[1]))
    with pytest.raises(InputError, match=r"^rig\[0\] is not where and how a camera may be mounted"):
        session(space(), inside)


def test_its_handles_move_a_camera_and_a_drag_is_one_step():
    planned = session(space())
    planner = Planner(planned, 0, lambda _: "", RandomSearch, Budget(1), seed=None)
    try:
        robot = planner._robot
        robot.stand(robot.position, roll_pitch_yaw([0.0, 0.2, np.pi / 2 - 0.7]))
        axes = axis_and_right(camera_pose(robot.position[None], np.array([0.7]), np.array([-0.2])))
        turn = Rotation.from_quat(robot._frame.wxyz, scalar_first=True).as_matrix()
        offsets = [turn @ mount.translation for mount in RIG.mounts]
        np.testing.assert_allclose(offsets, RIG.views(axes)[0][:, 0], atol=1e-9)
        assert not robot._handles.visible
        robot._choice.value = "camera 1"
        robot._choose(None)
        assert robot._handles.visible
        np.testing.assert_allclose(robot._handles.position, RIG.mounts[1].translation)
        for phase, y in (("start", 0.05), ("update", 0.0), ("update", -0.08), ("end", -0.08)):
            robot._latest = np.array([-0.3, y, 0.1]), robot._handles.wxyz
            robot._follow(phase == "end")
        np.testing.assert_allclose(robot._handles.position, [-0.22, -0.08, 0.1])
        assert "camera 1: (-0.220, -0.080, 0.100) m, yaw 171.9" in robot._text.content
        planned.undo()
        assert planned.rig == RIG
        robot._latest = np.zeros(3), np.zeros(4)
        with pytest.raises(InputError, match=r"^that is no rotation\.$"):
            robot._follow(True)
    finally:
        planner.close()


@pytest.mark.parametrize(("yaw", "pitch", "ahead"), [(0, 0, (1, 0, 0)), (90, 0, (0, 1, 0)), (-45, 30, None)])
def test_the_drawn_frustum_looks_where_the_angles_of_ros_say(yaw, pitch, ahead):
    """Yaw from x towards y, as in a rig; a positive pitch looks down."""
    planned = session(rig=Rig((Mount(CAMERA),)))
    planner = Planner(planned, 0, lambda _: "", RandomSearch, Budget(1), seed=None)
    try:
        planner._panel.yaw.value, planner._panel.pitch.value = float(yaw), float(pitch)
        planner._look(None)
        robot = planner._robot
        drawn, turns = robot._views[0], [robot._frame.wxyz, robot._views[0].wxyz]
        outer, inner = (Rotation.from_quat(turn, scalar_first=True) for turn in turns)
        middle = (outer * inner).apply(drawn.points.reshape(-1, 3)).mean(axis=0)
    finally:
        planner.close()
    expected = ahead or np.sqrt([3 / 8, 3 / 8, 1 / 4]) * [1, -1, -1]
    np.testing.assert_allclose(middle / np.linalg.norm(middle), expected, atol=1e-6)
