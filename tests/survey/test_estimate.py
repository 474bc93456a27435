from dataclasses import replace

import numpy as np
import pytest
import walks
from scipy.optimize import approx_fprime
from scipy.stats import chi2

from lmd.geometry.se3 import camera_pose, exp, inverse, log
from lmd.scene.deployment import Deployment
from lmd.survey.estimate import estimate_map
from lmd.survey.prior import Known, Prior, poses_of
from lmd.survey.residuals import Poses, Reprojection, squared_errors

COUNT, FRAMES, SIGMA = 24, 80, 0.2
NOTHING = Prior(np.tile(np.eye(4), (COUNT, 1, 1)), np.zeros((COUNT, 6)))


def walked(seed, **options):
    """Where tags were planned, where they hang, and their sightings."""
    rng = np.random.default_rng(seed)
    plan = walks.wall_tags(COUNT, rng)
    true = walks.hung(plan, rng)
    detected = walks.photographed(true, walks.walk(FRAMES, rng), rng, SIGMA, **options)
    return plan, true, detected


def deployment_of(poses):
    return Deployment(poses[:, :3, 3], poses[:, :3, 2])


def off(found, true):
    """How far tags are from where they hang, millimetres, once the maps are laid on each other."""
    a, b = found[:, :3, 3], true[:, :3, 3]
    left, _, right = np.linalg.svd((a - a.mean(0)).T @ (b - b.mean(0)))
    turn = left @ np.diag([1.0, 1.0, np.linalg.det(left @ right)]) @ right
    return 1e3 * np.linalg.norm((a - a.mean(0)) @ turn - (b - b.mean(0)), axis=1)


def test_derivatives_are_those_of_the_residuals():
    rng = np.random.default_rng(1)
    tag, mount = walks.wall_tags(1, rng), exp(rng.normal(0.0, 0.1, (1, 6)))
    frame = camera_pose(tag[:, :3, 3] + [0.4, 1.5, 0.2], np.pi, 0.1, 0.05) @ inverse(mount)
    one = walks.photographed(tag, frame @ mount, rng, SIGMA)
    some = walks.sightings(one, [0])
    at = Reprojection(some, tag, frame, mount)
    for which, found in enumerate((at.by_tag, at.by_frame, at.by_mount)):

        def error(twist, which=which):
            poses = [tag, frame, mount]
            poses[which] = poses[which] @ exp(twist[None])
            return Reprojection(some, *poses).error[0]

        np.testing.assert_allclose(found[0], approx_fprime(np.zeros(6), error, 1e-7), rtol=1e-3, atol=0.5)


def test_the_map_of_tags_that_hang_off_their_plan_is_found():
    plan, true, detected = walked(3)
    prior = Known(deployment_of(plan)).prior(np.arange(COUNT))
    found = estimate_map(walks.sightings(detected, np.arange(COUNT)), prior)
    assert found.mapped.tolist() == list(range(COUNT))
    assert not found.misfits.any()
    assert np.median(off(found.poses.tags, true)) < 1.2
    assert np.median(off(plan, true)) > 8.0
    # The world is that of the plan, as well as so many tags that hang at random say where it is.
    assert np.median(np.linalg.norm(found.poses.tags[:, :3, 3] - true[:, :3, 3], axis=1)) < 0.005


def test_covariances_hold():
    """The squared normalised errors of one tag over seeds are within the 99 % limits of their distribution."""
    squares = []
    for seed in range(6):
        _, true, detected = walked(100 + seed)
        found = estimate_map(walks.sightings(detected, np.arange(COUNT)), NOTHING)
        first = int(np.flatnonzero(found.prior.information.any(axis=1))[0])
        tag = (first + 1) % COUNT
        twist = log(inverse(true[tag]) @ true[first] @ found.poses.tags[tag])
        squares.append(twist @ np.linalg.solve(found.covariances[tag], twist))
    low, high = chi2.ppf([0.005, 0.995], 6 * len(squares))
    assert low < sum(squares) < high


def test_errors_the_detector_does_not_account_for_are_found():
    rng = np.random.default_rng(5)
    true = walks.wall_tags(COUNT, rng)
    detected = walks.photographed(true, walks.walk(FRAMES, rng), rng, 0.5)
    found = estimate_map(walks.sightings(detected, np.arange(COUNT), sigma=0.3), NOTHING)
    assert found.floor == pytest.approx(0.4, rel=0.15)


@pytest.mark.parametrize("planned", [True, False])
def test_a_tenth_of_wrong_ids_does_no_harm(planned):
    plan, true, detected = walked(10)
    rng = np.random.default_rng(8)
    wrong = rng.random(len(detected)) < 0.1
    ids = np.where(wrong, (detected.ids + rng.integers(1, COUNT, len(wrong))) % COUNT, detected.ids)
    prior = Known(deployment_of(plan)).prior(np.arange(COUNT)) if planned else NOTHING
    found = estimate_map(walks.sightings(replace(detected, ids=ids), np.arange(COUNT)), prior)
    assert len(found.mapped) == COUNT
    assert np.median(off(found.poses.tags, true)) < 2.0
    of_map = found.used | found.misfits
    assert found.misfits.sum() == pytest.approx(wrong.sum(), abs=0.15 * wrong.sum())
    assert of_map.sum() > 0.95 * len(detected)


def test_two_cameras_on_one_body_find_how_they_are_mounted():
    rng = np.random.default_rng(9)
    true = walks.wall_tags(COUNT, rng)
    mounts = np.stack([np.eye(4), exp(np.array([0.02, 0.4, -0.01, 0.2, 0.01, -0.02]))])
    detected = walks.photographed(true, walks.walk(FRAMES, rng), rng, SIGMA, mounts=mounts)
    found = estimate_map(walks.sightings(detected, np.arange(COUNT)), NOTHING)
    assert len(found.mapped) == COUNT
    turned, moved = np.split(log(inverse(mounts[1]) @ found.poses.mounts[1]), 2)
    assert np.linalg.norm(moved) < 0.001
    assert np.linalg.norm(turned) < 0.0005
    assert np.median(off(found.poses.tags, true)) < 0.8
    told = estimate_map(walks.sightings(detected, np.arange(COUNT)), replace(NOTHING, mounts=mounts))
    np.testing.assert_allclose(told.poses.mounts, mounts, atol=1e-12)
    assert np.median(off(told.poses.tags, true)) < 0.8


def test_groups_that_no_photograph_connects_are_told_apart():
    _, _, detected = walked(11)
    half = detected.ids < COUNT // 2
    frames = np.where(half, detected.frame, detected.frame + FRAMES)
    order = np.argsort(frames, kind="stable")
    apart = replace(detected, times=tuple(map(str, range(2 * FRAMES))), frame=frames).of(order)
    found = estimate_map(walks.sightings(apart, np.arange(COUNT)), NOTHING)
    assert set(found.group.tolist()) == {0, 1}
    assert len({tuple(found.group[: COUNT // 2]), tuple(found.group[COUNT // 2 :])}) == 2
    assert np.isnan(found.covariances[found.group == 1]).all()


def test_the_least_sum_is_reached():
    """No other pose of a tag nearby explains the sightings better."""
    _, _, detected = walked(13)
    found = estimate_map(walks.sightings(detected, np.arange(COUNT)), NOTHING)
    some = found.sightings.of(found.used)

    def cost(poses: Poses) -> float:
        return float(np.log1p(squared_errors(some, poses) / (some.noise**2 + found.floor**2) / 4.0).sum())

    for seed in range(6):
        step = np.random.default_rng(seed).normal(0.0, 3e-5, 6)
        moved = found.poses.tags.copy()
        moved[found.mapped[seed + 1]] = moved[found.mapped[seed + 1]] @ exp(step)
        assert cost(replace(found.poses, tags=moved)) > cost(found.poses)


def test_poses_of_a_deployment_have_z_along_the_normal():
    tags = walks.wall_tags(4, np.random.default_rng(2))
    np.testing.assert_allclose(poses_of(deployment_of(tags)), tags, atol=1e-12)
