"""What the static and the interactive scene figure share: geometry, colours and wording."""

import itertools
from pathlib import Path

import numpy as np

from lmd.checks import FloatArray
from lmd.sight.reference import BoolArray
from lmd.space.cuboid import Room

ARROW_LENGTH = 0.35  # metres, drawn along the normal of a landmark
LANDMARK = "#d62728"
ROOM = "#000000"
REACHABLE = "#8a8a8a"
QUALIFIED = "#1a9641"
UNQUALIFIED = "#9e9e9e"
COLOUR_MAP = "viridis"  # known by this name to both libraries, even in lightness, hence safe to print
AXIS_LABELS = ("x [m]", "y [m]", "z [m]")
ELEVATION, AZIMUTH = 16.0, -66.0  # of the viewer in static figures, degrees


def viewer() -> FloatArray:
    """Unit vector `(3,)` from the middle of the room towards the viewer of static figures, world frame."""
    elevation, azimuth = np.radians((ELEVATION, AZIMUTH))
    horizontal = np.cos(elevation)
    return np.array((horizontal * np.cos(azimuth), horizontal * np.sin(azimuth), np.sin(elevation)))


def box_edges(low: FloatArray, high: FloatArray) -> FloatArray:
    """The 12 edges of an axis-aligned box with corners `low` and `high` of shape `(3,)`, as `(12, 2, 3)`."""
    bits = np.array(list(itertools.product((0, 1), repeat=3)))
    pairs = [(a, b) for a, b in itertools.combinations(bits, 2) if np.abs(a - b).sum() == 1]
    return np.where(np.array(pairs) == 1, high, low)


def boxes(room: Room) -> dict[str, FloatArray]:
    """Edges `(12, 2, 3)` of the room and of its reachable area, metres."""
    return {
        "room": box_edges(np.zeros(3), np.asarray(room.size)),
        "reachable area": box_edges(room.reachable_low, room.reachable_high),
    }


def ball_scale(room: Room, count: int) -> float:
    """Factor for the diameter of one of `count` balls: at most 1, less where they are closer than in the paper."""
    spacing = np.cbrt(np.prod(room.reachable_size) / count)
    return min(1.0, float(spacing / np.linalg.norm(room.size)) / 0.046)


def colour_label(n: int) -> str:
    """What the colours of P_n mean."""
    return f"probability of seeing at least {n} landmark{'s' if n > 1 else ''}"


def qualified_labels(is_qualified: BoolArray, thold_p: float) -> tuple[str, str]:
    """Legend entries of the qualified and of the unqualified positions `(P,)`."""
    share = 100.0 * is_qualified.mean()
    return (
        f"qualified, probability ≥ {thold_p:g} ({share:.1f} %)",
        f"unqualified ({100.0 - share:.1f} %)",
    )


def shrink(path: str | Path) -> None:
    """Reduce a PNG in place to 256 colours: no difference to a figure's eye, a third of its size."""
    from PIL import Image

    with Image.open(path) as picture:
        reduced = picture.convert("RGB").quantize(256)
    reduced.save(path, optimize=True)
