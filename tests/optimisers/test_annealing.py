from dataclasses import replace

import numpy as np
import pytest
from contracts.field import copied
from support.paper import paper_room, paper_scene
from support.small import make, problem

from lmd.formats.tag_maps import FileDeployment
from lmd.objectives.coverage import Coverage
from lmd.objectives.sampling import Sampling
from lmd.optimisers.annealing import Annealing, Stage
from lmd.optimisers.annealing.moves import SINGLE_STAGE, _reflect
from lmd.optimisers.annealing.surrogate import AVERAGING_ETA, RESTART_M, Conditions, MeanPlaces, Surrogate
from lmd.optimisers.ledger import Budget
from lmd.problem import Problem
from lmd.scene import pdf
from lmd.scene.deployment import Deployment
from lmd.scene.deployment_sources import RandomDeployment, UniformDeployment

PAIRS = {"temperature": [1e-3, 1e-4], "width": [0.1, 0.01], "step": [1.0, 0.1]}
TRUE = Conditions(False, 1.0, 1.0, SINGLE_STAGE.settings(0.0, 0.1))
SAMPLING = Sampling(positions=2, divisions=6)


def covered(n=2, sampling=None, start=None, threads=1):
    p = problem()
    return Problem(p.scene, Coverage(n, 0.3, sampling), start or p.start, threads)


def surrogate_of(p, walkers=1):
    """A surrogate, and the generator and the start of its walk."""
    rng = np.random.default_rng(0)
    return Surrogate(p, walkers), rng, p.draw(rng)


def spied(monkeypatch):
    """Conditions of all walks from now on."""
    seen, walk = [], Surrogate.walk

    def spy(self, here, best, conditions, *rest):
        seen.append((conditions, self.is_true(len(here), conditions)))
        return walk(self, here, best, conditions, *rest)

    monkeypatch.setattr(Surrogate, "walk", spy)
    return seen


@pytest.mark.parametrize(("count", "n"), [(30, 2), (31, 2), (31, 3), (4, 4), (5, 1)])
def test_every_landmark_ends_flush_on_an_allowed_wall(count, n):
    room = paper_room(spacing=1.5, walls=("x_min", "ceiling", "y_max"))
    scene = paper_scene(room=room, orientations=pdf.grid_with_ends(6))
    result = make("annealing").run(Problem(scene, Coverage(n, 0.3), RandomDeployment(count), threads=1), Budget(300))
    found, walls = result.deployment, room.surfaces()
    on = [np.abs((found.positions - w.origin) @ w.normal) < 1e-9 for w in walls]
    faces = [(found.normals == w.normal).all(axis=1) for w in walls]
    assert (np.array(on) & np.array(faces)).any(axis=0).all()
    assert (len(found), result.evaluations) == (count, 300)


@pytest.mark.parametrize(("n", "size"), [(2, 0.2), (2, 1.0), (1, 1.0)])
def test_stacks_are_pulled_apart_by_the_spread(n, size):
    optimiser, p = make("annealing"), covered(n)
    optimiser.run(p, Budget(300), lambda o: o.ledger.evaluations > 50)
    assert optimiser.in_stacks
    apart = optimiser._separated(p, n, size)
    if n == 1:
        np.testing.assert_array_equal(apart.positions, optimiser.here.positions)
        return
    pairs = apart.positions.reshape(-1, 2, 3)
    inside = ((pairs > 0.1) & (pairs < np.array(p.scene.room.size) - 0.1)).sum(axis=2).min(axis=1) >= 2
    np.testing.assert_allclose(np.linalg.norm(pairs[:, 0] - pairs[:, 1], axis=1)[inside], size * 1.6 * 0.05)


@pytest.mark.parametrize("walkers", [1, 2])
def test_footprints_grow_to_their_size_and_stay_there(monkeypatch, walkers):
    seen = spied(monkeypatch)
    Annealing(walkers=walkers).run(problem(), Budget(300))
    sizes = [each.size for each, _ in seen if not each.in_stacks]
    assert (seen[0][0].in_stacks, seen[0][0].size, seen[0][1]) == (True, 1.0, False)
    assert sizes == sorted(sizes)
    assert 0.2 <= sizes[0] < 0.4
    assert sizes[-1] == 1.0
    assert all(true == (walkers == 1 and not each.in_stacks and each.size == 1.0) for each, true in seen)


@pytest.mark.parametrize("sampling", [None, SAMPLING])
def test_samples_are_climbed_under_conditions_of_their_own(monkeypatch, sampling):
    seen, optimiser = spied(monkeypatch), make("annealing")
    optimiser.run(covered(sampling=sampling), Budget(300))
    last = min(each.settings.width for each, _ in seen if not each.in_stacks)
    assert (last < optimiser.sampled.width[1]) == (sampling is None)


def test_an_objective_with_a_sampling_is_climbed_on_fresh_draws():
    p = covered(sampling=Sampling(positions=12, divisions=6))
    surrogate, rng, deployment = surrogate_of(p)
    positions = []
    for done in (0.0, 0.7, 1.0, 1.0):
        surrogate.walk(deployment, deployment, replace(TRUE, done=done), 0, rng)
        positions.append(surrogate._field.positions[:, surrogate._field.index_of])
    assert not surrogate.is_true(len(deployment), TRUE)
    assert [x.shape[1] // len(p.evaluator.positions) for x in positions] == [1, 3, 5, 5]
    assert not np.isin(positions[3][0], positions[2][0]).any()
    result = make("annealing").run(p, Budget(300))
    assert (result.evaluations, result.fitness) == (300, p.fitness_of(result.deployment))


@pytest.mark.parametrize("sampling", [None, SAMPLING])
def test_walkers_move_landmarks_of_their_own_and_are_put_together(sampling):
    surrogate, rng, start = surrogate_of(covered(sampling=sampling), walkers=3)
    here, _ = surrogate.walk(start, start, TRUE, 400, rng)
    walkers = surrogate._walkers
    assert sorted(np.concatenate([walker.members for walker in walkers])) == list(range(30))
    for walker in walkers:
        moved = np.flatnonzero((start.positions != walker.state.poses[:3].T).any(axis=1))
        assert len(moved) > 0
        assert np.isin(moved, walker.members).all()
        np.testing.assert_array_equal(here.positions[walker.members], walker.state.poses[:3].T[walker.members])
        np.testing.assert_array_equal(here.surfaces[walker.members], walker.state.surfaces[walker.members])


@pytest.mark.parametrize("in_stacks", [True, False])
@pytest.mark.parametrize("count", [0, 5])
@pytest.mark.parametrize("walkers", [1, 3])
def test_walkers_go_on_from_what_all_have_found(in_stacks, count, walkers):
    fixed = problem(RandomDeployment(count)).draw(np.random.default_rng(3)) if count else None
    p = problem(RandomDeployment(20), fixed=fixed)
    surrogate, rng, complete = surrogate_of(p, walkers)
    here = start = complete[count:] if in_stacks else complete
    conditions, before = replace(TRUE, in_stacks=in_stacks), []
    for _ in range(4):
        now, _ = surrogate.walk(here, complete, conditions, 0, rng)  # where it begins
        np.testing.assert_array_equal(now.positions, here.positions)
        assert not before or all(now.state is then.state for now, then in zip(surrogate._walkers, before, strict=True))
        for walker in surrogate._walkers:
            for array, fresh in zip(copied(walker.state), copied(surrogate._field.state(here)), strict=True):
                np.testing.assert_array_equal(array, fresh)
        here, _ = surrogate.walk(here, complete, conditions, 300, rng)
        before = surrogate._walkers
        assert (here.positions != start.positions).any()


@pytest.mark.parametrize("sampled", [False, True])
@pytest.mark.parametrize("n", [1, 2])
def test_walkers_lead_to_the_same_place_on_any_number_of_threads(n, sampled):
    """Each n and each start with samples or without, in half of the runs that all three would take."""
    start = UniformDeployment(9) if sampled == (n == 1) else RandomDeployment(30)
    one, three = (
        make("annealing").run(covered(n, SAMPLING if sampled else None, start, threads), Budget(400)).deployment
        for threads in (1, 3)
    )
    np.testing.assert_array_equal(one.positions, three.positions)
    np.testing.assert_array_equal(one.normals, three.normals)


def test_a_given_start_is_not_stacked(tmp_path):
    start = UniformDeployment(30)
    p = problem(start)
    start.draw(p.scene.room, np.random.default_rng()).to_csv(tmp_path / "start.csv")
    for source in (start, FileDeployment(str(tmp_path / "start.csv"))):
        optimiser = make("annealing")
        optimiser.run(problem(source), Budget(40), lambda _: True)
        assert (optimiser.in_stacks, len(optimiser.here)) == (False, 30)


def test_a_coordinate_beyond_a_wall_is_folded_back():
    assert [_reflect(v, 2.0) for v in (0.5, -0.5, 2.5, 4.5, -4.5)] == [0.5, 0.5, 1.5, 0.5, 0.5]


def test_conditions_run_geometrically_from_first_to_last():
    stage = Stage(**PAIRS)
    assert stage.settings(0.0, 0.1).temperature == 1e-3
    assert stage.settings(0.5, 0.1).temperature == pytest.approx(np.sqrt(1e-7))
    assert stage.settings(1.0, 0.1).step == pytest.approx(0.1)
    assert stage.settings(2.0, 0.1).width == pytest.approx(0.01)


def at(positions, surfaces=(0, 1)):
    return Deployment(np.array(positions, dtype=float), np.tile([0.0, 0.0, 1.0], (2, 1)), np.array(surfaces))


def test_mean_places_weigh_by_polynomial_decay():
    rng = np.random.default_rng(0)
    places = rng.uniform(0.0, 0.2, (20, 2, 3))
    walk, weights = MeanPlaces(at(places[0])), np.zeros(20)
    for t, place in enumerate(places, start=1):
        mean = walk.add(at(place))
        rate = (AVERAGING_ETA + 1.0) / (t + AVERAGING_ETA)
        weights *= 1.0 - rate
        weights[t - 1] = rate
    np.testing.assert_allclose(mean.positions, np.tensordot(weights, places, axes=1))
    assert weights.sum() == pytest.approx(1.0)
    assert weights[15:].sum() > 0.5


def test_the_mean_of_a_landmark_begins_anew_after_a_jump_or_on_another_surface():
    walk = MeanPlaces(at([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0]]))
    for _ in range(5):
        walk.add(at([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0]]))
    far = walk.add(at([[0.1, 0.0, 0.0], [1.0 + 1.1 * RESTART_M, 0.0, 0.0]]))
    assert 0.0 < far.positions[0, 0] < 0.1
    assert far.positions[1, 0] == 1.0 + 1.1 * RESTART_M
    other = walk.add(at([[0.2, 0.0, 0.0], [1.7, 0.0, 0.0]], surfaces=(3, 1)))
    assert (other.positions[0, 0], other.surfaces[0]) == (0.2, 3)
    assert 1.0 + 1.1 * RESTART_M < other.positions[1, 0] < 1.7
