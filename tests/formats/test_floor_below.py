"""A room whose floor was not captured."""

import numpy as np
import pytest
import shapely

from lmd.core.checks import InputError
from lmd.formats.captured_rooms import floor_below

L = np.array([(0, 0), (6, 0), (6, 2), (3, 2), (3, 4), (0, 4)], dtype=np.float64)  # 18 m2; its hull has 21


def walls(corners, gap=0.0):
    """Upright faces between corners one after the other, each shorter by a gap at its ends, y up."""
    found = []
    for k, (a, b) in enumerate(zip(corners, np.roll(corners, -1, axis=0), strict=True)):
        way = gap * (b - a) / np.linalg.norm(b - a)
        ends = [a + way, b - way]
        rows = [(*ends[0], 0.1), (*ends[1], 0.1), (*ends[1], 2.6), (*ends[0], 2.6)]
        found.append((f"wall_{k}", np.array([(x, y, z) for x, z, y in rows])))
    return found


def area(outline):
    return shapely.Polygon(outline[:, [0, 2]]).area


@pytest.mark.parametrize("gap", [0.0, 0.03])
def test_walls_that_meet_enclose_the_floor(gap):
    outline, is_sure = floor_below(walls(L, gap))
    assert is_sure
    assert area(outline) == pytest.approx(18.0, rel=0.05 if gap else 1e-9)
    assert (outline[:, 1] == 0.1).all()


def test_walls_of_a_circle_enclose_it():
    angles = np.arange(40) * 2 * np.pi / 40
    outline, is_sure = floor_below(walls(4.0 * np.stack([np.cos(angles), np.sin(angles)], axis=1)))
    assert is_sure
    assert area(outline) == pytest.approx(20 * 16 * np.sin(2 * np.pi / 40))


def test_walls_that_do_not_close_leave_the_hull_and_are_named():
    outline, is_sure = floor_below(walls(L)[:-1])
    assert not is_sure
    assert area(outline) == pytest.approx(21.0)


def test_nothing_has_no_floor():
    with pytest.raises(InputError, match="neither a floor nor walls"):
        floor_below([])
