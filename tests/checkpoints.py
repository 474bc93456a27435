"""Runs that are stopped, saved and resumed, for tests."""

import math

from lmd.optimisers.checkpoint import Checkpoint
from lmd.optimisers.ega import EGA
from lmd.optimisers.ledger import Budget

SETTINGS = {"seed": 0, "objective.n": 2, "camera.rig": [{"yaw": 0.5}], "tag": None, "room.height": math.inf}
BUDGET = 100


def stopped(optimiser, p, evaluations=BUDGET // 2):
    optimiser.run(p, Budget(BUDGET), lambda o: o.ledger.evaluations >= evaluations)
    return optimiser


def saved(directory, p):
    Checkpoint(stopped(EGA(), p), SETTINGS, "abc").save(directory)
    return directory


def resumed(directory, p, settings=SETTINGS, optimiser=None):
    checkpoint = Checkpoint(optimiser or EGA(), settings)
    checkpoint.resume(directory, p)
    return checkpoint
