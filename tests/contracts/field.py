"""What an incremental field promises: moves are tried, carried out and taken back to the bit."""

import numpy as np

from lmd.incremental.field import ACCEPT, BOUND, NO_UNITS, SETTLE, UNDO, Places, perform, placed, runner
from lmd.objectives.reference_field import field_of
from lmd.sight.evaluator import Evaluator
from lmd.sight.kernels import PROBABILITY_ONE


def check_field(objective, scene, deployment, targets, rng):
    """Move random landmarks of a deployment to `targets`, one after the other, as `annealing` does.

    A bound is no lower than the settled values, a trial leaves the state as it was, a move that is carried out has the
    values it promised, and one that is taken back leaves no trace. In the end the state equals one that is built anew
    and its values those of a full evaluation.

    Args:
        objective: its field at the positions of the scene is checked.
        scene: where the landmarks hang.
        deployment: K landmarks to begin with.
        targets: poses to move to.
        rng: chooses the landmarks, and what becomes of each move.

    Returns:
        the deployment after the moves that were carried out.
    """
    evaluator = Evaluator(scene, threads=1)
    field = field_of(objective, evaluator)
    state = field.state(deployment)
    scratch = field.scratch(state)
    for pose in poses_of(targets):
        k, end, before = int(rng.integers(len(deployment))), rng.choice(["dropped", "kept", "undone"]), copied(state)
        bound(field, k, pose, -1, state, scratch)
        most = scratch.units.copy()
        if end == "dropped" and rng.random() < 0.5:
            continue
        settle(field, k, state, scratch)
        settled = scratch.units.copy()
        assert (settled <= most).all(), "the bound is lower than a settled value"
        assert_same(state, before, "a trial changed the state")
        if end != "dropped":
            accept(field, k, state, scratch)
            np.testing.assert_array_equal(state.units, settled, "a move has other values than its trial")
        if end == "undone":
            undo(field, k, state, scratch)
            assert_same(state, before, "a move that is taken back left a trace")
    check_undone_together(field, state, targets)
    return check_rebuilt(objective, evaluator, field, state)


def check_undone_together(field, state, targets):
    """Up to three moves, two of them of the same landmark, are taken back one after the other."""
    done = []
    for i, pose in enumerate(poses_of(targets)[:3]):
        k, scratch, before = i % 2 % len(placed(state).surfaces), field.scratch(state), copied(state)
        move(field, k, pose, -1, state, scratch)
        done.append((k, scratch, before))
    for k, scratch, before in reversed(done):
        undo(field, k, state, scratch)
        assert_same(state, before, "moves that are taken back one after the other left a trace")


def check_rebuilt(objective, evaluator, field, state):
    """A state equals one that is built anew, and its values a full evaluation; returns its deployment."""
    known = placed(state)
    now = Places(known.poses, known.surfaces).deployment()
    assert_same(field.state(now), copied(state), "the state differs from one that is built anew")
    values = objective.values(evaluator, now.positions[None], now.normals[None])[0]
    np.testing.assert_array_equal(state.units[field.index_of] / PROBABILITY_ONE, values)
    return now


def poses_of(deployment):
    """Positions and normals, `(K, 6)`."""
    return np.hstack([deployment.positions, deployment.normals])


def copied(state):
    """Copies of all arrays of a state, those of its parts among them."""
    if isinstance(state, np.ndarray):
        return [state.copy()]
    return [array for part in state for array in copied(part)] if isinstance(state, tuple) else []


def assert_same(state, before, message):
    for array, was in zip(copied(state), before, strict=True):
        if array.tobytes() != was.tobytes():  # in a tenth of the time
            np.testing.assert_array_equal(array, was, message)


def _step(which, field, k, state, scratch, pose=(0.0,) * 6, surface=-1):
    """By `perform`, so that a field is compiled once for all tests; layers share the memory of the scratch."""
    steps, poses = np.array([(which, k, surface, 0)]), np.array([pose])
    runner(field, perform)(steps, poses, field, state, _alone(scratch), NO_UNITS)


def _alone(scratch):
    """Scratch arrays with a leading axis of length 1, the axis of `layers`."""
    if isinstance(scratch, tuple):
        return type(scratch)(*map(_alone, scratch)) if hasattr(scratch, "_fields") else tuple(map(_alone, scratch))
    return scratch[None]


def bound(field, k, pose, surface, state, scratch):
    _step(BOUND, field, k, state, scratch, pose, surface)


def settle(field, k, state, scratch):
    _step(SETTLE, field, k, state, scratch)


def accept(field, k, state, scratch):
    _step(ACCEPT, field, k, state, scratch)


def undo(field, k, state, scratch):
    _step(UNDO, field, k, state, scratch)


def move(field, k, pose, surface, state, scratch):
    """Move a landmark, whatever that is worth."""
    bound(field, k, pose, surface, state, scratch)
    settle(field, k, state, scratch)
    accept(field, k, state, scratch)
