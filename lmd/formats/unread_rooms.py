"""Files of rooms that are not read: their kind, and the way to one that is."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from lmd.core.checks import InputError
from lmd.core.files import read_keys

OUTLINE = "take the corners of the floor from it, in metres, as the outline of a floor plan (docs/rooms.md)"
MODEL = "export .glb or .obj from the program that made it, or import it into Blender and export it from there"
GRID = f"an occupancy grid has no walls to hang tags on; {OUTLINE}: pixels times its resolution, from its origin"
# The kind of a file and the way to one that is read, by its ending.
ENDINGS = {
    **dict.fromkeys((".dxf", ".dwg"), ("a drawing", f"{OUTLINE}, or extrude its walls in FreeCAD and export .obj")),
    ".svg": ("a drawing", f"{OUTLINE}: its own units are none"),
    **dict.fromkeys((".pdf", ".png", ".jpg", ".jpeg"), ("a picture", OUTLINE)),
    ".pgm": ("the picture of an occupancy grid", GRID),
    **dict.fromkeys(
        (".ifc", ".ifczip"), ("a building in IFC", "`IfcConvert plan.ifc plan.obj` of IfcOpenShell makes an .obj")
    ),
    **dict.fromkeys(
        (".usdz", ".usd", ".usda", ".usdc"),
        ("a scene in USD", "RoomPlan also gives its CapturedRoom as .json, and Blender imports USD and exports .glb"),
    ),
    **dict.fromkeys((".geojson", ".topojson"), ("a file of polygons", f"{OUTLINE}; degrees are no metres")),
    **dict.fromkeys((".dae", ".fbx", ".3ds", ".blend", ".x3d", ".wrl", ".3mf", ".off"), ("a model", MODEL)),
    **dict.fromkeys(
        (".skp", ".rvt", ".max", ".3dm"), ("a model", "export .glb, .obj or .stl from the program that made it")
    ),
    **dict.fromkeys((".stp", ".step", ".igs", ".iges", ".fcstd"), ("a CAD model", "export .obj or .stl from FreeCAD")),
    **dict.fromkeys(
        (".las", ".laz", ".e57", ".pcd", ".pts", ".ptx", ".xyz"),
        ("a cloud of points", "make a mesh of it in MeshLab or CloudCompare, and flatten its walls"),
    ),
    ".sh3d": ("a home of Sweet Home 3D", "export its 3D view to OBJ, in centimetres: a scale of 0.01"),
    **dict.fromkeys(
        (".world", ".sdf", ".urdf"), ("a world of Gazebo", "name the mesh that it places, or export it as .glb")
    ),
}


def refuse_ending(file: Path, endings: tuple[str, ...]) -> None:
    """Raise `InputError` for a file whose ending is none of those that are read."""
    ending = file.suffix.lower()
    kind, way = _of_yaml(file) if ending in (".yaml", ".yml") else ENDINGS.get(ending, (None, ""))
    read = f"path = {str(file)!r} must end in one of {', '.join(endings)}"
    raise InputError(f"{read}; this is {kind}: {way}." if kind else f"{read} (docs/rooms.md).", "path")


def _of_yaml(file: Path) -> tuple[str | None, str]:
    keys = read_keys(file, "path")
    if {"image", "resolution"} <= keys.keys():
        return "the map of an occupancy grid", GRID
    if "levels" in keys:
        return "a building of Open-RMF", f"{OUTLINE}: its vertices are pixels, and a measurement has their scale"
    return None, ""


def kind_of_keys(keys: Mapping[str, Any]) -> str | None:
    """The kind of a JSON file by its keys, and the way to one that is read; None if it may be one that is read."""
    rooms = keys.get("rooms")
    if isinstance(rooms, list) and "walls" not in keys and any(isinstance(r, dict) and "walls" in r for r in rooms):
        told = "it is a CapturedStructure of RoomPlan's"
        return f"{told} with {len(rooms)} rooms: `jq '.rooms[0]' structure.json > one.json` saves the first"
    walls = keys.get("walls")
    first = walls[0] if isinstance(walls, list) and walls else {}
    if isinstance(first, dict) and {"xStart", "yStart"} <= first.keys():
        return f"it has the walls of Sweet Home 3D, in centimetres: export its 3D view to OBJ, or {OUTLINE}"
    plan = keys.get("floorplan")
    if isinstance(plan, dict) and "corners" in plan:
        return f"it is a plan of Blueprint3D, in centimetres: {OUTLINE}"
    if keys.get("type") in (
        "FeatureCollection",
        "Feature",
        "Polygon",
        "MultiPolygon",
        "GeometryCollection",
        "Topology",
    ):
        return f"it has polygons in GeoJSON: {OUTLINE}; degrees are no metres"
    if "asset" in keys and ("meshes" in keys or "scenes" in keys):
        return "it is a glTF: let its name end in .gltf"
    if "metadata" in keys and ("geometries" in keys or "object" in keys):
        return "it is a scene of three.js: open it in its editor and export .glb"
    if "levels" in keys:
        return f"it is a building of Open-RMF: {OUTLINE}"
    return None
