"""Edges of the tags of a deployment."""

import numpy as np

from lmd.core.checks import FloatArray, InputError, IntArray
from lmd.core.tables import Table

LARGEST_EDGE = 10.0  # metres, of a file: what is beyond is in millimetres
EDGE = "edge"  # the column with the edge of each tag, metres; empty where the scene's tag says it


def checked_edges(edges: FloatArray | None, ids: IntArray) -> FloatArray:
    """Edges of K tags, `(K,)`, metres, NaN for tags without an own edge; None: all of them.

    Raises:
        InputError: there are more or fewer than `ids` `(K,)`, or one is not positive.
    """
    edges = np.full(ids.shape, np.nan) if edges is None else np.array(edges, dtype=np.float64)
    if edges.shape != ids.shape:
        raise InputError(f"deployment edges must have the shape ({len(ids)},), got {edges.shape}.")
    if (wrong := np.flatnonzero((edges <= 0.0) | np.isinf(edges))).size:
        raise InputError(f"{EDGE} must be positive metres, landmark {ids[wrong[0]]} has {edges[wrong[0]]:g}.")
    edges.flags.writeable = False
    return edges


def edge_column(table: Table) -> FloatArray:
    """Edges that a file says, `(K,)`, metres, NaN where it leaves one out or has no such column.

    Raises:
        InputError: one is no number, or looks like millimetres.
    """
    if EDGE not in table:
        return np.full(len(table.lines), np.nan)
    try:
        edges = np.array([float(text or "nan") for text in table.texts[EDGE]])
    except ValueError as error:
        raise InputError(f"{table.path}: {EDGE} must be positive metres: {error}.") from None
    if (wrong := np.flatnonzero((edges > LARGEST_EDGE) & np.isfinite(edges))).size:
        place = f"{table.path} line {table.lines[wrong[0]]}"
        raise InputError(f"{place}: {EDGE} = {edges[wrong[0]]:g} looks like millimetres; edges are in metres.")
    return edges
