"""What the cameras of a rig tell of landmarks, each seen from all positions of an evaluator at once."""

from typing import NamedTuple

import numpy as np
from numba import literal_unroll

from lmd.core.bits import ZERO
from lmd.core.checks import FloatArray
from lmd.core.compiled import inner
from lmd.objectives.localisation.body import gain_of
from lmd.objectives.localisation.slots import Mounts, add_landmark, add_up
from lmd.scene.deployment import Deployment
from lmd.sight.evaluator import Evaluator
from lmd.sight.mounts import Part
from lmd.sight.rig_sets import seen_by_each


class Looks(NamedTuple):
    """What the M cameras of a part cover of K landmarks: sets of orientations, `(M, P, K, W)`."""

    mounts: Mounts
    sets: np.ndarray


def looks_of(
    evaluator: Evaluator, parts: tuple[Part, ...], positions: FloatArray, deployment: Deployment
) -> tuple[Looks, ...]:
    """What the parts of a rig, of the evaluator's or variants of them, cover from positions of the body, `(P, 3)`."""
    args = evaluator.scene.room.blockers(), positions, deployment.positions, deployment.normals
    return tuple(map(Looks, mounts_of(evaluator, parts), [seen_by_each(part, *args) for part in parts]))


def mounts_of(evaluator: Evaluator, parts: tuple[Part, ...]) -> tuple[Mounts, ...]:
    """The mounts of the parts of a rig, of the evaluator's or variants of them."""
    cameras = evaluator.scene.cameras
    each = enumerate(zip(parts, dict.fromkeys(cameras), strict=True))
    return tuple(Mounts(j, p.sight, p.offsets, p.axes, gain_of(kind, cameras[0])) for j, (p, kind) in each)


@inner
def _seen(looks, p, k, w):
    """See `seen_by_any`, of a part."""
    seen = ZERO
    for m in range(len(looks.sets)):
        seen |= looks.sets[m, p, k, w]
    return seen


@inner
def _add(looks, p, which, w, place, tags, precision, slots):
    """See `add_of_all`, of a part."""
    for k in which:
        tag = (
            tags[k, 0], tags[k, 1], tags[k, 2], tags[k, 3], tags[k, 4], tags[k, 5], tags[k, 6], tags[k, 7], tags[k, 8]
        )  # fmt: skip
        for m in range(len(looks.sets)):
            add_landmark(looks.mounts, m, w, looks.sets[m, p, k, w], place, tag, 1.0, precision, slots)


@inner
def seen_by_any(every, p, k, w):
    """The orientations of word w with which some camera covers landmark k from position p."""
    seen = ZERO
    for looks in literal_unroll(every):
        seen |= _seen(looks, p, k, w)
    return seen


@inner
def add_of_all(every, p, which, w, place, tags, precision, slots):
    """Add what those landmarks of `tags` that are in `which` tell all cameras, the body at `place`, position p."""
    for looks in literal_unroll(every):
        _add(looks, p, which, w, place, tags, precision, slots)
    add_up(precision, slots)
