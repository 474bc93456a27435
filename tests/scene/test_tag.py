import numpy as np
import pytest

from lmd.core.checks import InputError
from lmd.geometry.squares import corners
from lmd.scene.tag import Tag


def test_sizes():
    tag = Tag(0.16, "36h11", quiet_zone=2.0)
    assert (tag.modules, tag.ids, tag.is_point) == (8, 587, False)
    assert tag.module == pytest.approx(0.02)
    assert tag.paper_edge == pytest.approx(0.24)


def test_sizes_of_a_tag_with_data_around_its_square():
    tag = Tag(0.05, "41h12")
    assert (tag.modules, tag.ids, tag.module) == (5, 2115, pytest.approx(0.01))
    assert (tag.picture_edge, tag.paper_edge) == (pytest.approx(0.09), pytest.approx(0.11))


@pytest.mark.parametrize("edge", [None, 0, 0.0])
def test_a_point_has_no_size(edge):
    tag = Tag(edge)
    assert tag.is_point
    assert tag == Tag()
    with pytest.raises(InputError, match="a point, which has no size"):
        _ = tag.paper_edge


def test_a_family_may_have_too_few_tags():
    Tag(0.1, "25h9").check_ids(np.arange(35))
    with pytest.raises(InputError, match="family 25h9 has 35 different tags, too few for 36"):
        Tag(0.1, "25h9").check_ids(np.arange(36))


def test_corners_go_round_from_the_top_left_as_seen_from_the_front():
    # On the wall y = 0 of a room with y > 0, the viewer looks along -y: right is -x.
    found = corners(np.array([[1.0, 0.0, 1.0]]), np.array([[0.0, 1.0, 0.0]]), np.array([[0.0, 0.0, 1.0]]), 0.2)
    expected = [[[1.1, 0.0, 1.1], [0.9, 0.0, 1.1], [0.9, 0.0, 0.9], [1.1, 0.0, 0.9]]]
    np.testing.assert_allclose(found, expected, atol=1e-15)
