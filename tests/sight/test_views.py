import numpy as np
import pytest
from examples import examples
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_array_equal
from paper import paper_scene
from strategies import scenes_with_boundary_landmarks, scenes_with_deployments

from lmd.scene.deployment_sources import UniformDeployment
from lmd.sight import reference
from lmd.sight.evaluator import Evaluator
from lmd.sight.views import visible

any_case = st.one_of(scenes_with_deployments(), scenes_with_boundary_landmarks())


@examples(200)
@given(any_case)
def test_a_camera_sees_what_the_reference_covers(case):
    scene, deployment = case
    axes = scene.pdf.axes
    for position in scene.room.grid():
        seen = visible(Evaluator(scene), deployment, np.tile(position, (len(axes), 1)), axes)
        assert_array_equal(seen, reference.coverage_caps(scene, deployment, position, axes))


@pytest.mark.parametrize("occlusion", ["paper", "line_of_sight", "none"])
def test_in_the_room_of_the_paper_it_counts_what_the_evaluator_counts(occlusion):
    scene = paper_scene(occlusion=occlusion)
    evaluator, deployment = Evaluator(scene), UniformDeployment(90).draw(scene.room, np.random.default_rng(0))
    grid, axes = scene.room.grid(), scene.pdf.axes[scene.pdf.axis_of]
    positions, directions = np.repeat(grid, len(axes), axis=0), np.tile(axes, (len(grid), 1))
    counts = visible(evaluator, deployment, positions, directions).sum(axis=1)
    assert_array_equal(counts.reshape(len(grid), -1), evaluator.counts(deployment))
