"""Displacements of tags beside dense least squares in which the displacement is one more unknown."""

from dataclasses import replace

import numpy as np
import pytest
from support import localisations as ld

from lmd.adjust.adjustment import Adjustment
from lmd.adjust.gauge import rows_of, twists_between
from lmd.adjust.refinement import nuisances_off
from lmd.localise.changes import displacements
from lmd.localise.fixed_map import LEAST_SIGMA

TAGS, MOVED = 6, 4


def covariance_of(kind, rng):
    """Covariance of a map: tags whose errors are correlated, or exact tags in an unknown world."""
    if kind == "singular":
        common = np.tile(np.eye(6), (TAGS, 1)) * 0.01
        return common @ common.T
    half = rng.normal(size=(6 * TAGS, 6 * TAGS)) * 3e-4
    return half @ half.T + 1e-6 * np.eye(6 * TAGS)


@pytest.mark.parametrize("kind", ["correlated", "singular"])
@pytest.mark.parametrize("seed", range(2))
def test_displacements_are_those_of_generalised_least_squares(kind, seed):
    """The prior holds for the twists of trusted tags, and for u_k - t. One tag has no prior."""
    walk = ld.walked(seed, TAGS, frames=40)
    joint = covariance_of(kind, np.random.default_rng(seed))
    walk = walk._replace(known=replace(walk.known, covariance=joint))
    found, known = ld.compared(walk, (MOVED,))
    values, covariances = displacements(found, known)
    there, *_ = found.adjustment.joint_step(found.poses, found.floor, 0.0, nuisances_off(found))
    twists = twists_between(known.poses, there.tags)
    blank = replace(found.prior, joint=0.0 * found.prior.joint)
    slope, spread = found.adjustment.efficiency(found.poses, found.floor)
    alone = Adjustment(found.sightings.of(found.used), blank)
    images = alone.system(found.poses, found.floor, 0.0, slope**2 / spread).matrix
    pull = (images + found.prior.joint) @ twists.ravel()  # as the twists are those of the optimum
    assert np.isfinite(values[MOVED]).all()
    assert np.isfinite(values).all(axis=1).sum() >= 4
    for k in np.flatnonzero(np.isfinite(values[:, 0])):
        with_prior = rows_of(np.array([j for j in range(TAGS) if j in (k,) or j != MOVED]))
        select = np.zeros((len(with_prior), 6 * TAGS + 6))
        select[np.arange(len(with_prior)), with_prior] = 1.0
        select[np.isin(with_prior, rows_of(np.array([k]))), -6:] = -np.eye(6)
        stated = joint[np.ix_(with_prior, with_prior)] + LEAST_SIGMA**2 * np.eye(len(with_prior))
        whole = select.T @ np.linalg.inv(stated) @ select
        whole[:-6, :-6] += images
        expected = np.linalg.solve(whole, np.append(pull, np.zeros(6)))[-6:]
        spread = np.linalg.inv(whole)[-6:, -6:]
        root = np.linalg.inv(np.linalg.cholesky(spread))
        np.testing.assert_allclose(root @ covariances[k] @ root.T, np.eye(6), atol=5e-3)
        np.testing.assert_allclose(root @ (values[k] - expected), 0.0, atol=5e-3)
