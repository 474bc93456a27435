from dataclasses import replace

import numpy as np
import pytest
import walks

from lmd.geometry.se3 import exp, inverse
from lmd.survey.estimate import estimate_map
from lmd.survey.faults import find_faults
from lmd.survey.prior import Prior

COUNT, FRAMES, SIGMA = 24, 64, 0.2
IDS = np.arange(COUNT)
NOTHING = Prior(np.tile(np.eye(4), (COUNT, 1, 1)), np.zeros((COUNT, 6)))
MOVED = 5


@pytest.fixture(scope="module")
def room():
    """Tags and a walk among them."""
    rng = np.random.default_rng(25)
    return walks.wall_tags(COUNT, rng), walks.walk(FRAMES, rng)


def found_in(detected, edges=walks.EDGE):
    return find_faults(estimate_map(walks.sightings(detected, IDS, edges), NOTHING))


def off(found, true, tag):
    """How far a tag is from where it hangs beside another one, metres."""
    other = (tag + 4) % COUNT  # on the same wall
    relative = inverse(found.poses.tags[other]) @ found.poses.tags[tag]
    return np.linalg.norm(relative[:3, 3] - (inverse(true[other]) @ true[tag])[:3, 3])


def test_a_walk_without_faults_has_none(room):
    tags, frames = room
    found, faults = found_in(walks.photographed(tags, frames, np.random.default_rng(1), SIGMA))
    assert len(found.mapped) == COUNT
    assert faults.second_places == ()
    assert faults.sizes == {}
    assert not faults.misread.any()


def test_a_tag_that_was_moved_half_way_hangs_where_it_was_seen_last(room):
    tags, frames = room
    after = tags.copy()
    after[MOVED] = after[MOVED] @ exp(np.array([0.0, 0.0, 0.1, 0.25, 0.1, 0.0]))
    half = FRAMES // 2
    rng = np.random.default_rng(2)
    one, two = walks.photographed(tags, frames[:half], rng, SIGMA), walks.photographed(after, frames[half:], rng, SIGMA)
    found, faults = found_in(walks.one_after_the_other(one, two))
    assert [place.tag for place in faults.second_places] == [MOVED]
    assert faults.second_places[0].moved >= half
    assert off(found, after, MOVED) < 0.03


def test_two_tags_of_one_number_are_named(room):
    tags, frames = room
    twin = tags[MOVED] @ exp(np.array([0.0, 0.0, 0.0, 0.3, 0.2, 0.0]))
    every = np.concatenate([tags, twin[None]])
    detected = walks.photographed(every, frames, np.random.default_rng(3), SIGMA, ids=np.append(IDS, MOVED))
    found, faults = found_in(detected)
    assert [(place.tag, place.moved) for place in faults.second_places] == [(MOVED, None)]
    assert len(found.mapped) == COUNT


@pytest.mark.parametrize("factor", [0.8, 1.1, 1.6])
def test_a_wrong_size_is_found(room, factor):
    tags, frames = room
    edges = np.full(COUNT, walks.EDGE)
    edges[MOVED] *= factor
    found, faults = found_in(walks.photographed(tags, frames, np.random.default_rng(4), SIGMA, edges=edges))
    assert list(faults.sizes) == [MOVED]
    assert faults.sizes[MOVED] == pytest.approx(edges[MOVED], rel=0.01)
    assert found.sightings.edges[MOVED] == faults.sizes[MOVED]
    assert off(found, tags, MOVED) < 0.02


def test_misread_tags_are_counted(room):
    tags, frames = room
    detected = walks.photographed(tags, frames, np.random.default_rng(5), SIGMA)
    wrong = np.flatnonzero(detected.ids == MOVED + 1)[:2]
    ids = detected.ids.copy()
    ids[wrong] = MOVED
    _, faults = found_in(replace(detected, ids=ids))
    assert faults.misread[MOVED] == len(wrong)
    assert faults.misread.sum() == len(wrong)
