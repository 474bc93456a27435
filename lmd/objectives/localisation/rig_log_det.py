"""What greedy selection climbs where a rig is localised: `log_det`, with the information of all cameras on the body."""

import math
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from numba import literal_unroll

from lmd.core.bits import ONE, ZERO, lowest
from lmd.core.checks import FloatArray
from lmd.core.compiled import inner, kernel
from lmd.core.threads import in_parts
from lmd.objectives.localisation.body import BODY_WIDTH, add_views, body_log_det, gain_of
from lmd.objectives.localisation.trial import VIEW
from lmd.scene.deployment import Deployment
from lmd.scene.scene import Scene
from lmd.sight.evaluator import Evaluator
from lmd.sight.poses import by_edge
from lmd.sight.station_views import seen_by
from lmd.sight.stations import Part, each_mount, with_sight

AT_A_TIME = 64  # poses that a thread works on at a time: what they see in all orientations is kept for so long


class Looks(NamedTuple):
    """What the M cameras of a part cover of N poses: sets of orientations, `(M, P, N, W)`; their gain see `gain_of`."""

    part: Part
    gain: float
    sets: np.ndarray


@inner
def _seen(looks, p, j, w):
    """The orientations of word w with which some camera of a part covers pose j from position p."""
    seen = ZERO
    for m in range(len(looks.sets)):
        seen |= looks.sets[m, p, j, w]
    return seen


@inner
def _add(looks, p, j, w, pose, place, precision, rows, first, row):
    """Add what pose j tells the cameras of a part to `rows`, the first orientation of word w to row `first`."""
    for m in range(len(looks.sets)):
        bits = looks.sets[m, p, j, w]
        add_views(looks.part, m, w, bits, place, pose, 0, 1.0, looks.gain, precision, rows, first, row)


@inner
def _seen_by_any(every, p, j, w):
    """The same as `_seen` of all parts."""
    seen = ZERO
    for looks in literal_unroll(every):
        seen |= _seen(looks, p, j, w)
    return seen


@inner
def _add_all(every, p, j, w, pose, place, precision, rows, first, row):
    """The same as `_add` of all parts."""
    for looks in literal_unroll(every):
        _add(looks, p, j, w, pose, place, precision, rows, first, row)


@kernel
def _gains(every, poses, prices, positions, precision, sums, known, out):
    """Write what N poses gain into `out` `(N,)`.

    Args:
        every: `Looks` of each part of the rig.
        poses: `(N, 6)`.
        prices: of positions and orientations, `(P, D)`.
        positions: of the body, `(P, 3)`.
        precision: the size of a tag.
        sums: what is known of each view, `(P D, BODY_WIDTH)`.
        known: their `body_log_det`, `(P, D)`.
    """
    words, rows, row = np.uint64(known.shape[1]) // VIEW, np.zeros((int(VIEW), sums.shape[1])), np.zeros(sums.shape[1])
    for j in range(len(out)):
        pose = poses[j, 0], poses[j, 1], poses[j, 2], poses[j, 3], poses[j, 4], poses[j, 5]
        out[j] = 0.0
        for p in range(np.uint64(len(positions))):
            place = positions[p, 0], positions[p, 1], positions[p, 2]
            for w in range(words):
                seen = left = _seen_by_any(every, p, j, w)
                if seen == ZERO:
                    continue
                while left:
                    bit = lowest(left)
                    left &= left - ONE
                    for i in range(sums.shape[1]):
                        rows[bit, i] = sums[(p * words + w) * VIEW + bit, i]
                _add_all(every, p, j, w, pose, place, precision, rows, ZERO, row)
                while seen:
                    bit = lowest(seen)
                    seen &= seen - ONE
                    a = w * VIEW + bit
                    out[j] += prices[p, a] * (body_log_det(rows, bit) - known[p, a])


@kernel
def _choose(every, poses, positions, precision, sums, known):
    """Add the only one of the poses to `sums` and `known`; args as in `_gains`."""
    words, row = np.uint64(known.shape[1]) // VIEW, np.zeros(sums.shape[1])
    pose = poses[0, 0], poses[0, 1], poses[0, 2], poses[0, 3], poses[0, 4], poses[0, 5]
    for p in range(np.uint64(len(positions))):
        place = positions[p, 0], positions[p, 1], positions[p, 2]
        for w in range(words):
            seen, first = _seen_by_any(every, p, 0, w), (p * words + w) * VIEW
            if seen:
                _add_all(every, p, 0, w, pose, place, precision, sums, first, row)
            while seen:
                bit = lowest(seen)
                seen &= seen - ONE
                known[p, w * VIEW + bit] = body_log_det(sums, first + bit)


class RigLogDeterminant:
    """See `LogDeterminant`; of a rig, whose body is known beforehand."""

    label = "mean log det of the information"

    def __init__(
        self,
        evaluator: Evaluator,
        relevance: FloatArray,
        precision: Callable[[Scene], Any],
        position: float,
        rotation: float,
    ) -> None:
        evaluator.check_memory(8 * (BODY_WIDTH + 2))
        self._evaluator, self._precision = evaluator, precision
        self._prices = relevance[:, None] / relevance.sum() * evaluator.probability
        start, cameras = np.zeros((1, BODY_WIDTH)), evaluator.scene.cameras
        start[0, [0, 3, 5]], start[0, [15, 18, 20]] = position, rotation
        self._sums = np.tile(start, (self._prices.size, 1))
        self._known = np.full(self._prices.shape, body_log_det(start, 0))
        self._gain = [gain_of(kind, cameras[0]) for kind in dict.fromkeys(cameras)]

    def _looks(self, e: Evaluator, poses: Deployment) -> tuple[Looks, ...]:
        """What the cameras cover of poses, none of which hides another, with the size of tags of an evaluator."""
        blockers, positions = e.scene.room.blockers(), e.positions
        parts = [with_sight(part, part.sight.unhidden()) for part in e.parts]
        args = blockers, positions, poses.positions, poses.normals, np.zeros(len(poses))
        sets = [np.stack([seen_by((mount,), *args) for mount in each_mount(part)]) for part in parts]
        return tuple(map(Looks, parts, self._gain, sets))

    def gains(self, poses: Deployment) -> FloatArray:
        """See `Selection.gains`."""
        gained = np.empty(len(poses))
        for e, index in by_edge(self._evaluator, poses):
            these, out, precision = poses[index], np.empty(len(index)), self._precision(e.scene)

            def job(
                first: int,
                last: int,
                e: Evaluator = e,
                these: Deployment = these,
                out: FloatArray = out,
                precision: Any = precision,
            ) -> None:
                part = these[first:last]
                there = np.hstack([part.positions, part.normals])
                known = self._prices, e.positions, precision, self._sums, self._known
                _gains(self._looks(e, part), there, *known, out[first:last])

            in_parts(e.threads, job, len(these), math.ceil(len(these) / AT_A_TIME))
            gained[index] = out
        return gained

    def add(self, pose: Deployment) -> None:
        """See `Selection.add`."""
        there = np.hstack([pose.positions, pose.normals])
        for e, _ in by_edge(self._evaluator, pose):
            _choose(self._looks(e, pose), there, e.positions, self._precision(e.scene), self._sums, self._known)
