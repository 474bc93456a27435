import numpy as np
import pytest
from examples import examples
from hypothesis import given
from hypothesis import strategies as st
from moves import accept, bound, move, settle, undo
from paper import paper_room, paper_scene
from strategies import deployments, scenes_with_boundary_landmarks, scenes_with_deployments, seeds

from lmd.incremental.coverage_field import coverage_field
from lmd.incremental.move import counts_of, state_of
from lmd.incremental.state import scratch_of
from lmd.scene.deployment import Deployment
from lmd.scene.deployment_sources import RandomDeployment
from lmd.sight import reference
from lmd.sight.evaluator import Evaluator


def moved(scene, deployment, targets, n, rng):
    """The state after moving random landmarks to each of `targets` in turn, and what the trials promised."""
    field = coverage_field(Evaluator(scene, threads=1), n)
    state = state_of(field, deployment)
    scratch = scratch_of(state)
    for position, normal in zip(targets.positions, targets.normals, strict=True):
        k = int(rng.integers(len(deployment)))
        before = [array.copy() for array in state]
        pose = np.concatenate([position, normal])
        bound(field, k, pose, -1, state, scratch)
        most = scratch.units.copy()
        settle(field, k, state, scratch)
        assert all((a == b).all() for a, b in zip(state, before, strict=True)), "a trial changed the state"
        promised = scratch.units.copy()
        assert (promised <= most).all(), "not a bound"
        end = rng.choice(["nothing", "carried out", "taken back", "moved", "moved and back"])
        if end in ("carried out", "taken back"):
            accept(field, k, state, scratch)
        if end in ("moved", "moved and back"):
            move(field, k, pose, -1, state, scratch)
        if end in ("taken back", "moved and back"):
            undo(field, k, state, scratch)
        moves = end in ("carried out", "moved")
        np.testing.assert_array_equal(state.units, promised if moves else before[-1])
        assert moves or all((a == b).all() for a, b in zip(state, before, strict=True)), end
    return field, state


def check(scene, deployment, targets, n, seed):
    field, state = moved(scene, deployment, targets, n, np.random.default_rng(seed))
    now = Deployment(state.landmarks.T, state.normals.T, state.surfaces)
    for array, fresh in zip(state, state_of(field, now), strict=True):
        np.testing.assert_array_equal(array, fresh)
    evaluator = Evaluator(scene, threads=1)
    units = evaluator.units(now.positions[None], now.normals[None], n)[0]
    np.testing.assert_array_equal(state.units[field.index_of], units)
    counts = counts_of(state, evaluator.axes.shape[1])
    np.testing.assert_array_equal(counts[field.index_of][:, scene.pdf.axis_of], reference.counts(scene, now))


@examples(60)
@given(data=st.data(), n=st.integers(1, 5), seed=seeds)
def test_after_any_moves_the_counts_are_the_references(data, n, seed):
    scene, deployment = data.draw(scenes_with_deployments())
    check(scene, deployment, data.draw(deployments(scene.room)), n, seed)


@examples(60)
@given(scene_and_targets=scenes_with_boundary_landmarks(), n=st.integers(1, 3), seed=seeds, data=st.data())
def test_moves_onto_a_boundary_are_exact_too(scene_and_targets, n, seed, data):
    scene, targets = scene_and_targets
    check(scene, data.draw(deployments(scene.room, most=6)), targets, n, seed)


@pytest.mark.parametrize("occlusion", ["paper", "line_of_sight", "none"])
def test_moves_in_the_papers_room_are_exact(occlusion):
    # Many blocks of positions, and landmarks that are moved to where they hide each other.
    scene, rng = paper_scene(paper_room(), occlusion=occlusion), np.random.default_rng(0)
    deployment = RandomDeployment(90).draw(scene.room, rng)
    near = rng.integers(90, size=60)
    along = rng.normal(0.0, 0.07, (60, 3)) * (deployment.normals[near] == 0.0)
    places = np.clip(deployment.positions[near] + along, 0.0, scene.room.size)
    check(scene, deployment, Deployment(places, deployment.normals[near]), 2, 0)


def test_several_moves_are_taken_back_one_by_one():
    scene, rng = paper_scene(paper_room()), np.random.default_rng(0)
    deployment, targets = (RandomDeployment(count).draw(scene.room, rng) for count in (30, 3))
    field = coverage_field(Evaluator(scene, threads=1), 2)
    state = state_of(field, deployment)
    scratches = [scratch_of(state) for _ in range(3)]
    before = [[array.copy() for array in state]]
    for k, (position, normal, scratch) in enumerate(zip(targets.positions, targets.normals, scratches, strict=True)):
        move(field, k % 2, np.concatenate([position, normal]), 0, state, scratch)  # the first moves twice
        before.append([array.copy() for array in state])
    for k in range(2, -1, -1):
        undo(field, k % 2, state, scratches[k])
        assert all((a == b).all() for a, b in zip(state, before[k], strict=True))
