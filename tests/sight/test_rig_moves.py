import numpy as np
from examples import examples
from floor_plans import lab
from hypothesis import given
from hypothesis import strategies as st
from moves import accept, bound, move, settle, undo
from rigs import rig_scenes_with_deployments, rigs
from strategies import deployments, seeds

from lmd.incremental.move import counts_of
from lmd.incremental.rig_field import rig_field
from lmd.scene.deployment import Deployment
from lmd.scene.deployment_sources import RandomDeployment
from lmd.scene.pdf import level_flight
from lmd.scene.scene import Scene
from lmd.sight import reference
from lmd.sight.evaluator import Evaluator
from lmd.sight.models.paper import Visibility


def arrays_of(state):
    """All arrays of a state, those of its parts among them."""
    own = [array.copy() for array in state if isinstance(array, np.ndarray)]
    return own + [array.copy() for part in state.parts for array in part]


def same(one, two):
    return all((a == b).all() for a, b in zip(one, two, strict=True))


def check(scene, deployment, targets, n, seed):
    """After any moves, tried, carried out or taken back, the field has what the reference counts."""
    evaluator, rng = Evaluator(scene, threads=1), np.random.default_rng(seed)
    field = rig_field(evaluator, n)
    state = field.state(deployment)
    scratch = field.scratch(state)
    for pose in np.hstack([targets.positions, targets.normals]):
        k, before, units = int(rng.integers(len(deployment))), arrays_of(state), state.units.copy()
        bound(field, k, pose, -1, state, scratch)
        most = scratch.units.copy()
        settle(field, k, state, scratch)
        assert same(arrays_of(state), before), "a trial changed the state"
        promised = scratch.units.copy()
        assert (promised <= most).all(), "not a bound"
        end = rng.choice(["nothing", "carried out", "taken back", "moved"])
        if end in ("carried out", "taken back"):
            accept(field, k, state, scratch)
            np.testing.assert_array_equal(state.units, promised)
        if end == "taken back":
            undo(field, k, state, scratch)
        if end == "moved":
            move(field, k, pose, -1, state, scratch)
        np.testing.assert_array_equal(state.units, promised if end in ("carried out", "moved") else units)
        assert end in ("carried out", "moved") or same(arrays_of(state), before), end
    now = Deployment(state.landmarks.T, state.normals.T, state.surfaces)
    assert same(arrays_of(state), arrays_of(field.state(now)))
    units = evaluator.units(now.positions[None], now.normals[None], n)[0]
    np.testing.assert_array_equal(state.units[field.index_of], units)
    counts = counts_of(state, evaluator.axes.shape[1])[field.index_of][:, scene.orientations.index_of]
    np.testing.assert_array_equal(counts, reference.counts(scene, now))


@examples(60)
@given(data=st.data(), case=rig_scenes_with_deployments(), n=st.integers(1, 4), seed=seeds)
def test_after_any_moves_a_rig_counts_what_the_reference_counts(data, case, n, seed):
    scene, deployment = case
    check(scene, deployment, data.draw(deployments(scene.room, most=8)), n, seed)


@examples(30)
@given(data=st.data(), case=rig_scenes_with_deployments(fiducial=True), n=st.integers(1, 3), seed=seeds)
def test_after_any_moves_of_tags_a_rig_counts_what_the_reference_counts(data, case, n, seed):
    scene, deployment = case
    check(scene, deployment, data.draw(deployments(scene.room, most=8)), n, seed)


@examples(20)
@given(rig=rigs(), n=st.integers(1, 3), seed=seeds)
def test_among_obstacles_too(rig, n, seed):
    rng, room = np.random.default_rng(seed), lab(spacing=1.0)
    scene = Scene(room, rig, level_flight(3), Visibility(thold=0.1))
    deployment, targets = (RandomDeployment(count).draw(room, rng) for count in (12, 8))
    check(scene, deployment, targets, n, seed)
