"""Checks of glTF for which its reader, trimesh, has no sentence.

trimesh leaves out sparse accessors and fans, takes integers that represent fractions for metres, ignores extensions
that place or compress triangles, and makes arrays as large as the header says before it looks at the data.
"""

import json
from pathlib import Path
from typing import Any

from lmd.core.checks import InputError, bounded

TEXT = ".gltf"
# Greatest number of levels of nodes; of nodes and of pieces, where a building has 10,000; and numbers in a value of
# each type.
DEEPEST_LEVEL, MOST_NODES = 32, 50_000
NUMBERS_OF_TYPE = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT2": 4, "MAT3": 9, "MAT4": 16}
FAN = 6  # mode of triangles that share their first corner
# Extensions that a file may require without effect on the places of triangles.
HARMLESS = (
    "KHR_mesh_quantization",
    *("KHR_materials_", "KHR_texture_", "KHR_lights_", "KHR_xmp", "KHR_animation_", "EXT_texture_", "EXT_lights_"),
)


def check_gltf(file: Path, content: bytes, most: int) -> None:
    """Raise `InputError` for a glTF that trimesh would read wrongly, that needs other files, or that is too large.

    All data must be in the named file, as a later run identifies the room by the content of that file.

    Args:
        file: path of the file, for its suffix and messages.
        content: content of the file.
        most: greatest number of triangles.

    Raises:
        ValueError, TypeError, KeyError, IndexError, AttributeError: the file is damaged.
    """
    size = int.from_bytes(content[12:16], "little")
    header = json.loads(content if file.suffix.lower() == TEXT else content[20 : 20 + size])
    source, accessors, nodes = f"path: {str(file)!r}", header.get("accessors", []), header.get("nodes", [])
    for buffer in header.get("buffers", []):
        if not buffer.get("uri", "data:").startswith("data:"):
            where = f"path = {str(file)!r} has its triangles in {buffer['uri']!r}"
            raise InputError(f"{where}; save it as one file, .glb with everything in it.", "path")
    meshes = [mesh["primitives"] for mesh in header.get("meshes", [])]
    for name, number in (("nodes", len(nodes)), ("pieces of meshes", sum(map(len, meshes)))):
        bounded(name, number, MOST_NODES, source, "path")
    if told := _unread(header, [piece for mesh in meshes for piece in mesh]):
        how = f"`gltf-transform {'dequantize' if 'integers' in told else 'cp'} {file.name} plain.glb` makes one that is"
        raise InputError(f"{source} {told}, which is not read; {how}, or an import and an export in Blender.", "path")
    counts = [part["count"] for part in accessors]
    if not all(isinstance(count, int) and count >= 0 for count in counts):
        raise ValueError("an accessor has a count that is none")
    numbers = sum(count * NUMBERS_OF_TYPE[part["type"]] for count, part in zip(counts, accessors, strict=True))
    if numbers > len(content):
        raise InputError(f"{source}, of {len(content)} bytes, asks for {numbers:.4g} numbers.", "path")
    _check_tree([node.get("children", []) for node in nodes])
    read = [[i for part in mesh for i in (part["attributes"]["POSITION"], part.get("indices"))] for mesh in meshes]
    corners = [sum(counts[i] for i in mesh if i is not None) for mesh in read]
    placed = sum(corners[node["mesh"]] for node in nodes if "mesh" in node)
    # trimesh also makes meshes that no node places.
    bounded("triangles", float(max(placed, sum(corners)) / 3), most, source, "path")


def _unread(header: dict[str, Any], pieces: list[dict[str, Any]]) -> str:
    """Feature of a glTF that trimesh does not read; empty if there is none."""
    instanced = "EXT_mesh_gpu_instancing"
    needed = [str(name) for name in header.get("extensionsRequired", [])]
    needed += [instanced for node in header.get("nodes", []) if instanced in node.get("extensions", {})]
    for name in needed:
        if not name.startswith(HARMLESS):
            return f"{'is compressed' if 'compression' in name else 'needs an extension'} ({name})"
    accessors = header.get("accessors", [])
    if FAN in [piece.get("mode") for piece in pieces]:
        return "has fans of triangles"
    if any("sparse" in part for part in accessors):
        return "has sparse accessors"
    fractions = any(accessors[piece["attributes"]["POSITION"]].get("normalized") for piece in pieces)
    return "has corners as fractions in integers" if fractions else ""


def _check_tree(children: list[list[int]]) -> None:
    """Raise `ValueError` if the nodes form no tree, or a tree with too many levels."""
    parents = {child: node for node, theirs in enumerate(children) for child in theirs}
    if len(parents) < sum(map(len, children)):
        raise ValueError("a node has two parents")
    for node in range(len(children)):
        above, depth = parents.get(node), 0
        while above is not None:
            above, depth = parents.get(above), depth + 1
            if depth > DEEPEST_LEVEL:
                raise ValueError(f"its nodes are nested more than {DEEPEST_LEVEL} deep")
