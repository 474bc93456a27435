"""Maps of ROS 2 and RTAB-Map: parameters of nodes, bundles, graphs and static transforms."""

import re
import sys
from types import ModuleType, SimpleNamespace

import numpy as np
import pytest
from format_samples import MAPS
from map_files import assert_is, reader
from numpy.testing import assert_allclose
from scipy.spatial.transform import Rotation

from lmd.core.checks import InputError
from lmd.export.exports import all_formats
from lmd.formats.tag_map import TagMap
from lmd.scene.deployment import Deployment
from lmd.scene.labels import Labels
from lmd.scene.tag import Tag
from lmd.space.cuboid import Cuboid

# Upright on a wall, looking along -y: a turn by 90 degrees about x.
TURN = {"qx": 0.7071067811865476, "qy": 0, "qz": 0, "qw": 0.7071067811865476}
PLACED = {"size": 0.1, "x": 2.0, "y": 0.0, "z": 1.2, **TURN}
TRANSFORM = [2.0, 0.0, 1.2, 0.7071067811865476, 0.7071067811865476, 0.0, 0.0]


@pytest.fixture
def read(tmp_path):
    return reader(tmp_path)


@pytest.mark.parametrize(
    "around",
    [
        lambda keys: {"/**": {"ros__parameters": keys}},
        lambda keys: {"apriltag": {"ros__parameters": keys}},
        lambda keys: {"robot": {"front": {"apriltag": {"ros__parameters": keys}}}},
        lambda keys: {"camera": {"ros__parameters": {"fps": 30}}, "/map_node": {"ros__parameters": keys}},
    ],
    ids=["any", "node", "namespaces", "two nodes"],
)
@pytest.mark.parametrize("name", [name for name in MAPS if name != "ros2"])
def test_the_parameters_of_a_node_may_hold_every_map(name, around, read):
    plain, wrapped = read(MAPS[name]), read(around(MAPS[name]))
    assert wrapped.ids.tolist() == plain.ids.tolist()
    assert_allclose(wrapped.positions, plain.positions)
    assert_allclose(wrapped.ups, plain.ups)


def test_parameters_may_have_dots_for_namespaces(read):
    bundle = {"tag_bundles.bundle_names": ["a"], "tag_bundles.a.ids": [7]}
    bundle |= {"tag_bundles.a.7.size": 0.1, "tag_bundles.a.7.transform": TRANSFORM}
    assert_is(read({"/**": {"ros__parameters": bundle}}), 7, [2, 0, 1.2], [0, -1, 0])
    with pytest.raises(InputError, match=r"the parameter a\.b is in a, which has a value of its own"):
        read({"n": {"ros__parameters": {"a": 1, "a.b": 2, "tag_bundles": {}}}})


@pytest.mark.parametrize(
    "bundles",
    [
        [{"name": "wall", "layout": [{"id": 7, **PLACED}]}],
        {"bundle_names": ["wall"], "wall": {"ids": [7], "7": {"size": 0.1, "transform": TRANSFORM}}},
        {"bundle_names": ["wall"], "wall": {"ids": [7], 7: {"size": 0.1, "transform": [2, 0, 1.2, np.pi / 2, 0, 0]}}},
        {"bundle_names": ["wall"], "wall": {"layout": {"ids": [7], "7": PLACED}}},
    ],
    ids=["ROS 1", "pull request 59", "angles", "pull request 158"],
)
def test_bundles_of_ros_1_and_of_its_ports(bundles, read):
    found = read({"family": "36h11", "tag_bundles": bundles}, family="36h11")
    assert_is(found, 7, [2, 0, 1.2], [0, -1, 0])
    assert found.edges.tolist() == [0.1]
    assert ("a transform is read as x y z qw qx qy qz" in found.note) == ("'transform'" in str(bundles))
    with pytest.raises(InputError, match=r"^family=36h11 is needed"):
        read({"family": "36h11", "tag_bundles": bundles}, family="16h5")


def test_standalone_tags_may_have_places_and_ros_2_wraps_its_parameters(read):
    tag = "{id: 7, size: 0.1, x: 2.0, y: 0.0, z: 1.2, qx: 0.7071067811865476, qy: 0, qz: 0, qw: 0.7071067811865476}"
    for text in (
        f"standalone_tags: [{tag}]\n",
        f"space:\n  node:\n    ros__parameters: {{standalone_tags: [{tag}]}}\n",
    ):
        found = read(text)
        assert_is(found, 7, [2, 0, 1.2], [0, -1, 0])
        assert found.edges.tolist() == [0.1]
    with pytest.raises(InputError, match="the key 'z' is missing"):
        read("standalone_tags: [{id: 7, size: 0.1, x: 2.0, y: 0.0}]\n")
    with pytest.raises(InputError, match="places in standalone_tags and in tag_bundles"):
        read(f"standalone_tags: [{tag}]\ntag_bundles: [{{name: a, layout: [{tag}]}}]\n")
    with pytest.raises(InputError, match="it has ros__parameters of 2 nodes"):
        read("a: {ros__parameters: {}}\nb: {ros__parameters: {}}\n")
    with pytest.raises(InputError, match=r"tag 0: its transform must be .* it has 4 values"):
        read("tag_bundles: {bundle_names: [a], a: {ids: [0], 0: {size: 0.1, transform: [2, 0, 1.2, 1]}}}\n")
    with pytest.raises(InputError, match="the key '0' is missing"):
        read("tag_bundles: {bundle_names: [a], a: {ids: [0]}}\n")


def test_a_bundle_of_apriltag_ros(read):
    text = """
standalone_tags:
  [
  ]
tag_bundles:
  [
    {
      name: 'desk',
      layout:
        [
          {id: 3, size: 0.05, x: 0.1, y: 0.2, z: 0.0, qw: 1, qx: 0, qy: 0, qz: 0},
          {id: 5, size: 0.10, qw: 0.7071067811865476, qx: 0.7071067811865476, qy: 0, qz: 0}
        ]
    }
  ]
"""
    found = read(text)
    assert found.ids.tolist() == [3, 5]
    assert_allclose(found.normals, [[0, 0, 1], [0, -1, 0]], atol=1e-12)
    assert_allclose(found.ups, [[0, 1, 0], [0, 0, 1]], atol=1e-12)
    assert found.edges.tolist() == [0.05, 0.1]
    with pytest.raises(InputError, match="standalone_tags without places: they need x, y, z, qx"):
        read("standalone_tags: [{id: 1, size: 0.1}]\n")
    with pytest.raises(InputError, match="it has the bundles a, b, each in a frame of its own"):
        read("tag_bundles: [{name: a, layout: [{id: 1, size: 0.1}]}, {name: b, layout: [{id: 2, size: 0.1}]}]\n")


def test_rtabmap_keeps_tags_in_its_settings_and_among_its_poses(read):
    text = "[Core]\nVersion=0.21\nMarker\\Priors=7 2.0 0.0 1.2 1.5707963267948966 0 0\nMarker\\Length=0.1\n"
    found = read(text)
    assert_is(found, 7, [2, 0, 1.2], [0, -1, 0])
    assert found.edges.tolist() == [0.1]
    with pytest.raises(InputError, match=r"^family=16h5 is needed"):
        read(text + "Marker\\Dictionary=17\n", family="36h11")
    poses = "#timestamp x y z qx qy qz qw id\n0.0 2 0 1.2 0.5 -0.5 -0.5 0.5 -7\n1700000000.1 0 0 0 0 0 0 1 1\n"
    assert_is(read(poses), 7, [2, 0, 1.2], [-1, 0, 0])
    with pytest.raises(InputError, match="poses of RTAB-Map, and no tag"):
        read(poses.replace(" -7", " 7"))


GRAPH = """PARAMS_SE3OFFSET 0 0 0 0 0 0 0 1
VERTEX_SE3:QUAT 9 0.5 0 1 0 0 0 1
VERTEX_SE3:QUAT 4 2 0 1.2 0.5 -0.5 -0.5 0.5
VERTEX_SE3:QUAT 1 0 0 0 0 0 0 1
VERTEX_SE3:QUAT 2 0 0 0 0 0 0 1
EDGE_SE3 1 4 2 0 1.2 0.5 -0.5 -0.5 0.5 1
EDGE_SE3:QUAT 1 2 0 0 0 0 0 0 1 1
"""


class Described:
    """A stub of an action or a description of ROS 2's launch: its positional and named arguments."""

    def __init__(self, *args, **options):
        self.args, self.__dict__ = args, {"args": args, **options}


def launched(path, monkeypatch):
    """What a launch file describes, run against stubs of `launch` and `launch_ros`."""
    names = {
        "launch": ["LaunchDescription"],
        "launch.actions": ["DeclareLaunchArgument"],
        "launch.substitutions": ["LaunchConfiguration"],
        "launch_ros": [],
        "launch_ros.actions": ["ComposableNodeContainer"],
        "launch_ros.descriptions": ["ComposableNode"],
    }
    for name, classes in names.items():
        module = ModuleType(name)
        for one in classes:
            setattr(module, one, type(one, (Described,), {}))
        monkeypatch.setitem(sys.modules, name, module)
    scope = {"__name__": "tags"}
    exec(compile(path.read_text(), str(path), "exec"), scope)
    argument, container = scope["generate_launch_description"]().args[0]
    return SimpleNamespace(argument=argument, container=container)


@pytest.mark.parametrize("family", ["36h11", "41h12"])
def test_the_launch_file_places_tags_where_they_are(family, tmp_path, monkeypatch):
    rng = np.random.default_rng(3)
    axes, places = Rotation.random(5, rng).as_matrix(), rng.uniform(-20, 20, (5, 3))
    turned = Deployment(places, axes[:, :, 2], labels=Labels(np.arange(5) * 3)).turned("here", axes[:, :, 1])
    tags = TagMap(Cuboid((6.0, 4.0, 2.8), (5.0, 3.0, 1.2), 0.5), Tag(0.16, family), turned)
    form = all_formats()["ros2_tf"]
    form.write(tmp_path / form.file, tags=tags)
    found = launched(tmp_path / form.file, monkeypatch)
    assert (found.argument.args, found.argument.default_value) == (("frame",), "map")
    assert (found.container.package, found.container.executable) == ("rclcpp_components", "component_container")
    nodes = found.container.composable_node_descriptions
    assert {(node.package, node.plugin) for node in nodes} == {("tf2_ros", "tf2_ros::StaticTransformBroadcasterNode")}
    # A node has a name of letters, digits and underscores, and no two have the same name.
    assert all(re.fullmatch(r"[A-Za-z]\w*", node.name) for node in nodes)
    assert len({node.name for node in nodes}) == 5
    library = {"36h11": "tag36h11", "41h12": "tagStandard41h12"}[family]
    corner = np.array([-0.08, 0.08, 0.0])  # the top left one in the frame of a tag
    for k, node in enumerate(nodes):
        (values,) = node.parameters
        assert values["frame_id"].args == ("frame",)
        assert values["child_frame_id"] == f"{library}:{3 * k}"
        assert all(isinstance(values[name], float) for name in values if "_id" not in name)
        w, x, y, z = (values[f"rotation.{axis}"] for axis in "wxyz")
        # The matrix of a quaternion, written out.
        turn = np.array(
            [
                [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
                [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
                [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
            ]
        )
        place = [values[f"translation.{axis}"] for axis in "xyz"]
        assert_allclose(turn @ corner + place, tags.corners[k, 0], atol=1e-9)


def test_a_launch_file_is_read_and_not_run(read):
    text = 'TAGS = [\n    ("tag16h5:7", 2.0, 0.0, 1.2, 0.0, 0.0, 0.0, 1.0),\n]\n'
    assert_is(read(text, family="16h5"), 7, [2, 0, 1.2], [0, 0, 1], [0, 1, 0])
    with pytest.raises(InputError, match=r"^family=16h5 is needed"):
        read(text, family="36h11")
    for old, new, message in (
        ("tag16h5:7", "tag16h5", "a family and a number, such as tag36h11:7, got 'tag16h5'"),
        ("2.0, ", "", "tag16h5:7 must be a list of 7 numbers"),
        ("2.0", "__import__('os')", "its TAGS must be a list of frames with seven numbers"),
    ):
        with pytest.raises(InputError, match=message):
            read(text.replace(old, new))
