from dataclasses import replace

import numpy as np
import pytest
from support.paper import chances, paper_room, paper_scene

from lmd.evaluation.validation import Sample, validation_metrics
from lmd.objectives.coverage import Coverage
from lmd.objectives.sampling import Sampling
from lmd.problem import Problem
from lmd.scene import pdf
from lmd.scene.deployment_sources import RandomDeployment, UniformDeployment
from lmd.sight import reference
from lmd.space.cuboid import Cuboid
from lmd.space.space import Relevance

SMALL = Sample(groups=8, positions=50, divisions=12)
RATIO, AVERAGE = "grid_free_qualified_ratio", "grid_free_average_coverage_probability"


def coarse_problem(orientations=None, threads=None, sampling=None, **room):
    there = paper_room(**({"spacing": 1.5} | room))
    scene = paper_scene(there, orientations=orientations or pdf.grid_with_ends(6))
    return Problem(scene, Coverage(2, 0.4, sampling), UniformDeployment(90), threads=threads)


def deployment_of(problem, seed=0):
    return problem.start.draw(problem.scene.room, np.random.default_rng(seed))


def from_samples(count=40):
    rng = np.random.default_rng(3)
    return pdf.OrientationPdf(
        rng.uniform(-np.pi, np.pi, count), rng.uniform(-1.0, 1.0, count), rng.dirichlet([1.0] * count)
    )


@pytest.mark.parametrize("samples", [False, True])
def test_the_finer_grid_is_the_references_at_half_the_spacing_and_half_the_step(samples):
    """Samples are not refined, but the positions are."""
    p = coarse_problem(from_samples() if samples else None)
    finer = replace(p.scene, room=paper_room(spacing=0.75), pdf=p.scene.pdf if samples else pdf.grid_with_ends(12))
    probability = reference.coverage_probability(reference.counts(finer, deployment_of(p)), finer.pdf, 2)
    metrics = validation_metrics(p, deployment_of(p), 0, SMALL)
    assert metrics["finer_grid_qualified_ratio"] == reference.qualified(probability, 0.4).mean()


@pytest.mark.parametrize("thold_p", [0.1, 0.3, 0.9])
def test_where_the_grid_is_all_there_is_the_figures_are_those_of_the_grid(thold_p):
    point = Cuboid(size=(4.0, 4.0, 4.0), reachable_size=(1e-12, 1e-12, 1e-12), spacing=1.0)
    scene = paper_scene(room=point, orientations=from_samples())
    p = Problem(scene, Coverage(1, thold_p), RandomDeployment(12))
    on_grid, metrics = p.metrics(deployment_of(p)), validation_metrics(p, deployment_of(p), 0, SMALL)
    assert 0.1 < on_grid["average_coverage_probability"] < 0.9
    assert metrics["finer_grid_qualified_ratio"] == metrics[RATIO] == on_grid["qualified_ratio"]
    assert metrics[AVERAGE] == pytest.approx(on_grid["average_coverage_probability"], abs=1e-12)
    assert metrics[f"{RATIO}_standard_error"] == 0.0
    assert metrics[f"{AVERAGE}_standard_error"] == pytest.approx(0.0, abs=1e-12)


def test_the_sample_depends_on_the_seed_only():
    p = coarse_problem(threads=1)
    once = validation_metrics(p, deployment_of(p), 5, SMALL)
    assert validation_metrics(coarse_problem(threads=3), deployment_of(p), 5, SMALL) == once
    other = validation_metrics(p, deployment_of(p), 6, SMALL)
    assert other[AVERAGE] != once[AVERAGE]
    assert other["finer_grid_qualified_ratio"] == once["finer_grid_qualified_ratio"]


@pytest.mark.parametrize("build", [pdf.grid_with_ends, pdf.grid_of_cells, pdf.solid_angle, pdf.level_flight])
def test_samples_differ_by_their_standard_errors(build):
    p = coarse_problem(build(6))
    metrics = [validation_metrics(p, deployment_of(p), seed, SMALL) for seed in range(12)]
    for key in (RATIO, AVERAGE):
        values, errors = (np.array([m[name] for m in metrics]) for name in (key, f"{key}_standard_error"))
        assert np.abs(values - values.mean()).max() < 4.0 * errors.max()
        # The standard deviation of 12 values is known to a factor of about 1.25.
        assert 0.4 < values.std(ddof=1) / np.sqrt((errors**2).mean()) < 1.8


def test_the_average_agrees_with_independent_poses():
    """One position and one orientation at a time, by the reference."""
    p = coarse_problem(pdf.solid_angle(6))
    rng, deployment, poses = np.random.default_rng(0), deployment_of(p), 1000
    positions = rng.uniform(p.scene.room.reachable_low, p.scene.room.reachable_high, (poses, 3))
    axes = rng.normal(size=(poses, 1, 3))
    axes /= np.linalg.norm(axes, axis=-1, keepdims=True)
    views = zip(positions, axes, strict=True)
    covered = [reference.coverage_caps(p.scene, deployment, at, axis).sum() >= 2 for at, axis in views]
    metrics = validation_metrics(p, deployment, 0, SMALL)
    error = np.hypot(metrics[f"{AVERAGE}_standard_error"], np.std(covered) / np.sqrt(poses))
    assert metrics[AVERAGE] == pytest.approx(np.mean(covered), abs=4.0 * error)


@pytest.mark.parametrize("positions", ["cells", "vertices"])
def test_a_jittered_position_is_nearer_to_its_own_grid_position_than_to_any_other(positions):
    room = paper_room(spacing=1.5, positions=positions)
    jittered, grid = room.jittered_grid(1, np.random.default_rng(0)), room.grid()
    distance = np.linalg.norm(jittered[:, None] - grid[None], axis=-1)
    np.testing.assert_array_equal(distance.argmin(axis=1), np.arange(len(grid)))
    assert (jittered >= room.reachable_low).all()
    assert (jittered <= room.reachable_high).all()


def test_a_sampling_measures_the_fitness_elsewhere_and_nothing_else():
    weighted = Relevance(regions=[{"low": [0.0, 0.0, 0.0], "high": [3.75, 5.0, 6.0], "weight": 3.0}])
    plain = coarse_problem(relevance=weighted)
    robust = coarse_problem(relevance=weighted, sampling=Sampling(positions=2, divisions=5))
    before, after = plain.metrics(deployment_of(plain)), robust.metrics(deployment_of(plain))
    assert after.pop("fitness") != before.pop("fitness")
    assert after == before
    evaluator, size = robust.fitness_evaluator, len(plain.relevance)
    assert len(evaluator.positions) == 2 * size
    assert len(evaluator.axis_of) == 50
    qualified = reference.qualified(chances(evaluator, deployment_of(plain), 2), 0.4)
    weight = np.tile(plain.relevance, 2)
    assert robust.fitness_of(deployment_of(plain)) == pytest.approx((qualified * weight).sum() / weight.sum())


def test_a_sampling_is_the_same_for_every_problem_and_leaves_samples_as_they_are():
    one, two = (coarse_problem(from_samples(), threads=t, sampling=Sampling(2, 5)).fitness_evaluator for t in (1, 2))
    np.testing.assert_array_equal(one.positions, two.positions)
    assert len(one.axis_of) == 40
