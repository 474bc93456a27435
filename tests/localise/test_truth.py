"""Smoothed poses beside the truth where map, mounts, prints, sizes or ids are not as stated."""

import numpy as np
import opencv_rooms as rooms
import pytest
from support import walks

from lmd.localise.results import to_text
from lmd.survey.results import map_of

QUICK = {"moved", "mount turned", "plane", "sizes"}
THOROUGH = pytest.mark.thorough("lmd/adjust", "lmd/localise")


@pytest.mark.parametrize("name", [pytest.param(name, marks=() if name in QUICK else THOROUGH) for name in rooms.NAMES])
def test_errors_of_smoothed_poses_are_those_stated(name):
    one = rooms.scenario(name, 8 if name in rooms.RIGS else 7)
    result = one.localised()
    square, off, stated = rooms.figures(one, result)
    assert 0.2 < square < 3.0
    assert off < 3.0 * stated
    assert result.smoothed.poses.known_frames.mean() > 0.9
    named = {change.tag for change in result.changes} | {int(doubt.split()[1]) for doubt in result.doubts}
    moved = np.flatnonzero(np.linalg.norm((one.true - one.known.poses)[:, :3, 3], axis=1) > 0.02)
    assert named == ({0} if name == "twice" else set(moved.tolist()))
    assert result.comparison.contradicted == 0
    if name == "sizes":
        odd = np.flatnonzero(one.known.poses[:, 0, 3] < 3.0)
        assert sorted(result.sizes) == odd.tolist()
        np.testing.assert_allclose(list(result.sizes.values()), rooms.ODD_EDGE, rtol=0.01)
        assert "other size" in to_text(result)


def test_a_survey_finds_tags_of_another_size():
    one = rooms.scenario("sizes", 7)
    found = walks.surveyed(one.detected, cameras=one.cameras, edge=rooms.EDGE)
    odd = np.flatnonzero(one.known.poses[:, 0, 3] < 3.0)
    assert sorted(found.faults.sizes) == odd.tolist()
    np.testing.assert_allclose(list(found.faults.sizes.values()), rooms.ODD_EDGE, rtol=0.02)
    assert len(map_of(found).ids) == 16
    off = walks.apart(found.found.poses.tags, one.true)
    assert (off < 4.0 * found.found.sigmas).all()
