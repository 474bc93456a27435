"""Photographs that a survey proposes; some 5 seconds in all."""

from dataclasses import replace

import numpy as np
import pytest
import walks

from lmd.scene.deployment import Deployment
from lmd.scene.labels import Labels
from lmd.space.cuboid import Cuboid
from lmd.survey.next_photographs import next_photographs
from lmd.survey.results import needing_photographs, survey_document
from lmd.survey.terminal import to_text

COUNT, UNSEEN, SIGMA = 20, 7, 0.2
ERRORS, ROOM = walks.constant_errors(SIGMA), Cuboid((5.0, 4.0, 2.5), (4.0, 3.0, 1.5), 1.0)


def surveyed(detected, plan):
    found = walks.surveyed(detected, plan=plan)
    return replace(found, proposed=next_photographs(found, walks.CAMERA, 8, ERRORS, needing_photographs(found), ROOM))


@pytest.fixture(scope="module")
def room():
    rng = np.random.default_rng(31)
    plan = walks.spaced_tags(COUNT, rng)
    true = walks.hung(plan, rng)
    detected = walks.photographed(true, walks.walk(50, rng), rng, SIGMA)
    return true, Deployment(plan[:, :3, 3], plan[:, :3, 2], labels=Labels(np.arange(COUNT))), detected


@pytest.fixture(scope="module")
def found(room):
    _, plan, detected = room
    return surveyed(detected.of(np.flatnonzero(detected.ids != UNSEEN)), plan)


def test_the_tag_that_was_not_seen_is_in_the_first_photograph(found):
    first = found.proposed[0]
    assert UNSEEN in found.ids[first.tags]
    assert len(first.tags) >= 2
    assert ROOM.contains(first.pose[:3, 3])
    assert survey_document(found)["next_photographs"][0]["tags"] == found.ids[first.tags].tolist()
    assert "\nnext 1 " in to_text(found)


def test_each_photograph_reduces_sigma(found):
    left = [photograph.left for photograph in found.proposed]
    assert left == sorted(left, reverse=True)


def test_no_two_photographs_are_nearly_the_same(found):
    """The second of them would have the errors of the first."""
    poses = np.stack([photograph.pose for photograph in found.proposed])
    first, second = np.triu_indices(len(poses), 1)
    apart = np.linalg.norm(poses[first, :3, 3] - poses[second, :3, 3], axis=1)
    turned = np.degrees(np.arccos(np.clip((poses[first, :3, 2] * poses[second, :3, 2]).sum(axis=1), -1.0, 1.0)))
    assert len(first) >= 1
    assert ((apart > 0.29) | (turned > 14.0)).all()


def test_the_predicted_sigma_is_that_of_a_survey_with_the_photograph(room, found):
    true, plan, detected = room
    first = found.proposed[0]
    rng = np.random.default_rng(1)
    extra = walks.photographed(true, first.pose[None], rng, SIGMA)
    kept = detected.of(np.flatnonzero(detected.ids != UNSEEN))
    taken = surveyed(walks.one_after_the_other(kept, extra), plan)
    assert taken.placed[UNSEEN]
    places = np.trace(taken.found.gauge_free_covariances[:, 3:, 3:], axis1=1, axis2=2)
    assert np.sqrt(places.mean()) == pytest.approx(first.left, rel=0.25)


def test_without_a_tag_in_need_no_photograph_is_proposed(found):
    assert next_photographs(found, walks.CAMERA, 8, ERRORS, np.empty(0, dtype=np.int64), ROOM) == ()
