"""The tables that say, for a cell of directions, which axes surely cover a landmark there and which may."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.paper import paper_camera, paper_scene
from support.strategies import seeds

from lmd.core.bits import in_words, unpacked
from lmd.scene import pdf
from lmd.scene.criteria import in_view as seen
from lmd.scene.tag import Tag
from lmd.sight.directions import EMPTY_ROW, SIDE, cell_of, tables
from lmd.sight.models.fiducial import Fiducial

AXIS = pdf.grid_with_ends(8).axes
RIGHT = np.cross(AXIS, [0.6, 0.0, 0.8])  # any way around will do
AXES = in_words(np.hstack([AXIS, RIGHT / np.linalg.norm(RIGHT, axis=1, keepdims=True)]).T)
REAL = len(AXIS)


def directions(seed, size=2000):
    drawn = np.random.default_rng(seed).normal(size=(size, 3))
    drawn[:8] = [[1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 1], [0, 0, -1], [1, 1, 0], [0, -1, -1]]
    return drawn / np.linalg.norm(drawn, axis=1, keepdims=True)


def sights(half_angle):
    """A round view of that half-angle, rad, and a rectangular one of a camera with a principal point off the centre."""
    cone = paper_scene().sight._replace(min_cosine=math.cos(half_angle))
    image = replace(paper_camera(), principal_point=(500.0, 700.0))
    return [cone, Fiducial(Tag(0.1)).sight(image)]


@given(seed=seeds, half_angle=st.floats(0.05, 3.0), which=st.integers(0, 1))
def test_no_axis_with_a_direction_in_view_is_missed_and_the_certain_ones_have_all_around_it_in_view(
    seed, half_angle, which
):
    sight, rng = sights(half_angle)[which], np.random.default_rng(seed)
    certain, possible = (unpacked(table, REAL).astype(bool) for table in tables(sight, AXES))
    towards = directions(seed, 50)
    cells = np.array([cell_of(tuple(direction)) for direction in towards])

    def in_view(ways, at):
        return [seen(sight, tuple(ways[d]), 0.0, 1.0, *map(tuple, np.split(AXES[:, a], 2))) for d, a in np.argwhere(at)]

    assert not any(in_view(towards, ~possible[cells]))
    near = towards + 0.99 * math.tan(sight.inset) * directions(rng.integers(2**32), 50)
    assert all(in_view(near / np.linalg.norm(near, axis=1, keepdims=True), certain[cells]))
    for table in (certain, possible):
        assert not table[EMPTY_ROW].any()


def test_a_cone_narrower_than_a_cell_contains_none():
    certain, possible = tables(sights(0.01)[0], AXES)
    assert not certain.any()
    assert possible.any()


@pytest.mark.parametrize("which", [0, 1])
def test_tables_leave_little_to_be_tested(which):
    certain, possible = (unpacked(t, REAL)[:EMPTY_ROW].mean() for t in tables(sights(0.65)[which], AXES))
    assert 0.03 < certain < possible < 2.5 * certain


def test_every_direction_has_a_cell_and_the_opposite_one_another():
    towards = directions(0)
    cells, opposite = (np.array([cell_of(tuple(d)) for d in sign * towards]) for sign in (1, -1))
    assert ((cells >= 0) & (cells < EMPTY_ROW)).all()
    assert (cells != opposite).all()
    assert len(np.unique(cells)) > 0.3 * min(len(towards), SIDE * SIDE)
    np.testing.assert_array_equal(cells, [cell_of(tuple(7.0 * d)) for d in towards])
