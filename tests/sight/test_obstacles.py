from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_array_equal
from support.paper import paper_scene
from support.rooms import L_SHAPE, lab

from lmd.objectives.coverage import Coverage
from lmd.objectives.localisation import Localisation
from lmd.optimisers.annealing import Annealing
from lmd.optimisers.ledger import Budget
from lmd.problem import Problem
from lmd.scene import pdf
from lmd.scene.deployment import Deployment
from lmd.scene.deployment_sources import RandomDeployment
from lmd.scene.tag import Tag
from lmd.sight.evaluator import Evaluator
from lmd.sight.models.fiducial import Fiducial
from lmd.sight.views import visible
from lmd.space.cuboid import Cuboid
from lmd.space.floor_plan import FloorPlan
from lmd.space.parts import Reachable
from lmd.space.prism import Prism


def lab_scene(fiducial, room=None):
    scene = paper_scene(room or lab(), orientations=pdf.grid_with_ends(6), thold=0.3, occlusion="line_of_sight")
    return replace(scene, visibility=Fiducial(Tag(0.15)), tag=None) if fiducial else scene


@pytest.mark.parametrize("fiducial", [False, True])
def test_a_cuboid_written_as_a_floor_plan_is_the_cuboid(fiducial):
    names = {"y_min": "wall_0", "x_max": "wall_1", "y_max": "wall_2", "x_min": "wall_3", "floor": "floor"}
    cuboid = Cuboid((6.0, 4.0, 2.5), (5.5, 3.5, 1.5), 0.5, walls=tuple(names))
    plan = FloorPlan([[0, 0], [6, 0], [6, 4], [0, 4]], 2.5, surfaces=list(names.values()))
    prism = Prism(plan, Reachable((0.5, 2.0), 0.25), 0.5)
    assert_array_equal(prism.grid(), cuboid.grid())
    localised = Localisation(tolerance=0.2, sampling=None)  # whose walk is compiled for commands, too
    found, objective = [], localised if fiducial else Coverage(2, 0.5)
    for room in (cuboid, prism):
        scene = lab_scene(fiducial, room)
        problem = Problem(scene, objective, RandomDeployment(12), threads=1)
        deployment = Annealing(seed=5).run(problem, Budget(80)).deployment
        found.append((deployment, Evaluator(scene, threads=1).counts(deployment)))
    (here, counts), (there, others) = found
    assert_array_equal(here.positions, there.positions)
    assert_array_equal(here.normals, there.normals)
    assert_array_equal(counts, others)


def test_a_room_of_two_halves_sees_only_its_own():
    # A wall with a gap of 10 cm: who stands before it sees through, who stands beside does not.
    wall = [{"low": [2.9, 0, 0], "high": [3.1, 1.95, 2.5]}, {"low": [2.9, 2.05, 0], "high": [3.1, 4, 2.5]}]
    plan = FloorPlan([[0, 0], [6, 0], [6, 4], [0, 4]], 2.5, obstacles=wall)
    room = Prism(plan, Reachable((1.0, 1.0), 0.5), 0.5)
    mark, normal = np.array([[6.0, 2.0, 1.0]]), np.array([[-1.0, 0.0, 0.0]])
    scene = paper_scene(room, thold=0.1)
    seen = Evaluator(scene, threads=1).counts(Deployment(mark, normal)).any(axis=1)
    x, y, _ = room.grid().T
    assert_array_equal(seen[x < 2.9], abs(y - 2.0)[x < 2.9] < 0.01)
    assert seen[x > 3.1].any()


def test_a_tag_is_seen_only_if_its_corners_are():
    # The edge of the pillar is in line with the middle of the tag, or 1 mm beside its corner.
    for beside, seen in ((0.0, False), (0.076, True)):
        pillar = {"low": [2.0, 0.5, 0.0], "high": [2.5, 2.0 - beside, 2.5]}
        plan = FloorPlan(L_SHAPE, 2.5, obstacles=[pillar])
        room = Prism(plan, Reachable((1.0, 1.0)), 0.5)
        scene = replace(lab_scene(True, room), visibility=Fiducial(Tag(0.15)))
        tag = Deployment([[3.0, 2.0, 1.0]], [[-1.0, 0.0, 0.0]])
        position, axis = np.array([[1.5, 2.0, 1.0]]), np.array([[1.0, 0.0, 0.0, 0.0, -1.0, 0.0]])
        assert visible(Evaluator(scene, threads=1), tag, position, axis)[0, 0] == seen
