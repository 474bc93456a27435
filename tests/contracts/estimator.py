"""What an estimator promises."""

from dataclasses import fields, replace

import numpy as np
from support.paper import paper_scene

from lmd.estimation.flights import Pace, RandomMotion
from lmd.estimation.recording import Flight, Odometry, record
from lmd.estimation.sensors import PointDetector
from lmd.geometry import se3
from lmd.scene.deployment_sources import UniformDeployment
from lmd.sight.evaluator import Evaluator

SECONDS, RATE = 3.0, 20.0  # of the flights; frames per second
NEAR = 0.02  # metres and rad, about, from the true pose to the first estimate


def check_estimator(estimator):
    """Check the errors of an estimator on two flights through the paper's room.

    They have a value for each frame of each run, are not negative, and missing in all figures where they are in one.
    Runs do not depend on each other, and the recording stays as it is. Errors are small where everything is exact.

    Args:
        estimator: a `lmd.estimation.estimators.Estimator`.
    """
    recording = flown(PointDetector(pixel_noise=0.5), Odometry(0.01, 0.01))
    start = recording.poses[:, 0] @ se3.exp(np.full(6, NEAR))
    arrays = [field.name for field in fields(recording) if isinstance(getattr(recording, field.name), np.ndarray)]
    before = {name: getattr(recording, name).copy() for name in arrays}
    found = values_of(estimator.errors(recording, start))
    for name, array in before.items():
        np.testing.assert_array_equal(getattr(recording, name), array, name)
    assert found.shape == (3, *recording.poses.shape[:2])
    missing = np.isnan(found)
    np.testing.assert_array_equal(missing.all(axis=0), missing.any(axis=0))
    assert not missing.all(), "no frame has an estimate"
    assert (found[~missing] >= 0.0).all()
    np.testing.assert_array_equal(values_of(estimator.errors(recording, start)), found, "not the same again")
    alone = values_of(estimator.errors(first_run(recording), start[:1]))
    np.testing.assert_allclose(alone[:, 0], found[:, 0], rtol=1e-9, atol=1e-12)
    exact = flown(PointDetector(), Odometry())
    _, position, attitude = values_of(estimator.errors(exact, exact.poses[:, 0]))
    assert np.nanmedian(position) < 1e-3
    assert np.nanmedian(attitude) < 1e-3


def flown(detector, odometry):
    """Two flights over 90 landmarks."""
    scene = paper_scene()
    landmarks, evaluator = UniformDeployment(90).draw(scene.room, np.random.default_rng(0)), Evaluator(scene, threads=1)
    motion = RandomMotion(SECONDS, Pace(1.0, 1.0, RATE))
    flights = [
        Flight(evaluator, landmarks, motion.draw(scene, np.random.default_rng(seed)), np.random.default_rng([seed, 1]))
        for seed in (3, 4)
    ]
    return record(detector, flights, odometry)


def values_of(errors):
    return np.stack([errors.frobenius, errors.position, errors.attitude])


def first_run(recording):
    """The recording without the other runs."""
    detections = int(recording.seen[0].sum())
    parts = {name: getattr(recording, name)[:1] for name in ("poses", "twists", "landmarks", "seen", "points")}
    return replace(recording, noise=recording.noise[:detections], covariance=recording.covariance[:detections], **parts)
