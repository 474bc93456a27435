"""Formats of floor plans, in the order in which they are tried."""

from collections.abc import Callable
from typing import Any

from lmd.formats.dxf import read_drawing
from lmd.formats.free_region import read_map
from lmd.formats.registry import Format, anything, ends, has_keys
from lmd.formats.rmf_buildings import read_building


def _refused(recognises: Callable[[Any], bool], why_not: str) -> Format:
    return Format("floor plan", "of another program", recognises, why_not=why_not)


FORMATS = (
    Format("floor plan", "DXF", ends(".dxf"), read_drawing, row="DXF (`.dxf`) | AutoCAD, LibreCAD, QCAD, FreeCAD"),
    _refused(ends(".dwg"), "a .dwg is not read: save it as DXF, or convert it by ODA File Converter"),
    _refused(
        ends(".pgm", ".png", ".bmp", ".jpg", ".jpeg"),
        "a picture has no scale and no origin: the map's .yaml, which names the picture, has both",
    ),
    _refused(
        lambda file: not ends(".yaml", ".yml")(file),
        "a floor plan is a .dxf, or a .yaml of nav2 or of Open-RMF; the room mesh is read from a model (docs/rooms.md)",
    ),
    Format(
        "floor plan", "Open-RMF", has_keys("levels"), read_building, row="`building.yaml` | Open-RMF's traffic editor"
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
