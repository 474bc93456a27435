"""Recordings that the tests of the orientation PDF share."""

import numpy as np

from lmd.orientation.procedure import estimate_pdf
from lmd.orientation.recording import OrientationRecording, SimulatedRecording

LEVEL = {"duration": 1200.0, "rate": 10.0, "correlation_time": 1.0, "coupling": 0.0}
LEVEL |= {"yaw_mean": 0.0, "yaw_concentration": 0.0, "pitch_mean": -0.1, "pitch_std": 0.0}
MOVING = {"yaw_mean": 3.0, "yaw_concentration": 2.0, "pitch_std": 0.2}


def simulated(seed=0, **changes):
    return SimulatedRecording(**(LEVEL | changes)).record(np.random.default_rng(seed))


def estimated(recording, seed=1, **settings):
    return estimate_pdf(recording, np.random.default_rng(seed), **settings)


def independent_draws(yaw, pitch):
    """A recording whose records, one a second, have nothing to do with each other."""
    return OrientationRecording(np.arange(len(yaw)), yaw, pitch, "draws")
