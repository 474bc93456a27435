"""Rooms over floor plans from files: formats, and what a file leaves open."""

from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import Any

import numpy as np
from typing_extensions import override

from lmd.core.checks import Checked, InputError, NotNegative, Pair, Positive, file_path, real
from lmd.formats.registry import read
from lmd.formats.trees import File
from lmd.space.parts import check_metres
from lmd.space.prism import Prism, from_floor_plan
from lmd.space.wall_lines import ReadPlan

# Values of `conf/room/floor_plan.yaml`, which a file replaces.
EXAMPLE = {
    "outline": [[0, 0], [6, 0], [6, 2], [3, 2], [3, 4], [0, 4]],
    "holes": [[[1.3, 1.3], [1.7, 1.3], [1.7, 1.7], [1.3, 1.7]]],
    "keep_out": [{"name": "door", "surface": "wall_0", "from_left": [0.3, 1.2], "from_below": [0.0, 2.1]}],
}


# Tolerance of the comparison of lengths, metres.
ROUNDING_M = 1e-9


class PlanFile(File):
    """File of a floor plan; `asked` has `start`, `tolerance`, `speck`, `passage`, `layers`, `unit` and `gap`."""

    @override
    def refused(self, reason: str) -> InputError:
        return InputError(f"path: {str(self.path)!r}: {reason}.", "path")


@dataclass(frozen=True)
class Reading(Checked):
    """Settings of a floor plan's file.

    Raises:
        InputError: a setting is refused.
    """

    start: Pair | None = None
    """Point (x, y) of the file's frame in the room, metres; None for the largest region."""
    tolerance: Positive = 0.1
    """Greatest distance of a wall from the contour in the file, metres."""
    speck: NotNegative = 0.2
    """A group of cells of an occupancy grid that are not free counts as free if both its sides are shorter than this,
    metres.
    """
    passage: NotNegative = 0.3
    """Least width of the parts of an occupancy grid's free region, metres; narrower parts are left out."""
    layers: Sequence[str] | None = None
    """Names of the layers of a drawing with walls; None for the layers whose names mean walls."""
    unit: str | None = None
    """Unit of a drawing, one of `lmd.space.parts.UNITS`; None for the unit that the drawing names."""
    gap: NotNegative = 1.3
    """Widest gap between walls of a drawing that is closed, such as a door, metres."""
    least_width: NotNegative = 0.4
    """Least width of the free stretch of a wall that carries landmarks by default, metres."""


def read_plan_room(
    outline: Any = None,
    height: Any = None,
    reachable: Any = None,
    spacing: Any = None,
    path: Any = None,
    holes: Any = (),
    keep_out: Any = (),
    surfaces: Any = None,
    margin: Any = 0.0,
    **more: Any,
) -> Prism:
    """Room over a floor plan from a file or from its arguments, in the frame of the file.

    Args:
        path: file of a format of this module; None for a plan from the other arguments.
        outline, holes: see `FloorPlan`; with a `path`, None or the values of `EXAMPLE`.
        keep_out: see `FloorPlan`; with a `path`, in addition to those of the file; those of `EXAMPLE` are ignored.
        surfaces: see `FloorPlan`; with a `path`, None for all walls with a free stretch of `least_width`.
        height, margin, reachable, spacing: see `FloorPlan` and `Prism`.
        more: fields of `Reading`, and further arguments of `from_floor_plan`.

    Raises:
        InputError: the file or a value is refused.
    """
    names = {field.name for field in fields(Reading)}
    asked, plan = ({name: more[name] for name in more if (name in names) == of_file} for of_file in (True, False))
    if path is None:
        if outline is None:
            raise InputError("path is missing: a file with a floor plan is needed, such as map.yaml.", "path")
        plan |= {"holes": holes, "keep_out": keep_out, "surfaces": surfaces, "margin": margin}
        return from_floor_plan(outline, height, reachable, spacing, **plan)
    for name, value in (("outline", outline), ("holes", holes)):
        if value not in (None, (), [], EXAMPLE[name]):
            raise InputError(f"{name} and path are both given: leave out {name}, or take path=null.", name)
    reading, height, margin = Reading(**asked), real("height", height, above=0.0), real("margin", margin, low=0.0)
    found: ReadPlan = read("floor plan", PlanFile(file_path("path", path), asked=vars(reading)))
    size = [*np.ptp(found.rings[0], axis=0), height]
    check_metres(size, f"path: {str(path)!r} with {found.scale} makes", "check its unit", "path")
    walls, parts = _walls(found, height, margin, reading.least_width)
    if surfaces is None and not walls:
        raise InputError(f"path: {str(path)!r} has no wall with a free stretch of {reading.least_width:g} m.", "path")
    outer, *inner = [ring.tolist() for ring in found.rings]
    plan |= {"holes": inner, "surfaces": walls if surfaces is None else surfaces, "margin": margin}
    plan["keep_out"] = [*parts, *([] if keep_out == EXAMPLE["keep_out"] else keep_out)]
    return from_floor_plan(outer, height, reachable, spacing, path=str(path), note=found.note, **plan)


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
