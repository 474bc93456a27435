import math
from dataclasses import replace

import numpy as np
import pytest
from support.paper import paper_camera, paper_room, paper_scene
from support.small import make

from lmd.evaluation.losses import losses
from lmd.objectives.coverage import Coverage
from lmd.objectives.sampling import Sampling
from lmd.optimisers.ledger import Budget
from lmd.problem import Problem
from lmd.scene import pdf
from lmd.scene.deployment_sources import RandomDeployment
from lmd.scene.rig import Mount, Rig

CAMERA = paper_camera()
BACK_TO_BACK = Rig((Mount(CAMERA, (0.1, 0.0, 0.0)), Mount(CAMERA, (-0.1, 0.0, 0.0), yaw=math.pi)))


def problem(camera, sampling=None):
    scene = replace(paper_scene(paper_room(spacing=1.5), orientations=pdf.level_flight(6)), camera=camera)
    return Problem(scene, Coverage(2, 0.3, sampling), RandomDeployment(12), threads=1)


# Compiled for it alone.
pytestmark = pytest.mark.thorough("lmd/incremental", "lmd/optimisers", "lmd/objectives", "lmd/sight")


@pytest.mark.parametrize("name", ["annealing", "greedy", "random_search"])
def test_one_camera_on_a_body_gets_the_deployment_of_that_camera(name):
    one, other = (make(name).run(problem(c), Budget(80)) for c in (CAMERA, Rig((Mount(CAMERA),))))
    np.testing.assert_array_equal(one.deployment.positions, other.deployment.positions)
    np.testing.assert_array_equal(one.deployment.normals, other.deployment.normals)
    assert one.fitness == other.fitness


@pytest.mark.parametrize(
    ("name", "sampling"),
    [("annealing", None), ("greedy", None), ("greedy", Sampling(2, 4)), ("annealing", Sampling(2, 4))],
)
def test_a_rig_is_climbed_and_scored_alike(name, sampling):
    rigged = problem(BACK_TO_BACK, sampling)
    result = make(name).run(rigged, Budget(80))
    assert result.fitness == rigged.fitness_of(result.deployment)
    assert result.fitness > rigged.fitness_of(rigged.draw(np.random.default_rng(0)))


@pytest.mark.parametrize("sampling", [None, Sampling(2, 4)])
def test_what_a_rig_loses_is_what_is_missing_without(sampling):
    """Of two kinds of cameras, for which moves are compiled."""
    mounts = BACK_TO_BACK.mounts
    two = Rig((mounts[0], replace(mounts[1], camera=replace(CAMERA, focal_length=1.2 * CAMERA.focal_length))))
    rigged = problem(two, sampling)
    drawn = rigged.draw(np.random.default_rng(0))
    left = losses(rigged, drawn)
    assert left.fitness == rigged.fitness_of(drawn)
    assert left.without[0, 0] == pytest.approx(rigged.fitness_of(drawn[1:]), abs=1e-12) != left.fitness
    assert left.without[0, 1] == pytest.approx(rigged.fitness_of(drawn[2:]), abs=1e-12) != left.without[0, 0]
