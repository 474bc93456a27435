"""Faces of more than three corners in files of meshes."""

import numpy as np
import pytest

from lmd.core.checks import InputError
from lmd.formats.meshes import read_mesh

# An L, 6 m by 4 m without 3 m by 2 m: 18 m2, whichever corner is first.
OUTLINE = [(0, 0), (6, 0), (6, 2), (3, 2), (3, 4), (0, 4)]


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


def test_a_concave_face_of_a_ply_is_refused(tmp_path):
    head = "ply\nformat ascii 1.0\nelement vertex 6\nproperty float x\nproperty float y\nproperty float z\n"
    head += "element face 1\nproperty list uchar int vertex_indices\nend_header\n"
    body = "".join(f"{x} {y} 0\n" for x, y in OUTLINE) + "6 0 1 2 3 4 5\n"
    (tmp_path / "room.ply").write_text(head + body)
    with pytest.raises(InputError, match="has faces of more than three corners"):
        read_mesh(str(tmp_path / "room.ply"))
