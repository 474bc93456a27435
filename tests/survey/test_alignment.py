"""Tags whose corners begin at another one than those of the plan: places decide, then ups."""

from dataclasses import replace

import numpy as np
import pytest
import walks

from lmd.core.checks import InputError
from lmd.scene.deployment import Deployment
from lmd.scene.labels import Labels
from lmd.scene.surveyed import Surveyed
from lmd.scene.tag import Tag
from lmd.survey.report import document, map_of, to_text
from lmd.survey.survey import Known, survey

COUNT, FRAMES, SIGMA = 20, 50, 0.2
FIXED, FREE = np.arange(0, COUNT, 2), np.arange(1, COUNT, 2)


@pytest.fixture(scope="module")
def room():
    """Tags on the walls, and what was detected of them."""
    rng = np.random.default_rng(5)
    tags = walks.spaced_tags(COUNT, rng)
    return tags, walks.photographed(tags, walks.walk(FRAMES, rng), rng, SIGMA)


def known_of(tags, ids):
    places = tags[ids, :3, 3]
    return Deployment(places, tags[ids, :3, 2], labels=Labels(ids), surveyed=Surveyed(places, places, tags[ids, :3, 1]))


def begun_at(detected, quarters):
    """The detections with corners that begin at another one: the next one as one goes round clockwise, by id."""
    rows = [
        np.roll(one, -quarters.get(number, 0), axis=0)
        for number, one in zip(detected.ids.tolist(), detected.corners, strict=True)
    ]
    return replace(detected, corners=np.array(rows))


def surveyed(detected, **known):
    return survey(detected, [walks.CAMERA], Tag(walks.EDGE), walks.constant_errors(SIGMA), Known(**known))


def off(found, tags):
    """How far tags of a map are from where they hang, metres, and their ups from what these are."""
    hung = map_of(found)
    return (
        np.linalg.norm(each - tags[hung.ids, :3, column], axis=1) for each, column in ((hung.places, 3), (hung.ups, 1))
    )


@pytest.mark.parametrize("quarters", [1, 2, 3])
@pytest.mark.parametrize("name", ["fixed", "plan"])
def test_corners_that_all_begin_elsewhere_are_counted_anew(room, quarters, name):
    tags, detected = room
    found = surveyed(begun_at(detected, dict.fromkeys(range(COUNT), quarters)), **{name: known_of(tags, FIXED)})
    away, ups = off(found, tags)
    assert len(away) == COUNT
    assert away.max() < 0.01
    assert ups.max() < 0.03
    # The corner that comes next clockwise was at the upper left: the tag is seen turned counter-clockwise the less.
    assert f"all, by {360 - 90 * quarters} degrees" in to_text(found)
    assert set(document(found)["turned"].values()) == {360 - 90 * quarters}


@pytest.mark.parametrize("name", ["fixed", "plan"])
def test_some_tags_that_hang_on_their_side_or_upside_down_are_named(room, name):
    tags, detected = room
    found = surveyed(begun_at(detected, {0: 2, 4: 1}), **{name: known_of(tags, FIXED)})
    away, ups = off(found, tags)
    assert away.max() < 0.01
    assert ups.max() < 0.03
    assert document(found)["turned"] == {"0": 180, "4": 270}
    assert "0 (180 degrees), 4 (270 degrees)" in to_text(found)


def test_fixed_tags_stay_where_they_are_fixed(room):
    tags, detected = room
    found = surveyed(begun_at(detected, dict.fromkeys(range(COUNT), 2)), fixed=known_of(tags, FIXED))
    np.testing.assert_allclose(map_of(found).places[FIXED], tags[FIXED, :3, 3], atol=3e-6)


def test_upright_tags_are_not_counted_anew(room):
    tags, detected = room
    found = surveyed(detected, plan=known_of(tags, FIXED))
    assert document(found)["turned"] == {}
    assert "in their planes" not in to_text(found)


def test_two_known_tags_are_enough_to_tell_that_both_are_turned(room):
    tags, detected = room
    found = surveyed(begun_at(detected, dict.fromkeys(range(COUNT), 2)), fixed=known_of(tags, FIXED[:2]))
    away, _ = off(found, tags)
    assert away.max() < 0.05


def test_a_fixed_tag_that_hangs_elsewhere_is_refused(room):
    tags, detected = room
    wrong = tags.copy()
    wrong[4, :3, 3] += [0.0, 0.0, 0.3]
    with pytest.raises(InputError, match=r"fixed has tag 4 0\.3 m from where \d+ detections show it") as refused:
        surveyed(detected, fixed=known_of(wrong, FIXED))
    assert refused.value.argument == "fixed"
