"""What greedy selection climbs where a rig is localised: `log_det`, with the information of all cameras on the body."""

import math
from collections.abc import Callable
from typing import Any

import numpy as np

from lmd.core.bits import ZERO
from lmd.core.checks import FloatArray
from lmd.core.compiled import kernel
from lmd.core.threads import in_parts
from lmd.objectives.localisation.body import BODY_WIDTH, body_log_det
from lmd.objectives.localisation.looks import Looks, add_of_all, looks_of, seen_by_any
from lmd.objectives.localisation.slots import ORIENTATION, VIEW, fill_slots, give_sums, new_slots, tags_of, take_sums
from lmd.scene.deployment import Deployment
from lmd.scene.scene import Scene
from lmd.sight.evaluator import Evaluator
from lmd.sight.mounts import with_sight
from lmd.sight.poses import by_edge

AT_A_TIME = 64  # poses that a thread works on at a time: what they see in all orientations is kept for so long


@kernel
def _gains(every, tags, prices, positions, precision, sums, known, slots, out):
    """Write what N poses gain into `out` `(N,)`.

    Args:
        every: `Looks` of each part of the rig.
        tags: the poses, see `tags_of`.
        prices: of positions and orientations, `(P, D)`.
        positions: of the body, `(P, 3)`.
        precision: the size of a tag.
        sums: what is known of each view, `(P D, BODY_WIDTH)`.
        known: their `body_log_det`, `(P, D)`.
        slots: working memory.
    """
    words, which, bits = np.uint64(known.shape[1]) // VIEW, np.zeros(1, dtype=np.int64), slots.lists[ORIENTATION]
    for j in range(len(out)):
        which[0], out[j] = j, 0.0
        for p in range(np.uint64(len(positions))):
            place = positions[p, 0], positions[p, 1], positions[p, 2]
            for w in range(words):
                seen, first = seen_by_any(every, p, j, w), (p * words + w) * VIEW
                if seen == ZERO:
                    continue
                count = fill_slots(seen, precision, slots)
                take_sums(sums, first, precision, slots, count)
                add_of_all(every, p, which, w, place, tags, precision, slots)
                for v in range(count):
                    a = w * VIEW + bits[v]
                    out[j] += prices[p, a] * (body_log_det(slots.rows, v, VIEW) - known[p, a])


@kernel
def _choose(every, tags, positions, precision, sums, flat, known, slots):
    """Add the only one of the poses to `sums`, whose numbers are `flat`, and `known`; args as in `_gains`."""
    words, which, bits = np.uint64(known.shape[1]) // VIEW, np.zeros(1, dtype=np.int64), slots.lists[ORIENTATION]
    for p in range(np.uint64(len(positions))):
        place = positions[p, 0], positions[p, 1], positions[p, 2]
        for w in range(words):
            seen, first = seen_by_any(every, p, 0, w), (p * words + w) * VIEW
            if seen == ZERO:
                continue
            count = fill_slots(seen, precision, slots)
            add_of_all(every, p, which, w, place, tags, precision, slots)
            give_sums(sums, first, precision, slots, count)
            for v in range(count):
                row = np.int64((first + bits[v]) * np.uint64(BODY_WIDTH))
                known[p, w * VIEW + bits[v]] = body_log_det(flat, row, 1)


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
        start = np.zeros(BODY_WIDTH)
        start[[0, 3, 5]], start[[15, 18, 20]] = position, rotation
        self._sums = np.tile(start, (self._prices.size, 1))
        self._known = np.full(self._prices.shape, body_log_det(start, 0, 1))

    def _looks(self, e: Evaluator, poses: Deployment) -> tuple[Looks, ...]:
        """What the cameras cover of poses, none of which hides another, with the size of tags of an evaluator."""
        parts = tuple(with_sight(part, part.sight.unhidden()) for part in e.parts)
        return looks_of(e, parts, e.positions, poses)

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
                there = tags_of(precision, part.positions, part.normals)
                known = self._prices, e.positions, precision, self._sums, self._known, new_slots()
                _gains(self._looks(e, part), there, *known, out[first:last])

            in_parts(e.threads, job, len(these), math.ceil(len(these) / AT_A_TIME))
            gained[index] = out
        return gained

    def add(self, pose: Deployment) -> None:
        """See `Selection.add`."""
        sums = self._sums, self._sums.reshape(-1)
        for e, _ in by_edge(self._evaluator, pose):
            precision = self._precision(e.scene)
            tags = tags_of(precision, pose.positions, pose.normals)
            _choose(self._looks(e, pose), tags, e.positions, precision, *sums, self._known, new_slots())
