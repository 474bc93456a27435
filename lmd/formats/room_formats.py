"""Formats of rooms, in the order in which they are tried."""

from collections.abc import Callable, Iterator
from typing import Any

from lmd.core.checks import said_of
from lmd.formats.captured_rooms import Captured, Keys, Thing, captured_by, mruk, roomplan, webxr
from lmd.formats.meshes import CAPTURED, RoomFile, triangles
from lmd.formats.registry import File, Format, anything, ends, has_keys

OUTLINE = "take the corners of the floor from it, in metres, as the outline of a floor plan (docs/rooms.md)"
MODEL = "export .glb or .obj from the program that made it, or import it into Blender and export it from there"
GRID = "the room occupancy_grid is read from map.yaml"
# Suffixes of files that are refused, and advice on a supported format.
ENDINGS = (
    ("a drawing", "the room floor_plan is read from it", (".dxf",)),
    ("a drawing", "save it as DXF, from which the room floor_plan is read", (".dwg",)),
    ("a drawing", f"{OUTLINE}: its own units are none", (".svg",)),
    ("a picture", OUTLINE, (".pdf", ".png", ".jpg", ".jpeg")),
    ("the picture of an occupancy grid", GRID, (".pgm",)),
    ("a building in IFC", "`IfcConvert plan.ifc plan.obj` of IfcOpenShell makes an .obj", (".ifc", ".ifczip")),
    (
        "a scene in USD",
        "RoomPlan also gives its CapturedRoom as .json, and Blender imports USD and exports .glb",
        (".usdz", ".usd", ".usda", ".usdc"),
    ),
    ("a file of polygons", f"{OUTLINE}; degrees are no metres", (".geojson", ".topojson")),
    ("a model", MODEL, (".dae", ".fbx", ".3ds", ".blend", ".x3d", ".wrl", ".3mf", ".off")),
    ("a model", "export .glb, .obj or .stl from the program that made it", (".skp", ".rvt", ".max", ".3dm")),
    ("a CAD model", "export .obj or .stl from FreeCAD", (".stp", ".step", ".igs", ".iges", ".fcstd")),
    (
        "a cloud of points",
        "make a mesh of it in MeshLab or CloudCompare, and flatten its walls",
        (".las", ".laz", ".e57", ".pcd", ".pts", ".ptx", ".xyz"),
    ),
    ("a home of Sweet Home 3D", "export its 3D view to OBJ, in centimetres: a scale of 0.01", (".sh3d",)),
    ("a world of Gazebo", "name the mesh that it places, or export it as .glb", (".world", ".sdf", ".urdf")),
)
POLYGONS = ("FeatureCollection", "Feature", "Polygon", "MultiPolygon", "GeometryCollection", "Topology")


def _refused(recognises: Callable[[Any], bool], why_not: str | Callable[[Any], str]) -> Format:
    return Format("room", "of another program", recognises, why_not=why_not)


def _yaml(*names: str) -> Callable[[File], bool]:
    """Make a test for YAML with the given keys."""
    return lambda file: ends(".yaml", ".yml")(file) and has_keys(*names)(file)


def _captured(name: str, mark: str, reader: Callable[[Keys], Iterator[Thing]], row: str) -> Format:
    """Format of JSON that is recognised by a key that no other format has."""

    def read_captured(file: RoomFile) -> Captured:
        with said_of(f"path: {str(file.path)!r}", "path"):
            return captured_by(reader, file.keys)

    return Format("room", name, has_keys(mark), read_captured, row=row)


def _is_structure(file: File) -> bool:
    rooms = file.keys.get("rooms")
    return (
        isinstance(rooms, list) and "walls" not in file.keys and any("walls" in r for r in rooms if isinstance(r, dict))
    )


def _is_sweet_home(file: File) -> bool:
    walls = file.keys.get("walls")
    first = walls[0] if isinstance(walls, list) and walls else {}
    return isinstance(first, dict) and {"xStart", "yStart"} <= first.keys()


def _is_blueprint(file: File) -> bool:
    plan = file.keys.get("floorplan")
    return isinstance(plan, dict) and "corners" in plan


FORMATS = (
    *(_refused(ends(*suffixes), f"this is {kind}: {way}") for kind, way, suffixes in ENDINGS),
    _refused(_yaml("image", "resolution"), f"this is the map of an occupancy grid: {GRID}"),
    _refused(_yaml("levels"), "this is a building of Open-RMF: the room floor_plan is read from it"),
    Format(
        "room",
        "triangles",
        ends(".gltf", ".glb", ".obj", ".stl", ".ply"),
        triangles,
        row="glTF (`.gltf`, `.glb`), OBJ, STL, PLY | modelling programs, scans of phones",
    ),
    _refused(lambda file: file.suffix != CAPTURED, ""),
    _refused(
        _is_structure,
        lambda file: (
            f"it is a CapturedStructure of RoomPlan's with {len(file.keys['rooms'])} rooms: "
            "`jq '.rooms[0]' structure.json > one.json` saves the first"
        ),
    ),
    _refused(
        _is_sweet_home, f"it has the walls of Sweet Home 3D, in centimetres: export its 3D view to OBJ, or {OUTLINE}"
    ),
    _refused(_is_blueprint, f"it is a plan of Blueprint3D, in centimetres: {OUTLINE}"),
    _refused(
        lambda file: file.keys.get("type") in POLYGONS, f"it has polygons in GeoJSON: {OUTLINE}; degrees are no metres"
    ),
    _refused(
        lambda file: has_keys("asset", "meshes")(file) or has_keys("asset", "scenes")(file),
        "it is a glTF: let its name end in .gltf",
    ),
    _refused(
        lambda file: has_keys("metadata", "geometries")(file) or has_keys("metadata", "object")(file),
        "it is a scene of three.js: open it in its editor and export .glb",
    ),
    _refused(has_keys("levels"), "it is a building of Open-RMF: the room floor_plan is read from building.yaml"),
    _captured(
        "WebXR", "spatialEntities", webxr, "WebXR scene (JSON) | a Quest, as Immersive Web Emulation Runtime saves it"
    ),
    _captured("MRUK", "Rooms", mruk, "Meta MRUK (JSON) | Unity; the only one of its `Rooms`"),
    _captured("RoomPlan", "walls", roomplan, "`CapturedRoom` (JSON) | Apple RoomPlan"),
    _refused(
        anything,
        lambda file: (
            "it is no room of a headset or a phone that is known here (spatialEntities, Rooms, walls): it has "
            f"{', '.join(file.keys)[:200] or 'no keys'} (docs/rooms.md)"
        ),
    ),
)
