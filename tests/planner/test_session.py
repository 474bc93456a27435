"""A planning session without a browser: after any changes, its figures are those of `Problem`."""

import threading
from dataclasses import replace

import numpy as np
import pytest
from support.paper import paper_room, paper_scene
from support.rooms import lab
from support.small import problem

from lmd.core.checks import InputError
from lmd.formats.tag_maps import FileDeployment
from lmd.objectives.coverage import Coverage
from lmd.objectives.localisation import Localisation
from lmd.objectives.sampling import Sampling
from lmd.optimisers.annealing import Annealing
from lmd.optimisers.genetic import RandomSearch
from lmd.optimisers.ledger import Budget
from lmd.planner.plan import Plan
from lmd.planner.session import PlanningSession
from lmd.problem import Problem
from lmd.scene import pdf
from lmd.scene.deployment import Deployment
from lmd.scene.deployment_sources import RandomDeployment
from lmd.scene.tag import Tag

TAG = Tag(edge=0.2)


def session(of=None):
    of = of or problem(tag=TAG)
    return PlanningSession(of, of.draw(np.random.default_rng(0)))


def small_scene(room, tag):
    return replace(paper_scene(room, orientations=pdf.grid_with_ends(6)), tag=tag)


def sampled():
    scene = small_scene(paper_room(spacing=1.5), None)
    return Problem(scene, Coverage(2, 0.5, sampling=Sampling(1, 4)), RandomDeployment(12), threads=1)


def localising():
    scene = small_scene(paper_room(spacing=2.0), TAG)
    return Problem(scene, Localisation(sampling=None), RandomDeployment(9), threads=1)


def on_a_floor_plan():
    return Problem(small_scene(lab(), TAG), Coverage(1, 0.3), RandomDeployment(9), threads=1)


def somewhere(of, rng):
    surfaces = of.scene.footprints.hanging.surfaces()
    surface = int(rng.integers(len(surfaces)))
    return surface, rng.uniform(-0.5, 0.5 + np.array(surfaces[surface].extent))


def act(planned, rng):
    """Do one random action; a refused one must change nothing."""
    number, place = int(rng.choice(planned.deployment.ids)), somewhere(planned.problem, rng)
    before = planned.plan

    def drag():
        for _ in range(3):
            planned.drag(number, *somewhere(planned.problem, rng))
        planned.drop()

    changes = lambda: planned.add(*place), lambda: planned.delete(number), lambda: planned.pin(number)
    try:
        (*changes, planned.undo, planned.redo, drag, drag, drag)[int(rng.integers(8))]()
    except InputError:
        assert planned.plan is before


@pytest.mark.parametrize("of", [problem, sampled, localising, on_a_floor_plan])
def test_figures_equal_those_of_a_full_evaluation(of):
    planned, rng = session(of()), np.random.default_rng(1)
    for _ in range(40):
        act(planned, rng)
        assert planned.metrics() == planned.problem.metrics(planned.deployment)
        assert (planned.values() == planned.problem.values(planned.deployment)).all()
        planned.problem.scene.footprints.check(planned.deployment)
        assert planned.deployment.fault(planned.problem.scene.footprints.hanging) is None


def test_a_tag_moves_to_the_nearest_free_place():
    planned = session()
    edge, wall = planned.problem.scene.footprints.edge, planned.problem.scene.room.surfaces()[0]
    planned.drag(3, 0, np.array([-1.0, 2.0]))
    planned.drag(4, 0, np.array([0.0, 2.0]))  # coordinates are 0 at the nearest place that a paper's centre may take
    for number, way in ((3, 0.0), (4, edge)):
        there = planned.deployment.positions[planned.plan.index_of(number)]
        a, b = (float(value) for value in wall.coordinates(there))
        assert {round(abs(a - edge / 2), 9), round(abs(b - 2.0 - edge / 2), 9)} == {0.0, round(way, 9)}
    planned.problem.scene.footprints.check(planned.deployment)


def test_a_drag_is_one_step_of_undo_and_redo():
    planned = session()
    plans = [planned.plan]
    for number in (2, 2, 5):
        for b in (1.0, 2.0, 3.0):
            planned.drag(number, 1, np.array([b, b]))
        planned.drop()
        plans.append(planned.plan)
    planned.pin(5)
    plans.append(planned.plan)
    plans.append(replace(plans[-1], pinned=frozenset()))
    for plan in plans[-3::-1]:
        planned.undo()
        assert planned.plan is plan
        assert planned.metrics() == planned.problem.metrics(plan.deployment)
    with pytest.raises(InputError, match=r"^there is nothing to undo\.$"):
        planned.undo()
    planned.redo()
    assert planned.plan is plans[1]
    planned.delete(0)
    with pytest.raises(InputError, match="nothing to redo"):
        planned.redo()


def test_a_new_tag_has_the_least_free_id_and_the_columns_of_the_file(write):
    path = write("id,x,y,z,nx,ny,nz,note\n7,0,2,3,1,0,0,by the door\n0,0,3,3,1,0,0,\n1,7.5,2,3,-1,0,0,\n")
    planned = session(problem(FileDeployment(path), tag=TAG))
    assert [planned.add(2, np.array([a, 1.0])) for a in (1.0, 2.0)] == [2, 3]
    planned.delete(0)
    assert planned.deployment.ids.tolist() == [7, 1, 2, 3]
    assert planned.deployment.labels.columns == {"note": ["by the door", "", "", ""]}
    assert Plan.of(Deployment([[0.0, 2.0, 3.0]] * 2, [[1.0, 0.0, 0.0]] * 2)).deployment.labels.ids.tolist() == [0, 1]


def test_of_several_sizes_the_user_chooses():
    planned = session(problem(tag=Tag(edges=(0.1, 0.4), counts=(20, 10))))
    assert planned.problem.scene.tag.size == 0.4
    for edge in (0.1, 0.4):
        number = planned.add(0, np.array([1.0, 1.0]), edge)
        assert planned.deployment.edges[planned.plan.index_of(number)] == edge
        planned.problem.scene.footprints.check(planned.deployment)
        assert planned.plan.described(number, planned.problem.scene).endswith(f") m, black square {edge} m")
        assert planned.metrics() == planned.problem.metrics(planned.deployment)


def test_pinned_tags_do_not_move_and_fixed_ones_stay_pinned():
    hung = Deployment([[0.0, 2.0, 3.0], [0.0, 3.0, 3.0]], [[1.0, 0.0, 0.0]] * 2)
    planned = session(problem(RandomDeployment(5), fixed=hung, tag=TAG))
    assert planned.plan.pinned == {0, 1}
    planned.pin(4)
    for refused in (lambda: planned.drag(4, 0, np.ones(2)), lambda: planned.delete(4)):
        with pytest.raises(InputError, match=r"^tag 4 is pinned: unpin it first\.$"):
            refused()
    planned.pin(4)
    planned.drag(4, 0, np.ones(2))
    with pytest.raises(InputError, match="tag 1 is fixed by the problem"):
        planned.pin(1)


@pytest.mark.parametrize(
    ("of", "change", "message"),
    [
        ({"start": RandomDeployment(2)}, lambda s: s.delete(0), "n = 2 exceeds the number of landmarks, 1"),
        ({"start": RandomDeployment(2)}, lambda s: s.drag(9, 0, np.ones(2)), r"^there is no tag 9\.$"),
        ({"tag": Tag(0.2, "16h5")}, lambda s: s.add(0, np.ones(2)), "16h5 has 30 different tags, too few for 31"),
        ({"tag": TAG}, lambda s: s.drag(0, 0, np.array([1e160, 1.0])), "is not on a surface"),
        ({"tag": TAG}, lambda s: s.drag(0, 0, np.array([np.nan, 1.0])), "is not on a surface"),
    ],
)
def test_impossible_changes_are_refused(of, change, message):
    planned = session(problem(**of))
    before = planned.plan
    with pytest.raises(InputError, match=message):
        change(planned)
    assert planned.plan is before


def test_changes_since_the_last_save_are_unsaved():
    planned = session()
    assert planned.is_saved
    planned.pin(3)
    assert planned.is_saved  # the file has no pins
    planned.drag(4, 0, np.ones(2))
    assert not planned.is_saved
    planned.note_saved()
    planned.delete(5)
    planned.undo()
    assert planned.is_saved


def test_the_free_tags_are_optimised_and_the_pinned_ones_stay():
    planned = session()
    planned.pin(0)
    planned.pin(17)
    before, start = planned.deployment, planned.metrics()["fitness"]
    search = planned.optimise(Annealing(), Budget(200))
    with pytest.raises(InputError, match="being optimised: stop the search first"):
        planned.undo()
    gained = planned.take()
    assert search.progress.used == 1.0
    assert gained > 0.0
    assert planned.metrics()["fitness"] == start + gained == search.progress.fitness
    stayed = (planned.deployment.positions == before.positions).all(axis=1)
    assert stayed[[0, 17]].all()
    assert not stayed.all()
    assert (planned.deployment.ids == before.ids).all()
    planned.problem.scene.footprints.check(planned.deployment)
    planned.undo()
    assert planned.deployment is before


def test_a_search_can_be_stopped_and_worse_deployments_are_not_applied():
    planned = session()
    search = planned.optimise(Annealing(), Budget(10**9))
    search.stop()
    planned.take()
    assert search.progress.used < 1e-3
    planned.optimise(Annealing(), Budget(200))
    assert planned.take() > 0.0
    before = planned.plan
    search = planned.optimise(RandomSearch(), Budget(3))
    assert planned.take() == 0.0
    assert search.progress.fitness <= planned.metrics()["fitness"]
    assert planned.plan is before


def test_a_search_that_cannot_begin_or_fails_says_why():
    planned = session()
    for number in planned.deployment.ids:
        planned.pin(int(number))
    with pytest.raises(InputError, match="all tags are pinned"):
        planned.optimise(Annealing(), Budget(10))
    tilted = replace(planned.deployment, normals=np.roll(planned.deployment.normals, 1, axis=1), surfaces=None)
    planned = PlanningSession(planned.problem, tilted)
    before = planned.plan
    planned.optimise(Annealing(), Budget(10))
    with pytest.raises(InputError, match="is not flush with its wall"):
        planned.take()
    assert planned.plan is before


def test_the_end_does_not_wait_for_a_search_that_compiles(monkeypatch):
    monkeypatch.setattr("lmd.planner.session.PATIENCE_SECONDS", 0.01)
    planned, go = session(), threading.Event()
    before = planned.plan

    class Compiling(RandomSearch):
        def run(self, *arguments):
            go.wait()
            return super().run(*arguments)

    search = planned.optimise(Compiling(), Budget(3))
    planned.end_search()
    assert search.running
    assert planned.plan is before
    go.set()
    search.join()
