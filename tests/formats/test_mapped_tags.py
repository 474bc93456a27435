"""Maps of programs for mapping and localisation, against what their sources compute of them."""

import copy

import numpy as np
import pytest
from map_files import assert_is, reader
from map_samples import KEYED
from numpy.testing import assert_allclose

from lmd.core.checks import InputError


@pytest.fixture
def read(tmp_path):
    return reader(tmp_path)


def changed(name, change):
    """A copy of a sample after a change of it in place."""
    keys = copy.deepcopy(KEYED[name])
    change(keys)
    return keys


def test_a_reconstruction_has_texts_and_its_quaternion_begins_with_w(read):
    # computeMarkerCorners3D: (-w/2, -h/2, 0) is the first corner of AprilTag, its lower left one.
    found = read(KEYED["visual marker mapping"], family="36h11")
    assert_is(found, 7, [2, 0, 1.2], [0, -1, 0])
    assert found.edges.tolist() == [0.1]
    with pytest.raises(InputError, match=r"^family=36h11 is needed"):
        read(KEYED["visual marker mapping"], family="16h5")
    for key, value, message in (
        ("height", "0.2", "tag 7: width = 0.1 and height = 0.2 must be equal"),
        ("rotation", ["1", "1", "0", "0"], "must have length 1, it has 1.414"),
        ("translation", ["here", "0", "0"], "translation must be a number, got 'here'"),
    ):
        with pytest.raises(InputError, match=message):
            read(
                changed(
                    "visual marker mapping", lambda keys, k=key, v=value: keys["reconstructed_tags"][0].update({k: v})
                )
            )


def test_pytagmapper_has_transforms_or_tags_that_lie(read):
    found = read(KEYED["pytagmapper"])
    assert found.ids.tolist() == [7, 8]
    assert_allclose(found.normals, [[0, -1, 0]] * 2, atol=1e-12)
    assert_allclose(found.ups, [[0, 0, 1]] * 2, atol=1e-12)
    assert found.edges.tolist() == [0.1, 0.2]
    # xytz_to_SE3 and xyt_to_SE2: a turn about z.
    up = [-np.sin(0.5), np.cos(0.5), 0.0]
    assert_is(read(KEYED["pytagmapper 2.5d"]), 7, [1, 2, 0.25], [0, 0, 1], up)
    flat = {"tag_side_length": 0.1, "tag_locations": {"7": [1, 2, 0.5]}}  # without map_type, as of older versions
    assert_is(read(flat), 7, [1, 2, 0], [0, 0, 1], up)
    # OpenCV, by which it detects, has AprilTags the other way up.
    assert_is(read(flat, family="36h11"), 7, [1, 2, 0], [0, 0, 1], [-up[0], -up[1], 0])
    with pytest.raises(InputError, match=r"map_type must be 2d, 2\.5d or 3d, got '4d'"):
        read(flat | {"map_type": "4d"})
    with pytest.raises(InputError, match=r"tag_locations\.7 must be a list of 3 numbers"):
        read(flat | {"tag_locations": {"7": [1, 2]}})
    with pytest.raises(InputError, match="tag 7: yaw = 90 looks like degrees"):
        read(flat | {"tag_locations": {"7": [1, 2, 90]}})


def test_the_frame_of_a_marker_of_the_zed_has_x_out_of_it(read):
    # A camera 2 m before marker 0, upright, has T = diag(1, -1, -1) and t = (0, 0, 2). As `ZedArucoLoc` multiplies:
    pose = np.eye(4)
    pose[:3, :3], pose[2, 3] = np.diag([1.0, -1.0, -1.0]), 2.0
    image_to_aruco, ros_to_image = np.diag([-1.0, -1.0, 1.0, 1.0]), np.eye(4)
    ros_to_image[:3, :3] = [[0, -1, 0], [0, 0, -1], [1, 0, 0]]
    turned = image_to_aruco @ ros_to_image
    camera = np.linalg.inv(turned) @ np.linalg.inv(image_to_aruco @ pose) @ turned
    assert_allclose(camera[:3, 3], [2, 0, 0], atol=1e-12)  # before the marker along its x
    assert_allclose(camera[:3, 2], [0, 0, 1], atol=1e-12)  # upright, as the marker is
    keys = changed("zed", lambda keys: keys["marker_000"].update(orientation=[0.0, 0.0, 0.0]))
    found = read({"/**": {"ros__parameters": keys}})
    assert_is(found, 7, [2, 0, 1.2], [1, 0, 0])
    assert found.edges.tolist() == [0.16]
    with pytest.raises(InputError, match=r"marker_000\.position must be a list of 3 numbers"):
        read(changed("zed", lambda keys: keys["marker_000"].update(position=[0.0])))


def test_other_xml_is_refused(read):
    with pytest.raises(
        InputError, match="it is XML with the element gpx, and Gazebo's sdf and Lanelet2's osm are read; write"
    ):
        read("<gpx></gpx>")
