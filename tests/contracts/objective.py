"""What an objective promises, with a field and a selection if it has them."""

import numpy as np
import pytest

from contracts.field import check_field
from lmd.core.checks import InputError
from lmd.evaluation.validation import Sample, validation_metrics
from lmd.incremental.field import in_order, smoothed, total_fitness
from lmd.objectives.base import Incremental, Selectable
from lmd.objectives.reference_field import field_of
from lmd.problem import Problem
from lmd.scene.deployment_sources import RandomDeployment
from lmd.sight.evaluator import Evaluator
from lmd.sight.kernels import PROBABILITY_ONE
from lmd.sight.poses import candidate_poses


def check_objective(objective, scene, count=20, seed=0):
    """Check values, fitness, figures and words, and the field and the selection where there are any.

    Args:
        objective: a `lmd.objectives.base.Objective`.
        scene: a small one, for which the objective is.
        count: of landmarks that serve it.
        seed: of the landmarks.
    """
    rng = np.random.default_rng(seed)
    evaluator, batch = Evaluator(scene, threads=1), [RandomDeployment(count).draw(scene.room, rng) for _ in range(3)]
    relevance = rng.uniform(0.1, 1.0, len(evaluator.positions))
    check_values(objective, scene, batch, relevance)
    check_words(objective, scene, batch[0])
    if isinstance(objective, Incremental):
        check_target(objective, evaluator, batch, relevance)
        check_field(objective, scene, batch[0], batch[1][:8], rng)
    if isinstance(objective, Selectable):
        check_selection(objective, evaluator, relevance)


def check_values(objective, scene, batch, relevance):
    """Values and fitness are in [0, 1], whatever the batch and the number of threads."""
    landmarks = np.stack([d.positions for d in batch]), np.stack([d.normals for d in batch])
    values = objective.values(Evaluator(scene, threads=1), *landmarks)
    assert values.shape == (len(batch), len(relevance))
    assert values.min() >= 0.0
    assert values.max() <= 1.0
    assert np.ptp(values) > 0.0, "nothing to tell deployments apart by"
    np.testing.assert_array_equal(objective.values(Evaluator(scene, threads=3), *landmarks), values)
    fitness = objective.fitness(values, relevance)
    for each, alone in zip(batch, values, strict=True):
        one = objective.values(Evaluator(scene, threads=1), each.positions[None], each.normals[None])
        np.testing.assert_array_equal(one[0], alone)
    np.testing.assert_array_equal([objective.fitness(alone, relevance) for alone in values], fitness)
    assert ((fitness >= 0.0) & (fitness <= 1.0)).all()
    assert objective.fitness(np.ones(len(relevance)), relevance) == pytest.approx(1.0)
    better = np.minimum(values + 0.1, 1.0)
    assert (objective.fitness(better, relevance) >= fitness).all(), "higher values make a lower fitness"
    qualified = objective.qualified(values)
    assert (qualified.shape, qualified.dtype) == (values.shape, np.dtype(bool))
    figures = objective.figures(values[0], relevance)
    for key, share in objective.shares(values[0]).items():
        assert figures[key] == pytest.approx(np.mean(share)), key


def check_words(objective, scene, deployment):
    """Figures and their names are there for the terminal, pictures and tables, on the grid and off it."""
    problem = Problem(scene, objective, RandomDeployment(len(deployment)), threads=1)
    metrics = problem.metrics(deployment)
    metrics |= validation_metrics(problem, deployment, 0, Sample(2, 20, 4))
    assert np.isfinite(list(metrics.values())).all()
    assert objective.headline.key in metrics
    for told in (objective.describe(metrics, len(problem.relevance), len(deployment)),
                 objective.describe_validation(metrics)):  # fmt: skip
        assert told
        assert all(isinstance(text, str) and text for pair in told.items() for text in pair)
    for name in (objective.name, objective.value_label):
        assert isinstance(name, str)
        assert name
    assert 0.0 <= objective.threshold <= 1.0
    objective.check(len(deployment))
    if objective.n > 1:
        with pytest.raises(InputError, match=r"\.$"):
            objective.check(objective.n - 1)


def check_target(objective, evaluator, batch, relevance):
    """What a target makes of the values of a field is the fitness; smoothed, it never falls and has a bound."""
    field = field_of(objective, evaluator)
    weights = in_order(field, relevance)
    target = objective.target(weights)
    for each in batch:
        values = objective.values(evaluator, each.positions[None], each.normals[None])[0]
        fitness = total_fitness(target, field.state(each).units)
        assert fitness == pytest.approx(float(objective.fitness(values, relevance)), abs=1e-9)
    steps, heaviest = np.linspace(0, PROBABILITY_ONE, 50).astype(np.int64), int(weights.argmax())
    for share in (0.0, 0.2):
        curve = [smoothed(target, heaviest, units, 0.0, 0.02, share) for units in steps]
        assert np.diff(curve).min() >= 0.0, "smoothed falls as the units rise"
        assert curve[-1] <= (1.0 + share) * weights[heaviest] * (1.0 + 1e-12), "smoothed exceeds its bound"


def check_selection(objective, evaluator, relevance):
    """Gains are not negative, and only shrink as landmarks are chosen."""
    selection, poses = objective.selection(evaluator, relevance), candidate_poses(evaluator.scene.room, 1.5)
    assert selection.label
    before = selection.gains(poses)
    assert before.shape == (len(poses),)
    assert before.min() >= 0.0
    assert before.max() > 0.0, "no pose gains anything"
    for _ in range(3):
        best = int(before.argmax())
        selection.add(poses[best : best + 1])
        after = selection.gains(poses)
        assert (after <= before + 1e-9).all(), "a gain grew"
        before = after
