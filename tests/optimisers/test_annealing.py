import numpy as np
import pytest
from contracts.field import copied
from paper import paper_room, paper_scene
from small import make, problem

from lmd.core.checks import InputError
from lmd.formats.deployments import FileDeployment
from lmd.incremental.state import HIDDEN
from lmd.objectives.coverage import Coverage
from lmd.objectives.sampling import Sampling
from lmd.optimisers.annealing import Annealing, Stage
from lmd.optimisers.annealing.annealing import SINGLE_STAGE
from lmd.optimisers.annealing.proposals import _reflect
from lmd.optimisers.annealing.surrogate import Surrogate
from lmd.optimisers.ledger import Budget
from lmd.problem import Problem
from lmd.scene import pdf
from lmd.scene.deployment import Deployment
from lmd.scene.deployment_sources import RandomDeployment, UniformDeployment

PAIRS = {"temperature": [1e-3, 1e-4], "width": [0.1, 0.01], "step": [1.0, 0.1]}


def flush_on_walls(room, deployment):
    walls = room.surfaces()
    on = [np.abs((deployment.positions - w.origin) @ w.normal) < 1e-9 for w in walls]
    faces = [(deployment.normals == w.normal).all(axis=1) for w in walls]
    return (np.array(on) & np.array(faces)).any(axis=0).all()


@pytest.mark.parametrize(("count", "n"), [(30, 2), (31, 2), (31, 3), (4, 4), (5, 1)])
def test_every_landmark_ends_flush_on_an_allowed_wall(count, n):
    room = paper_room(spacing=1.5, walls=("x_min", "ceiling", "y_max"))
    scene = paper_scene(room=room, orientations=pdf.grid_with_ends(6))
    p = Problem(scene, Coverage(n, 0.3), RandomDeployment(count), threads=1)
    result = make("annealing").run(p, Budget(300))
    assert len(result.deployment) == count
    assert flush_on_walls(room, result.deployment)
    assert result.evaluations == 300


@pytest.mark.parametrize("size", [0.2, 1.0])
def test_stacks_are_pulled_apart_by_the_spread(size):
    optimiser = make("annealing")
    p = problem()
    optimiser.run(p, Budget(300), lambda o: o.ledger.evaluations > 50)
    assert optimiser.in_stacks
    pairs = optimiser._apart(p, 2, size).positions.reshape(-1, 2, 3)
    inside = ((pairs > 0.1) & (pairs < np.array(p.scene.room.size) - 0.1)).sum(axis=2).min(axis=1) >= 2
    distance = np.linalg.norm(pairs[:, 0] - pairs[:, 1], axis=1)
    np.testing.assert_allclose(distance[inside], size * 1.6 * 0.05)


@pytest.mark.parametrize("walkers", [1, 2])
def test_plates_grow_to_their_size_and_stay_there(monkeypatch, walkers):
    seen = []
    prepare = Surrogate.prepare

    def spy(self, here, best, in_stacks, size, done, rng):
        prepare(self, here, best, in_stacks, size, done, rng)
        seen.append((in_stacks, size, self.is_true))

    monkeypatch.setattr(Surrogate, "prepare", spy)
    Annealing(walkers=walkers).run(problem(), Budget(300))
    sizes = [size for in_stacks, size, _ in seen if not in_stacks]
    assert seen[0] == (True, 1.0, False)
    assert sizes == sorted(sizes)
    assert 0.2 <= sizes[0] < 0.4
    assert sizes[-1] == 1.0
    assert all(is_true == (walkers == 1 and not in_stacks and size == 1.0) for in_stacks, size, is_true in seen)


def test_smaller_plates_hide_less():
    p = problem()
    drawn = p.start.draw(p.scene.room, np.random.default_rng(0))
    pairs = np.repeat(drawn.positions[:15], 2, axis=0)
    pairs[::2, 2] = np.clip(pairs[::2, 2] + 0.03, 0.0, p.scene.room.size[2])
    deployment = Deployment(pairs, np.repeat(drawn.normals[:15], 2, axis=0))
    surrogate = Surrogate(p, 1, 0.35)
    reached = []
    for size in (0.2, 0.5, 1.0):
        surrogate.prepare(deployment, deployment, False, size, 1.0, np.random.default_rng(0))
        reached.append(int((surrogate._walkers[0].state.hides[HIDDEN] > 0).sum()))
    assert reached[0] < reached[1] < reached[2]
    assert surrogate._walkers[0].best.fitness[0] == pytest.approx(p.fitness_of(deployment))


def test_an_objective_with_a_sampling_is_climbed_on_fresh_draws():
    sampling = Sampling(positions=12, divisions=6)
    p = problem()
    p = Problem(p.scene, Coverage(2, 0.3, sampling), p.start, threads=1)
    surrogate, rng = Surrogate(p, 1, 0.35), np.random.default_rng(0)
    deployment = p.start.draw(p.scene.room, rng)
    positions = []
    for done in (0.0, 0.7, 1.0, 1.0):
        surrogate.prepare(deployment, deployment, False, 1.0, done, rng)
        assert not surrogate.is_true
        positions.append(surrogate._field.positions[:, surrogate._field.index_of])
    grid = len(p.evaluator.positions)
    assert [x.shape[1] // grid for x in positions] == [1, 3, 5, 5]
    assert not np.isin(positions[3][0], positions[2][0]).any()
    result = make("annealing").run(p, Budget(300))
    assert result.evaluations == 300
    assert result.fitness == p.fitness_of(result.deployment)


@pytest.mark.parametrize("sampling", [None, Sampling(positions=2, divisions=6)])
def test_samples_are_climbed_under_conditions_of_their_own(monkeypatch, sampling):
    seen, walk = [], Surrogate.walk

    def spy(self, moves, settings, rng):
        seen.append((self._climbed, settings.width))
        return walk(self, moves, settings, rng)

    monkeypatch.setattr(Surrogate, "walk", spy)
    p, optimiser = problem(), make("annealing")
    optimiser.run(Problem(p.scene, Coverage(2, 0.3, sampling), p.start, threads=1), Budget(300))
    last = min(width for (in_stacks, _), width in seen if not in_stacks)
    assert (last < optimiser.sampled.width[1]) == (sampling is None)


@pytest.mark.parametrize("sampling", [None, Sampling(positions=2, divisions=6)])
def test_walkers_move_landmarks_of_their_own_and_are_put_together(sampling):
    p = problem()
    p = Problem(p.scene, Coverage(2, 0.3, sampling), p.start, threads=1)
    surrogate, rng = Surrogate(p, 3, 0.35), np.random.default_rng(0)
    start = p.start.draw(p.scene.room, rng)
    surrogate.prepare(start, start, False, 1.0, 1.0, rng)
    surrogate.walk(400, SINGLE_STAGE.settings(0.0, 0.1), rng)
    walkers, here = surrogate._walkers, surrogate.here()
    assert sorted(np.concatenate([walker.members for walker in walkers])) == list(range(30))
    for walker in walkers:
        moved = np.flatnonzero((start.positions != walker.state.poses[:3].T).any(axis=1))
        assert len(moved) > 0
        assert np.isin(moved, walker.members).all()
        np.testing.assert_array_equal(here.positions[walker.members], walker.state.poses[:3].T[walker.members])
        np.testing.assert_array_equal(here.surfaces[walker.members], walker.state.surfaces[walker.members])


@pytest.mark.parametrize("walkers", [1, 3])
def test_a_walk_goes_on_where_the_last_one_ended(walkers):
    p = problem(RandomDeployment(20))
    surrogate, rng = Surrogate(p, walkers, 0.35), np.random.default_rng(0)
    start = p.draw(rng)
    surrogate.prepare(start, start, False, 1.0, 1.0, rng)
    surrogate.walk(300, SINGLE_STAGE.settings(0.0, 0.1), rng)
    here = surrogate.here()
    assert (here.positions != start.positions).any()
    if walkers == 1:  # others are led to what all have found
        surrogate.prepare(here, start, False, 1.0, 1.0, rng)
    surrogate.walk(0, SINGLE_STAGE.settings(0.0, 0.1), rng)
    np.testing.assert_array_equal(surrogate.here().positions, here.positions)


@pytest.mark.parametrize("in_stacks", [True, False])
@pytest.mark.parametrize("count", [0, 5])
def test_walkers_that_go_on_know_what_the_others_did(in_stacks, count):
    fixed = problem(RandomDeployment(count)).draw(np.random.default_rng(3)) if count else None
    p = problem(RandomDeployment(20), fixed=fixed)
    surrogate, rng = Surrogate(p, 3, 0.35), np.random.default_rng(0)
    complete = p.draw(rng)
    here = start = complete[count:] if in_stacks else complete
    before = []
    for _ in range(4):
        surrogate.prepare(here, complete, in_stacks, 1.0, 1.0, rng)
        assert not before or all(now.state is then.state for now, then in zip(surrogate._walkers, before, strict=True))
        surrogate.walk(0, SINGLE_STAGE.settings(0.0, 0.1), rng)  # where it begins
        for walker in surrogate._walkers:
            for array, fresh in zip(copied(walker.state), copied(surrogate._field.state(here)), strict=True):
                np.testing.assert_array_equal(array, fresh)
        surrogate.walk(300, SINGLE_STAGE.settings(0.0, 0.1), rng)
        before, here = surrogate._walkers, surrogate.here()
        assert (here.positions != start.positions).any()


@pytest.mark.parametrize("sampled", [False, True])
@pytest.mark.parametrize("n", [1, 2])
def test_walkers_lead_to_the_same_place_on_any_number_of_threads(n, sampled):
    """Each n and each start with samples or without, in half of the runs that all three would take."""
    sampling = Sampling(positions=2, divisions=6) if sampled else None
    start = UniformDeployment(9) if sampled == (n == 1) else RandomDeployment(30)
    scene, found = problem().scene, []
    for threads in (1, 3):
        p = Problem(scene, Coverage(n, 0.3, sampling), start, threads)
        found.append(make("annealing").run(p, Budget(400)).deployment)
    np.testing.assert_array_equal(found[0].positions, found[1].positions)
    np.testing.assert_array_equal(found[0].normals, found[1].normals)


def test_for_one_landmark_in_view_stacks_are_single_landmarks():
    optimiser = make("annealing")
    p = Problem(problem().scene, Coverage(1, 0.5), RandomDeployment(30), threads=1)
    optimiser.run(p, Budget(300), lambda o: o.ledger.evaluations > 50)
    assert optimiser.in_stacks
    np.testing.assert_array_equal(optimiser._apart(p, 1, 1.0).positions, optimiser.here.positions)


def test_a_given_start_is_not_stacked(tmp_path):
    start = UniformDeployment(30)
    p = problem(start)
    start.draw(p.scene.room, np.random.default_rng()).to_csv(tmp_path / "start.csv")
    for source in (start, FileDeployment(str(tmp_path / "start.csv"))):
        optimiser = make("annealing")
        optimiser.run(problem(source), Budget(40), lambda _: True)
        assert not optimiser.in_stacks
        assert len(optimiser.here) == 30


def test_a_coordinate_beyond_a_wall_is_folded_back():
    assert [_reflect(v, 2.0) for v in (0.5, -0.5, 2.5, 4.5, -4.5)] == [0.5, 0.5, 1.5, 0.5, 0.5]


def test_conditions_run_geometrically_from_first_to_last():
    stage = Stage(**PAIRS)
    assert stage.settings(0.0, 0.1).temperature == 1e-3
    assert stage.settings(0.5, 0.1).temperature == pytest.approx(np.sqrt(1e-7))
    assert stage.settings(1.0, 0.1).step == pytest.approx(0.1)
    assert stage.settings(2.0, 0.1).width == pytest.approx(0.01)


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"temperature": [1.0]}, r"^temperature must be a list of 2 numbers"),
        ({"width": [0.1, 0.0]}, r"^width\[1\] must be greater than 0"),
        ({"jump": 0.7, "join": 0.5}, r"^join must be in \[0, 0\.3\], got 0\.5"),
    ],
)
def test_impossible_conditions_are_refused(values, message):
    with pytest.raises(InputError, match=message):
        Stage(**(PAIRS | values))
