"""The formats of floor plans, in the order in which they are tried."""

from collections.abc import Callable
from typing import Any

from lmd.formats.free_region import read_map
from lmd.formats.registry import Format, anything, ends, has_keys


def _refused(recognises: Callable[[Any], bool], why_not: str) -> Format:
    return Format("floor plan", "of another program", recognises, why_not=why_not)


FORMATS = (
    _refused(
        ends(".pgm", ".png", ".bmp", ".jpg", ".jpeg"),
        "a picture has no scale and no origin: the map's .yaml, which names the picture, has both",
    ),
    _refused(
        lambda file: not ends(".yaml", ".yml")(file),
        "a floor plan is the .yaml of an occupancy grid; the room mesh is read from a model (docs/rooms.md)",
    ),
    _refused(
        has_keys("levels"),
        "it is a building of Open-RMF: rmf_building_map_tools make a world of it, of which nav2 makes a map",
    ),
    Format(
        "floor plan",
        "occupancy grid",
        lambda file: bool({"image", "resolution", "origin"} & file.keys.keys()),
        read_map,
        row="`map.yaml` with PGM, PNG or BMP | nav2, slam_toolbox, Cartographer, gmapping",
    ),
    _refused(anything, "it has none of the keys of an occupancy grid, such as image, resolution and origin"),
)
