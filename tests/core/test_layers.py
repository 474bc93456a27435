import gc
import weakref
from typing import NamedTuple

import numpy as np
import pytest

from lmd.core.layers import layer, layers


class Pair(NamedTuple):
    first: np.ndarray
    others: tuple[np.ndarray, ...]


@pytest.fixture
def pair():
    return Pair(np.arange(3.0), (np.ones((2, 2), dtype=bool), np.arange(4)))


def test_a_layer_is_a_copy_of_the_bundle(pair):
    made = layers(pair, 2)
    layer(made, 1).first[0] = 7.0
    assert layer(made, 0).first.tolist() == pair.first.tolist() == [0.0, 1.0, 2.0]
    assert layer(made, 1).first.tolist() == [7.0, 1.0, 2.0]
    assert [part.tolist() for part in layer(made, 1).others] == [part.tolist() for part in pair.others]


def test_an_array_that_is_there_twice_stays_one(pair):
    made = layers(Pair(pair.first, (pair.first,)), 2)
    assert made.first is made.others[0]


def test_layers_that_nobody_needs_are_gone_at_once(pair):
    """Python looks for garbage in circles too seldom: an optimisation took 600 MB more."""
    gc.disable()
    try:
        made = layers(pair, 2)
        kept = weakref.ref(made.first)
        del made
        assert kept() is None
    finally:
        gc.enable()
