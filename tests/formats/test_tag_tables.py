"""Axes, families and further columns of tables of tags."""

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.spatial.transform import Rotation

from lmd.formats.tag_maps import read_deployment


@pytest.fixture
def read(tmp_path):
    def read_text(text, **options):
        (tmp_path / "map").write_text(text)
        return read_deployment(tmp_path / "map", **options)

    return read_text


def test_the_axes_of_a_tag_are_what_is_said(read):
    rng = np.random.default_rng(0)
    turn = Rotation.random(random_state=rng)
    quaternion = ",".join(map(str, turn.as_quat()))
    for axes, out, up in (
        (None, [0, 0, 1], [0, 1, 0]),
        (["right", "down", "into"], [0, 0, -1], [0, -1, 0]),  # AprilTag's
        (["out", "right", "up"], [1, 0, 0], [0, 0, 1]),  # WPILib's
    ):
        found = read(f"id,x,y,z,qx,qy,qz,qw\n3,1,2,3,{quaternion}\n", axes=axes)
        assert_allclose(found.normals[0], turn.apply(out), atol=1e-12)
        assert_allclose(found.ups[0], turn.apply(up), atol=1e-12)
    roll, pitch, yaw = 0.3, -0.2, 1.1
    expected = Rotation.from_euler("xyz", [roll, pitch, yaw])  # about fixed axes, as ROS's setRPY
    found = read(f"id,x,y,z,roll,pitch,yaw\n3,1,2,3,{roll},{pitch},{yaw}\n")
    assert_allclose(found.normals[0], expected.apply([0, 0, 1]), atol=1e-12)


def test_further_columns_of_a_table_stay_and_edges_are_metres(read):
    found = read("id,x,y,z,qx,qy,qz,qw,size,place\n7,2,0,1,0,0,0,1,0.15,door\n8,3,0,1,0,0,0,1,,stairs\n")
    assert found.labels.columns == {"place": ["door", "stairs"]}
    assert_allclose(found.edges, [0.15, np.nan])
