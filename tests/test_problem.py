import json
import math

import numpy as np
import pytest
from support.paper import one_position_room, paper_camera, paper_room, paper_scene

from lmd.core.checks import InputError
from lmd.formats.rigs import rig_of
from lmd.objectives.coverage import Coverage
from lmd.problem import Problem
from lmd.scene import pdf
from lmd.scene.deployment_sources import RandomDeployment, UniformDeployment
from lmd.sight import reference
from lmd.space.space import Relevance


def coarse_scene(**room):
    return paper_scene(room=paper_room(**({"spacing": 1.5} | room)), orientations=pdf.grid_with_ends(6))


def problem(scene=None, n=2, thold_p=0.5, start=None, **options):
    return Problem(scene or coarse_scene(), Coverage(n, thold_p), start or RandomDeployment(40), **options)


def test_settings_are_json_also_where_nothing_is_out_of_focus():
    camera = paper_camera(aperture=0.0, focus_distance=math.inf)
    mounts = [{"yaw": yaw} for yaw in (0.0, 1.0)]
    for cameras in (camera, rig_of(mounts, camera)):
        scene = paper_scene(room=paper_room(spacing=1.5), camera=cameras, orientations=pdf.grid_with_ends(6))
        assert "Infinity" not in json.dumps(problem(scene).settings())


def test_metrics_are_the_references():
    scene = coarse_scene()
    deployment = UniformDeployment(40).draw(scene.room, np.random.default_rng())
    metrics = problem(scene).metrics(deployment)
    probability = reference.coverage_probability(reference.counts(scene, deployment), scene.pdf, 2)
    is_qualified = reference.qualified(probability, 0.5)
    assert metrics["qualified_ratio"] == is_qualified.mean()
    assert metrics["average_coverage_probability"] == pytest.approx(probability.mean(), abs=1e-12)
    assert metrics["maximum_coverage_probability"] == pytest.approx(probability.max(), abs=1e-12)
    assert metrics["cost"] == is_qualified.sum()
    assert metrics["fitness"] == metrics["qualified_ratio"]


def test_relevance_weighs_the_fitness_but_not_the_qualified_ratio():
    half = {"low": [0.0, 0.0, 0.0], "high": [3.75, 5.0, 6.0], "weight": 3.0}
    p = problem(coarse_scene(relevance=Relevance(regions=[half])))
    deployment = p.start.draw(p.scene.room, np.random.default_rng(0))
    is_qualified = reference.qualified(p.values(deployment), 0.5)
    near = p.evaluator.positions[:, 0] <= 3.75
    metrics = p.metrics(deployment)
    assert metrics["qualified_ratio"] == is_qualified.mean()
    assert metrics["cost"] == 3 * is_qualified[near].sum() + is_qualified[~near].sum()
    assert metrics["fitness"] == pytest.approx(metrics["cost"] / (3 * near.sum() + (~near).sum()))
    assert p.fitness_of(deployment) == metrics["fitness"]


def test_more_landmarks_than_exist_cannot_be_required():
    with pytest.raises(InputError, match=r"^n = 4 exceeds the number of landmarks, 3"):
        problem(n=4, start=RandomDeployment(3))


def test_one_position_is_a_problem_too():
    p = problem(paper_scene(room=one_position_room()), thold_p=0.0)
    assert p.fitness_of(p.start.draw(p.scene.room, np.random.default_rng(0))) == 1.0
