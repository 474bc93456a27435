"""Faults that are put into walks."""

from dataclasses import replace

import numpy as np
import pytest
from support import walks

from lmd.adjust.faults import without_faults
from lmd.adjust.prior import Prior
from lmd.geometry.se3 import exp, inverse
from lmd.survey.survey import estimate_map

COUNT, FRAMES, MOVED = 24, 64, 5
IDS = np.arange(COUNT)
NOTHING = Prior(np.tile(np.eye(4), (COUNT, 1, 1)), np.zeros((COUNT, 6)))


@pytest.fixture(scope="module")
def room():
    """Tags and a walk among them."""
    rng = np.random.default_rng(25)
    return walks.wall_tags(COUNT, rng), walks.walk(FRAMES, rng)


def found_in(detected):
    return without_faults(estimate_map(walks.sightings(detected, IDS), NOTHING), np.zeros(COUNT, dtype=bool))


def off(found, true):
    """Distance of the tag from its true place beside another one on its wall, metres."""
    other = MOVED + 4
    relative = inverse(found.poses.tags[other]) @ found.poses.tags[MOVED]
    return np.linalg.norm(relative[:3, 3] - (inverse(true[other]) @ true[MOVED])[:3, 3])


def test_a_walk_without_faults_has_none(room):
    found, faults = found_in(walks.photographed(*room, np.random.default_rng(1)))
    assert (found.group == 0).all()
    assert not faults.second_places
    assert faults.sizes == {}
    assert not faults.misread.any()


def test_a_tag_that_was_moved_half_way_hangs_at_its_last_place(room):
    tags, frames = room
    after = tags.copy()
    after[MOVED] = after[MOVED] @ exp(np.array([0.0, 0.0, 0.1, 0.25, 0.1, 0.0]))
    half, rng = FRAMES // 2, np.random.default_rng(2)
    one, two = walks.photographed(tags, frames[:half], rng), walks.photographed(after, frames[half:], rng)
    found, faults = found_in(walks.one_after_the_other(one, two))
    assert [place.tag for place in faults.second_places] == [MOVED]
    assert faults.second_places[0].moved >= half
    assert off(found, after) < 0.03


def test_two_tags_of_one_id_are_found(room):
    tags, frames = room
    twin = tags[MOVED] @ exp(np.array([0.0, 0.0, 0.0, 0.3, 0.2, 0.0]))
    every = np.concatenate([tags, twin[None]])
    found, faults = found_in(walks.photographed(every, frames, np.random.default_rng(3), ids=np.append(IDS, MOVED)))
    assert [(place.tag, place.moved) for place in faults.second_places] == [(MOVED, None)]
    assert (found.group == 0).all()


@pytest.mark.parametrize("factor", [0.8, 1.1, 1.6])
def test_a_wrong_size_is_found(room, factor):
    edges = np.full(COUNT, walks.EDGE)
    edges[MOVED] *= factor
    found, faults = found_in(walks.photographed(*room, np.random.default_rng(4), edges=edges))
    assert list(faults.sizes) == [MOVED]
    assert faults.sizes[MOVED] == pytest.approx(edges[MOVED], rel=0.01)
    assert found.sightings.edges[MOVED] == faults.sizes[MOVED]
    assert off(found, room[0]) < 0.02


def test_misread_tags_are_counted(room):
    detected = walks.photographed(*room, np.random.default_rng(5))
    wrong = np.flatnonzero(detected.ids == MOVED + 1)[:2]
    ids = detected.ids.copy()
    ids[wrong] = MOVED
    _, faults = found_in(replace(detected, ids=ids))
    assert faults.misread.tolist() == [len(wrong) * (k == MOVED) for k in range(COUNT)]
