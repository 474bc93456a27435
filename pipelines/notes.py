"""What a command says of its problem before it begins, in notes on stderr."""

import sys
from collections import Counter
from functools import cache
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from lmd.scene.deployment import Deployment
    from lmd.scene.tag import Tag
    from lmd.space.space import Space

SAME_EDGE = 1e-6  # metres
MENTIONED = 8  # tags in a note


@cache
def note(text: str) -> None:
    """Say it, unless it is empty, once, however many problems a process builds."""
    if text:
        print(f"note: {text}", file=sys.stderr)


def note_edges(tag: "Tag", deployment: "Deployment") -> None:
    """Say how many tags have an edge of their own by their file, and which."""
    own = deployment.edges_of(tag).tolist()
    other = Counter(edge for edge in own if abs(edge - tag.size) > SAME_EDGE)
    if other and tag.edges is None:
        sizes = ", ".join(f"{edge:g} m ({count})" for edge, count in sorted(other.items()))
        holds = f"{len(own) - other.total()} of {len(own)} tags"
        note(f"tag.edge = {tag.size:g} m holds for {holds}; the others have their own: {sizes}")


def note_outside(room: "Space", tag: "Tag", deployment: "Deployment") -> None:
    """Say which landmarks have a corner behind a face of the room, be it by a rounding: nothing sees them."""
    from lmd.core.words import few
    from lmd.geometry.squares import corners

    points = corners(deployment.positions, deployment.normals, deployment.ups, deployment.edges_of(tag))
    behind = deployment.ids[~room.contains(points).all(axis=1)]
    if len(behind):
        said = few(behind, MENTIONED)
        note(f"behind a face of the {room.describe()}, where no camera sees them: {said}")
