"""Criteria in NumPy alone: the figures are those of the compiled half, and what needs it says so."""

from dataclasses import asdict, replace
from functools import partial
from types import SimpleNamespace

import numpy as np
import pytest
from contracts.objective import check_objective
from contracts.optimiser import check_going_on
from support.paper import paper_room, paper_scene

from lmd.core.checks import InputError
from lmd.estimation import study
from lmd.evaluation import validation
from lmd.evaluation.accuracy import accuracy_metrics
from lmd.evaluation.bounds import Search, affordable, average_upper_bound, fitness_upper_bound
from lmd.evaluation.losses import losses
from lmd.evaluation.sensitivity import sensitivity
from lmd.evaluation.validation import Sample, validation_metrics
from lmd.objectives.coverage import Coverage
from lmd.objectives.localisation import Localisation
from lmd.optimisers.annealing import Annealing
from lmd.optimisers.genetic import EGA
from lmd.optimisers.greedy import Greedy
from lmd.optimisers.ledger import Budget
from lmd.planner.figures import additions
from lmd.planner.session import PlanningSession
from lmd.problem import Problem
from lmd.scene import pdf
from lmd.scene.criteria import Covering
from lmd.scene.deployment_sources import GivenDeployment, RandomDeployment
from lmd.scene.tag import Tag
from lmd.sight import reference
from lmd.sight.evaluator import Evaluator
from lmd.sight.models.paper import Visibility
from lmd.space.cuboid import Cuboid

SAMPLE = Sample(2, 10, 4)
LOCALISATION = Localisation(2, tolerance=0.05, sampling=None)


class Plain(Visibility):
    """The paper's criteria without their compiled half."""

    def sight(self, camera):
        return None


class Ahead(Covering):
    """What is ahead within two metres."""

    def covered(self, camera, position, axes, landmarks, normals):
        away = landmarks - position
        return (axes[:, :3] @ away.T > 0.0) & ((away**2).sum(axis=1) < 4.0)


def both():
    """The same scene with and without a compiled half, with tags that hide each other."""
    scene = replace(paper_scene(paper_room(spacing=2.0), None, pdf.grid_with_ends(4), thold=0.2, nu=0.3), tag=Tag(0.2))
    return scene, replace(scene, visibility=Plain(**asdict(scene.visibility)))


def hung(scene, count=12, seed=0):
    return scene.footprints.draw(RandomDeployment(count), np.random.default_rng(seed))


def problems(objective, count=12):
    return [Problem(s, objective, GivenDeployment(hung(s, count)), threads=1) for s in both()]


WALK = pytest.mark.thorough("lmd/objectives/localisation", "lmd/optimisers/annealing")  # compiled for it alone


@pytest.mark.parametrize(
    ("walkers", "objective"),
    [(1, Coverage(1, 0.5)), (2, Coverage(1, 0.5)), pytest.param(1, LOCALISATION, marks=WALK)],
)
def test_annealing_walks_as_with_the_compiled_half(objective, walkers):
    found = [Annealing(walkers=walkers).run(p, Budget(12)) for p in problems(objective)]
    np.testing.assert_array_equal(*(result.deployment.positions for result in found))
    assert found[0].fitness == found[1].fitness > found[0].history[0].best_fitness


def alone():
    return Problem(both()[1], Coverage(2, 0.3), RandomDeployment(10), threads=1)


@pytest.mark.parametrize("kind", [Annealing, Greedy, EGA])
def test_optimisers_improve_on_their_start(kind):
    problem = alone()
    result = kind().run(problem, Budget(60))
    assert result.fitness == problem.metrics(result.deployment)["fitness"] > result.history[0].best_fitness


def test_annealing_goes_on_from_a_checkpoint(tmp_path):
    make = partial(Annealing, walkers=1)
    check_going_on(make, alone, make().run(alone(), Budget(10)), tmp_path)


@pytest.mark.parametrize("objective", [Coverage(2, 0.3), LOCALISATION])
def test_figures_of_an_evaluation_are_those_of_the_compiled_half(objective):
    found = []
    for problem in problems(objective, 6):
        deployment = problem.draw(np.random.default_rng(0))
        session = PlanningSession(problem, deployment)
        session.drag(int(deployment.ids[0]), int(deployment.surfaces[1]), np.array([1.0, 1.0]))
        found.append({
            **problem.metrics(deployment),
            **validation_metrics(problem, deployment, 0, SAMPLE),
            **losses(problem, deployment).metrics(),
            **accuracy_metrics(problem, deployment, 0, SAMPLE),
            **{f"dragged {key}": value for key, value in session.metrics().items()},
            "added": additions(problem, deployment, hung(problem.scene, 1, 5))[0],
        })  # fmt: skip
    assert found[0] == pytest.approx(found[1], rel=1e-9, abs=1e-12)


def test_sensitivity_is_that_of_the_compiled_half_but_for_the_draw():
    """Which landmarks are missed in which view is drawn in another order."""
    one, other = (sensitivity(p, p.draw(np.random.default_rng(0)), 0, SAMPLE) for p in problems(LOCALISATION, 5))
    for table in ("assumptions", "tags", "lost"):
        left, right = (getattr(each, table).select_dtypes("number").to_numpy() for each in (one, other))
        np.testing.assert_allclose(left, right, rtol=1e-9, atol=1e-12)
    assert other.cameras is None


def test_an_objective_keeps_its_contract_with_a_criterion_of_two_lines():
    scene = replace(both()[1], visibility=Ahead())
    check_objective(Coverage(1, 0.5), scene, 12)


def test_it_is_said_once_that_there_is_no_compiled_half(capsys):
    reference._warn_uncompiled.cache_clear()
    for _ in range(2):
        for scene in both():
            Evaluator(scene, threads=1)
    told = capsys.readouterr()
    assert told.out == ""
    (line,) = told.err.splitlines()
    assert line.startswith("note: Plain is not compiled, so its NumPy code is used: an evaluation takes about 100")
    assert line.endswith('; see docs/extend.md, "Compile a criterion"')


def test_bounds_say_that_they_need_the_compiled_half():
    problem, search = alone(), Search(1.0, 10, 0.1)
    for bound in (affordable, average_upper_bound, fitness_upper_bound):
        with pytest.raises(InputError, match=r"^an upper bound needs a compiled visibility model, but Plain has no"):
            bound(problem, 10, search)


def test_a_class_with_covered_alone_is_told_what_to_derive_from():
    class Bare:
        covered = Ahead.covered

    with pytest.raises(InputError, match=r"Bare has `covered` and no `sight`: derive it from lmd\.scene\.criteria"):
        replace(paper_scene(), visibility=Bare())


def test_criteria_in_numpy_are_validated_at_as_many_positions_as_the_counted_work_allows(monkeypatch):
    compiled, alone = problems(Coverage(1, 0.3))
    deployment, sample = hung(compiled.scene), Sample(4, 200, 4)
    expected = validation_metrics(compiled, deployment, 0, sample)
    assert validation_metrics(alone, deployment, 0, sample) == expected
    monkeypatch.setattr(validation, "MOST_WORK", 20 * 5400)  # some 20 positions, a fortieth
    found = validation_metrics(alone, deployment, 0, sample)
    assert validation_metrics(compiled, deployment, 0, sample) == expected
    for key in ("finer_grid_qualified_ratio", "grid_free_average_coverage_probability"):
        assert 0.0 < abs(found[key] - expected[key]) < 4.0 * found[f"{key}_standard_error"] < 0.8
    assert "+- " in validation.describe_validation(alone, found)[validation.FINER]


def a_class(base, name, value, *arguments, **settings):
    """An object of a subclass whose method `name` returns what `value` makes of the result."""
    made = type("Mine", (base,), {name: lambda self, *given: value(getattr(super(type(self), self), name)(*given))})
    return made(*arguments, **settings)


def figures_of(problem):
    deployment = problem.draw(np.random.default_rng(0))
    return problem.metrics(deployment) | validation_metrics(problem, deployment, 0, SAMPLE)


@pytest.mark.parametrize(
    ("part", "method", "value", "said"),
    [
        (Ahead, "covered", lambda seen: seen[0], r"booleans of the shape \(\d+, 12\), got bool of the shape \(12,\)"),
        (Ahead, "covered", lambda seen: seen.T, r"got bool of the shape \(12, \d+\)"),
        (Ahead, "covered", lambda seen: 1 * seen, "got int64 of the shape"),
        (Coverage, "values", lambda values: values[0], r"real numbers of the shape \(1, 18\), got float64 .* \(18,\)"),
        (Coverage, "fitness", lambda fitness: [fitness], r"of the shape \(\), got float64 of the shape \(1,\)"),
        (Coverage, "shares", lambda shares: {key: each[None] for key, each in shares.items()}, "got bool of .*1, "),
        (Cuboid, "grid", lambda points: points[:, :2], r"of the shape \(any, 3\), got float64 of the shape \(8, 2\)"),
        (Cuboid, "sample_evenly", lambda points: points[1:], r"of the shape \(10, 3\), got .* \(9, 3\)"),
    ],
)
def test_arrays_of_a_class_of_ones_own_have_the_shape_and_kind_that_is_asked(part, method, value, said):
    """NumPy would broadcast them, and the figures would be wrong."""
    scene, objective = both()[1], Coverage(1, 0.3)
    if part is Ahead:
        scene = replace(scene, visibility=a_class(Ahead, method, value))
    elif part is Cuboid:
        scene = replace(scene, room=a_class(Cuboid, method, value, (5.0, 5.0, 5.0), (4.0, 4.0, 4.0), 2.0))
    else:
        objective = a_class(Coverage, method, value, 1, 0.3)
    with pytest.raises(InputError, match=rf"Mine\.{method}.* must be .*{said}"):
        figures_of(Problem(scene, objective, RandomDeployment(12)))


def test_errors_of_an_estimator_of_ones_own_have_a_value_for_each_frame():
    recording, estimator = SimpleNamespace(time=np.arange(5.0)), SimpleNamespace(errors=lambda *_: "lost")
    with pytest.raises(InputError, match=r"errors\(\)\.frobenius must be real numbers of the shape \(2, 5\)"):
        study._errors({"mine": estimator}, recording, np.zeros((2, 4, 4)))
