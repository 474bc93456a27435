import numpy as np
import pytest
from hypothesis import strategies as st
from numpy.testing import assert_array_equal
from support.paper import paper_scene
from support.strategies import scenes_with_boundary_landmarks, scenes_with_deployments

from lmd.scene.deployment_sources import UniformDeployment
from lmd.sight.evaluator import Evaluator
from lmd.sight.views import visible

any_case = st.one_of(scenes_with_deployments(), scenes_with_boundary_landmarks())


@pytest.mark.parametrize("occlusion", ["paper", "line_of_sight", "none"])
def test_in_the_room_of_the_paper_it_counts_what_the_evaluator_counts(occlusion):
    scene = paper_scene(occlusion=occlusion)
    evaluator, deployment = Evaluator(scene), UniformDeployment(90).draw(scene.room, np.random.default_rng(0))
    grid, axes = scene.room.grid(), scene.pdf.axes[scene.pdf.by_axis.index_of]
    positions, directions = np.repeat(grid, len(axes), axis=0), np.tile(axes, (len(grid), 1))
    counts = visible(evaluator, deployment, positions, directions).sum(axis=1)
    assert_array_equal(counts.reshape(len(grid), -1), evaluator.counts(deployment))
