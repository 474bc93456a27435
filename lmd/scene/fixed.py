"""Fixed landmarks, which exist already, combined with the landmarks to place."""

from dataclasses import replace

import numpy as np

from lmd.core.checks import InputError
from lmd.scene.deployment import Deployment
from lmd.scene.labels import Labels
from lmd.space.surface import NEAR_SURFACE

COLUMN = "fixed"  # column in a file of landmarks: 1 for fixed landmarks, 0 for others


def beside(fixed: Deployment, others: Deployment) -> Deployment:
    """Concatenate the fixed landmarks and the others; ids and columns are kept, and the column `COLUMN` is added.

    Others without labels get the smallest unused ids. `others` may include fixed landmarks, identified by their ids;
    these are dropped from `others`.

    Args:
        fixed: F landmarks with known surfaces.
        others: N landmarks with known surfaces.

    Raises:
        InputError: a fixed landmark and another landmark have one id and different positions, or all `others` are
            fixed.
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
