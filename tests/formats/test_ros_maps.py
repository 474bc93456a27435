"""Static transforms of tags, as ROS 2 launches them."""

import re
import sys
from types import SimpleNamespace
from unittest.mock import MagicMock

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


def launched(path, monkeypatch):
    """Run a launch file against a stub of `launch` and `launch_ros`, which notes all calls."""
    stub = MagicMock()
    for name in ("", ".actions", ".substitutions", ".descriptions"):
        monkeypatch.setitem(sys.modules, f"launch{name}", stub)
        monkeypatch.setitem(sys.modules, f"launch_ros{name}", stub)
    scope = {"__name__": "tags"}
    exec(compile(path.read_text(), str(path), "exec"), scope)
    scope["generate_launch_description"]()
    return stub


def crossing(x, y, z):
    """Matrix of a cross product."""
    return np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])


@pytest.mark.parametrize("family", ["36h11", "41h12"])
def test_the_launch_file_places_tags_where_they_are(family, tmp_path, monkeypatch):
    rng = np.random.default_rng(3)
    axes, places = Rotation.random(5, rng).as_matrix(), rng.uniform(-20, 20, (5, 3))
    turned = Deployment(places, axes[:, :, 2], labels=Labels(np.arange(5) * 3)).turned("here", axes[:, :, 1])
    tags = TagMap(Cuboid((6.0, 4.0, 2.8), (5.0, 3.0, 1.2), 0.5), Tag(0.16, family), turned)
    form = all_formats()["ros2_tf"]
    form.write(tmp_path / form.file, tags=tags)
    found = launched(tmp_path / form.file, monkeypatch)
    (argument,), options = found.DeclareLaunchArgument.call_args
    container = SimpleNamespace(**found.ComposableNodeContainer.call_args.kwargs)
    assert (argument, options["default_value"]) == ("frame", "map")
    assert (container.package, container.executable) == ("rclcpp_components", "component_container")
    nodes = [SimpleNamespace(**call.kwargs) for call in found.ComposableNode.call_args_list]
    assert {(node.package, node.plugin) for node in nodes} == {("tf2_ros", "tf2_ros::StaticTransformBroadcasterNode")}
    found.LaunchConfiguration.assert_called_with("frame")
    # A node has a name of letters, digits and underscores, and no two have the same name.
    assert all(re.fullmatch(r"[A-Za-z]\w*", node.name) for node in nodes)
    assert len({node.name for node in nodes}) == 5
    library = {"36h11": "tag36h11", "41h12": "tagStandard41h12"}[family]
    corner = np.array([-0.08, 0.08, 0.0])  # the top left one in the frame of a tag
    for k, node in enumerate(nodes):
        (values,) = node.parameters
        assert values["frame_id"] is found.LaunchConfiguration.return_value
        assert values["child_frame_id"] == f"{library}:{3 * k}"
        assert all(isinstance(values[name], float) for name in values if "_id" not in name)
        w, x, y, z = (values[f"rotation.{axis}"] for axis in "wxyz")
        turn = np.eye(3) + 2.0 * w * crossing(x, y, z) + 2.0 * crossing(x, y, z) @ crossing(x, y, z)
        place = [values[f"translation.{axis}"] for axis in "xyz"]
        assert_allclose(turn @ corner + place, tags.corners[k, 0], atol=1e-9)


def test_a_launch_file_is_read_and_not_run(write):
    text = 'TAGS = [\n    ("tag16h5:7", 2.0, 0.0, 1.2, 0.0, 0.0, 0.0, 1.0),\n]\n'
    assert read_deployment(write(text), family="16h5").positions.tolist() == [[2, 0, 1.2]]
