import numpy as np
import pytest
from support.composing import composed
from support.paper import paper_room, paper_scene
from support.small import make, problem

from lmd.objectives.coverage import CappedCount, Coverage
from lmd.optimisers.annealing import annealing
from lmd.optimisers.greedy import GreedyDeployment, select
from lmd.optimisers.ledger import Budget
from lmd.scene import pdf
from lmd.scene.deployment import Deployment
from lmd.sight import reference
from lmd.sight.evaluator import Evaluator
from lmd.sight.poses import candidate_poses
from pipelines.building import build_problem

SCENE = paper_scene(room=paper_room(spacing=2.0), orientations=pdf.solid_angle(5), occlusion="none")


POSES = candidate_poses(SCENE.room, 2.5)


def surrogate(counts, n):
    """The mean over positions of the expected min(covered, n)."""
    return (np.minimum(counts, n) * SCENE.pdf.weight).sum(axis=1).mean()


@pytest.fixture(scope="module")
def alone():
    """What the reference counts of each pose, `(N, P, A)`: nobody hides another."""
    each = (Deployment(POSES.positions[[j]], POSES.normals[[j]]) for j in range(len(POSES)))
    return np.stack([reference.counts(SCENE, one) for one in each])


@pytest.mark.parametrize("n", [1, 2, 3])
def test_the_lazy_choice_is_the_greedy_choice(alone, n):
    poses, count = POSES, 5
    relevance = np.ones(len(SCENE.room.grid()))
    chosen, evaluated = select(CappedCount(Evaluator(SCENE, threads=1), relevance, n), poses, count)
    so_far: list[int] = []
    for k in chosen:
        values = [surrogate(alone[[*so_far, j]].sum(axis=0), n) for j in range(len(poses)) if j not in so_far]
        so_far.append(int(k))
        assert surrogate(alone[so_far].sum(axis=0), n) == pytest.approx(max(values), abs=1e-12)
    assert len(set(so_far)) == count
    assert evaluated <= count * len(poses)


@pytest.mark.parametrize("looks", [0, 1, 4])
def test_a_selection_stops_when_its_time_is_over(looks):
    calls, selection = iter(range(99)), CappedCount(Evaluator(SCENE, threads=1), np.ones(len(SCENE.room.grid())), 2)
    chosen, evaluated = select(selection, POSES, 30, stop=lambda: next(calls) >= looks)
    assert next(calls) == looks + 1
    assert len(chosen) == looks  # for each landmark there is one look
    assert (evaluated > 0) == (looks > 0)


def test_more_landmarks_than_poses_get_a_finer_grid():
    greedy = GreedyDeployment(200, SCENE, Coverage(2, 0.5), 2.5).draw(SCENE.room, np.random.default_rng())
    assert len(greedy) == 200
    assert len(np.unique(greedy.positions, axis=0)) == 200


@pytest.mark.parametrize("optimiser", ["ega", "annealing", "one_plus_one"])
def test_any_optimiser_starts_from_greedy(optimiser):
    overrides = ["deployment=greedy", "deployment.count=20", "deployment.spacing=0.8", "room.spacing=1.5", "threads=1"]
    p = build_problem(composed("optimise", *overrides))
    start = p.fitness_of(p.start.draw(p.scene.room, np.random.default_rng()))
    result = make(optimiser).run(p, Budget(20))
    assert result.fitness >= start
    assert result.history[0].best_fitness >= start


def test_the_greedy_optimiser_pays_for_its_gains():
    optimiser = make("greedy")
    optimiser.run(problem(), Budget(200), lambda _: True)
    assert optimiser.ledger.history[0].evaluations > 2.0


def test_annealing_of_many_stacks_does_what_greedy_does(monkeypatch):
    monkeypatch.setattr(annealing, "MOST_STACKS", 1)
    runs = [make(name, seed=3).run(problem(), Budget(60)) for name in ("annealing", "greedy")]
    assert runs[0].fitness == runs[1].fitness
    np.testing.assert_array_equal(runs[0].deployment.positions, runs[1].deployment.positions)
