"""Maps of tags of one family."""

import json

import numpy as np
import pytest
from support.tables import rows

from lmd.core.checks import InputError
from lmd.formats.placed_tag import NUMBERS, tag_named
from lmd.formats.tag_maps import FileDeployment, read_deployment
from lmd.scene.families import FAMILIES
from lmd.scene.tag import Tag
from lmd.space.cuboid import Cuboid


def fmap(*families):
    turn = np.eye(4).ravel().tolist()
    tags = [{"id": k, "size": 165.1, "transform": turn} | ({"family": f} if f else {}) for k, f in enumerate(families)]
    return {"fiducials": tags}


def test_the_numbers_of_families_are_those_of_opencv():
    aruco = pytest.importorskip("cv2").aruco
    for number, name in NUMBERS.items():
        if name in FAMILIES:
            assert getattr(aruco, FAMILIES[name].dictionary) == number


def test_a_map_keeps_to_the_family_that_it_names(write):
    assert len(read_deployment(write(json.dumps(fmap("apriltag3_16h5_classic", None))), family="16h5")) == 2
    assert len(read_deployment(write(json.dumps(fmap("apriltag3_16h5_classic"))))) == 1  # points have no family


def test_a_source_asks_for_the_family_of_its_tag_and_not_of_points(tmp_path):
    (tmp_path / "map.fmap").write_text(json.dumps(fmap("apriltag3_16h5_classic")))
    room, rng = Cuboid((8.0, 4.0, 3.0), (7.0, 3.0, 1.0), 0.5), np.random.default_rng(0)
    for family in ((), ("36h11",)):
        source = FileDeployment(tmp_path / "map.fmap", None, True, *family)
        assert len(source.draw(room, rng)) == 1
        with pytest.raises(InputError, match=r"^family=16h5 is needed"):
            source.draw(room, rng, Tag(0.1))


@pytest.mark.parametrize(("family", "names"), rows(__file__, "names of tags"))
def test_a_name_has_the_family_and_the_number_of_a_tag(family, names):
    assert {tag_named(name) for name in names.split(" ")} == {None if family == "unsure" else (family, 7)}
    assert tag_named("tag_3611") == (None, 3611)
