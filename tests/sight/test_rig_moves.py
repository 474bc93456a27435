"""Moves of single landmarks before a rig, against the reference."""

import numpy as np
import pytest
from contracts.criterion import check_every_path
from hypothesis import given
from hypothesis import strategies as st
from support.rooms import lab
from support.strategies import deployments, rig_scenes_with_deployments, rigs, rooms, seeds
from support.thorough import examples

from lmd.scene.deployment_sources import RandomDeployment
from lmd.scene.pdf import level_flight
from lmd.scene.scene import Scene
from lmd.sight.models.paper import Visibility


@examples(60)
@given(data=st.data(), case=rig_scenes_with_deployments(), n=st.integers(1, 4), seed=seeds)
def test_after_any_moves_a_rig_counts_what_the_reference_counts(data, case, n, seed):
    scene, deployment = case
    check_every_path(scene, deployment, data.draw(deployments(scene.room, most=8)), n, np.random.default_rng(seed))


tagged = rig_scenes_with_deployments(fiducial=True, room=rooms(cells=1))  # whose reference takes longest


@pytest.mark.thorough("lmd/incremental", "lmd/sight")
@examples(30)
@given(data=st.data(), case=tagged, n=st.integers(1, 3), seed=seeds)
def test_after_any_moves_of_tags_a_rig_counts_what_the_reference_counts(data, case, n, seed):
    scene, deployment = case
    check_every_path(scene, deployment, data.draw(deployments(scene.room, most=8)), n, np.random.default_rng(seed))


@examples(20)
@given(rig=rigs(), n=st.integers(1, 3), seed=seeds)
def test_among_obstacles_too(rig, n, seed):
    rng, room = np.random.default_rng(seed), lab(spacing=1.0)
    scene = Scene(room, rig, level_flight(3), Visibility(thold=0.1))
    deployment, targets = (RandomDeployment(count).draw(room, rng) for count in (12, 8))
    check_every_path(scene, deployment, targets, n, rng)
