"""The tables that say, for a cell of directions, which axes surely cover a landmark there and which may."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from strategies import seeds

from lmd import pdf
from lmd.sight.incremental.bits import unpacked
from lmd.sight.incremental.directions import NOWHERE, SIDE, cell_of, cones
from lmd.sight.kernels import in_blocks

AXES = in_blocks(pdf.grid_with_ends(8).axes.T)
REAL = len(pdf.grid_with_ends(8).axes)


def directions(seed, size=2000):
    drawn = np.random.default_rng(seed).normal(size=(size, 3))
    drawn[:8] = [[1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 1], [0, 0, -1], [1, 1, 0], [0, -1, -1]]
    return drawn / np.linalg.norm(drawn, axis=1, keepdims=True)


@given(seed=seeds, half_angle=st.floats(0.05, 3.0), narrower=st.floats(0.0, 0.5))
def test_no_axis_in_the_outer_cone_is_missed_and_every_axis_of_the_inner_table_is_in_the_inner_cone(
    seed, half_angle, narrower
):
    inner, outer = math.cos(max(half_angle - narrower, 0.0)), math.cos(half_angle)
    certain, possible = (unpacked(table, REAL).astype(bool) for table in cones(AXES, inner, outer))
    towards = directions(seed, 200)
    cells = np.array([cell_of(*direction) for direction in towards])
    cosine = towards @ AXES[:, :REAL]
    assert (possible[cells] >= (cosine >= outer)).all()
    assert (certain[cells] <= (cosine >= inner)).all()
    assert not certain[NOWHERE].any()
    assert not possible[NOWHERE].any()


@pytest.mark.parametrize("inner", [1.0, 2.0])
def test_an_inner_cone_can_be_empty(inner):
    certain, possible = cones(AXES, inner, 0.5)
    assert not certain.any()
    assert possible.any()


def test_tables_leave_little_to_be_tested():
    certain, possible = (unpacked(table, REAL)[:NOWHERE].mean() for table in cones(AXES, 0.8, 0.8))
    cap = (1.0 - 0.8) / 2.0  # the share of the sphere
    assert certain < possible
    assert possible - certain < 0.5 * cap


def test_every_direction_has_a_cell_and_the_opposite_one_another():
    towards = directions(0)
    cells, opposite = (np.array([cell_of(*d) for d in sign * towards]) for sign in (1, -1))
    assert ((cells >= 0) & (cells < NOWHERE)).all()
    assert (cells != opposite).all()
    assert len(np.unique(cells)) > 0.3 * min(len(towards), SIDE * SIDE)
    np.testing.assert_array_equal(cells, [cell_of(*(7.0 * d)) for d in towards])
