"""Static transforms of tags, as ROS 2 launches them."""

import re
import sys
from types import ModuleType, SimpleNamespace

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.spatial.transform import Rotation

from lmd.export.exports import all_formats
from lmd.formats.tag_map import TagMap
from lmd.formats.tag_maps import read_deployment
from lmd.scene.deployment import Deployment
from lmd.scene.labels import Labels
from lmd.scene.tag import Tag
from lmd.space.cuboid import Cuboid


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


def test_a_launch_file_is_read_and_not_run(write):
    text = 'TAGS = [\n    ("tag16h5:7", 2.0, 0.0, 1.2, 0.0, 0.0, 0.0, 1.0),\n]\n'
    assert read_deployment(write(text), family="16h5").positions.tolist() == [[2, 0, 1.2]]
