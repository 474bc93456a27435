"""Ascents that climb, end, and begin anew at random deployments, beyond the contract in test_optimisers."""

import numpy as np
import pytest
from support.small import problem

from lmd.core.checks import InputError
from lmd.objectives.coverage import Coverage
from lmd.objectives.sampling import Sampling
from lmd.optimisers.gradient_ascent import GradientAscent, _Climb
from lmd.optimisers.ledger import Budget
from lmd.problem import Problem
from lmd.scene.deployment_sources import UniformDeployment

PLENTY = Budget(600)


def followed(optimiser, p, budget=PLENTY):
    """Run, and return what the optimiser was before each trial: stage, step and deployment."""
    seen = []
    optimiser.run(p, budget, lambda o: seen.append((o.stage, o.step, o.here)))
    return seen


def test_an_ascent_narrows_its_threshold_and_is_followed_by_another():
    seen = followed(GradientAscent(), problem())
    stages = [stage for stage, _, _ in seen]
    restarts = [i for i in range(1, len(stages)) if stages[i] < stages[i - 1]]
    assert set(stages) == {0, 1, 2}
    assert len(restarts) >= 2
    for i in restarts:
        assert stages[i - 1] == 2
        assert stages[i] == 0
        away = np.linalg.norm(seen[i][2].positions - seen[i - 1][2].positions, axis=1)
        assert np.median(away) > 0.5  # a deployment of its own
    assert all(0.02 <= step <= 1.0 for _, step, _ in seen)


def test_the_smoothed_fitness_rises_within_a_stage():
    p, width = problem(), 0.1
    seen = followed(GradientAscent(widths=[width]), p, Budget(100))
    reached = []
    for _, _, here in seen[: next((i for i, each in enumerate(seen) if each[1] < 0.05), len(seen))]:
        share = p.values(here)
        reached.append((1.0 / (1.0 + np.exp(-(share - p.objective.thold_p) / width)) + 0.02 * share).mean())
    assert len(set(reached)) > 4
    assert reached == sorted(reached)


def test_the_slope_leads_upwards():
    p = problem()
    climb = _Climb(p, p.draw(np.random.default_rng(0)))
    direction = climb.direction(0.5, 0.1)
    length = np.linalg.norm(direction, axis=1)
    assert np.isclose(length, 1.0).sum() > 10
    assert (np.isclose(length, 1.0) | (length == 0.0)).all()
    assert not climb.rises(climb.moved(-0.5 * direction), 0.1)
    assert climb.rises(climb.moved(0.5 * direction), 0.1)


def test_a_start_that_is_given_is_climbed_first_and_followed_by_random_ones():
    p = problem(UniformDeployment(30))
    first = p.draw(np.random.default_rng())
    seen = followed(GradientAscent(), p)
    assert np.linalg.norm(seen[0][2].positions - first.positions, axis=1).max() <= 1.0 + 1e-9
    assert max(np.median(np.linalg.norm(here.positions - first.positions, axis=1)) for _, _, here in seen) > 1.0


def test_an_objective_with_a_sampling_is_climbed_on_it():
    p = problem()
    robust = Problem(p.scene, Coverage(2, 0.15, Sampling(positions=2, divisions=6)), p.start, threads=1)
    result = GradientAscent().run(robust, Budget(60))
    assert result.fitness == robust.fitness_of(result.deployment) > result.history[0].best_fitness


def test_a_state_that_is_none_is_refused():
    optimiser = GradientAscent()
    optimiser.run(problem(), Budget(10))
    for wrong in ({"stage": 3}, {"step": 1.1}, {"direction": np.full((30, 2), 2.0)}):
        with pytest.raises(InputError, match=f"^{next(iter(wrong))} must"):
            GradientAscent().restore(optimiser.state() | wrong, problem())
