"""Edges of the tags of a deployment."""

import numpy as np

from lmd.core.checks import FloatArray, InputError, IntArray
from lmd.core.tables import Table

LARGEST_EDGE = 10.0  # largest edge in a file, metres; larger numbers are assumed to be millimetres and refused
EDGE = "edge"  # column with the edge of each tag, metres; an empty cell means the edge of the scene's tag


def checked_edges(edges: FloatArray | None, ids: IntArray) -> FloatArray:
    """Check the edges of K tags, metres, `(K,)`; NaN for tags without their own edge.

    Args:
        edges: edges, metres, `(K,)`; None if no tag has its own edge.
        ids: ids of the tags, `(K,)`.

    Raises:
        InputError: the numbers of edges and `ids` differ, or an edge is not positive.
    """
    edges = np.full(ids.shape, np.nan) if edges is None else np.array(edges, dtype=np.float64)
    if edges.shape != ids.shape:
        raise InputError(f"deployment edges must have the shape ({len(ids)},), got {edges.shape}.")
    if (wrong := np.flatnonzero((edges <= 0.0) | np.isinf(edges))).size:
        raise InputError(f"{EDGE} must be positive metres, landmark {ids[wrong[0]]} has {edges[wrong[0]]:g}.")
    edges.flags.writeable = False
    return edges


def edge_column(table: Table) -> FloatArray:
    """Column `EDGE` of a file, metres, `(K,)`; NaN for empty cells or without the column.

    Raises:
        InputError: an edge is no number, or exceeds `LARGEST_EDGE`.
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
