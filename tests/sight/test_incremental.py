"""After moves of single landmarks, the incremental field of coverage equals the reference."""

import numpy as np
import pytest
from contracts.criterion import check_every_path
from hypothesis import given
from hypothesis import strategies as st
from support.paper import paper_room, paper_scene
from support.strategies import deployments, scenes_with_boundary_landmarks, scenes_with_deployments, seeds
from support.thorough import examples

from lmd.scene.deployment import Deployment
from lmd.scene.deployment_sources import RandomDeployment


@examples(60)
@given(data=st.data(), n=st.integers(1, 5), seed=seeds)
def test_after_any_moves_the_counts_are_the_references(data, n, seed):
    scene, deployment = data.draw(scenes_with_deployments())
    check_every_path(scene, deployment, data.draw(deployments(scene.room)), n, np.random.default_rng(seed))


@examples(60)
@given(scene_and_targets=scenes_with_boundary_landmarks(), n=st.integers(1, 3), seed=seeds, data=st.data())
def test_moves_onto_a_boundary_are_exact_too(scene_and_targets, n, seed, data):
    scene, targets = scene_and_targets
    check_every_path(scene, data.draw(deployments(scene.room, most=6)), targets, n, np.random.default_rng(seed))


@pytest.mark.parametrize("occlusion", ["paper", "line_of_sight", "none"])
def test_moves_in_the_papers_room_are_exact(occlusion):
    # Many blocks of positions, and landmarks that are moved to where they hide each other.
    scene, rng = paper_scene(paper_room(), occlusion=occlusion), np.random.default_rng(0)
    deployment = RandomDeployment(90).draw(scene.room, rng)
    near = rng.integers(90, size=60)
    along = rng.normal(0.0, 0.07, (60, 3)) * (deployment.normals[near] == 0.0)
    places = np.clip(deployment.positions[near] + along, 0.0, scene.room.size)
    check_every_path(scene, deployment, Deployment(places, deployment.normals[near]), 2, rng)
