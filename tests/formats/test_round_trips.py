"""Files that a format writes are read again to the last digit."""

from dataclasses import replace

import numpy as np
import pytest
from contracts.format import check_format
from scipy.spatial.transform import Rotation

from lmd.core.checks import InputError
from lmd.export.exports import Export, all_formats
from lmd.formats.registry import ONE
from lmd.formats.tag_map import TagMap
from lmd.scene.deployment import Deployment
from lmd.scene.labels import Labels
from lmd.scene.tag import Tag
from lmd.space.cuboid import Cuboid

ROOM, EDGE = Cuboid((6.0, 4.0, 2.8), (5.0, 3.0, 1.2), 0.5), 0.3
MAPS = tuple(name for name, form in all_formats().items() if not form.on_paper)
WITH_PLACES = tuple(name for name in MAPS if name != "apriltag_ros2")


def turned_anyhow(seed):
    """Tags with random places and turns, two of them with edges of their own."""
    rng = np.random.default_rng(seed)
    axes = Rotation.random(9, rng).as_matrix()
    edges = np.array([0.05, np.nan, 0.4125, *[np.nan] * 6])
    places, labels = rng.uniform([0, 0, 0], [6, 4, 2.8], (9, 3)), Labels(rng.permutation(30)[:9])
    return Deployment(places, axes[:, :, 2], labels=labels, edges=edges).turned("random", axes[:, :, 1])


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("family", ["36h11", "4x4_50"])
@pytest.mark.parametrize("name", WITH_PLACES)
def test_what_was_written_is_read_again(name, family, seed, tmp_path):
    form, deployment = all_formats()[name], turned_anyhow(seed)
    if form.edges == ONE:
        deployment = replace(deployment, edges=None)
    found = check_format(form, TagMap(ROOM, Tag(EDGE, family), deployment), tmp_path)
    assert found.has_own_edges == (name not in ("wpilib", "rtabmap", "ros2_tf"))


def test_what_has_one_edge_takes_no_tags_with_several():
    several = turned_anyhow(0)
    export = Export([*MAPS, "sheets"], "a4")
    unfit = export.unfit(TagMap(ROOM, Tag(EDGE), several))
    assert set(unfit) == {"rtabmap"}
    with pytest.raises(InputError, match=r"^formats has rtabmap: .* 0\.05, 0\.3, 0\.4125 m"):
        export.writers(ROOM, Tag(EDGE), several)
    assert export.silent(TagMap(ROOM, Tag(EDGE), several)) == ("ros2_tf", "wpilib")
    with pytest.raises(InputError, match=r"^formats has rtabmap: .* 0\.05, 0\.1 m\.$"):  # before anything is placed
        Export(["rtabmap"], "a4").check(Tag(EDGE, edges=[0.1, 0.05]))
