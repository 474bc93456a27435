"""The edges of tags in a deployment that has tags of several sizes."""

import numpy as np

from lmd.core.checks import FloatArray, InputError, IntArray
from lmd.core.tables import Table
from lmd.scene.tag import Tag

LARGEST_EDGE = 10.0  # metres, of a file: what is beyond is in millimetres
EDGE = "edge"  # the column with the edge of each tag, metres; empty where the scene's tag says it


def checked_edges(edges: FloatArray | None, ids: IntArray) -> FloatArray | None:
    """The edges of K tags, `(K,)`, metres, NaN where a tag has none of its own; None if that is so for all.

    Raises:
        InputError: there are more or fewer than `ids` `(K,)`, or one is not positive.
    """
    if edges is None:
        return None
    edges = np.array(edges, dtype=np.float64)
    if edges.shape != ids.shape:
        raise InputError(f"deployment edges must have the shape ({len(ids)},), got {edges.shape}.")
    if (wrong := np.flatnonzero((edges <= 0.0) | np.isinf(edges))).size:
        raise InputError(f"{EDGE} must be positive metres, landmark {ids[wrong[0]]} has {edges[wrong[0]]:g}.")
    if np.isnan(edges).all():
        return None
    edges.flags.writeable = False
    return edges


def joined(parts: list[tuple[int, FloatArray | None]]) -> FloatArray | None:
    """The edges of several deployments, each with its number of tags, one after the other."""
    if all(edges is None for _, edges in parts):
        return None
    return np.hstack([with_gaps(edges, count) for count, edges in parts])


def with_gaps(edges: FloatArray | None, count: int) -> FloatArray:
    """The edges of `count` tags, `(count,)`, metres, NaN for those that have none of their own."""
    return np.full(count, np.nan) if edges is None else edges


def edges_or(edges: FloatArray | None, count: int, tag: Tag) -> FloatArray:
    """The edge of each of `count` tags, `(count,)`, metres: its own of `edges`, or else that of `tag`; 0 for points."""
    if tag.is_point:
        return np.zeros(count)
    own = with_gaps(edges, count)
    return np.where(np.isnan(own), tag.size, own)


def edge_column(table: Table) -> FloatArray | None:
    """The edges that a file says, `(K,)`, NaN where it leaves one out; None where it has no such column.

    Raises:
        InputError: one is no number, or looks like millimetres.
    """
    if EDGE not in table:
        return None
    try:
        edges = np.array([float(text or "nan") for text in table.texts[EDGE]])
    except ValueError as error:
        raise InputError(f"{table.path}: {EDGE} must be positive metres: {error}.") from None
    if (wrong := np.flatnonzero((edges > LARGEST_EDGE) & np.isfinite(edges))).size:
        place = f"{table.path} line {table.lines[wrong[0]]}"
        raise InputError(f"{place}: {EDGE} = {edges[wrong[0]]:g} looks like millimetres; edges are in metres.")
    return edges
