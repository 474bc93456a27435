"""Rooms over floor plans from files, see `lmd.formats.plan_formats`."""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from typing_extensions import override

from lmd.core.checks import FloatArray, InputError, file_path, real, vector
from lmd.formats.registry import File, read
from lmd.space.parts import check_metres
from lmd.space.prism import Prism, from_floor_plan
from lmd.space.relevance import Relevance

# Values of `conf/room/floor_plan.yaml`, which a file replaces.
EXAMPLE = {
    "outline": [[0, 0], [6, 0], [6, 2], [3, 2], [3, 4], [0, 4]],
    "holes": [[[1.3, 1.3], [1.7, 1.3], [1.7, 1.7], [1.3, 1.7]]],
    "keep_out": [{"name": "door", "surface": "wall_0", "from_left": [0.3, 1.2], "from_below": [0.0, 2.1]}],
}


# Tolerance of the comparison of lengths, metres.
ROUNDING_M = 1e-9


class Stretch(NamedTuple):
    """Part of an edge of a plan where nothing hangs, such as a door."""

    ring: int
    """Index of the ring: 0 for the outline, 1 for the first hole."""
    edge: int
    """Index of the edge in its ring."""
    start: float
    """Distance from the first vertex of the edge, metres."""
    stop: float
    """Distance of the end from the first vertex, metres."""
    name: str
    """Name on drawings."""


class ReadPlan(NamedTuple):
    """Floor plan in a file."""

    rings: Sequence[FloatArray]
    """Vertices of the outline and of the holes, counter-clockwise, metres, `(N, 2)` each."""
    stretches: Sequence[Stretch]
    """Parts of the walls where nothing hangs."""
    scale: str
    """Text on the unit of the file, such as `resolution = 0.05`, for messages."""
    note: str = ""
    """Remark on omitted or ambiguous parts, a sentence; empty without a remark."""


class PlanFile(File):
    """File of a floor plan; `asked` has `start`, `tolerance`, `speck`, `passage`, `layers`, `unit` and `gap`."""

    @override
    def refused(self, reason: str) -> InputError:
        return InputError(f"path: {str(self.path)!r}: {reason}.", "path")


def read_plan_room(
    outline: Any = None,
    height: Any = None,
    reachable: Any = None,
    spacing: Any = None,
    positions: str = "cells",
    relevance: Relevance | None = None,
    path: Any = None,
    holes: Any = (),
    keep_out: Any = (),
    surfaces: Any = None,
    margin: Any = 0.0,
    start: Any = None,
    tolerance: Any = 0.1,
    speck: Any = 0.2,
    passage: Any = 0.3,
    layers: Any = None,
    unit: Any = None,
    gap: Any = 1.3,
    least_width: Any = 0.4,
    **plan: Any,
) -> Prism:
    """Room over a floor plan from a file or from its arguments, in the frame of the file.

    Args:
        path: file of one of the formats of this module; None for a plan from the other arguments.
        outline, holes: see `FloorPlan`; with a `path`, None or the values of `EXAMPLE`.
        keep_out: see `FloorPlan`; with a `path`, in addition to the keep-outs of the file, while the keep-outs of
            `EXAMPLE` are ignored.
        surfaces: see `FloorPlan`; with a `path`, None for all walls with a free stretch of `least_width`.
        height, margin, plan: see `FloorPlan`.
        reachable, spacing, positions, relevance: see `Prism`.
        start: point (x, y) of the file's frame in the room, metres; None for the largest region.
        tolerance: greatest distance of a wall from the contour in the file, metres.
        speck: a group of cells of an occupancy grid that are not free counts as free if both its sides are shorter than
            this, metres.
        passage: least width of the parts of an occupancy grid's free region, metres; narrower parts are left out.
        layers: names of the layers of a drawing with walls; None for the layers whose names mean walls.
        unit: unit of a drawing, one of `lmd.formats.dxf.UNITS`; None for the unit that the drawing names.
        gap: widest gap between walls of a drawing that is closed, such as a door, metres.
        least_width: least width of the free stretch of a wall that carries landmarks by default, metres.

    Raises:
        InputError: the file or a value is refused.
    """
    if path is None and outline is None:
        raise InputError("path is missing: a file with a floor plan is needed, such as map.yaml.", "path")
    if path is None:
        own = {"holes": holes, "keep_out": keep_out, "surfaces": surfaces, "margin": margin, **plan}
        return from_floor_plan(outline, height, reachable, spacing, positions, relevance, **own)
    for name, value in (("outline", outline), ("holes", holes)):
        if value not in (None, (), [], EXAMPLE[name]):
            raise InputError(f"{name} and path are both given: leave out {name}, or take path=null.", name)
    asked: dict[str, Any] = {
        "start": None if start is None else vector("start", start, 2),
        "layers": layers,
        "unit": unit,
    }
    asked["tolerance"] = real("tolerance", tolerance, above=0.0)
    asked |= {
        name: real(name, value, low=0.0) for name, value in (("speck", speck), ("passage", passage), ("gap", gap))
    }
    file, height, margin = file_path("path", path), real("height", height, above=0.0), real("margin", margin, low=0.0)
    found: ReadPlan = read("floor plan", PlanFile(file, asked=asked))
    check_metres(
        [*np.ptp(found.rings[0], axis=0), height],
        f"path: {str(path)!r} with {found.scale} makes",
        "check its unit",
        "path",
    )
    walls, parts = _walls(found, height, margin, real("least_width", least_width, low=0.0))
    if surfaces is None and not walls:
        raise InputError(f"path: {str(path)!r} has no wall with a free stretch of {least_width:g} m.", "path")
    rings = [ring.tolist() for ring in found.rings]
    return from_floor_plan(
        rings[0],
        height,
        reachable,
        spacing,
        positions,
        relevance,
        holes=rings[1:],
        surfaces=walls if surfaces is None else surfaces,
        keep_out=[*parts, *([] if keep_out == EXAMPLE["keep_out"] else keep_out)],
        margin=margin,
        path=str(path),
        note=found.note,
        **plan,
    )


def _walls(found: ReadPlan, height: float, margin: float, least_width: float) -> tuple[list[str], list[dict[str, Any]]]:
    """Names of the walls with a free stretch of the least width, and keep-outs as mappings of their arguments."""
    walls: list[str] = []
    parts: list[dict[str, Any]] = []
    for i, ring in enumerate(found.rings):
        lengths = np.linalg.norm(np.roll(ring, -1, axis=0) - ring, axis=1)
        for j, length in enumerate(lengths.tolist()):
            name = f"wall_{j}" if i == 0 else f"hole_{i - 1}_wall_{j}"
            spans = sorted((each.start, each.stop, each.name) for each in found.stretches if each[:2] == (i, j))
            free, reached = 0.0, margin
            for start, stop, _ in [*spans, (length - margin, length, "")]:
                free, reached = max(free, start - reached), max(reached, stop)
            if free > ROUNDING_M and free >= least_width - ROUNDING_M:
                walls.append(name)
            for start, stop, label in spans:
                # The left end of a wall, as seen from the room, is the end of an edge of the outline.
                left = [start, stop] if i else [length - stop, length - start]
                parts.append({"surface": name, "from_left": left, "from_below": [0.0, height], "name": label})
    return walls, parts
