"""What a format has written is read again, to the last digits."""

from dataclasses import replace

import numpy as np
import pytest
import yaml
from scipy.spatial.transform import Rotation

from lmd.core.checks import InputError
from lmd.mapping.formats import FORMATS, Export
from lmd.mapping.tag_map import TagMap
from lmd.scene.deployment import Deployment
from lmd.scene.labels import Labels
from lmd.scene.tag import Tag
from lmd.scene.tag_map_files import read_deployment
from lmd.space.cuboid import Cuboid

ROOM, EDGE = Cuboid((6.0, 4.0, 2.8), (5.0, 3.0, 1.2), 0.5), 0.3
MAPS = tuple(name for name, form in FORMATS.items() if not form.on_paper and name != "duckietown")
WITH_PLACES = tuple(name for name in MAPS if name != "apriltag_ros2")


def turned_anyhow(seed):
    """Tags with random places and turns, two of them with edges of their own."""
    rng = np.random.default_rng(seed)
    axes = Rotation.random(9, rng).as_matrix()
    edges = ["0.05", "", "0.4125", *[""] * 6]
    places, labels = rng.uniform([0, 0, 0], [6, 4, 2.8], (9, 3)), Labels(rng.permutation(30)[:9], {"edge": edges})
    return Deployment(places, axes[:, :, 2], labels=labels).turned("random", axes[:, :, 1])


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("family", ["36h11", "4x4_50"])
@pytest.mark.parametrize("name", WITH_PLACES)
def test_what_was_written_is_read_again(name, family, seed, tmp_path):
    form, deployment = FORMATS[name], turned_anyhow(seed)
    if form.check is TagMap.check_one_edge:
        deployment = replace(deployment, labels=Labels(deployment.ids))
    tags = TagMap(ROOM, Tag(EDGE, family), deployment)
    form.write(tmp_path / "anything", tags=tags)
    again = read_deployment(tmp_path / "anything", family=family)
    np.testing.assert_array_equal(again.ids, deployment.ids)
    for field in ("positions", "normals", "ups"):
        np.testing.assert_allclose(getattr(again, field), getattr(deployment, field), atol=1e-7, err_msg=field)
    if name not in ("wpilib", "frc971", "rtabmap"):  # which have no edge
        np.testing.assert_allclose(TagMap(ROOM, Tag(EDGE, family), again).sizes, tags.sizes, rtol=1e-9)


def test_duckietown_takes_tags_on_the_floor(tmp_path):
    up = np.array([[0.0, 0.0, 1.0]] * 2)
    lying = Deployment(np.array([[1.0, 2.0, 0.0], [3.0, 1.5, 0.0]]), up, labels=Labels(np.array([300, 17])))
    turned = lying.turned("here", np.array([[0.0, 1.0, 0.0], [-np.sin(0.3), np.cos(0.3), 0.0]]))
    Export(["duckietown"], "a4").writers(ROOM, Tag(0.065), turned)["tags.duckietown.yaml"](tmp_path / "map.yaml")
    objects = yaml.safe_load((tmp_path / "map.yaml").read_text())["objects"]
    assert objects["tag17"]["pose"]["~SE2Transform"] == {"p": [3.0, 1.5], "theta_deg": pytest.approx(np.degrees(0.3))}
    assert objects["tag300"]["tag"]["~TagInstance"] == {"family": "36h11", "size": 0.065, "tag_id": 300}
    again = read_deployment(tmp_path / "map.yaml")
    np.testing.assert_allclose(again.ups, turned.ups, atol=1e-9)
    np.testing.assert_allclose(again.positions, turned.positions)
    with pytest.raises(InputError, match=r"^formats has duckietown: .* only, which tag \d+ does not"):
        Export(["duckietown"], "a4").writers(ROOM, Tag(EDGE), turned_anyhow(0))


def test_what_has_one_edge_takes_no_tags_with_several():
    several = turned_anyhow(0)
    export = Export([*MAPS, "sheets"], "a4")
    unfit = export.unfit(TagMap(ROOM, Tag(EDGE), several))
    assert set(unfit) == {"fiducial_vlam", "rtabmap", "sheets"}
    with pytest.raises(InputError, match=r"^formats has fiducial_vlam: .* 0\.05, 0\.3, 0\.4125 m"):
        export.writers(ROOM, Tag(EDGE), several)
