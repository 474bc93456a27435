"""Covariances that estimators state, against their errors on flights."""

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.stats import chi2
from test_fusion import DRIFT, FLIGHTS, TAG, recorded, start_of

from lmd.estimation.estimators import squares
from lmd.estimation.fusion import FixedLagSmoother
from lmd.estimation.pnp import PerspectiveNPoint
from lmd.estimation.sensors import TagDetector
from lmd.geometry import se3

pytest.importorskip("gtsam")


def test_squares_of_drawn_errors_are_chi_square():
    rng = np.random.default_rng(0)
    root = rng.normal(size=(6, 6)) * 0.01
    covariance, true = root @ root.T, se3.exp(rng.normal(size=(4000, 6)))
    estimates = [(pose @ se3.exp(-root @ rng.normal(size=6)), covariance) for pose in true]
    estimates[7] = (np.full((4, 4), np.nan), covariance)
    found = squares(estimates, true)
    assert np.isnan(found[7]).all()
    for i, degrees in enumerate((6, 3, 3)):
        low, high = chi2.ppf([0.005, 0.995], degrees * 3999)
        assert low < np.nansum(found[:, i]) < high
        assert_allclose(np.nanquantile(found[:, i], 0.9), chi2.ppf(0.9, degrees), rtol=0.05)


def test_smoother_and_pnp_state_covariances_of_the_right_size():
    """Corners with errors as assumed; 2 s, most of it the smoother's."""
    recording = recorded(TagDetector(TAG, "aruco"), DRIFT, FLIGHTS[:3])
    start = start_of(recording, 0.05)
    smoother, pnp = FixedLagSmoother(0.05, 0.05), PerspectiveNPoint()
    for estimator, most in ((smoother, 2.0), (pnp, 2.5)):
        found = np.concatenate([
            squares(list(estimator.run(recording, s, start[s])), recording.poses[s])[::5] for s in range(3)
        ])  # fmt: skip
        assert 0.5 < np.nanmedian(found[:, 0]) / chi2.median(6) < most
        errors = estimator.errors(recording, start)
        assert_allclose(errors.squares[2, ::5], found[-len(errors.squares[2, ::5]) :])
