"""Lines of walls, windows and doors enclose a room."""

import pytest
import shapely

from lmd.core.checks import InputError
from lmd.space.wall_lines import Drawing, plan_of

TOO_MANY = {
    "crossings of two lines; at most 1000": [
        ends for i in range(40) for ends in ([(i, -1), (i, 130)], [(-1, i), (130, i)])
    ],
    "meetings of two lines; at most 50000": [[(0, 0), (1, i / 1e3)] for i in range(400)],
}


@pytest.mark.parametrize("words", TOO_MANY)
def test_lines_that_would_take_hours_are_refused(words, monkeypatch):
    monkeypatch.setattr("lmd.space.wall_lines.MOST_MEETINGS", 50_000)
    monkeypatch.setattr("lmd.space.wall_lines.MOST_CROSSINGS", 1_000)
    lines = shapely.MultiLineString(TOO_MANY[words])
    with pytest.raises(InputError, match=words):
        plan_of("flat", Drawing(lines, shapely.MultiLineString(), [], "metres", "walls are lines"), 1.3, None)
