"""What the cameras of a rig tell of landmarks, each seen from all positions of an evaluator at once."""

from typing import NamedTuple

import numpy as np
from numba import literal_unroll

from lmd.core.bits import ZERO
from lmd.core.checks import FloatArray
from lmd.core.compiled import inner
from lmd.objectives.localisation.body import gain_of
from lmd.objectives.localisation.slots import add_landmark
from lmd.scene.deployment import Deployment
from lmd.sight.evaluator import Evaluator
from lmd.sight.station_views import seen_by
from lmd.sight.stations import Part, each_mount


class Looks(NamedTuple):
    """What the M cameras of a part cover of K landmarks: sets of orientations, `(M, P, K, W)`; gain: see `gain_of`."""

    part: Part
    gain: float
    sets: np.ndarray


def looks_of(
    evaluator: Evaluator, parts: tuple[Part, ...], positions: FloatArray, deployment: Deployment
) -> tuple[Looks, ...]:
    """What the parts of a rig, of the evaluator's or variants of them, cover from positions of the body, `(P, 3)`."""
    args = evaluator.scene.room.blockers(), positions, deployment.positions, deployment.normals
    sets = [[seen_by((mount,), *args, np.zeros(len(deployment))) for mount in each_mount(part)] for part in parts]
    return tuple(map(Looks, parts, gains_of(evaluator), map(np.stack, sets)))


def gains_of(evaluator: Evaluator) -> list[float]:
    """`gain_of` the cameras of each part of a rig, in the order of `stations.parts_of`."""
    cameras = evaluator.scene.cameras
    return [gain_of(kind, cameras[0]) for kind in dict.fromkeys(cameras)]


@inner
def _seen(looks, p, k, w):
    """See `seen_by_any`, of a part."""
    seen = ZERO
    for m in range(len(looks.sets)):
        seen |= looks.sets[m, p, k, w]
    return seen


@inner
def _add(looks, p, k, w, place, pose, precision, slots, count):
    """See `add_of_all`, of a part."""
    for m in range(len(looks.sets)):
        seen = looks.sets[m, p, k, w]
        if seen:
            add_landmark(looks.part, m, w, seen, place, pose, k, 1.0, looks.gain, precision, slots, count)


@inner
def seen_by_any(every, p, k, w):
    """The orientations of word w with which some camera covers landmark k from position p."""
    seen = ZERO
    for looks in literal_unroll(every):
        seen |= _seen(looks, p, k, w)
    return seen


@inner
def add_of_all(every, p, k, w, place, pose, precision, slots, count):
    """Add what landmark k, with its `pose`, tells all cameras with the body at `place`, position p: `add_landmark`."""
    for looks in literal_unroll(every):
        _add(looks, p, k, w, place, pose, precision, slots, count)
