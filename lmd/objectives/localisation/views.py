"""What views are worth: the counts and the information of their images, of one camera or of a rig."""

from typing import Any, NamedTuple

import numpy as np

from lmd.core.checks import FloatArray
from lmd.objectives.localisation.by_reference import reference_views
from lmd.objectives.localisation.kernels import localise_range
from lmd.objectives.localisation.rig import rig_views
from lmd.sight.evaluator import Evaluator
from lmd.sight.poses import CHUNKS_PER_THREAD


class Views(NamedTuple):
    """What the views of B deployments are worth at P positions: see `kernels.localise_range`."""

    covered: np.ndarray
    localised: np.ndarray
    variances: np.ndarray


def localised_views(
    evaluator: Evaluator, positions: FloatArray, normals: FloatArray, n: int, precision: Any, keep: bool = False
) -> Views:
    """Evaluate deployments; the same for any number of threads. Those of a rig are moments of all its cameras.

    Args:
        evaluator: the scene.
        positions, normals: `(B, K, 3)` landmarks of B deployments.
        n: landmarks that must be covered.
        precision: what is asked of a view besides.
        keep: whether to return the variances, `(B, P, D)`.
    """
    e, batch, size = evaluator, len(positions), len(evaluator.positions)
    if keep:
        e.check_memory(8 * batch)
    if e.by_reference:
        return Views(*reference_views(e, positions, normals, n, precision, keep))
    if e.scene.rig is not None:
        return Views(*rig_views(e, positions, normals, n, precision, keep))
    covered, localised = np.zeros((2, batch, size), dtype=np.int64)
    views = Views(covered, localised, np.empty((batch, size, e.axes.shape[1]) if keep else (0, 0, 0)))
    scene = e.batch(positions, normals)
    fixed = (*scene, n, max(positions.shape[1], n).bit_length(), precision, precision.asks, *views, keep)
    e.by_blocks(localise_range, fixed, CHUNKS_PER_THREAD)
    return views
