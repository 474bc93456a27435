"""Bundle adjustment of linked frames, beside dense algebra and drives whose truth is known."""

from dataclasses import replace

import drives
import numpy as np
import pytest
import walks

from lmd.adjust.corners import Poses, Reprojection, squared_errors, student_weight
from lmd.adjust.motion import DRIFT, STEADY, Motion, seconds_of
from lmd.geometry.se3 import exp, inverse, log
from lmd.survey.adjustment import Adjustment
from lmd.survey.knowledge import EXACT_SIGMA, Prior
from lmd.survey.linked_adjustment import LinkedAdjustment, adjustment_of, constraining

COUNT, SIGMA = 5, 0.2


def system(kind, seed=0):
    """A short drive: truth, sightings, prior, and poses near the true ones."""
    rng = np.random.default_rng(seed)
    driven = drives.drive(7.0, COUNT, rng, dark=0.0)
    some = walks.sightings(driven.detected, np.arange(COUNT), drives.EDGE, SIGMA, drives.CAMERA)
    times = seconds_of(driven.detected.times)
    motion = (
        Motion.by_odometry(times, drives.odometry(driven, rng)) if kind == "odometry" else Motion(times, (0.2, 0.2))
    )
    information = np.zeros((COUNT, 6))
    information[some.tag[0]] = EXACT_SIGMA**-2.0
    some = some.of(constraining(some, np.ones(len(some), dtype=bool), motion))
    tags = driven.tags @ exp(rng.normal(0.0, 0.003, (COUNT, 6)))
    tags[some.tag[0]] = driven.tags[some.tag[0]]
    frames = driven.frames @ exp(rng.normal(0.0, 0.003, (len(times), 6)))
    return driven, some, Prior(driven.tags, information, motion=motion), Poses(tags, frames, np.eye(4)[None])


def dense(adjustment, poses, is_robust=False):
    """Whitened Jacobian and errors: columns of frames with their velocities, of tags, and of the bias of odometry."""
    some, links, seen = adjustment.sightings, adjustment.links, adjustment.seen
    at, joints = Reprojection(some, *poses.of(some)), links.at(poses.frames[seen])
    size, width, alike = links.size, joints.error.shape[1], len(joints.bias)
    first = size * len(seen)
    slopes = np.zeros((8 * len(some) + width * len(links.first) + alike, first + 6 * COUNT + alike))
    errors = np.zeros(len(slopes))
    for n, frame in enumerate(np.searchsorted(seen, some.frame)):
        own = slice(8 * n, 8 * n + 8)
        slopes[own, size * frame : size * frame + 6] = at.by_frame[n] / SIGMA
        slopes[own, first + 6 * some.tag[n] : first + 6 * some.tag[n] + 6] = at.by_tag[n] / SIGMA
        errors[own] = at.error[n] / SIGMA
    for m, one in enumerate(links.first):
        own = slice(8 * len(some) + width * m, 8 * len(some) + width * (m + 1))
        half = np.linalg.cholesky(links.information[m]).T
        slopes[own, size * one : size * one + size] = half @ joints.by_first[m]
        slopes[own, size * one + size : size * one + 2 * size] = half @ joints.by_second[m]
        slopes[own, first + 6 * COUNT :] = half @ joints.by_bias[m]
        errors[own] = half @ joints.error[m]
    if is_robust:
        weights = student_weight((at.error**2).sum(axis=1) / SIGMA**2)
        slopes[: 8 * len(some)] *= np.repeat(weights**0.5, 8)[:, None]
        errors[: 8 * len(some)] *= np.repeat(weights**0.5, 8)
    slopes[len(slopes) - alike :, first + 6 * COUNT :] = np.eye(alike)
    errors[len(slopes) - alike :] = joints.bias
    return slopes, errors, first


@pytest.mark.parametrize("kind", ["odometry", "steady"])
def test_frames_are_eliminated_as_dense_algebra_does(kind):
    _, some, prior, poses = system(kind)
    adjustment = LinkedAdjustment(some, prior)
    matrix, right, _ = adjustment.schur_system(poses, 0.0, 0.0, 1.0)
    slopes, errors, first = dense(adjustment, poses)
    whole, pull = slopes.T @ slopes, -slopes.T @ errors
    kept = np.arange(first, first + 6 * COUNT)
    rest = np.setdiff1d(np.arange(len(whole)), kept)
    inner = np.linalg.solve(whole[np.ix_(rest, rest)] + 1e-9 * np.eye(len(rest)), whole[np.ix_(rest, kept)])
    known = np.diag(prior.information.ravel())
    expected = whole[np.ix_(kept, kept)] + known - whole[np.ix_(kept, rest)] @ inner
    np.testing.assert_allclose(matrix, expected, rtol=1e-4, atol=1e-4 * np.abs(expected[known == 0.0]).max())
    np.testing.assert_allclose(right.ravel(), pull[kept] - inner.T @ pull[rest], atol=1e-3 * np.abs(pull[kept]).max())
    seen = np.flatnonzero(np.diag(expected) > 0.0)
    volume = np.linalg.slogdet(whole[np.ix_(rest, rest)])[1] + np.linalg.slogdet(expected[np.ix_(seen, seen)])[1]
    assert adjustment.log_determinant(poses, 0.0) == pytest.approx(volume, abs=0.05)


@pytest.mark.parametrize("kind", ["odometry", "steady"])
def test_a_step_is_that_of_dense_algebra(kind):
    _, some, prior, poses = system(kind)
    if kind == "odometry":  # wide enough that no link counts less
        prior = replace(prior, motion=replace(prior.motion, spread=(0.5, 1.0)))
    adjustment = LinkedAdjustment(some, prior)
    slopes, errors, first = dense(adjustment, poses, is_robust=True)
    whole = slopes.T @ slopes + 1e-9 * np.eye(slopes.shape[1])
    own = np.arange(first, first + 6 * COUNT)
    whole[own, own] += prior.information.ravel()
    step = -np.linalg.solve(whole, slopes.T @ errors)[:first].reshape(len(adjustment.seen), -1)[:, :6]
    there = adjustment.step(poses, 0.0, 0.0).frames[adjustment.seen]
    np.testing.assert_allclose(
        log(inverse(poses.frames[adjustment.seen]) @ there), step, atol=5e-3 * np.abs(step).max()
    )


def test_frames_that_nothing_links_are_adjusted_as_others():
    _, some, prior, poses = system("steady")
    apart = replace(prior, motion=Motion.steady(100.0 * np.arange(some.frames)))
    some = some.of(np.bincount(some.frame)[some.frame] > 0)
    linked, alone = LinkedAdjustment(some, apart), Adjustment(some, replace(prior, motion=None))
    for one, other in zip(
        linked.schur_system(poses, 0.1, 1e-3)[:2], alone.schur_system(poses, 0.1, 1e-3)[:2], strict=True
    ):
        np.testing.assert_allclose(one, other, atol=1e-6 * np.abs(other).max())
    assert type(adjustment_of(some, replace(prior, motion=None))) is Adjustment


def test_a_single_tag_in_a_linked_frame_constrains_the_map():
    _, some, prior, _ = system("steady")
    used = np.ones(len(some), dtype=bool)
    assert constraining(some, used, prior.motion).all()
    counts = np.bincount(some.frame)
    assert (constraining(some, used, None) == (counts[some.frame] >= 2)).all()


@pytest.mark.parametrize(("kind", "times"), [("odometry", 1.0), ("odometry", 4.0), ("steady", 1.0)])
def test_a_drive_estimates_its_spread(kind, times):
    """The spread of odometry is that of the simulation; that of a steady motion is far below its prior."""
    found = []
    for seed in range(4):
        driven, some, prior, poses = system(kind, seed)
        if kind == "odometry":
            drift = (times * drives.DRIFT[0], times * drives.DRIFT[1])
            odometry = drives.odometry(driven, np.random.default_rng(seed), drift)
            prior = replace(prior, motion=Motion.by_odometry(prior.motion.times, odometry))
        for _ in range(3):
            adjustment = LinkedAdjustment(some, prior)
            poses = adjustment.run(poses, 0.0, 20)[0]
            prior = replace(prior, motion=adjustment.estimate_motion(poses, 0.0))
        found.append(prior.motion.spread)
    turn, place = np.sqrt(np.mean(np.square(found), axis=0))
    if kind == "odometry":
        # A turn adds to the length that the spread is of, and not to the odometer's own error.
        assert 0.75 * times * DRIFT[0] < turn < 1.1 * times * DRIFT[0]
        assert 0.75 * times * DRIFT[1] < place < 1.1 * times * DRIFT[1]
    else:
        assert turn < 0.6 * STEADY[0]
        assert place < 0.6 * STEADY[1]


def test_a_slip_of_a_wheel_counts_little():
    rng = np.random.default_rng(2)
    driven, some, prior, poses = system("odometry", 2)
    odometry = drives.odometry(driven, rng)
    together = np.flatnonzero((np.diff(some.tag) == 0) & (np.diff(some.frame) == 1))
    at = some.frame[together[len(together) // 2]] + 1  # before and after which one tag is seen
    slipped = odometry.poses.copy()
    slipped[at:] = (
        slipped[at - 1] @ exp(np.array([0.0, 0.2, 0.0, 0.0, 0.0, 0.5])) @ inverse(slipped[at - 1]) @ slipped[at:]
    )
    errors = []
    for path in (odometry.poses, slipped):
        motion = Motion.by_odometry(prior.motion.times, replace(odometry, poses=path))
        adjustment = LinkedAdjustment(some, replace(prior, motion=motion))
        found = adjustment.run(poses, 0.0, 40)[0]
        errors.append(np.linalg.norm(found.tags[:, :3, 3] - driven.tags[:, :3, 3], axis=1).max())
        assert np.median(squared_errors(some, found)) < 8.0 * SIGMA**2
    assert errors[1] < errors[0] + 0.15
