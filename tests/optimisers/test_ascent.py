import numpy as np
import pytest
from support.small import make, problem

from lmd.incremental.field import in_order
from lmd.objectives.coverage import Coverage
from lmd.objectives.sampling import Sampling
from lmd.optimisers.annealing import Annealing
from lmd.optimisers.annealing import ascent as room
from lmd.optimisers.annealing.ascent import Ascent, slopes
from lmd.optimisers.ledger import Budget
from lmd.problem import Problem
from lmd.scene.deployment import Deployment
from lmd.scene.deployment_sources import RandomDeployment
from lmd.sight.kernels import PROBABILITY_ONE
from lmd.space.surface import SurfaceArrays

SAMPLING = Sampling(positions=2, divisions=6)


def sampled(start=None, threads=1, fixed=None, sampling=SAMPLING):
    p = problem(fixed=fixed)
    return Problem(p.scene, Coverage(2, 0.15, sampling), start or p.start, threads, fixed)


def smooth_fitness(p, evaluator, relevance, deployment):
    """Smooth fitness that the ascent increases, from a full evaluation."""
    units = evaluator.units(deployment.positions[None], deployment.normals[None], p.objective.n)[0]
    share = units / PROBABILITY_ONE
    logistic = 1.0 / (1.0 + np.exp(-(share - p.objective.thold_p) / room.WIDTH))
    return float(((logistic + room.SHARE * share) * relevance).sum() / relevance.sum())


def test_slopes_are_differences_of_full_evaluations():
    p = sampled(sampling=Sampling(positions=1, divisions=40))  # orientations enough to change by millimetres
    here = p.draw(np.random.default_rng(0))
    evaluator, relevance = p.resampled(0.0, np.random.default_rng(1))
    field = p.objective.field(evaluator)
    state, out = field.state(here), np.zeros((len(here), 2))
    surfaces = SurfaceArrays.of(p.scene.room.surfaces())
    target = p.objective.target(in_order(field, relevance))
    slopes(0, field, state, field.scratch(state), target, surfaces, room.DIFFERENCE_M, room.WIDTH, out)
    expected = np.zeros_like(out)
    for k in range(len(here)):
        for side, axes in enumerate((surfaces.u, surfaces.v)):
            values = []
            for away in (-room.DIFFERENCE_M, room.DIFFERENCE_M):
                positions = here.positions.copy()
                positions[k] += away * axes[here.surfaces[k]]
                values.append(smooth_fitness(p, evaluator, relevance, Deployment(positions, here.normals)))
            expected[k, side] = (values[1] - values[0]) / (2.0 * room.DIFFERENCE_M)
    assert np.count_nonzero(expected) >= 10
    # `Target` counts from a threshold that is lower by a tolerance of 1e-9.
    np.testing.assert_allclose(out, expected, rtol=2e-6, atol=1e-9)


def test_the_ascent_rises_on_positions_it_never_saw():
    p = sampled()
    here, rng, ascent = p.draw(np.random.default_rng(0)), np.random.default_rng(1), Ascent(30)
    others = p.objective.sampling.evaluator(p.scene, 20, np.random.default_rng(2), 1), np.tile(p.relevance, 20)
    before = smooth_fitness(p, *others, here)
    for i in range(100):
        here = ascent.step(p, here, i / 100, 2, rng)
    assert smooth_fitness(p, *others, here) > before + 0.01


@pytest.mark.parametrize("threads", [1, 3])
def test_a_step_moves_what_is_free_along_its_surface(threads):
    fixed = problem(RandomDeployment(5)).draw(np.random.default_rng(3))
    p = sampled(RandomDeployment(10), threads, fixed)
    here = p.draw(np.random.default_rng(0))
    moved = Ascent(15).step(p, here, 0.0, 2, np.random.default_rng(1))
    away = moved.positions - here.positions
    assert (away[:5] == 0.0).all()
    assert (np.abs(away[5:]).max(axis=1) > 0.0).any()
    assert np.abs(away).max() <= room.STEP_M[0] * (1.0 + 1e-9)
    np.testing.assert_allclose((away * here.normals).sum(axis=1), 0.0, atol=1e-12)
    again = sampled(RandomDeployment(10), 1, fixed)
    np.testing.assert_array_equal(
        moved.positions, Ascent(15).step(again, here, 0.0, 2, np.random.default_rng(1)).positions
    )


@pytest.mark.parametrize(
    ("sampling", "share", "climbs"), [(None, 0.2, False), (SAMPLING, 0.2, True), (SAMPLING, 0.0, False)]
)
def test_annealing_climbs_at_the_end_where_there_are_samples(monkeypatch, sampling, share, climbs):
    done, step = [], Ascent.step

    def spy(self, problem, here, progress, samples, rng):
        done.append((optimiser.spent / problem.count, progress))
        return step(self, problem, here, progress, samples, rng)

    monkeypatch.setattr(Ascent, "step", spy)
    p, optimiser = problem(), Annealing(climb_share=share)
    result = optimiser.run(Problem(p.scene, Coverage(2, 0.3, sampling), p.start, threads=1), Budget(400))
    assert result.evaluations == 400
    assert bool(done) == climbs
    if climbs:
        evaluations, progress = zip(*done, strict=True)
        assert min(evaluations) >= 320
        assert list(progress) == sorted(progress)
        assert 0.0 <= progress[0] < 0.2 < progress[-1] < 1.0


def test_a_run_that_stops_while_it_climbs_goes_on_as_if_it_had_not():
    p, found = sampled(), []
    for sittings in (1, 2):
        optimiser = make("annealing")
        for sitting in range(sittings):
            stops = sitting == 0 and sittings == 2
            found.append(optimiser.run(p, Budget(400), lambda o: stops and o.ascent is not None))  # noqa: B023
    assert found[1].stopped == "interrupted"
    np.testing.assert_array_equal(found[0].deployment.positions, found[2].deployment.positions)
