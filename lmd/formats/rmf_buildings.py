"""Buildings of Open-RMF's traffic editor: `building.yaml`.

Source: `building_map` of rmf_building_map_tools. Vertices are pixels with y down; the scale is the mean over the
measurements.
"""

from collections.abc import Mapping
from typing import Any

import numpy as np

from lmd.core.checks import FloatArray, InputError, choice, real, said_of
from lmd.formats.plans import ReadPlan
from lmd.formats.registry import File
from lmd.formats.wall_lines import Drawing, plan_of

# Sign of y in each supported coordinate system, and True if its unit is the metre.
SYSTEMS = {"reference_image": (-1.0, False), "cartesian_meters": (1.0, True)}


def read_building(file: File) -> ReadPlan:
    """Read the room on a level of a building, in the frame that Open-RMF gives the level.

    Args:
        file: `building.yaml`; its `asked` has `layers` (name of the level), `gap` and `start` (see `read_plan_room`).

    Raises:
        InputError: a value is missing or wrong, the level is not known, or its walls enclose no room.
    """
    with said_of(f"path: {str(file.path)!r}", "path", ("layers",)):
        try:
            drawing = _level(file, file.keys)
        except (KeyError, IndexError, TypeError, ValueError, AttributeError) as error:
            if isinstance(error, InputError):
                raise
            raise InputError(f"the key or value {' '.join(str(error).split())} is missing or wrong.") from None
    return plan_of(file, drawing)


def _level(file: File, keys: Mapping[str, Any]) -> Drawing:
    import shapely

    levels, asked = keys["levels"], file.asked["layers"]
    names = list(levels) if asked is None else list(asked)
    if len(names) != 1:
        raise InputError(f"layers must name one level of {str(file.path)!r}, which has {', '.join(levels)}.", "layers")
    level = levels[choice("layers", names[0], list(levels))]
    system = str(keys.get("coordinate_system", "reference_image"))
    if system not in SYSTEMS:
        raise InputError(f"its coordinate_system is {system}, and {', '.join(SYSTEMS)} are read.")
    sign, is_metric = SYSTEMS[system]
    vertices = np.array([[real("vertices", at[0]), sign * real("vertices", at[1])] for at in level["vertices"]])
    scale = 1.0 if is_metric else _scale(level.get("measurements") or [], vertices)
    walls, doors = (
        [scale * vertices[[int(edge[0]), int(edge[1])]] for edge in level.get(name) or []]
        for name in ("walls", "doors")
    )
    walls = [wall for wall in walls if (wall[0] != wall[1]).any()]
    if not walls:
        raise InputError(f"its level {names[0]} has no walls.")
    boxes = [("door", shapely.box(*door.min(axis=0), *door.max(axis=0))) for door in doors]
    own = len(levels) > 1 and names[0] != next(iter(levels))
    note = f"coordinates are those of the drawing of {names[0]}, which fiducials may move" if own else ""
    return Drawing(shapely.MultiLineString(walls), shapely.MultiLineString(doors), boxes, f"{scale:.4g} m", note)


def _scale(measurements: list[Any], vertices: FloatArray) -> float:
    """Metres per pixel."""
    if not measurements:
        raise InputError("it has no measurement, which gives the scale: add one in the traffic editor.")
    ratios = []
    for start, stop, keys in measurements:
        length = float(np.linalg.norm(vertices[int(start)] - vertices[int(stop)]))
        ratios.append(real("distance", keys["distance"][1], above=0.0) / real("length", length, above=0.0))
    return float(np.mean(ratios))
