"""Gains by one more tag, against problems with that tag."""

from dataclasses import replace

import numpy as np
import pytest
from support.paper import paper_room, paper_scene
from support.small import problem

from lmd.objectives.localisation import Localisation
from lmd.planner.figures import additions, candidate_cells
from lmd.problem import Problem
from lmd.scene import pdf
from lmd.scene.deployment_sources import RandomDeployment
from lmd.scene.tag import Tag

TAG = Tag(edge=0.3)


def localising():
    scene = replace(paper_scene(paper_room(spacing=2.0), orientations=pdf.grid_with_ends(6)), tag=TAG)
    return Problem(scene, Localisation(sampling=None), RandomDeployment(9), threads=1)


@pytest.mark.parametrize(("of", "mean"), [(problem, "average_coverage_probability"), (localising, "localised_share")])
def test_gains_are_differences_of_metrics(of, mean):
    planned, rng = of(), np.random.default_rng(0)
    deployment, cells = planned.draw(rng), candidate_cells(planned)
    poses = cells.poses[rng.integers(len(cells.poses), size=40)]
    found, before = additions(planned, deployment, poses), planned.metrics(deployment)
    assert np.abs(found).max() > 0.0
    for k in np.flatnonzero(np.isfinite(found)):
        after = planned.metrics(deployment + poses[k : k + 1])
        assert found[k] == pytest.approx(after[mean] - before[mean], abs=1e-12)


def test_gains_are_nan_where_a_paper_would_overlap_another():
    planned = problem(tag=TAG)
    deployment, poses = planned.draw(np.random.default_rng(0)), candidate_cells(planned).poses
    found = additions(planned, deployment, poses)
    away = np.abs(poses.positions[:, None] - deployment.positions).max(axis=-1)
    same = poses.surfaces[:, None] == deployment.surfaces
    overlaps = (same & (away < planned.scene.footprints.edge - 1e-9)).any(axis=1)
    assert overlaps.any()
    assert (np.isnan(found) == overlaps).all()


def test_any_room_has_about_3000_allowed_candidates():
    for size in (1.0, 10.0):
        planned = problem(size=(7.5 * size, 5.0 * size, 6.0 * size))
        poses = candidate_cells(planned).poses
        assert 2500 < len(poses) < 4000
        assert poses.fault(planned.scene.footprints.hanging) is None


def test_unwanted_gains_are_not_computed():
    planned = problem()
    deployment, poses = planned.draw(np.random.default_rng(0)), candidate_cells(planned).poses
    asked = iter([True, False])
    assert additions(planned, deployment, poses, lambda: next(asked)) is None
    assert next(asked, None) is None
