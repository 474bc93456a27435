"""Every source of a deployment hangs tags in allowed regions only, in a room with a pillar, a rack and a door."""

from dataclasses import replace

import pytest
from support.paper import paper_scene
from support.rooms import hangs_properly, lab

from lmd.evaluation.bounds import Search, average_upper_bound
from lmd.objectives.coverage import Coverage
from lmd.objectives.sampling import Sampling
from lmd.optimisers.annealing import Annealing
from lmd.optimisers.genetic import EGA
from lmd.optimisers.greedy import Greedy
from lmd.optimisers.ledger import Budget
from lmd.problem import Problem
from lmd.scene import pdf
from lmd.scene.deployment_sources import RandomDeployment
from lmd.scene.tag import Tag

SCENE = paper_scene(lab(), orientations=pdf.grid_with_ends(6), thold=0.3, occlusion="line_of_sight")
WITH_TAGS = replace(SCENE, tag=Tag(0.15))


@pytest.mark.slow
@pytest.mark.parametrize("scene", [SCENE, WITH_TAGS], ids=["points", "tags"])
@pytest.mark.parametrize("sampling", [None, Sampling(1, 6)], ids=["grid", "samples"])
@pytest.mark.parametrize("optimiser", [Annealing, Greedy, lambda: EGA(), lambda: EGA(encoding="paper")])
def test_what_is_found_hangs_where_it_may(optimiser, scene, sampling):
    problem = Problem(scene, Coverage(2, 0.5, sampling=sampling), RandomDeployment(16), threads=1)
    result = optimiser().run(problem, Budget(200))
    edge, found = scene.footprints.edge, result.deployment
    assert hangs_properly(scene.room, found.positions, found.surfaces, edge).all()
    scene.footprints.check(found.movable(scene.room))
    assert result.fitness == problem.fitness_of(found)


def test_a_budget_too_small_for_a_pose_on_each_wall_is_no_reason_to_fail():
    problem = Problem(WITH_TAGS, Coverage(2, 0.5), RandomDeployment(6), threads=1)
    assert Greedy().run(problem, Budget(3)).fitness >= 0.0


def test_no_deployment_exceeds_the_bound(monkeypatch):
    monkeypatch.setattr("lmd.evaluation.relaxation.MOST_CELLS", 20_000)  # the bound holds whenever it stops
    problem = Problem(SCENE, Coverage(2, 0.5), RandomDeployment(16), threads=1)
    found = Greedy().run(problem, Budget(200)).deployment
    average = problem.metrics(found)["average_coverage_probability"]
    bound = average_upper_bound(problem, 16, Search(0.5, 20, 0.01))
    assert average <= bound.walls
    assert bound.grid < 1.0
