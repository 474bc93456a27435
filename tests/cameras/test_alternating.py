"""Cameras and tags in turn: no turn lowers the fitness, and a stopped run resumes."""

import numpy as np
import pytest
from support.small import make
from test_camera_problem import Squared, problem, tagged

from lmd.core.checks import InputError
from lmd.optimisers.alternating import Alternating
from lmd.optimisers.checkpoint import Checkpoint
from lmd.optimisers.ledger import Budget

BUDGET = Budget(8)


def alternating(name="camera_annealing", rounds=2):
    return Alternating(lambda seed: make(name, seed), rounds, Budget(12), seed=5)


@pytest.mark.parametrize("name", ["camera_annealing", "ega"])
def test_stopped_again_and_again_it_ends_where_it_would_have(name, tmp_path):
    calls = []
    whole = alternating(name)
    expected = whole.run(problem(), BUDGET, lambda _: calls.append(1))
    reached = list(whole.figures().values())
    assert len(reached) == 4
    assert reached == sorted(reached)
    assert expected.fitness == reached[-1] == problem().with_rig(expected.rig).fitness_of(expected.deployment)
    sittings = 0
    Checkpoint(alternating(name), {}).save(tmp_path)
    while True:
        checkpoint, left = Checkpoint(alternating(name), {}), iter(range(5))
        checkpoint.resume(tmp_path, problem())
        found = checkpoint.optimiser.run(problem(), BUDGET, lambda _, left=left: next(left) == 4)
        checkpoint.save(tmp_path)
        sittings += 1
        if found.stopped == "budget":
            break
    assert sittings > len(calls) / 5
    assert found.rig == expected.rig
    np.testing.assert_array_equal(found.deployment.positions, expected.deployment.positions)
    assert [(r.evaluations, r.best_fitness) for r in found.history] == [
        (r.evaluations, r.best_fitness) for r in expected.history
    ]
    assert list(checkpoint.optimiser.figures().values()) == reached


def test_a_run_that_has_ended_is_not_gone_on_with(tmp_path):
    done = alternating(rounds=1)
    found = done.run(problem(), BUDGET)
    Checkpoint(done, {}).save(tmp_path)
    checkpoint = Checkpoint(alternating(rounds=1), {})
    checkpoint.resume(tmp_path, problem())
    again = checkpoint.optimiser.run(problem(), BUDGET)
    assert (again.rig, again.fitness, again.evaluations) == (found.rig, found.fitness, found.evaluations)


@pytest.mark.parametrize(
    ("key", "value", "message"),
    [
        ("rig", np.zeros((2, 7)), "is not a pose that the body allows"),
        ("rig", np.full((2, 7), 9.0), "rig must not have the value 9.0"),
        ("rig", None, "rig must be float64 of shape"),
        ("began", -1, "began must be"),
        ("began", 0, "inner has a history"),
        ("reached", np.array([np.nan]), "reached must not have the value nan"),
    ],
)
def test_what_somebody_wrote_into_a_checkpoint_is_checked(key, value, message):
    stopped = alternating()
    stopped.run(problem(), BUDGET, lambda o: len(o.reached) == 1 and len(o.ledger.history) > o.began + 1)
    with pytest.raises(InputError, match=message):
        alternating().restore(stopped.state() | {key: value}, problem())


def test_it_needs_cameras_to_place_and_an_objective_that_tags_can_climb():
    with pytest.raises(InputError, match=r"^Alternating places cameras and tags"):
        alternating().check(tagged())
    with pytest.raises(InputError, match=r"Squared"):
        alternating().check(problem(Squared(2, 0.5)))
