"""Lists of tags that people write, under the names that they give to the values."""

import numpy as np
import pytest
from map_files import assert_is, reader
from map_samples import HALF

from lmd.core.checks import InputError

PLACE, UPRIGHT = [2, 0, 1.2], [np.pi / 2, 0, 0]  # looks along -y


@pytest.fixture
def read(tmp_path):
    return reader(tmp_path)


@pytest.mark.parametrize(
    "keys",
    [
        {"landmarks": [{"id": 7, "position": PLACE, "orientation": UPRIGHT}]},
        {"landmarks": [{"id": 7, "position": dict(zip("xyz", PLACE, strict=True)), "rotation": UPRIGHT}]},
        {"tags": [{"id": 7, "position": PLACE, "orientation_rpy": UPRIGHT}]},
        {"tags": {7: {"position_m": PLACE, "quaternion_wxyz": [HALF, HALF, 0, 0]}}},
        {"markers": [{"marker_id": "7", "pose": {"position": PLACE, "orientation_xyzw": [HALF, 0, 0, HALF]}}]},
        {"markers": [{"id": 7, "x": 2, "y": 0, "z": 1.2, "roll": np.pi / 2, "pitch": 0, "yaw": 0}]},
        {"markers": {"7": {"x": 2, "y": 0, "z": 1.2, "qx": HALF, "qy": 0, "qz": 0, "qw": HALF}}},
        {"tag_locations": [{"id": 7, "x": 2, "y": 0, "z": 1.2, "qx": HALF, "qy": 0, "qz": 0, "qw": HALF}]},
        {"tags": {"tag36h11:7": {"position": PLACE, "orientation": {"x": HALF, "y": 0, "z": 0, "w": HALF}}}},
        {"fiducials": [{"name": "tag_7", "translation_vector": PLACE, "rotation_vector": UPRIGHT}]},
        {"apriltags": [{"id": 7, "xyz": PLACE, "orientation": {"x": HALF, "y": 0, "z": 0, "w": HALF}}]},
    ],
)
def test_a_tag_has_a_place_and_a_turn_under_several_names(keys, read):
    found = read(keys)
    assert_is(found, 7, [2, 0, 1.2], [0, -1, 0])
    assert "the axes x, y, z of a tag point right, up, out, and axes can say otherwise" in found.note


def test_the_list_leaves_open_where_the_axes_of_a_tag_point(read):
    # With x out of the tag and z up.
    keys = {"landmarks": [{"id": 7, "position": PLACE, "orientation": {"roll": 0, "pitch": 0, "yaw": -np.pi / 2}}]}
    found = read(keys, axes=["out", "right", "up"])
    assert_is(found, 7, [2, 0, 1.2], [0, -1, 0])
    assert "point out, right, up" in found.note


def test_sizes_and_families_are_those_of_a_tag_or_of_the_list(read):
    tags = [{"id": 7, "position": PLACE, "orientation": UPRIGHT}]
    for keys in ({"tag_size": 0.1, "tag_family": "tag36h11", "tags": tags}, {"tags": [tags[0] | {"size": 0.1}]}):
        assert read(keys).edges.tolist() == [0.1]
    with pytest.raises(InputError, match=r"^family=36h11 is needed"):
        read({"tag_family": "tag36h11", "tags": tags}, family="16h5")


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"orientation": [90, 0, 0]}, "tag 7: roll = 90 looks like degrees"),
        (
            {"orientation": [1, 0, 0, 0]},
            r"landmarks\[0\]: its orientation must be .* a quaternion whose name says where w",
        ),
        ({"orientation": None}, r"landmarks\[0\] has no orientation: it needs roll, pitch and yaw"),
        ({"orientation": None, "yaw": 1.0}, r"landmarks\[0\] has no orientation: it needs roll, pitch and yaw"),
        ({"position": [1, "a", 0]}, r"landmarks\[0\]: position\[1\] must be a number, got 'a'"),
        ({"position": None, "x": 1, "y": 2}, r"landmarks\[0\] has no position of x, y and z, metres; it has id"),
        ({"size": 150}, r"landmarks\[0\]: size = 150 is in metres here"),
        ({"id": 1.5}, "id must be a whole number"),
        ({"id": "door"}, r"landmarks\[0\]: the name 'door' has no number of a tag"),
        ({"id": "tag36h11:7", "family": "16h5"}, "of the families 16h5 and 36h11"),
        ({"rvec": [0, 180, 0]}, "rotation = 180 looks like degrees"),
    ],
)
def test_a_tag_that_lacks_a_value_is_refused(change, message, read):
    with pytest.raises(InputError, match=message):
        read({"landmarks": [{"id": 7, "position": PLACE, "orientation": UPRIGHT} | change]})
    with pytest.raises(InputError, match=r"tags\[0\] has no orientation: a tag needs {position: "):
        read({"tags": {"0": PLACE}})
