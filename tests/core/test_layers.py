import gc
import weakref
from typing import NamedTuple

import numpy as np
import pytest

from lmd.core.compiled import borrowing, inner
from lmd.core.layers import layer, layers
from lmd.incremental.state import State


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
    """Python looks for garbage in circles too seldom, and here never: an optimisation took 600 MB more."""
    assert not gc.isenabled()
    made = layers(pair, 2)
    kept = weakref.ref(made.first)
    del made
    assert kept() is None


@inner
def _both(one, other):
    return 10 * one.units[0] + other.units[0]


def _compare(bundle, found):
    last = layer(bundle, 0)
    for i in range(len(found)):
        new = layer(bundle, i)
        found[i] = _both(last, new)
        if i % 3 == 1:
            last = new


@pytest.mark.parametrize("kind", [inner, borrowing])
def test_a_layer_stays_what_it_was_as_others_are_taken(kind):
    known = layers(State(**{name: np.zeros(1, dtype=np.int64) for name in State._fields}), 6)
    known.units[:, 0] = range(6)
    found = np.zeros(6, dtype=np.int64)
    kind(_compare)(known, found)
    assert found.tolist() == [0, 1, 12, 13, 14, 45]
