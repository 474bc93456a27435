"""What every model of sight must pass: all fast paths count what its reference counts."""

import numpy as np
from moves import move

from lmd.incremental.coverage_field import coverage_field
from lmd.incremental.move import counts_of, state_of
from lmd.incremental.state import scratch_of
from lmd.scene.deployment import Deployment
from lmd.sight import reference
from lmd.sight.evaluator import Evaluator
from lmd.sight.views import visible


def check_every_path(scene, deployment, targets, n, rng):
    """Counts at once, single views, and counts after moves to `targets`, each against the reference."""
    evaluator = Evaluator(scene, threads=1)
    np.testing.assert_array_equal(evaluator.counts(deployment), reference.counts(scene, deployment))
    axes = scene.orientations.axes
    for position in scene.room.grid()[:2]:
        seen = visible(evaluator, deployment, np.tile(position, (len(axes), 1)), axes)
        np.testing.assert_array_equal(seen, reference.coverage_caps(scene, deployment, position, axes))
    field = coverage_field(evaluator, n)
    state = state_of(field, deployment)
    scratch = scratch_of(state)
    for target in np.hstack([targets.positions, targets.normals]):
        move(field, int(rng.integers(len(deployment))), target, -1, state, scratch)
    now = Deployment(state.landmarks.T, state.normals.T)
    np.testing.assert_array_equal(
        state.units[field.index_of], evaluator.units(now.positions[None], now.normals[None], n)[0]
    )
    counts = counts_of(state, evaluator.axes.shape[1])[field.index_of][:, scene.orientations.index_of]
    np.testing.assert_array_equal(counts, reference.counts(scene, now))
