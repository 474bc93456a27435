"""Fixed landmarks, which hang already, beside those that are placed."""

from dataclasses import replace

import numpy as np

from lmd.core.checks import InputError
from lmd.scene.deployment import Deployment
from lmd.scene.labels import Labels
from lmd.space.surface import NEAR_SURFACE

COLUMN = "fixed"  # of a file of landmarks: 1 for those that hung already, 0 for the others


def beside(fixed: Deployment, others: Deployment) -> Deployment:
    """The fixed landmarks, then the others; all keep their ids and columns, and `fixed` says which are which.

    Others without labels get the least ids that are free. Among those of a file may be the fixed ones themselves, known
    by their ids: they are left out, and stay where `fixed` has them.

    Args:
        fixed: F landmarks, with their surfaces.
        others: N landmarks, with their surfaces.

    Raises:
        InputError: one of the others has the id of a fixed one and hangs elsewhere, or there is no other.
    """
    if others.labels is None:
        unused = np.setdiff1d(np.arange(len(fixed) + len(others)), fixed.ids)[: len(others)]
        others = replace(others, labels=Labels(unused))
    again, of, among = np.intersect1d(fixed.ids, others.ids, return_indices=True)
    away = np.linalg.norm(fixed.positions[of] - others.positions[among], axis=1)
    if (elsewhere := np.flatnonzero(away > NEAR_SURFACE)).size:
        first = elsewhere[0]
        raise InputError(
            f"fixed has a landmark {again[first]}, and so has the start, {away[first]:.4g} m away from it; ids must be "
            "different, and a file without the column id numbers its landmarks from 0.",
            "fixed",
        )
    if len(again) == len(others):
        raise InputError(f"fixed has all {len(fixed)} landmarks, which leaves none to place.", "fixed")
    others = others[np.setdiff1d(np.arange(len(others)), among)]
    assert others.labels is not None, "they were given some"
    labels = (fixed.labels or Labels(fixed.ids)) + others.labels
    marks = ["1"] * len(fixed) + ["0"] * len(others)
    labels = replace(labels, columns={**labels.columns, COLUMN: marks})
    return replace(fixed + others, labels=labels, note=others.note)
