"""Laws that hold for every factor of a bundle adjustment: corners, priors of tags, sheets, mounts, links of motion."""

from dataclasses import replace

import adjust_rooms as rooms
import numpy as np
import pytest
from scipy.optimize import approx_fprime
from scipy.stats import chi2
from support import walks
from threadpoolctl import threadpool_limits

from lmd.adjust.adjustment import Adjustment
from lmd.adjust.corners import Poses, Reprojection, student_weight
from lmd.adjust.estimate import ONE_THREAD, Estimate
from lmd.adjust.gauge import in_world, rows_of
from lmd.adjust.intrinsics import Optics, intrinsics_of, parameter_slopes, prior_sigmas, with_intrinsics
from lmd.adjust.prior import EXACT_SIGMA
from lmd.geometry.projection import bearings, project
from lmd.geometry.se3 import camera_pose, exp, inverse, log

LINKS = (None, "odometry", "constant velocity")
EVERY = ("independent", "sheets")
WORLD = exp(np.array([0.4, -0.3, 1.1, 2.0, -1.0, 0.5]))
NOWHERE = np.zeros(rooms.TAGS, dtype=np.int64)


def adjustment_of(room, nuisances=False):
    return Adjustment(room.sightings(nuisances), room.prior, nuisances)


def adjusted(room, poses):
    """Estimate from poses."""
    with threadpool_limits(limits=ONE_THREAD):
        return Estimate(room.sightings(), room.prior, poses, NOWHERE).adjusted(0.0)


def nees(found, true, covariances):
    """Squared normalised errors of poses `(n, 4, 4)`."""
    off = log(inverse(found) @ true)
    return np.einsum("ni,nij,nj->n", off, np.linalg.inv(covariances), off)


@pytest.mark.parametrize("factor", ["tag", "frame", "mount", "shape", "size", "lens"])
def test_the_jacobian_of_corners_is_their_derivative(factor):
    room = rooms.drawn(EVERY, sigma=0.0)
    some, true = room.sightings(nuisances=True), room.true
    sigmas = [np.append(prior_sigmas(rooms.CAMERA), [0.1, 0.05])] * 3
    at = Reprojection(some, *true.of(some))
    found = {"lens": some.lens[..., :11] / sigmas[0], **{f: getattr(at, f"by_{f}") for f in ("tag", "frame", "mount")}}
    found |= {"shape": at.by_shape, "size": at.by_size}

    def error(values):
        poses, other = {"tags": true.tags, "frames": true.frames, "mounts": true.mounts}, some
        if factor == "lens":
            other = room.seen.through([Optics(rooms.CAMERA).at(values)] * 3)
        elif factor == "size":
            other = replace(some, edges=some.edges * np.exp(values[0]))
        elif factor == "shape":
            other = replace(some, shapes=np.tile(values, (rooms.TAGS, 1)))
        else:
            poses[f"{factor}s"] = poses[f"{factor}s"] @ exp(values)
        return Reprojection(other, *Poses(**poses).of(other)).error.ravel()

    start = Optics(rooms.CAMERA).values if factor == "lens" else np.zeros(found[factor].shape[2])
    step = np.r_[[1e-3] * 4, [1e-5] * 5, [1e-4] * 2] if factor == "lens" else 1e-7
    expected = approx_fprime(start, error, step).reshape(found[factor].shape)
    scale = np.abs(expected).max(axis=(0, 1))
    np.testing.assert_allclose(found[factor] / scale, expected / scale, rtol=1e-2, atol=1e-3)


@pytest.mark.parametrize(
    "camera",
    [
        rooms.CAMERA,
        walks.CAMERA,
        replace(rooms.CAMERA, distortion_model="equidistant", distortion=(0.01, 0.0, 0.0, 0.0)),
    ],
)
def test_slopes_by_intrinsics_are_those_of_the_image(camera):
    direction = bearings(camera, np.array([[1300.0, 250.0]]))
    values = intrinsics_of(camera)

    def seen(values):
        return project(with_intrinsics(camera, values), np.eye(4), direction)[0]

    expected = approx_fprime(values, seen, 1e-6 * np.maximum(np.abs(values), 1.0))
    np.testing.assert_allclose(parameter_slopes(camera, direction)[0], expected, rtol=1e-3, atol=1e-3)


@pytest.mark.parametrize("factor", rooms.FACTORS)
def test_the_gradient_is_the_derivative_of_the_loss(factor):
    """The gradient of all unknowns, before frames are eliminated, along random directions."""
    room, rng = rooms.drawn((factor,)), np.random.default_rng(1)
    poses, _ = rooms.astray(room.true, rng, 0.2)
    joint = adjustment_of(room)
    system = joint.system(poses, 0.0)
    steps = system.frames.steps(np.zeros((rooms.FRAMES, 6)))
    kept = system.right.copy()
    (part,) = system.frames.parts
    kept[part.rows] += np.einsum("firk,fi->rk", part.panel, steps)
    own = part.gradient if joint.links is None else system.frames.right[:, :6]
    for _ in range(4):
        _, twists = rooms.astray(room.true, rng)
        expected = -(kept[: rooms.TAGS] * twists[0]).sum() - (own * twists[1]).sum()
        expected -= (kept[joint.mounts] * twists[2][1:]).sum()
        there, here = (joint.loss(rooms.moved(poses, twists, by), 0.0) for by in (1e-3, -1e-3))
        assert (there - here) / 2e-3 == pytest.approx(expected, rel=1e-2)


def dense(joint, poses, weight=None):
    """Information of all unknowns, and their gradient downhill: frames with their velocities, kept unknowns, poses of
    sheets, and the bias of odometry.
    """
    some, prior, links, seen = joint.sightings, joint.prior, joint.links, joint.seen
    size = 6 if links is None else links.size
    first, kept = size * len(seen), 6 * joint.kept
    matrix, right = np.zeros((first + kept + 6, first + kept + 6)), np.zeros(first + kept + 6)

    def add(information, error, *slopes):
        for here, slope in slopes:
            right[here : here + slope.shape[1]] -= slope.T @ information @ error
            for there, other in slopes:
                matrix[here : here + slope.shape[1], there : there + other.shape[1]] += slope.T @ information @ other

    at, sigmas = Reprojection(some, *poses.of(some)), some.shape_sigmas
    sheet, bias = first + kept, first + 6 * joint.first_lens - 6
    for n, (frame, tag, camera) in enumerate(
        zip(np.searchsorted(seen, some.frame), some.tag, some.camera, strict=True)
    ):
        slopes = [(size * frame, at.by_frame[n]), (first + 6 * tag, at.by_tag[n])]
        if camera:
            slopes.append((first + 6 * (rooms.TAGS + camera - 1), at.by_mount[n]))
        if joint.lens_blocks:
            slopes.append((first + 6 * (joint.first_lens + joint.lens_blocks * camera), some.lens[n]))
            slopes.append((first + 6 * (joint.first_shape + tag), sigmas[tag] * at.by_shape[n]))
        variance = some.noise[n] ** 2
        trust = student_weight(at.squared[n] / variance) if weight is None else weight
        add(trust / variance * np.eye(8), at.error[n], *slopes)
    off, robust = prior.off(poses.tags), weight is None
    for k in range(rooms.TAGS):
        trust = student_weight(prior.squares(off)[k], 6) if robust else 1.0
        add(trust * np.diag(prior.information[k]), off[k], (first + 6 * k, np.eye(6)))
    if prior.sheets is not None:
        twists, squares = prior.sheets.fitted(poses.tags)
        for m, tag in enumerate(prior.sheets.tag):
            trust = student_weight(squares[m], 6) if robust else 1.0
            slopes = (first + 6 * tag, np.eye(6)), (sheet, -prior.sheets.turned[m])
            add(trust * np.diag(prior.sheets.information), twists[m], *slopes)
    for c, twist in enumerate(prior.mounts.off(poses.mounts)):
        add(np.diag(prior.mounts.information[c]), twist, (first + 6 * (rooms.TAGS + c), np.eye(6)))
    right[sheet:] = 0.0  # sheets are at their best
    own = np.arange(first + 6 * joint.first_lens, first + kept)
    matrix[own, own] += 1.0
    if links is not None:
        joints = links.at(poses.frames[seen])
        trust = links.weights(links.squares(joints.error)) if robust else np.ones(len(links.first))
        for m, one in enumerate(links.first):
            slopes = (
                (size * one, joints.by_first[m]),
                (size * (one + 1), joints.by_second[m]),
                (bias, joints.by_bias[m]),
            )
            add(trust[m] * links.information[m], joints.error[m], *slopes)
        add(np.eye(len(joints.bias)), joints.bias, (bias, np.eye(len(joints.bias))))
    there = np.flatnonzero(np.diag(matrix) > 0.0)
    return matrix[np.ix_(there, there)], right[there], first, kept


@pytest.mark.parametrize("links", LINKS)
def test_frames_are_eliminated_as_dense_algebra_does(links):
    """With all other factors: the system, its determinant, a step, and the covariances of tags and of frames."""
    room = rooms.drawn((*EVERY, links))
    poses, _ = rooms.astray(room.true, np.random.default_rng(1), 0.2)
    joint = adjustment_of(room, nuisances=True)
    slope, spread = joint.efficiency(poses, 0.0)
    for weight in (None, slope**2 / spread):
        whole, pull, first, count = dense(joint, poses, weight)
        system = joint.system(poses, 0.0, 0.0, weight)
        kept, rest = np.arange(first, first + count), np.r_[:first, first + count : len(whole)]
        gain = np.linalg.solve(whole[np.ix_(rest, rest)], whole[np.ix_(rest, kept)])
        expected = whole[np.ix_(kept, kept)] - whole[np.ix_(kept, rest)] @ gain
        scale = np.sqrt(np.diag(expected))
        np.testing.assert_allclose(system.matrix / np.outer(scale, scale), expected / np.outer(scale, scale), atol=1e-5)
        np.testing.assert_allclose(system.right.ravel() / scale, (pull[kept] - gain.T @ pull[rest]) / scale, atol=1e-4)
    whole_covariance, sigmas = np.linalg.inv(whole), np.sqrt(np.diag(np.linalg.inv(whole)))
    of_kept = np.outer(sigmas[kept], sigmas[kept])
    np.testing.assert_allclose(
        joint.fixed_system(poses, 0.0).covariance / of_kept, whole_covariance[np.ix_(kept, kept)] / of_kept, atol=1e-3
    )
    size = first // rooms.FRAMES
    for k, found in enumerate(joint.frame_covariances(poses, 0.0)):
        own = np.arange(size * k, size * k + 6)
        of_frame = np.outer(sigmas[own], sigmas[own])
        np.testing.assert_allclose(found / of_frame, whole_covariance[np.ix_(own, own)] / of_frame, atol=1e-3)
    step = np.linalg.solve(*dense(joint, poses)[:2])[:first].reshape(rooms.FRAMES, -1)[:, :6]
    there = joint.step(poses, 0.0, 0.0).frames
    np.testing.assert_allclose(log(inverse(poses.frames) @ there), step, atol=1e-3 * np.abs(step).max())
    volume = np.linalg.slogdet(whole[:first, :first])[1] + np.linalg.slogdet(expected)[1]
    assert system.log_determinant == pytest.approx(volume, abs=1e-3)


@pytest.mark.parametrize("factors", [("independent",), ("joint",), ("sheets",), ("odometry",), ("constant velocity",)])
def test_the_covariance_is_the_scatter(factors):
    """Of poses that were drawn from the priors: chi^2 of all tags, of a mount, and of a frame, over eight rooms."""
    found = {}
    for seed in range(8):
        room = rooms.drawn(factors, seed)
        one = adjusted(room, room.true)
        here, there = one.poses.tags, room.true.tags
        twist, tags = log(inverse(here) @ there).ravel(), rows_of(np.arange(rooms.TAGS))
        covariance = one.covariance[np.ix_(tags, tags)]
        found.setdefault(30, []).append(twist @ np.linalg.solve(covariance, twist))
        frames = one.adjustment.frame_covariances(one.poses, one.floor)
        mount = one.covariance[None, len(twist) : len(twist) + 6, len(twist) : len(twist) + 6]
        found.setdefault(6, []).extend(nees(one.poses.frames[4:5], room.true.frames[4:5], frames[4:5]))
        found[6].extend(nees(one.poses.mounts[1:2], room.true.mounts[1:2], mount))
    for freedom, squares in found.items():
        low, high = chi2.ppf([0.001, 0.999], freedom * len(squares))
        assert low < np.sum(squares) < high, f"{np.sum(squares):.0f} of {freedom * len(squares)}"


@pytest.mark.parametrize("links", LINKS)
def test_a_motion_of_the_world_changes_nothing_but_the_world(links):
    room = rooms.drawn((*EVERY, links))
    poses, _ = rooms.astray(room.true, np.random.default_rng(1))
    elsewhere = replace(room, prior=replace(room.prior, tags=WORLD @ room.prior.tags))
    one, other = adjusted(room, poses), adjusted(elsewhere, rooms.turned(poses, WORLD))
    for name in ("tags", "frames", "mounts"):
        expected = getattr(rooms.turned(one.poses, WORLD), name)
        np.testing.assert_allclose(getattr(other.poses, name), expected, atol=2e-6)
    np.testing.assert_allclose(other.covariance, one.covariance, rtol=1e-3, atol=1e-3 * np.abs(one.covariance).max())
    np.testing.assert_array_equal(other.used, one.used)


def test_the_tag_that_is_the_world_does_not_change_a_map():
    """Of a map without a prior: the covariance of the tags relative to each other is that of any exact tag."""
    room, every = rooms.drawn(("independent",)), []
    for tag in (0, 3):
        information = np.zeros((rooms.TAGS, 6))
        information[tag] = EXACT_SIGMA**-2.0
        prior = replace(room.prior, tags=room.true.tags, information=information)
        found = adjusted(replace(room, prior=prior), room.true)
        assert found.known.all()
        every.append((found.gauge_free_covariance, inverse(found.poses.tags[1]) @ found.poses.tags))
    for one, other in zip(*every, strict=True):
        np.testing.assert_allclose(one, other, atol=3e-3 * np.abs(one).max())


@pytest.mark.parametrize("links", LINKS)
def test_the_order_of_detections_tags_and_cameras_changes_nothing(links):
    """Ids of tags are reversed, the second camera and the third are exchanged, and detections are shuffled."""
    room, rng = rooms.drawn(("independent", links)), np.random.default_rng(2)
    poses, _ = rooms.astray(room.true, rng)
    back, swap, seen = np.arange(rooms.TAGS)[::-1], np.array([0, 2, 1]), room.seen.detected
    order = np.concatenate([rng.permutation(np.flatnonzero(seen.frame == f)) for f in range(rooms.FRAMES)])
    shuffled = replace(seen, ids=back[seen.ids], camera=swap[seen.camera]).of(order)
    mounts = replace(room.prior.mounts, poses=room.prior.mounts.poses[swap])
    prior = replace(room.prior, tags=room.prior.tags[back], information=room.prior.information[back], mounts=mounts)
    other = adjusted(replace(room, seen=replace(room.seen, detected=shuffled), prior=prior),
                     Poses(poses.tags[back], poses.frames, poses.mounts[swap]))  # fmt: skip
    one = adjusted(room, poses)
    here = one.poses.tags, one.poses.frames, one.poses.mounts, one.covariances
    there = other.poses.tags[back], other.poses.frames, other.poses.mounts[swap], other.covariances[back]
    for expected, found in zip(here, there, strict=True):
        np.testing.assert_allclose(found, expected, atol=1e-6 * np.abs(expected).max())


def test_covariances_in_the_axes_of_the_map():
    pose = camera_pose([1.0, 2.0, 3.0], 0.3, 0.2, 0.1)
    twists = np.random.default_rng(0).normal(size=(100000, 6)) * [0.01, 0.02, 0.03, 0.01, 0.02, 0.03]
    moved = pose @ exp(twists)
    found = in_world(pose[None], np.cov(twists.T)[None])[0]
    np.testing.assert_allclose(np.cov((moved[:, :3, 3] - pose[:3, 3]).T), found[:3, :3], atol=2e-5)
    turned = moved[:, :3, :3] @ pose[:3, :3].T
    about = np.stack([turned[:, 2, 1] - turned[:, 1, 2], turned[:, 0, 2] - turned[:, 2, 0],
                      turned[:, 1, 0] - turned[:, 0, 1]], axis=1) / 2.0  # fmt: skip
    np.testing.assert_allclose(np.cov(about.T), found[3:, 3:], atol=2e-5)
