"""Meshes from files of others."""

import base64
import json
import os
import re
import struct
from pathlib import Path

import numpy as np
import pytest
import trimesh
import yaml

import lmd.formats.meshes
from lmd.core.checks import InputError
from lmd.formats.meshes import SUFFIXES, read_mesh

TRIANGLE = struct.pack("<9f", 0, 0, 0, 3, 0, 0, 0, 3, 0)
# An L, 6 m by 4 m without 3 m by 2 m: 18 m2, whichever corner is first.
OUTLINE = [(0, 0), (6, 0), (6, 2), (3, 2), (3, 4), (0, 4)]
WRONG = yaml.safe_load(Path(__file__).with_name("files").joinpath("refused.yaml").read_text(encoding="utf-8"))
TABLE = Path(lmd.formats.meshes.__file__).with_name("tables") / "room.yaml"
REFUSED = {
    row["ends"]: row["refuse"] for row in yaml.safe_load(TABLE.read_text())["rows"] if row.keys() >= {"ends", "refuse"}
}
ENDINGS = [ending for endings in REFUSED for ending in endings.split()]


def gltf(uri=None, nodes=None):
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
        "accessors": [{"bufferView": 0, "componentType": 5126, "count": 3, "type": "VEC3"}],
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
        assert f"has its triangles in '{uri}'; save mesh and triangles as one" in refused(
            written(tmp_path / name, gltf(uri))
        )
    assert len(read_mesh(written(tmp_path / name, gltf())).faces) == 1


@pytest.mark.parametrize("name", ["room.gltf", "room.glb"])
@pytest.mark.parametrize("row", WRONG["gltf"], ids=lambda row: row["words"])
def test_a_gltf_that_stands_for_more_than_it_holds_is_refused(name, row, tmp_path):
    assert re.search(row["words"], refused(written(tmp_path / name, gltf() | row["part"])))


def test_a_gltf_of_deep_nodes_is_refused(tmp_path):
    nodes = [{"mesh": 0, "children": [i + 1]} for i in range(99)] + [{"mesh": 0}]
    assert "nested more than 32 deep" in refused(written(tmp_path / "room.gltf", gltf(nodes=nodes)))


@pytest.mark.parametrize("name", ["room.gltf", "room.glb"])
@pytest.mark.parametrize("row", WRONG["trimesh"], ids=lambda row: row["words"])
def test_what_trimesh_would_read_wrongly_is_refused(name, row, tmp_path):
    told = refused(written(tmp_path / name, gltf() | row["part"]))
    assert re.search(row["words"], told)
    assert "scale" not in told
    assert len(read_mesh(written(tmp_path / name, gltf() | {"extensionsRequired": ["KHR_materials_unlit"]})).faces) == 1


def test_a_mesh_of_too_many_triangles_is_refused(tmp_path, monkeypatch):
    many = gltf(nodes=[{"children": [1, 2]}, {"mesh": 0}, {"mesh": 0}])
    assert len(read_mesh(written(tmp_path / "room.gltf", many)).faces) == 1  # one that is there twice
    monkeypatch.setattr("lmd.formats.meshes.MOST_TRIANGLES", 1)
    assert "has 2 triangles; at most 1 are allowed" in refused(written(tmp_path / "room.gltf", many))
    trimesh.creation.box().export(tmp_path / "box.ply")
    assert "has 12 triangles; at most 1 are allowed" in refused(str(tmp_path / "box.ply"))


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
    assert told.endswith(f"at ({bad:g}, 0.5, 0.5), which is not finite.")


def test_names_in_a_file_do_not_reach_the_terminal_as_they_are(tmp_path):
    faces = "v 0 0 0\nv 3 0 0\nv 0 3 0\nv 0 0 3\no a\x1b[2J\nf 1 2 3\no b\nf 1 2 4\n"
    (tmp_path / "room.obj").write_text(faces)
    assert read_mesh(tmp_path / "room.obj").names == (r"a\x1b[2J", "b")


def area(mesh):
    corners = mesh.vertices[mesh.faces]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    assert (normals[:, 2] > 0.0).all()  # all the same way
    return np.linalg.norm(normals, axis=1).sum() / 2.0


@pytest.mark.parametrize("first", range(6))
def test_a_concave_face_of_an_obj_has_its_own_area(tmp_path, first):
    lines = [f"v {x} {y} {z}" for z in (0.0, 2.5) for x, y in OUTLINE]
    order = [1 + (first + i) % 6 for i in range(6)]
    lines += ["f " + " ".join(map(str, order)), "f " + " ".join(f"{i - 7}//1" for i in order)]  # and a ceiling
    (tmp_path / "room.obj").write_text("vn 0 0 1\n" + "\n".join(lines) + "\n")
    assert area(read_mesh(str(tmp_path / "room.obj"), up="z")) == pytest.approx(36.0)


@pytest.mark.parametrize("ending", [*ENDINGS, ".rmf", ""])
def test_an_ending_that_is_not_read(ending, tmp_path):
    message = refused(tmp_path / f"room{ending.upper()}")
    assert f"must end in one of {', '.join(SUFFIXES)}" in message
    way = next((way for names, way in REFUSED.items() if ending in names.split()), "docs/rooms.md")
    assert way.replace("{advice}", "").strip(";, ") in message or "outline of a floor plan" in message


def test_the_unit_of_a_file_is_asked_for(tmp_path):
    """The room is 6 x 4 x 2.5 m in several units; the unit that the sentence proposes reads it."""
    corners = [(x, y, z) for x in (0, 6) for y in (0, 4) for z in (0, 2.5)]
    faces = "f 1 2 4 3\nf 5 7 8 6\nf 1 5 7 3\nf 2 4 8 6\nf 1 2 6 5\nf 3 7 8 4\n"
    for unit, per in {"millimetres": 0.001, "centimetres": 0.01}.items():
        path = tmp_path / f"{unit}.obj"
        path.write_text("".join(f"v {x / per:g} {y / per:g} {z / per:g}\n" for x, y, z in corners) + faces)
        assert f"a file in {unit} needs {per:g}, which makes 6 x 4 x 2.5 m" in refused(path)
        assert (read_mesh(path, per).vertices.max(axis=0) - (6, 4, 2.5)).max() < 1e-9
    path.write_text("".join(f"v {x * 1e-9:g} {y * 1e-9:g} {z * 1e-9:g}\n" for x, y, z in corners) + faces)
    assert refused(path).endswith("; no usual unit gives it the size of a room.")
