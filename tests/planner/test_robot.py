"""The drawn camera looks where the angles say: yaw from x towards y, as in a rig; a positive pitch looks down."""

from types import SimpleNamespace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from support.paper import experiment_room, paper_camera, paper_scene

from lmd.objectives.coverage import Coverage
from lmd.optimisers.genetic import RandomSearch
from lmd.optimisers.ledger import Budget
from lmd.planner.server import Planner
from lmd.planner.session import PlanningSession
from lmd.problem import Problem
from lmd.scene import pdf
from lmd.scene.deployment_sources import RandomDeployment
from lmd.scene.rig import Mount, Rig


@pytest.mark.parametrize(("yaw", "pitch", "ahead"), [(0, 0, (1, 0, 0)), (90, 0, (0, 1, 0)), (-45, 30, None)])
def test_the_drawn_frustum_looks_where_the_angles_of_ros_say(yaw, pitch, ahead):
    scene = paper_scene(experiment_room(spacing=0.9), Rig((Mount(paper_camera()),)), pdf.level_flight(4))
    planned = Problem(scene, Coverage(2, 0.5), RandomDeployment(12), threads=1)
    session = PlanningSession(planned, planned.draw(np.random.default_rng(3)))
    planner = Planner(session, 0, lambda _: "", RandomSearch, Budget(1), seed=None)
    try:
        planner._click_position(SimpleNamespace(instance_index=0))
        planner._panel.yaw.value, planner._panel.pitch.value = float(yaw), float(pitch)
        planner._look(None)
        (drawn,), frame = planner._robot.views, planner._robot._frame
        outer, inner = (Rotation.from_quat(turn, scalar_first=True) for turn in (frame.wxyz, drawn.wxyz))
        middle = (outer * inner).apply(drawn.points.reshape(-1, 3)).mean(axis=0)
    finally:
        planner.close()
    expected = ahead or np.sqrt([3 / 8, 3 / 8, 1 / 4]) * [1, -1, -1]
    np.testing.assert_allclose(middle / np.linalg.norm(middle), expected, atol=1e-6)
