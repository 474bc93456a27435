"""Orientation probabilities that depend on the position: every fast path equals the reference exactly."""

import numpy as np
from numpy.testing import assert_array_equal
from support.paper import paper_room, paper_scene
from support.strategies import with_probabilities

from lmd.evaluation.bounds import Search, average_upper_bound
from lmd.objectives.coverage import Coverage
from lmd.problem import Problem
from lmd.scene import pdf
from lmd.scene.deployment_sources import UniformDeployment


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
