"""Fitness without some tags, against evaluations of the remaining tags."""

from dataclasses import replace
from itertools import combinations_with_replacement

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from support.paper import X
from support.small import problem
from support.strategies import deployments, scenes
from support.thorough import examples

from lmd.evaluation.losses import losses
from lmd.objectives.coverage import Coverage, MeanCoverage
from lmd.objectives.localisation import Localisation
from lmd.objectives.sampling import Sampling
from lmd.problem import Problem
from lmd.scene.deployment import Deployment
from lmd.scene.deployment_sources import RandomDeployment


def check(p, deployment):
    found = losses(p, deployment)
    assert found.fitness == pytest.approx(p.fitness_of(deployment), abs=1e-12)
    np.testing.assert_array_equal(found.without, found.without.T)
    for i, j in combinations_with_replacement(range(len(deployment)), 2):
        rest = deployment[np.setdiff1d(np.arange(len(deployment)), [i, j])]
        assert found.without[i, j] == pytest.approx(p.fitness_of(rest), abs=1e-12)
    rest = np.arange(len(deployment))
    assert sorted(found.order) == list(rest)
    for gone, fitness in zip(found.order[:-1], found.left, strict=False):  # no deployment is empty
        each = [p.fitness_of(deployment[rest[rest != i]]) for i in rest]
        assert fitness == pytest.approx(max(each), abs=1e-12)
        assert each[list(rest).index(gone)] == pytest.approx(fitness, abs=1e-12)
        rest = rest[rest != gone]


@given(data=st.data(), scene=scenes(), n=st.integers(1, 2), thold_p=st.floats(0.0, 0.5))
@examples(15)
def test_the_fitness_without_tags_is_that_of_the_others(data, scene, n, thold_p):
    deployment = data.draw(deployments(scene.room, 6))
    assume(len(deployment) >= 3)
    check(Problem(scene, Coverage(n, thold_p), RandomDeployment(3), threads=1), deployment)


@pytest.mark.slow  # compiled for another objective
def test_the_same_for_localisation_on_samples():
    scene = problem().scene
    p = Problem(scene, Localisation(tolerance=0.1, sampling=Sampling(2, 4)), RandomDeployment(8), threads=1)
    check(p, p.draw(np.random.default_rng(0)))


def test_of_two_doubles_each_is_idle_and_both_matter():
    positions, normals = [[0.0, 2.0, 3.0], [0.0, 2.0, 3.0], [7.5, 2.5, 3.0]], [X, X, -X]
    scene = problem().scene
    scene = replace(scene, visibility=replace(scene.visibility, occlusion="none"))
    p = Problem(scene, Coverage(1, 0.05), RandomDeployment(3), threads=1)
    found = losses(p, Deployment(positions, normals))
    assert found.idle.tolist() == [0, 1]
    assert found.table["id"][0] == 2
    assert found.table["fitness_loss"][0] > 0.0
    assert found.without[0, 1] < found.fitness
    assert found.order[0] == 0  # the first of two that are equal
    assert found.left.tolist() == pytest.approx([found.fitness, found.left[1], 0.0])
    assert "one after the other, and the fitness left in %: 0 (" in found.to_text()
    assert "gained without each: none\n" in found.to_text()
    figures = found.metrics()
    assert figures["fitness_without_one_worst"] == found.without[2, 2]
    assert figures["fitness_without_one_mean"] == pytest.approx((2.0 * found.fitness + found.without[2, 2]) / 3.0)
    assert figures["fitness_without_two_worst"] <= figures["fitness_without_two_mean"] < found.fitness
    assert f"lost without each: 2 ({100.0 * found.table['fitness_loss'][0]:.2f})" in found.to_text()
    assert found.to_text().endswith("nothing is lost: 0, 1")


def test_a_tag_that_hides_more_than_it_adds_hurts():
    p = Problem(problem().scene, MeanCoverage(2, 0.5), RandomDeployment(60), threads=1)
    deployment = p.draw(np.random.default_rng(0))
    found = losses(p, deployment)
    ((number, gain),) = found.harmful.items()
    rest = p.fitness_of(deployment[np.flatnonzero(found.ids != number)])
    assert gain == pytest.approx(rest - found.fitness)
    assert gain > 1e-4
    assert number not in found.idle
    assert found.ids[found.order[0]] == number
    assert f"gained without each: {number} ({100.0 * gain:.2f})" in found.to_text()
