"""Orientation probabilities that depend on the position: every fast path equals the reference exactly."""

import numpy as np
import pytest
from contracts.criterion import check_counts
from contracts.field import check_field
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_array_equal
from support.paper import facing, paper_room, paper_scene
from support.strategies import deployments, plain_scenes, seeds, tag_scenes, varied_scenes, with_probabilities
from support.thorough import examples

from lmd.evaluation.bounds import Search, average_upper_bound
from lmd.objectives.coverage import Coverage
from lmd.objectives.localisation import Localisation
from lmd.objectives.localisation import reference as localisation_reference
from lmd.problem import Problem
from lmd.scene import pdf
from lmd.scene.deployment_sources import UniformDeployment
from lmd.sight.evaluator import Evaluator
from lmd.sight.kernels import PROBABILITY_ONE

coverages = st.builds(Coverage, st.integers(1, 4), st.just(0.5))
objectives = st.one_of(
    coverages,
    st.builds(Localisation, n=st.integers(1, 3), tolerance=st.sampled_from([0.02, 0.3, np.inf])),
    st.builds(Localisation, tolerance=st.just(0.1), coverage_weight=st.just(0.3)),
)


def units_by_the_reference(scene, good):
    """The weights in units of the axes that are `good` at each position, summed, `(P,)`."""
    evaluator, axes = Evaluator(scene, threads=1), scene.orientations.axes
    rows = evaluator.weights[:, : len(axes)]
    assert len(rows) == len(evaluator.positions)
    assert (evaluator.weights.sum(axis=1) == PROBABILITY_ONE).all()
    return np.array([row[good(p, axes)].sum() for row, p in zip(rows, evaluator.positions, strict=True)])


@examples(60)
@given(data=st.data(), scene=varied_scenes, n=st.integers(1, 4), threads=st.sampled_from([1, 3]))
def test_probabilities_are_those_of_the_reference(data, scene, n, threads):
    check_counts(scene, data.draw(deployments(scene.room)), n, threads)


@examples(40)
@given(data=st.data(), scene=plain_scenes, tolerance=st.sampled_from([0.02, 0.3]))
def test_localised_views_are_those_of_the_reference(data, scene, tolerance):
    deployment, objective = data.draw(deployments(scene.room)), Localisation(tolerance=tolerance)
    expected = units_by_the_reference(
        scene,
        lambda p, axes: localisation_reference.localised(
            scene, deployment, objective.n, objective.precision(scene), p, axes
        ),
    )
    for threads in (1, 3):
        evaluator = Evaluator(scene, threads=threads)
        values = objective.values(evaluator, deployment.positions[None], deployment.normals[None])[0]
        assert_array_equal(values, expected / PROBABILITY_ONE)


@examples(60)
@given(
    data=st.data(),
    # What is seen and what is asked do not depend on each other, and every pair is compiled anew.
    case=st.one_of(st.tuples(plain_scenes, objectives), st.tuples(tag_scenes, coverages)),
    seed=seeds,
)
def test_after_any_moves_the_values_are_those_of_a_full_evaluation(data, case, seed):
    scene, objective = case
    deployment, targets = data.draw(deployments(scene.room)), data.draw(deployments(scene.room, most=6))
    check_field(objective, scene, deployment, targets, np.random.default_rng(seed))


def test_moves_in_many_blocks_of_positions_are_exact():
    scene, rng = with_probabilities(paper_scene(paper_room()), 1), np.random.default_rng(0)
    deployment = UniformDeployment(60).draw(scene.room, rng)
    check_field(Coverage(2, 0.5), scene, deployment, deployment[rng.integers(60, size=30)], rng)


def test_the_same_probabilities_everywhere_give_what_one_row_gives():
    scene = paper_scene(paper_room(spacing=1.5), orientations=pdf.solid_angle(6))
    weight = scene.pdf.weight
    repeated = pdf.OrientationPdf(
        scene.pdf.yaw, scene.pdf.pitch, weight, by_position=lambda at: np.tile(weight, (len(at), 1))
    )
    deployment = UniformDeployment(60).draw(scene.room, np.random.default_rng())
    once, often = (Evaluator(paper_scene(scene.room, orientations=p), threads=1) for p in (scene.pdf, repeated))
    assert len(once.weights) == 1 < len(often.weights)
    assert_array_equal(once.probabilities(deployment, 2), often.probabilities(deployment, 2))


def test_one_landmark_counts_as_often_as_the_camera_looks_that_way():
    # Two positions on either side of a landmark between them, of which each sees it only when it looks that way.
    scene = paper_scene(paper_room(spacing=1.5))
    here = scene.room.grid()
    ahead, behind = np.array([[np.pi / 2, 0.0], [-np.pi / 2, 0.0]])
    share = np.linspace(0.0, 1.0, len(here))
    orientations = pdf.OrientationPdf(
        *np.stack([ahead, behind], axis=1), np.full(2, 0.5), by_position=lambda _: np.stack([share, 1 - share], axis=1)
    )
    landmark = facing(here[4], here[4] + np.array([1.2, 0.0, 0.0]))
    probability = Evaluator(paper_scene(scene.room, orientations=orientations), threads=1).probabilities(landmark, 1)
    assert probability[4] == pytest.approx(share[4], abs=1e-15)


def test_no_deployment_exceeds_the_bound():
    scene = with_probabilities(paper_scene(paper_room(spacing=1.5), orientations=pdf.grid_of_cells(4)), 5)
    p = Problem(scene, Coverage(1, 0.5), UniformDeployment(12), threads=1)
    most = average_upper_bound(p, 12, Search(spacing=1.0, iterations=20)).walls
    values = p.values(p.draw(np.random.default_rng(0)))
    assert values.mean() <= most < 1.0


def test_orientations_are_drawn_where_they_occur():
    at = np.array([[1.0, 1.0, 1.0], [2.0, 1.0, 1.0]])
    orientations = pdf.OrientationPdf(
        [0.1, 0.2], [0.0, 0.3], [0.5, 0.5], by_position=lambda p: np.stack([p[:, 0] < 1.5, p[:, 0] > 1.5], axis=1) * 1.0
    )
    yaw, pitch, roll = orientations.draw_at(np.repeat(at, 50, axis=0), np.random.default_rng(0))
    assert_array_equal(yaw, np.repeat([0.1, 0.2], 50))
    assert_array_equal(pitch, np.repeat([0.0, 0.3], 50))
    assert not roll.any()
