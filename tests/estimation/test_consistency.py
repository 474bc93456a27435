"""Covariances that estimators state, against their errors on flights."""

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.stats import chi2
from test_fusion import DRIFT, FLIGHTS, TAG, recorded, start_of

from lmd.estimation.estimators import interval, squares
from lmd.estimation.fusion import FixedLagSmoother, InvariantKalmanFilter
from lmd.estimation.observer import Observer, with_covariances
from lmd.estimation.pnp import PerspectiveNPoint
from lmd.estimation.sensors import PointDetector, TagDetector
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
        low, high = interval(degrees, 3999)
        assert low < np.nanmean(found[:, i]) / degrees < high
        assert_allclose(np.nanquantile(found[:, i], 0.9), chi2.ppf(0.9, degrees), rtol=0.05)


@pytest.mark.parametrize("form", ["right", "left"])
def test_the_errors_of_the_observer_are_as_its_gains_make_them(form):
    recording = recorded(PointDetector(0.5), DRIFT, FLIGHTS[:6])
    start, observer, assumed = start_of(recording, 0.02), Observer(form), InvariantKalmanFilter(0.02, 0.02)
    runs = [list(with_covariances(observer, assumed, recording, s, start[s])) for s in range(len(start))]
    assert_allclose([[pose for pose, _ in run] for run in runs], observer.estimates(recording, start), atol=1e-9)
    found = np.stack([squares(run, true)[::20] for run, true in zip(runs, recording.poses, strict=True)])
    for i, degrees in enumerate((6, 3, 3)):
        low, high = interval(degrees, len(start))
        assert low < found[..., i].mean() / degrees < high


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
