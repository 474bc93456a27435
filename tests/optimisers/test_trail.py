import numpy as np
import pytest

from lmd.optimisers.annealing.trail import AVERAGING_ETA, RESTART_M, Trail
from lmd.scene.deployment import Deployment


def at(positions, surfaces=(0, 1)):
    return Deployment(np.array(positions, dtype=float), np.tile([0.0, 0.0, 1.0], (2, 1)), np.array(surfaces))


def test_the_mean_is_that_of_polynomial_decay():
    rng = np.random.default_rng(0)
    places = rng.uniform(0.0, 0.2, (20, 2, 3))
    trail, weights = Trail(at(places[0])), np.zeros(20)
    for t, place in enumerate(places, start=1):
        mean = trail.add(at(place))
        rate = (AVERAGING_ETA + 1.0) / (t + AVERAGING_ETA)
        weights *= 1.0 - rate
        weights[t - 1] = rate
    np.testing.assert_allclose(mean.positions, np.tensordot(weights, places, axes=1))
    assert weights.sum() == pytest.approx(1.0)
    assert weights[15:].sum() > 0.5


def test_it_is_nearer_to_the_middle_than_a_noisy_walk():
    rng = np.random.default_rng(1)
    middle = rng.uniform(0.0, 5.0, (2, 3))
    trail, errors = Trail(at(middle)), []
    for _ in range(200):
        here = at(middle + rng.normal(0.0, 0.05, (2, 3)))
        errors.append([np.abs(d.positions - middle).mean() for d in (here, trail.add(here))])
    walked, mean = np.mean(errors[100:], axis=0)
    assert mean < walked / 3.0


def test_a_landmark_that_jumps_begins_anew():
    trail = Trail(at([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0]]))
    for _ in range(5):
        trail.add(at([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0]]))
    far = trail.add(at([[0.1, 0.0, 0.0], [1.0 + 1.1 * RESTART_M, 0.0, 0.0]]))
    assert 0.0 < far.positions[0, 0] < 0.1
    assert far.positions[1, 0] == 1.0 + 1.1 * RESTART_M
    other = trail.add(at([[0.2, 0.0, 0.0], [1.7, 0.0, 0.0]], surfaces=(3, 1)))
    assert other.positions[0, 0] == 0.2
    assert other.surfaces[0] == 3
    assert 1.0 + 1.1 * RESTART_M < other.positions[1, 0] < 1.7
