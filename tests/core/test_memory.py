"""What would not fit into memory is refused before it is taken."""

import numpy as np
import pytest
from support.paper import paper_scene

from lmd.core import memory
from lmd.core.checks import InputError
from lmd.core.memory import check_memory, free_memory
from lmd.incremental.coverage_field import coverage_field
from lmd.objectives.coverage import CappedCount, Coverage
from lmd.objectives.localisation import Localisation
from lmd.objectives.localisation.evaluation import localised_views
from lmd.optimisers.genetic import EGA
from lmd.optimisers.ledger import Budget
from lmd.problem import Problem
from lmd.scene.deployment_sources import RandomDeployment
from lmd.sight.evaluator import Evaluator

MIB = 2**20
SCENE = paper_scene()


@pytest.fixture
def machine(tmp_path, monkeypatch):
    """A machine that has so many bytes."""

    def with_bytes(free, limit="max"):
        for name, text in (("meminfo", f"MemTotal: 9 kB\nMemAvailable: {free // 1024} kB\n"), ("limit", f"{limit}\n")):
            (tmp_path / name).write_text(text)
        monkeypatch.setattr(memory, "MEMINFO", tmp_path / "meminfo")
        monkeypatch.setattr(memory, "LIMITS", (tmp_path / "limit", tmp_path / "none"))

    return with_bytes


def test_the_smaller_of_what_is_free_and_what_a_container_may_take(machine):
    machine(64 * MIB)
    assert free_memory() == 64 * MIB
    machine(64 * MIB, limit=16 * MIB)
    assert free_memory() == 16 * MIB
    machine(8 * MIB, limit=16 * MIB)
    assert free_memory() == 8 * MIB


def test_without_linux_it_is_what_the_machine_has(monkeypatch, tmp_path):
    there = free_memory()
    monkeypatch.setattr(memory, "MEMINFO", tmp_path / "none")
    assert free_memory() >= there > 0


def test_both_figures_are_named(machine):
    machine(2**30)
    check_memory(2**30, "count = 5 landmarks", "count")
    with pytest.raises(
        InputError, match=r"^count = 5 landmarks would take 2 GiB of memory, but only 1 GiB are free\.$"
    ) as told:
        check_memory(2**31, "count = 5 landmarks", "count")
    assert told.value.argument == "count"


def test_a_population_that_does_not_fit_is_refused_before_it_is_drawn():
    problem = Problem(SCENE, Coverage(2, 0.5), RandomDeployment(90))
    with pytest.raises(InputError, match=r"^optimiser: 1000000000 candidates of 180 genes at a time would take"):
        EGA(population=10**9).run(problem, Budget(10))


def test_what_the_evaluator_keeps_of_every_view_is_estimated_before(machine):
    evaluator, deployment = Evaluator(SCENE), RandomDeployment(90).draw(SCENE.room, np.random.default_rng(0))
    landmarks = deployment.positions[None], deployment.normals[None]
    asked = Localisation().precision(SCENE)
    views = r"^756 positions x 320 orientations"
    machine(MIB // 4)
    for keep in (
        lambda: evaluator.counts(deployment),
        lambda: localised_views(evaluator, *landmarks, 2, asked, keep=True),
        lambda: CappedCount(evaluator, np.ones(756), 2),
    ):
        with pytest.raises(InputError, match=f"{views} would take"):
            keep()
    with pytest.raises(InputError, match=r"x 320 orientations x 90 landmarks would take"):
        coverage_field(evaluator, 2).state(deployment)
    machine(2**30)
    assert evaluator.counts(deployment).shape == (756, 325)


def test_the_estimate_of_a_state_is_near_what_it_takes(machine):
    evaluator, deployment = Evaluator(SCENE), RandomDeployment(90).draw(SCENE.room, np.random.default_rng(0))
    field = coverage_field(evaluator, 2)
    state = field.state(deployment)
    poses, surfaces, counts, units, *views = state
    taken = sum(array.nbytes for array in (poses, surfaces, *counts, units, *views))
    for free, fits in ((taken // 2, False), (3 * taken, True)):
        machine(free)
        if fits:
            field.state(deployment)
        else:
            with pytest.raises(InputError, match="would take"):
                field.state(deployment)
