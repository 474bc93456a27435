"""Meshes as a stranger may hand them over."""

import base64
import json
import os
import struct
from contextlib import suppress

import numpy as np
import pytest
import trimesh

from lmd.core.checks import InputError
from lmd.formats.meshes import read_mesh

TRIANGLE = struct.pack("<9f", 0, 0, 0, 3, 0, 0, 0, 3, 0)


def gltf(uri=None, accessors=None, nodes=None):
    """A triangle, in the file itself if nothing else is said."""
    uri = uri or "data:application/octet-stream;base64," + base64.b64encode(TRIANGLE).decode()
    return {
        "asset": {"version": "2.0"},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": nodes or [{"mesh": 0}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}}]}],
        "buffers": [{"byteLength": len(TRIANGLE), "uri": uri}],
        "bufferViews": [{"buffer": 0, "byteLength": len(TRIANGLE)}],
        "accessors": accessors or [{"bufferView": 0, "componentType": 5126, "count": 3, "type": "VEC3"}],
    }


def written(path, document):
    text = json.dumps(document).encode()
    if path.suffix == ".glb":
        text += b" " * (-len(text) % 4)
        text = struct.pack("<4sII", b"glTF", 2, 20 + len(text)) + struct.pack("<I4s", len(text), b"JSON") + text
    path.write_bytes(text)
    return str(path)


def refused(path, **how):
    with pytest.raises(InputError) as told:
        read_mesh(path, **how)
    assert str(told.value).isprintable()
    return str(told.value)


@pytest.mark.parametrize("name", ["room.gltf", "room.glb"])
def test_triangles_are_in_the_file_that_is_named(name, tmp_path):
    """Else a repeated sweep would not know that they changed."""
    (tmp_path / "room.bin").write_bytes(TRIANGLE)
    for uri in ("room.bin", "../room.bin", f"{tmp_path}/room.bin", "http://localhost/room.bin", "file:///dev/zero"):
        assert f"has its triangles in '{uri}'; save it as one file" in refused(written(tmp_path / name, gltf(uri)))
    assert len(read_mesh(written(tmp_path / name, gltf())).faces) == 1


@pytest.mark.parametrize("name", ["room.gltf", "room.glb"])
@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"accessors": [{"componentType": 5126, "count": 600_000_000, "type": "VEC3"}]}, "asks for 1.8e+09 numbers"),
        ({"accessors": [{"componentType": 5126, "count": -1, "type": "VEC3"}]}, "a count that is none"),
        ({"nodes": [{"children": [1]}, {"children": [0]}]}, "nested more than 32 deep"),
        ({"nodes": [{"mesh": 0, "children": [i + 1]} for i in range(99)] + [{"mesh": 0}]}, "nested more than 32 deep"),
        ({"nodes": [{"children": [1, 1]}, {"mesh": 0}]}, "two parents"),
    ],
)
def test_a_gltf_that_stands_for_more_than_it_holds_is_refused(name, change, message, tmp_path):
    assert message in refused(written(tmp_path / name, gltf(**change)))


# A room of 6 x 2.5 x 4 m (y up) in integers: fractions of what the node makes of 1, and of its middle.
QUANTISED = {5120: ("b", 127), 5121: ("B", 255), 5122: ("h", 32767), 5123: ("H", 65535)}


@pytest.mark.parametrize("name", ["room.gltf", "room.glb"])
@pytest.mark.parametrize("component", QUANTISED)
def test_integers_that_stand_for_fractions(name, component, tmp_path):
    """KHR_mesh_quantization: c / 32767 and so on, then scaled and moved by the node."""
    kind, largest = QUANTISED[component]
    low = 0 if kind.isupper() else -largest
    corners = [(x, y, z) for x in (low, largest) for y in (low, largest) for z in (low, largest)]
    row = struct.Struct(f"<3{kind}{'x' * (1 if kind in 'bB' else 2)}")
    positions = b"".join(row.pack(*corner) for corner in corners)
    faces = [0, 1, 3, 0, 3, 2, 4, 6, 7, 4, 7, 5, 0, 4, 5, 0, 5, 1, 2, 3, 7, 2, 7, 6]
    data = positions + struct.pack(f"<{len(faces)}H", *faces)
    size = [6.0, 2.5, 4.0] if low == 0 else [3.0, 1.25, 2.0]
    document = gltf("data:application/octet-stream;base64," + base64.b64encode(data).decode()) | {
        "extensionsRequired": ["KHR_mesh_quantization"],
        "nodes": [{"mesh": 0, "scale": size, "translation": [0.0] * 3 if low == 0 else size}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}, "indices": 1}]}],
        "bufferViews": [
            {"buffer": 0, "byteLength": len(positions), "byteStride": row.size},
            {"buffer": 0, "byteOffset": len(positions), "byteLength": len(data) - len(positions)},
        ],
        "accessors": [
            {"bufferView": 0, "componentType": component, "normalized": True, "count": 8, "type": "VEC3"},
            {"bufferView": 1, "componentType": 5123, "count": len(faces), "type": "SCALAR"},
        ],
    }
    document["buffers"][0]["byteLength"] = len(data)
    mesh = read_mesh(written(tmp_path / name, document))
    assert np.abs(mesh.vertices.min(axis=0) - [0, -4, 0]).max() < 1e-5
    assert np.abs(mesh.vertices.max(axis=0) - [6, 0, 2.5]).max() < 1e-5
    assert len(mesh.faces) == 8
    document["accessors"][0]["byteOffset"] = 10**9
    assert "reaches beyond its buffer" in refused(written(tmp_path / name, document))


@pytest.mark.parametrize("name", ["room.gltf", "room.glb"])
@pytest.mark.parametrize(
    ("extension", "message"),
    [
        ("KHR_draco_mesh_compression", "`gltf-transform cp room.gl"),
        ("EXT_meshopt_compression", "`gltf-transform cp room.gl"),
        ("EXT_of_tomorrow", "needs the extension EXT_of_tomorrow of glTF, which is not read; import it into Blender"),
    ],
)
def test_an_extension_that_decides_where_triangles_are(name, extension, message, tmp_path):
    told = refused(written(tmp_path / name, gltf() | {"extensionsRequired": [extension]}))
    assert message in told
    assert "scale" not in told
    assert len(read_mesh(written(tmp_path / name, gltf() | {"extensionsRequired": ["KHR_materials_unlit"]})).faces) == 1


def test_a_mesh_of_too_many_triangles_is_refused(tmp_path, monkeypatch):
    many = gltf(nodes=[{"children": [1, 2]}, {"mesh": 0}, {"mesh": 0}])
    assert len(read_mesh(written(tmp_path / "room.gltf", many)).faces) == 1  # one that is there twice
    monkeypatch.setattr("lmd.formats.meshes.MOST_TRIANGLES", 1)
    assert "has 2 triangles, and at most 1 are taken" in refused(written(tmp_path / "room.gltf", many))
    trimesh.creation.box().export(tmp_path / "box.ply")
    assert "has 12 triangles, and at most 1 are taken" in refused(str(tmp_path / "box.ply"))


def test_a_file_that_was_damaged_is_read_or_refused(tmp_path):
    """Bits that flipped, an end that is missing, numbers that grew."""
    rng = np.random.default_rng(0)
    for name in ("room.obj", "room.ply", "room.stl", "room.glb"):
        trimesh.creation.box().export(tmp_path / name)
        good = (tmp_path / name).read_bytes()
        for _ in range(30):
            at = int(rng.integers(len(good)))
            flipped = bytes([good[at] ^ 1 << int(rng.integers(8))])
            for middle in (flipped, b"9999999", b""):
                end = b"" if middle == b"" else good[at + 1 :]
                (tmp_path / name).write_bytes(good[:at] + middle + end)
                with suppress(InputError):
                    read_mesh(tmp_path / name)


def test_no_other_file_is_looked_for(tmp_path):
    """A material in a pipe would be waited for."""
    os.mkfifo(tmp_path / "room.mtl")
    os.mkfifo(tmp_path / "room.png")
    trimesh.creation.box().export(tmp_path / "box.obj")
    (tmp_path / "room.obj").write_text("mtllib room.mtl\n" + (tmp_path / "box.obj").read_text())
    head = b"ply\ncomment TextureFile room.png\n"
    (tmp_path / "room.ply").write_bytes(head + trimesh.creation.box().export(file_type="ply").removeprefix(b"ply\n"))
    for name in ("room.obj", "room.ply"):
        assert len(read_mesh(tmp_path / name).faces) == 12
    os.mkfifo(tmp_path / "pipe.obj")
    assert "it is a pipe" in refused(tmp_path / "pipe.obj")


@pytest.mark.filterwarnings("ignore:invalid value")  # of what writes the file
@pytest.mark.parametrize("bad", [np.nan, np.inf])
@pytest.mark.parametrize("name", ["room.obj", "room.ply", "room.stl", "room.glb"])
def test_a_corner_that_is_no_place_is_refused(name, bad, tmp_path):
    """Its triangles would be missing, a hole in the wall."""
    box = trimesh.creation.box()
    box.vertices[3, 0] = bad
    box.export(tmp_path / name)
    told = refused(tmp_path / name, up="z")
    assert f"{name}' has a corner of 'geometry" in told
    assert told.endswith(f"at ({bad:g}, 0.5, 0.5), which is no place.")


def test_names_in_a_file_do_not_reach_the_terminal_as_they_are(tmp_path):
    faces = "v 0 0 0\nv 3 0 0\nv 0 3 0\nv 0 0 3\no a\x1b[2J\nf 1 2 3\no b\nf 1 2 4\n"
    (tmp_path / "room.obj").write_text(faces)
    assert read_mesh(tmp_path / "room.obj").names == (r"a\x1b[2J", "b")


def test_nothing_is_said_of_each_object(tmp_path, caplog):
    caplog.set_level("INFO")
    corners = "".join(f"v {x} {y} {z}\n" for z in (0, 2) for x, y in ((0, 0), (3, 0), (3, 3), (0, 3)))
    (tmp_path / "room.obj").write_text(f"{corners}o floor\nf 1 2 3 4\no ceiling\nf 5 6 7 8\n")
    assert len(read_mesh(tmp_path / "room.obj").faces) == 4
    assert not caplog.records
