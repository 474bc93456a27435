"""Bundle adjustment of walks whose truth is known."""

from dataclasses import replace

import numpy as np
import pytest
from support import walks

from lmd.adjust.prior import Prior
from lmd.geometry.se3 import exp, inverse, log
from lmd.scene.deployment import Deployment
from lmd.survey.knowledge import PriorKnowledge
from lmd.survey.survey import estimate_map

COUNT, FRAMES, SIGMA = 24, 80, 0.2
IDS = np.arange(COUNT)
NOTHING = Prior(np.tile(np.eye(4), (COUNT, 1, 1)), np.zeros((COUNT, 6)))


def walked(seed, **options):
    """Planned poses of tags, true poses, and their detections."""
    rng = np.random.default_rng(seed)
    plan = walks.wall_tags(COUNT, rng)
    true = walks.hung(plan, rng)
    return plan, true, walks.photographed(true, walks.walk(FRAMES, rng), rng, SIGMA, **options)


def prior_of(plan):
    return PriorKnowledge(Deployment(plan[:, :3, 3], plan[:, :3, 2])).prior(IDS)


def estimated(detected, prior=NOTHING, sigma=SIGMA):
    return estimate_map(walks.sightings(detected, IDS, sigma=sigma), prior)


def test_the_map_of_tags_that_hang_off_their_plan_is_found():
    plan, true, detected = walked(3)
    found = estimated(detected, prior_of(plan))
    assert np.flatnonzero(found.group == 0).tolist() == IDS.tolist()
    assert not found.misfits.any()
    assert np.median(walks.apart(found.poses.tags, true)) < 0.0012
    assert np.median(walks.apart(plan, true)) > 0.008
    # The world is that of the plan, within the errors of hanging of all tags.
    assert np.median(np.linalg.norm(found.poses.tags[:, :3, 3] - true[:, :3, 3], axis=1)) < 0.005


def test_the_floor_is_the_error_beyond_the_detectors():
    rng = np.random.default_rng(5)
    detected = walks.photographed(walks.wall_tags(COUNT, rng), walks.walk(FRAMES, rng), rng, 0.5)
    assert estimated(detected, sigma=0.3).floor == pytest.approx(0.4, rel=0.15)


@pytest.mark.parametrize("planned", [True, False])
def test_a_tenth_of_wrong_ids_does_no_harm(planned):
    plan, true, detected = walked(10)
    rng = np.random.default_rng(8)
    wrong = rng.random(len(detected)) < 0.1
    ids = np.where(wrong, (detected.ids + rng.integers(1, COUNT, len(wrong))) % COUNT, detected.ids)
    found = estimated(replace(detected, ids=ids), prior_of(plan) if planned else NOTHING)
    assert (found.group == 0).all()
    assert np.median(walks.apart(found.poses.tags, true)) < 0.002
    assert found.misfits.sum() == pytest.approx(wrong.sum(), abs=0.15 * wrong.sum())
    assert (found.used | found.misfits).sum() > 0.95 * len(detected)


def test_mounts_of_two_cameras_are_found():
    rng = np.random.default_rng(9)
    true = walks.wall_tags(COUNT, rng)
    mounts = np.stack([np.eye(4), exp(np.array([0.02, 0.4, -0.01, 0.2, 0.01, -0.02]))])
    detected = walks.photographed(true, walks.walk(FRAMES, rng), rng, SIGMA, mounts=mounts)
    found = estimated(detected)
    turned, moved = np.split(log(inverse(mounts[1]) @ found.poses.mounts[1]), 2)
    assert np.linalg.norm(moved) < 0.001
    assert np.linalg.norm(turned) < 0.0005
    assert (found.group == 0).all()
    assert np.median(walks.apart(found.poses.tags, true)) < 0.0008


def test_groups_that_no_photograph_connects_stay_apart():
    _, _, detected = walked(11)
    frames = np.where(detected.ids < COUNT // 2, detected.frame, detected.frame + FRAMES)
    order = np.argsort(frames, kind="stable")
    found = estimated(replace(detected, times=tuple(map(str, range(2 * FRAMES))), frame=frames).of(order))
    groups = [set(half) for half in np.split(found.group, 2)]
    assert sorted(groups, key=min) == [{0}, {1}]
    assert np.isnan(found.covariances[found.group == 1]).all()
