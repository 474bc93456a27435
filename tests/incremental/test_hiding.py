"""Occluders of each landmark, found block by block, against the reference."""

import numpy as np
import pytest
from contracts.field import bound, settle
from hypothesis import given
from hypothesis import strategies as st
from support.paper import paper_room, paper_scene
from support.strategies import scenes_with_deployments
from support.thorough import examples

from lmd.incremental.camera import turns
from lmd.incremental.coverage_field import coverage_field
from lmd.incremental.state import HIDDEN, HIDING
from lmd.scene.deployment_sources import RandomDeployment
from lmd.sight.blocks import BLOCK
from lmd.sight.evaluator import Evaluator
from lmd.sight.models.paper import hidden_by_others


def hidden_by_each(scene, landmarks, position):
    """Mask of the landmarks that occlude each landmark, `(K, K)`, by the reference, one pair at a time."""
    offset = landmarks - position
    pairs = [[j != k and hidden_by_others(offset[[k, j]], scene.visibility)[0] for j in range(len(offset))]
             for k in range(len(offset))]  # fmt: skip
    return np.array(pairs, dtype=bool).reshape(len(offset), len(offset))


def counted(field, landmarks, block):
    """Which landmarks count for which others: those within the horizon of each other and both of the block."""
    gaps = np.abs(landmarks - field.boxes[:3, block]) - field.boxes[3:, block]
    near = np.linalg.norm(np.maximum(gaps, 0.0), axis=1) <= field.horizon
    apart = np.linalg.norm(landmarks[:, None] - landmarks, axis=2)
    return (apart <= field.horizon) & near & near[:, None]


def check(scene, deployment):
    field = coverage_field(Evaluator(scene, threads=1), 1)
    state = field.state(deployment)
    for p in range(0, field.positions.shape[1], 7):
        hides = hidden_by_each(scene, deployment.positions, field.positions[:, p])
        near = hides & counted(field, deployment.positions, p // BLOCK)
        np.testing.assert_array_equal(state.hides[HIDDEN, :, p], near.sum(axis=1))
        np.testing.assert_array_equal(state.hides[HIDING, :, p], near.sum(axis=0))
        reached = state.reachable[:, p]
        np.testing.assert_array_equal(near[reached], hides[reached])  # nothing that matters is left out


@examples(40)
@given(scenes_with_deployments())
def test_a_state_knows_how_many_hide_each_landmark_and_how_many_it_hides(case):
    check(*case)


@pytest.mark.parametrize("occlusion", ["paper", "line_of_sight"])
def test_so_it_is_in_a_room_of_many_blocks_full_of_landmarks(occlusion):
    scene = paper_scene(paper_room(spacing=1.0), occlusion=occlusion, nu=0.3)
    check(scene, RandomDeployment(40).draw(scene.room, np.random.default_rng(0)))


@given(scenes_with_deployments(), st.data())
def test_a_trial_finds_what_its_place_hides_and_who_hides_it(case, data):
    scene, deployment = case
    field = coverage_field(Evaluator(scene, threads=1), 1)
    state = field.state(deployment)
    if field.cameras.sight.reach < 0.0:
        return
    scratch = field.scratch(state)
    k = data.draw(st.integers(0, len(deployment) - 1))
    target = deployment.positions[data.draw(st.integers(0, len(deployment) - 1))] + data.draw(
        st.sampled_from([0, 0.03])
    )
    bound(field, k, np.concatenate([target, deployment.normals[k]]), -1, state, scratch)
    settle(field, k, state, scratch)
    moved = deployment.positions.copy()
    moved[k] = target
    hidden, hiding = scratch.hides[HIDDEN], scratch.hides[HIDING]
    for p in range(0, field.positions.shape[1], 5):
        hides = hidden_by_each(scene, moved, field.positions[:, p]) & counted(field, moved, p // BLOCK)
        assert hidden[p] == hides[k].sum()
        assert hiding[p] == hides[:, k].sum()
        named = np.flatnonzero(scratch.known[p])
        assert set(np.flatnonzero(hides[k] | hides[:, k])) <= set(named.tolist())
        assert k not in named


def test_a_landmark_flips_where_the_first_comes_to_hide_it_or_the_last_ceases_to():
    cases = [(0, 0), (0, 1), (1, 0), (1, 2), (2, 1), (0, 3)]
    assert [bool(turns(True, was, now)) for was, now in cases] == [False, True, True, False, False, True]
    assert not any(turns(False, was, now) for was, now in cases)
