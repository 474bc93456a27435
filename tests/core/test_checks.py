from pathlib import Path
from types import SimpleNamespace
from typing import Protocol
from unittest.mock import MagicMock

import numpy as np
import pytest

from lmd.core.checks import InputError, boolean, check_members, file_path, integer, real, seed_number
from lmd.core.tables import radians, seconds


@pytest.mark.parametrize("value", [1000, 1e3, np.int64(1000), np.float64(1000.0)])
def test_a_float_that_is_whole_is_a_whole_number(value):
    number = integer("evaluations", value, low=1)
    assert number == 1000
    assert type(number) is int


def test_a_large_whole_number_keeps_every_digit():
    assert seed_number(2**60 + 1) == 2**60 + 1


def test_large_numbers_are_taken_up_to_what_can_only_be_a_slip():
    assert real("edge", -1e12) == -1e12
    assert real("far", float("inf"), infinite=True) == float("inf")


def test_only_true_and_false_are_boolean():
    assert boolean("page", True) is True
    with pytest.raises(InputError, match=r"^page must be true or false, got "):
        boolean("page", np.True_)


def test_a_path_is_text():
    assert file_path("resume", "runs/first") == Path("runs/first")


@pytest.mark.parametrize("unit", [1e3, 1e6, 1e9])
def test_stamps_of_a_clock_in_other_units_than_seconds_are_refused(unit):
    now = np.array([1.75e9, 1.76e9])
    seconds("flight.csv", now)
    with pytest.raises(
        InputError, match=r"^flight\.csv: time = 1\.?76.* looks like milliseconds or nanoseconds; times"
    ):
        seconds("flight.csv", unit * now)


@pytest.mark.parametrize("rate", [30.0, 200.0])
def test_milliseconds_since_the_start_are_refused_where_the_camera_would_creep(rate):
    time = np.arange(100) / rate
    walk = np.stack([0.8 * time, np.zeros(100), np.ones(100)], axis=1)
    rare = np.arange(100) * 10.0
    for true, way in ((time, walk), (rare, 0.8 * rare[:, None] * [1.0, 0.0, 0.0]), (rare, np.ones((100, 3)))):
        seconds("flight.csv", true, way)
    with pytest.raises(InputError, match=r"^flight\.csv: the times look like milliseconds, .* 0\.8 mm/s; times are"):
        seconds("flight.csv", 1e3 * time, walk)


def test_angles_beyond_one_turn_look_like_degrees():
    radians("flight.csv", yaw=np.array([-6.2832, 6.2832]), pitch=np.array([1.57]))
    with pytest.raises(InputError, match=r"^flight\.csv: yaw = -90 looks like degrees; angles are in radians"):
        radians("flight.csv", yaw=np.array([45.0, -90.0]), pitch=np.zeros(2))


class Shape(Protocol):
    @property
    def sides(self):
        """How many."""

    def area(self):
        """Square metres."""


def test_a_part_that_lacks_a_method_is_named():
    for part in (SimpleNamespace(sides=None, area=float), MagicMock()):  # one that has it, one that delegates
        check_members("shape", part, Shape, "docs/shapes.md")
    told = r"^shape is a .*SimpleNamespace, which lacks area; see docs/shapes\.md\.$"
    with pytest.raises(InputError, match=told):
        check_members("shape", SimpleNamespace(sides=None), Shape, "docs/shapes.md")
