"""Unsupported room files: one sentence names the kind of file and how to convert it."""

import pytest

from lmd.core.checks import InputError
from lmd.formats.meshes import SUFFIXES, read_mesh
from lmd.formats.room_formats import ENDINGS

UNREAD = [suffix for _, _, suffixes in ENDINGS for suffix in suffixes]
OUTLINE = "the outline of a floor plan"


def told(path):
    with pytest.raises(InputError) as error:
        read_mesh(path)
    message = str(error.value)
    assert message.startswith(("path", "scale"))
    assert "\n" not in message
    return message


@pytest.mark.parametrize("ending", [*UNREAD, ".rmf", ""])
def test_an_ending_that_is_not_read(ending, tmp_path):
    message = told(tmp_path / f"room{ending.upper()}")
    assert f"must end in one of {', '.join(SUFFIXES)}" in message
    assert ("; this is " if ending in UNREAD else "docs/rooms.md") in message


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        (
            "image: map.pgm\nresolution: 0.05\norigin: [0, 0, 0]\n",
            "this is the map of an occupancy grid: the room occupancy_grid",
        ),
        ("levels:\n  L1: {}\n", "this is a building of Open-RMF"),
        ("outline: [[0, 0]]\n", "docs/rooms.md"),
    ],
)
def test_a_text_in_yaml(text, expected, tmp_path):
    path = tmp_path / "room.yaml"
    path.write_text(text)
    with pytest.raises(InputError, match=expected):
        read_mesh(path)


def test_the_unit_of_a_file_is_asked_for(tmp_path):
    """A room of 6 x 4 x 2.5 m in several units: what the sentence proposes reads it."""
    corners = [(x, y, z) for x in (0, 6) for y in (0, 4) for z in (0, 2.5)]
    faces = (
        "o west\nf 1 2 4 3\no east\nf 5 7 8 6\no floor\nf 1 5 7 3\no top\nf 2 4 8 6\no a\nf 1 2 6 5\no b\nf 3 7 8 4\n"
    )
    for unit, per in {"millimetres": 0.001, "centimetres": 0.01}.items():
        path = tmp_path / f"{unit}.obj"
        path.write_text("".join(f"v {x / per:g} {y / per:g} {z / per:g}\n" for x, y, z in corners) + faces)
        assert f"a file in {unit} takes {per:g}, which makes 6 x 4 x 2.5 m" in told(path)
        assert (read_mesh(path, per).vertices.max(axis=0) - (6, 4, 2.5)).max() < 1e-9
    path.write_text("".join(f"v {x * 1e-9:g} {y * 1e-9:g} {z * 1e-9:g}\n" for x, y, z in corners) + faces)
    assert told(path).endswith("; no usual unit makes a room of it.")


def test_a_cloud_of_points_is_no_mesh(tmp_path):
    path = tmp_path / "cloud.ply"
    head = "ply\nformat ascii 1.0\nelement vertex 2\nproperty float x\nproperty float y\nproperty float z\nend_header\n"
    path.write_text(f"{head}0 0 0\n1 1 1\n")
    assert "make a mesh of a cloud of points in MeshLab or CloudCompare" in told(path)
