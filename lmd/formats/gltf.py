"""glTF: checks before triangles are read, and conversion of integer coordinates that represent fractions."""

import base64
import json
from pathlib import Path
from typing import Any

import numpy as np

from lmd.core.checks import InputError, bounded

TEXT = ".gltf"
# Greatest number of levels of nodes; of nodes and of pieces, where a building has 10,000; and numbers in a value of
# each type.
DEEPEST_LEVEL, MOST_NODES = 32, 50_000
NUMBERS_OF_TYPE = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT2": 4, "MAT3": 9, "MAT4": 16}
# NumPy types of integer components, and divisors of normalised integers.
FRACTIONS = {5120: ("i1", 127.0), 5121: ("u1", 255.0), 5122: ("<i2", 32767.0), 5123: ("<u2", 65535.0)}
FLOAT = 5126
FAN = 6  # mode of triangles that share their first corner
# Extensions that a file may require without effect on the places of triangles.
QUANTISED = "KHR_mesh_quantization"
LOOKS = ("KHR_materials_", "KHR_texture_", "KHR_lights_", "KHR_xmp", "KHR_animation_", "EXT_texture_", "EXT_lights_")
COMPRESSED = ("KHR_draco_mesh_compression", "EXT_meshopt_compression", "KHR_meshopt_compression")
DATA = "data:application/octet-stream;base64,"


def header_of(file: Path, content: bytes) -> dict[str, Any]:
    """Checked JSON part of a glTF: the file contains its triangles, uncompressed, and no more than its header states.

    All data must be in the named file, as a later run identifies the room by the content of that file.

    Raises:
        InputError: the triangles are in another file, compressed, or placed by an extension that is not supported.
        ValueError: the file is damaged.
    """
    header = json.loads(content if file.suffix.lower() == TEXT else content[20 : 20 + _word(content, 12)])
    for buffer in header.get("buffers", []):
        if not buffer.get("uri", "data:").startswith("data:"):
            where = f"path = {str(file)!r} has its triangles in {buffer['uri']!r}"
            raise InputError(f"{where}; save it as one file, .glb with everything in it.", "path")
    _check_extensions(file, header)
    accessors = header.get("accessors", [])
    if any("sparse" in part for part in accessors):
        raise ValueError("an accessor is sparse, which is not read")
    counts = [part["count"] for part in accessors]
    if not all(isinstance(count, int) and count >= 0 for count in counts):
        raise ValueError("an accessor has a count that is none")
    numbers = sum(n * NUMBERS_OF_TYPE[part["type"]] for n, part in zip(counts, accessors, strict=True))
    if numbers > len(content):
        raise InputError(f"path: {str(file)!r}, of {len(content)} bytes, asks for {numbers:.4g} numbers.", "path")
    pieces = sum(len(mesh["primitives"]) for mesh in header.get("meshes", []))
    for name, number in (("nodes", len(header.get("nodes", []))), ("pieces of meshes", pieces)):
        bounded(name, number, MOST_NODES, f"path: {str(file)!r}", "path")
    _check_tree([node.get("children", []) for node in header.get("nodes", [])])
    return dict(header)


def triangles_of(header: dict[str, Any]) -> float:
    """Upper bound on the number of triangles in the meshes of a checked glTF, and of those that its nodes place."""
    counts, corners = [part["count"] for part in header.get("accessors", [])], []
    for mesh in header.get("meshes", []):
        read = [i for part in mesh["primitives"] for i in (part["attributes"]["POSITION"], part.get("indices"))]
        corners.append(sum(counts[i] for i in read if i is not None))
    placed = sum(corners[node["mesh"]] for node in header.get("nodes", []) if "mesh" in node)
    return float(max(placed, sum(corners)) / 3)  # the library makes meshes that no node places


def with_fractions(header: dict[str, Any], content: bytes, kind: str) -> tuple[bytes, str]:
    """Content and kind (`glb` or `gltf`) of a checked glTF, with floats in place of integers that represent fractions.

    A signed 16-bit integer c represents c / 32767; `FRACTIONS` has all types. The reader of meshes would take integers
    for metres.
    """
    accessors = header.get("accessors", [])
    corners = {p["attributes"]["POSITION"] for mesh in header.get("meshes", []) for p in mesh["primitives"]}
    normalised = [
        i for i in sorted(corners) if accessors[i].get("normalized") and accessors[i]["componentType"] != FLOAT
    ]
    if not normalised:
        return content, kind
    if kind == "glb":
        begin = 20 + _word(content, 12)
        chunk = content[begin + 8 : begin + 8 + _word(content, begin)]
        if "uri" not in header["buffers"][0]:
            header["buffers"][0]["uri"] = _uri(chunk)
    for i in normalised:
        values = _fractions(header, accessors[i]).astype("<f4").tobytes()
        header["buffers"].append({"byteLength": len(values), "uri": _uri(values)})
        header["bufferViews"].append({"buffer": len(header["buffers"]) - 1, "byteLength": len(values)})
        accessors[i] = {"bufferView": len(header["bufferViews"]) - 1, "componentType": FLOAT} | {
            key: accessors[i][key] for key in ("count", "type")
        }
    return json.dumps(header).encode(), "gltf"


def _fractions(header: dict[str, Any], accessor: dict[str, Any]) -> Any:
    """Values of an accessor `(count, 3)`, in [-1, 1]."""
    view = header["bufferViews"][accessor["bufferView"]]
    buffer = base64.b64decode(header["buffers"][view["buffer"]]["uri"].partition(",")[2])
    kind, largest = FRACTIONS[accessor["componentType"]]
    begin = view.get("byteOffset", 0) + accessor.get("byteOffset", 0)
    size, count = np.dtype(kind).itemsize, accessor["count"]
    stride = view.get("byteStride", 3 * size)
    end = begin + (count - 1) * stride + 3 * size
    if accessor["type"] != "VEC3" or begin < 0 or stride < 3 * size or end > len(buffer):
        raise ValueError("an accessor of corners reaches beyond its buffer")
    values = np.ndarray((count, 3), kind, buffer, begin, (stride, size))
    return np.maximum(values / largest, -1.0)


def _uri(content: bytes) -> str:
    return DATA + base64.b64encode(content).decode()


def _check_extensions(file: Path, header: dict[str, Any]) -> None:
    """Raise `InputError` if an unsupported extension determines the places of triangles."""
    needed = [str(name) for name in header.get("extensionsRequired", [])]
    if any("EXT_mesh_gpu_instancing" in node.get("extensions", {}) for node in header.get("nodes", [])):
        needed.append("EXT_mesh_gpu_instancing")
    for name in needed:
        if name in COMPRESSED:
            how = f"gltf-transform cp {file.name} plain.glb"
            raise InputError(
                f"path: {str(file)!r} is compressed ({name}), which is not read; `{how}` makes one that is, as Blender "
                "does when it imports it and exports it without compression.",
                "path",
            )
        if name != QUANTISED and not name.startswith(LOOKS):
            raise InputError(
                f"path: {str(file)!r} needs the extension {name} of glTF, which is not read; import it into Blender "
                "and export it as .glb.",
                "path",
            )
    modes = [part.get("mode") for mesh in header.get("meshes", []) for part in mesh["primitives"]]
    if FAN in modes:
        raise InputError(f"path: {str(file)!r} has fans of triangles, which are not read; export lists.", "path")


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


def _word(content: bytes, at: int) -> int:
    return int.from_bytes(content[at : at + 4], "little")
