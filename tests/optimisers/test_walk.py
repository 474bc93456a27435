import numpy as np
import pytest
from contracts import field as moves
from support.paper import paper_room, paper_scene

from lmd.objectives.coverage import Coverage
from lmd.optimisers.annealing import Stage
from lmd.optimisers.annealing import walk as module
from lmd.optimisers.annealing.surrogate import NOWHERE, Conditions, Surrogate
from lmd.problem import Problem
from lmd.scene import pdf
from lmd.scene.deployment_sources import RandomDeployment


def walked(n, occlusion, stage):
    """Where 200 moves lead, the random numbers after them, and how many trials were finished."""
    scene = paper_scene(paper_room(spacing=1.5), orientations=pdf.grid_with_ends(6), occlusion=occlusion)
    problem = Problem(scene, Coverage(n, 0.3), RandomDeployment(20), threads=1)
    surrogate, rng = Surrogate(problem, 1), np.random.default_rng(0)
    start = problem.start.draw(scene.room, rng)
    settings = stage.settings(0.0, 0.1)
    surrogate.walk(start, start, Conditions(False, 1.0, 1.0, settings), 0, rng)
    finished = []

    def spy(*arguments):
        finished.append(arguments)
        moves.settle(*arguments)

    with pytest.MonkeyPatch.context() as patch:
        # Uncompiled, so that its parts can be exchanged; the walk begins where it is.
        parts = {"bound": moves.bound, "settle": spy, "accept": moves.accept, "undo": moves.undo}
        for name, part in {**parts, "move_to": lambda *_: None, "_try": module._try}.items():
            patch.setattr(module, name, part)
        (walker,) = surrogate._walkers
        room = surrogate._surfaces, surrogate._footprints
        getattr(module.walk, "py_func", module.walk)(
            200, NOWHERE, walker, surrogate._field, surrogate._target, room, settings, rng
        )
    return [*moves.copied(walker.state), walker.best.fitness, *walker.best.places, rng.random()], len(finished)


@pytest.mark.parametrize("occlusion", ["paper", "line_of_sight"])
@pytest.mark.parametrize("n", [1, 2, 3])
@pytest.mark.parametrize("temperature", [1e-2, 1e-6])
def test_the_bound_changes_nothing_but_how_many_trials_are_finished(monkeypatch, occlusion, n, temperature):
    stage = Stage([temperature] * 2, [0.05] * 2, [0.1] * 2, join=0.2, together=0.3)
    bounded, some = walked(n, occlusion, stage)
    monkeypatch.setattr(module, "_SLACK", 1e100)  # then the bound rejects nothing
    exactly, every = walked(n, occlusion, stage)
    for a, b in zip(bounded, exactly, strict=True):
        np.testing.assert_array_equal(a, b)
    first = 0.3 * (n - 1)  # of those that move together, all but the last are finished whatever follows
    assert some < (0.7 + first) / (1.0 + first) * every if temperature < 1e-5 else some <= every
