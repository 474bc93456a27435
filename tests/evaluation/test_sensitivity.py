from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from matplotlib.image import imread
from support.paper import X, Y, paper_room, paper_scene
from support.strategies import deployments, scenes, seeds
from support.thorough import examples

from lmd.evaluation.sensitivity import (
    FACTORS,
    MISS_PROBABILITIES,
    SHARE_COLUMNS,
    lost_shares,
    missed_shares,
    sensitivity,
)
from lmd.evaluation.validation import Sample, sampled_values
from lmd.objectives.coverage import Coverage
from lmd.objectives.localisation import Localisation
from lmd.objectives.localisation.evaluation import localised_views
from lmd.plot.charts import save_sensitivity_figure
from lmd.problem import Problem
from lmd.scene import pdf
from lmd.scene.deployment import Deployment
from lmd.scene.deployment_sources import GivenDeployment, UniformDeployment
from lmd.scene.labels import Labels
from lmd.scene.scene import Scene
from lmd.scene.tag import Tag
from lmd.sight.evaluator import Evaluator
from lmd.sight.kernels import PROBABILITY_ONE

# Compiled for it alone.
pytestmark = [
    pytest.mark.long,
    pytest.mark.thorough("lmd/evaluation", "lmd/objectives", "lmd/incremental", "lmd/sight"),
]

SAMPLE = Sample(groups=3, positions=20, divisions=4)
TAG = Tag(0.1)


def problem_of(deployment=None, objective=None, tag=TAG, threads=1, **visibility):
    scene = paper_scene(room=paper_room(spacing=1.5), orientations=pdf.grid_with_ends(6), **visibility)
    scene = replace(scene, tag=tag)
    start = UniformDeployment(30) if deployment is None else GivenDeployment(deployment.with_surfaces(scene.room))
    return Problem(scene, objective or Localisation(), start, threads)


def measured(problem, seed=0, sample=SAMPLE):
    return sensitivity(problem, problem.draw(np.random.default_rng(0)), seed, sample)


def tagged(scene, edge):
    return Scene(scene.room, scene.camera, scene.pdf, scene.visibility, Tag(edge))


@examples(40)
@given(
    data=st.data(),
    scene=st.builds(tagged, scenes(), st.sampled_from([None, 0.1])),
    n=st.integers(1, 3),
    tolerance=st.sampled_from([0.02, 0.2, np.inf]),
)
def test_what_is_left_without_landmarks_is_what_the_others_are_worth(data, scene, n, tolerance):
    deployment = data.draw(deployments(scene.room, 6))
    objective = Localisation(n, tolerance=tolerance, ambiguity="ignored")
    assume(len(deployment) >= 3)
    evaluator = Evaluator(scene, threads=1)
    found = lost_shares(objective.field(evaluator), deployment)
    for i in range(len(deployment)):
        for j in range(len(deployment)):
            rest = deployment[np.setdiff1d(np.arange(len(deployment)), [i, j])]
            landmarks = rest.positions[None], rest.normals[None]
            views = localised_views(evaluator, *landmarks, n, objective.precision(scene))
            expected = [views.localised.mean(), views.covered.mean()]
            np.testing.assert_allclose(found[:, i, j], np.array(expected) / PROBABILITY_ONE, rtol=1e-12)


@given(seed=seeds, n=st.integers(1, 3))
@examples(10)
def test_missed_landmarks_are_thinned_as_the_binomial_formula_says(seed, n):
    problem = problem_of(objective=Localisation(n))
    deployment = problem.draw(np.random.default_rng(seed))
    field = problem.objective.field(problem.evaluator)
    located, exact, drawn = missed_shares(field, deployment, np.random.default_rng(seed)).T
    np.testing.assert_allclose(drawn[0], exact[0], rtol=1e-12)
    views = len(problem.evaluator.positions) * len(problem.scene.orientations.axes)
    assert (np.abs(drawn - exact) < 5.0 * 0.5 / np.sqrt(views)).all()
    assert (np.diff(exact) < 0.0).all()
    assert (np.diff(located) <= 0.0).all()  # what is missed with one probability is missed with all greater
    assert (located <= drawn).all()


def test_without_a_tolerance_localised_is_covered():
    found = measured(problem_of(objective=Localisation(tolerance=np.inf)))
    shown = found.assumptions
    np.testing.assert_array_equal(shown.localised_share, shown.covered_share)
    np.testing.assert_array_equal(found.tags.localised_loss, found.tags.covered_loss)
    # Here one is drawn and the other is exact.
    np.testing.assert_allclose(found.misses.localised_share, found.misses.covered_share, atol=0.02)


def test_what_was_assumed_gives_the_figure_of_the_validation():
    problem = problem_of()
    found = measured(problem, seed=3)
    expected = sampled_values(problem, problem.draw(np.random.default_rng(0)), 3, SAMPLE).mean()
    assumed = found.assumptions[found.assumptions.factor == 1.0]
    assert assumed.assumption.tolist() == ["pixel_noise", "tolerance", "edge"]
    assert assumed["value"].tolist() == [0.5, 0.02, 0.1]
    for shares in (assumed.localised_share, found.misses.localised_share[:1]):
        np.testing.assert_allclose(shares, expected, rtol=1e-12)
    np.testing.assert_allclose(found.misses.covered_share[0], assumed.covered_share, rtol=1e-12)


def test_half_the_noise_is_twice_the_tolerance():
    shares = measured(problem_of()).assumptions.set_index(["assumption", "factor"]).localised_share
    assert shares.pixel_noise[0.5] == shares.tolerance[2.0]
    assert (np.diff(shares.tolerance) > 0.0).all()
    assert (np.diff(shares.edge) > 0.0).all()  # larger tags tell more, and these criteria see them as before


def test_papers_that_would_overlap_have_a_sentence_instead_of_a_figure():
    positions = np.array([[0.0, 2.0, 3.0], [0.0, 2.15, 3.0], [1.0, 0.0, 3.0]])
    found = measured(problem_of(Deployment(positions, np.array([X, X, Y]))))
    edge = found.assumptions[found.assumptions.assumption == "edge"].set_index("factor")
    assert (edge.note.loc[:1.0] == "").all()
    assert "landmarks 0 and 1 on x_min overlap" in edge.note[2.0]
    assert edge.loc[2.0, SHARE_COLUMNS].isna().all()
    assert edge.loc[:1.0, SHARE_COLUMNS].notna().all(axis=None)
    assert "edge_2/localised_share" not in found.metrics()
    assert "edge x 2: landmarks 0 and 1" in found.to_text()


def test_points_have_no_edge_and_an_objective_of_coverage_has_the_default_assumptions():
    points = measured(problem_of(tag=Tag(), objective=Coverage(3, 0.65))).assumptions
    assert set(points.assumption) == {"pixel_noise", "tolerance"}
    expected = measured(problem_of(tag=Tag(), objective=Localisation(3))).assumptions
    pd.testing.assert_frame_equal(points, expected)


def test_a_single_landmark_has_no_pair_to_lose_and_is_named_by_its_id():
    one = Deployment(np.array([[0.0, 2.0, 3.0]]), np.array([X]), labels=Labels(np.array([57])))
    found = measured(problem_of(one, Coverage(1, 0.5), Tag()))
    assert found.lost.lost.tolist() == [1, 1]
    assert found.lost.worst_ids.tolist() == ["57", "57"]
    assert found.tags.covered_loss[0] == pytest.approx(found.misses.covered_share[0])


def test_the_number_of_threads_does_not_matter():
    one, three = (measured(problem_of(threads=threads)) for threads in (1, 3))
    for name in one.tables:
        pd.testing.assert_frame_equal(one.tables[name], three.tables[name], check_exact=True)
    assert one.metrics() != measured(problem_of(), seed=1).metrics()


def test_all_figures_have_a_name_and_are_shown(tmp_path):
    found = measured(problem_of())
    metrics = found.metrics()
    assert len(metrics) == 2 * (3 * len(FACTORS) + len(MISS_PROBABILITIES) + 2 * 2)
    assert metrics["missed_0.1/localised_share"] == found.misses.localised_share[MISS_PROBABILITIES.index(0.1)]
    assert metrics["lost_1/localised_share_worst"] == found.tags.localised_loss.max()
    assert metrics["lost_1/covered_share_mean"] == pytest.approx(found.tags.covered_loss.mean())
    assert metrics["lost_2/localised_share_worst"] >= metrics["lost_1/localised_share_worst"]
    path = tmp_path / "sensitivity.png"
    save_sensitivity_figure(path, found, "T")
    assert imread(path).shape[:2] == (500, 1500)
