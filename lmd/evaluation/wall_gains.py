"""What a landmark anywhere on the walls earns at most, by branch and bound on cells (`lmd.sight.poses`)."""

import heapq
import math

import numpy as np

from lmd.core.checks import FloatArray
from lmd.core.compiled import clock
from lmd.evaluation.time_limit import TimeLimit
from lmd.sight.evaluator import Evaluator
from lmd.sight.poses import Cells, gains

# Cells that branch and bound may look at, a minute or two on two cores; the bound is valid whenever it stops.
MOST_CELLS = 2_000_000
# It cuts so many cells at a time, and looks at the landmark in the centre of so many of the new ones.
BATCH, PROBES = 10_000, 500
BATCH_SHARE = 0.05  # for each batch, of the time that is left


def largest_gain(
    evaluator: Evaluator, cells: Cells, prices: FloatArray, tolerance: float, limit: TimeLimit | None = None
) -> float:
    """No flush landmark in any of the cells earns more than this; some landmark earns `tolerance` less, if time allows.

    Args:
        cells: pieces of wall.
        prices: y, `(P, D)`, not negative.
        tolerance: in units of the gain.
        limit: of the time; None for none.
    """
    limit, began = limit or TimeLimit(), clock()
    largest, looked_at = 0.0, 0
    # The most promising cells first: whenever this stops, the first on the heap bounds all that are left.
    heap: list[tuple[float, int, Cells]] = []
    while True:
        most = gains(evaluator, cells.poses, prices, cells.radius)
        looked_at += len(most)
        order = np.argsort(-most)
        largest = max(largest, float(gains(evaluator, cells.picked(order[:PROBES]).poses, prices).max()))
        order = order[most[order] > largest + tolerance]
        each = (clock() - began) / looked_at
        batch = BATCH if limit.left == math.inf else int(np.clip(BATCH_SHARE * limit.left / each / 4, 1, BATCH))
        for first in range(0, len(order), batch):
            part = order[first : first + batch]
            heapq.heappush(heap, (-float(most[part[0]]), looked_at + first, cells.picked(part)))
        if not heap or -heap[0][0] <= largest + tolerance:
            return largest + tolerance
        so_far = f"the walls after {looked_at} cells"
        if looked_at > MOST_CELLS:
            limit.cut.append(so_far)
            return -heap[0][0]
        limit.tell(f"{looked_at} cells of the walls: a landmark earns {largest:.4g} to {-heap[0][0]:.4g}")
        if not limit.leaves(4 * each * len(heap[0][2].poses), so_far):
            return -heap[0][0]
        cells = heapq.heappop(heap)[2].quarters()
