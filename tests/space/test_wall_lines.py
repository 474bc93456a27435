"""Lines of walls, windows and doors enclose a room."""

import pytest
import shapely

from lmd.core.checks import InputError
from lmd.space.wall_lines import Drawing, plan_of

# Two rooms with walls of 0.2 m, an opening of 0.9 m between them, and a pillar.
WEST = [(1, 0), (1, 0.2), (0.2, 0.2), (0.2, 4.8), (1.5, 4.8), (1.5, 5), (0, 5), (0, 0), (1, 0)]
EAST = [
    *[(1.9, 0), (8, 0), (8, 5), (3.9, 5), (3.9, 4.8), (5, 4.8), (5, 3), (5.1, 3), (5.1, 4.8), (7.8, 4.8), (7.8, 0.2)],
    *[(5.1, 0.2), (5.1, 2.1), (5, 2.1), (5, 0.2), (1.9, 0.2), (1.9, 0)],
]
PILLAR = shapely.box(3.0, 2.0, 3.4, 2.4)
WINDOW = [[(1.5, y), (3.9, y)] for y in (4.8, 5.0)]


BOXES = [("door", shapely.box(1.0, 0.2, 1.9, 1.1)), ("window", shapely.box(1.5, 4.8, 3.9, 5.0))]


def drawn(*walls, windows=(), boxes=()):
    lines = shapely.MultiLineString(list(walls)), shapely.MultiLineString(list(windows))
    return Drawing(*lines, list(boxes), "metres", "walls are lines")


FLAT = drawn(WEST, EAST, PILLAR.exterior, windows=WINDOW, boxes=BOXES)


def test_gaps_are_closed_and_the_room_at_a_point_is_chosen():
    plan = plan_of("flat", FLAT, 1.3, None)
    west = shapely.box(0.2, 0.2, 5.0, 4.8).difference(PILLAR)
    assert shapely.Polygon(plan.rings[0], plan.rings[1:]).symmetric_difference(west).area < 1e-2
    # Boxes of doors and windows are 5 cm wider on each side, which blocks often lack.
    spans = {each.name: each.stop - each.start for each in plan.stretches}
    assert spans == pytest.approx({"door": 1.0, "window": 2.5, "opening": 0.9}, abs=0.03)
    told, start = plan.note.split("; a region of 1")
    assert told == "flat: walls are lines"
    assert start.startswith("2.4 m2 is left out: start = [")
    east = shapely.Polygon(plan_of("flat", FLAT, 1.3, [6.0, 3.0]).rings[0])
    assert east.bounds == pytest.approx((5.1, 0.2, 7.8, 4.8), abs=1e-3)


@pytest.mark.parametrize(("gap", "start"), [(0.5, None), (1.3, [50.0, 3.0])])
def test_walls_that_enclose_no_room_are_refused(gap, start):
    where = "" if start is None else r"start = \[50.0, 3.0\]: "
    with pytest.raises(InputError, match=f"^path: {where}the walls of 'flat' enclose no room; a gap is wider than gap"):
        plan_of("flat", FLAT, gap, start)


TOO_MANY = {
    "crossings of two lines, and at most 1000": [
        ends for i in range(40) for ends in ([(i, -1), (i, 130)], [(-1, i), (130, i)])
    ],
    "meetings of two lines, and at most 50000": [[(0, 0), (1, i / 1e3)] for i in range(400)],
}


@pytest.mark.parametrize("words", TOO_MANY)
def test_lines_that_would_take_hours_are_refused(words, monkeypatch):
    monkeypatch.setattr("lmd.space.wall_lines.MOST_MEETINGS", 50_000)
    monkeypatch.setattr("lmd.space.wall_lines.MOST_CROSSINGS", 1_000)
    with pytest.raises(InputError, match=words):
        plan_of("flat", drawn(*TOO_MANY[words]), 1.3, None)
