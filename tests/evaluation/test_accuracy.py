"""The predicted errors against the inverse of each view's 6 x 6 information."""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from support.paper import paper_room, paper_scene
from support.references import view_matrices

from lmd.evaluation.accuracy import TOLERANCES, accuracy_metrics, predicted_errors, save_accuracy_map
from lmd.evaluation.validation import VALIDATION_STREAM, Sample
from lmd.objectives.coverage import Coverage
from lmd.objectives.localisation import Localisation
from lmd.problem import Problem
from lmd.scene import pdf
from lmd.scene.deployment_sources import RandomDeployment, UniformDeployment
from lmd.scene.tag import Tag

SCENE = replace(paper_scene(paper_room(spacing=2.0), orientations=pdf.grid_with_ends(6)), tag=Tag(0.1))
NOISE = 0.8


def problem(objective):
    return Problem(SCENE, objective, RandomDeployment(60), threads=2)


def errors_of(scene, deployment, positions, n, noise):
    """Standard deviation of the position in each view, `(P, A)`, infinite where fewer than n are covered."""
    scale, axes = noise / np.sqrt(np.prod(scene.camera.focal_pixels)), scene.orientations.axes
    errors = np.full((len(positions), len(axes)), np.inf)
    for p, position in enumerate(positions):
        each = view_matrices(scene, deployment, position, axes)
        enough = (np.trace(each, axis1=2, axis2=3) > 0.0).sum(axis=1) >= n
        inverse = np.linalg.inv(each.sum(axis=1)[enough])
        errors[p, enough] = scale * np.sqrt(np.trace(inverse[:, :3, :3], axis1=1, axis2=2))
    return errors


def median(errors, weights):
    """The least error that at least half the weight does not exceed."""
    return min(e for e in errors if weights[errors <= e].sum() >= 0.5)


@pytest.mark.parametrize(("objective", "noise"), [(Localisation(pixel_noise=NOISE), NOISE), (Coverage(2, 0.5), 0.5)])
def test_errors_are_those_of_the_inverse_and_infinite_where_too_little_is_seen(objective, noise):
    subject = problem(objective)
    deployment = UniformDeployment(60).draw(SCENE.room, np.random.default_rng(0))
    errors, covered = predicted_errors(subject, deployment, subject.evaluator)
    expected = errors_of(SCENE, deployment, subject.evaluator.positions, 2, noise)
    np.testing.assert_allclose(errors, expected, rtol=1e-4)
    assert 0.1 < np.isfinite(errors).mean() < 0.9
    np.testing.assert_allclose(covered, np.isfinite(expected) @ SCENE.orientations.weight, atol=1e-12)


def test_the_figures_are_those_of_all_views_of_the_sample():
    subject, sample, seed = problem(Localisation(pixel_noise=NOISE)), Sample(2, 12, 4), 3
    deployment = UniformDeployment(150).draw(SCENE.room, np.random.default_rng(0))
    figures = accuracy_metrics(subject, deployment, seed, sample)
    rng, errors, weights = np.random.default_rng([seed, VALIDATION_STREAM]), [], []
    for _ in range(sample.groups):
        positions = SCENE.room.sample_evenly(sample.positions, rng)
        drawn = replace(SCENE, pdf=SCENE.pdf.stratified(sample.divisions, rng))
        errors.append(errors_of(drawn, deployment, positions, 2, NOISE))
        weights.append(np.broadcast_to(drawn.orientations.weight, errors[-1].shape) / errors[-1].size)
    errors, weights = np.ravel(errors), np.ravel(weights) / np.sum(weights)
    assert figures["covered_share"] == pytest.approx(weights[np.isfinite(errors)].sum(), abs=1e-9)
    shares = [weights[errors <= tolerance].sum() for tolerance in TOLERANCES]
    assert shares[0] < shares[1] < shares[2]
    assert [figures[f"localised_share_{name}mm"] for name in (10, 20, 50)] == pytest.approx(shares, abs=1e-9)
    middle = figures["predicted_error_median"]
    assert weights[errors < 0.9999 * middle].sum() <= 0.5 + 1e-9
    assert weights[errors < 1.0001 * middle].sum() >= 0.5 - 1e-9
    assert "predicted_error_90" not in figures  # more than a tenth of the views see too little


def test_the_map_has_the_figures_of_each_position(tmp_path):
    subject = problem(Localisation())
    deployment = UniformDeployment(60).draw(SCENE.room, np.random.default_rng(0))
    save_accuracy_map(tmp_path / "accuracy.csv", subject, deployment)
    table = pd.read_csv(tmp_path / "accuracy.csv")
    grid, weight = SCENE.room.grid(), SCENE.orientations.weight
    np.testing.assert_allclose(table[["x", "y", "z"]], grid)
    errors = errors_of(SCENE, deployment, grid, 2, 0.5)
    np.testing.assert_allclose(table.localised_share_20mm, (errors <= 0.02) @ weight, atol=1e-12)
    medians = np.array([median(row, weight) for row in errors])
    np.testing.assert_allclose(table.predicted_error_median, np.where(np.isfinite(medians), medians, np.nan), rtol=1e-4)
    assert 0 < table.predicted_error_median.isna().sum() < len(table)
