import numpy as np
import pytest

from lmd.sight.blocks import BLOCK, boxes_around, in_blocks


@pytest.mark.parametrize("size", [1, 2, BLOCK - 1, BLOCK, BLOCK + 1, 3 * BLOCK, 500])
def test_each_position_is_in_one_block_and_copies_fill_up_the_last(size):
    order, index_of = in_blocks(np.random.default_rng(size).uniform(size=(size, 3)))
    assert len(order) == -(-size // BLOCK) * BLOCK
    assert sorted(order[:size]) == list(range(size))
    np.testing.assert_array_equal(order[index_of], np.arange(size))
    assert set(order[size:]) <= {order[size - 1]}


def test_a_block_has_neighbours():
    """Of a grid in any order, four times four positions each."""
    x, y = np.meshgrid(np.arange(8.0), np.arange(16.0))
    positions = np.random.default_rng(0).permutation(np.column_stack([x.ravel(), y.ravel(), np.ones(x.size)]))
    order, _ = in_blocks(positions)
    centres, halves = boxes_around(positions[order])
    np.testing.assert_allclose(halves, np.tile([[1.5], [1.5], [0.0]], 8), rtol=1e-5)
    assert len({tuple(centre) for centre in centres.T}) == 8


def test_where_sides_are_equal_the_first_is_cut_and_equal_positions_stay_in_order():
    positions = np.zeros((2 * BLOCK, 3))
    np.testing.assert_array_equal(in_blocks(positions)[0], np.arange(2 * BLOCK))
    positions[:BLOCK, :2] = 1.0
    np.testing.assert_array_equal(in_blocks(positions)[0], [*range(BLOCK, 2 * BLOCK), *range(BLOCK)])
