"""Covariance of the pose from one image, against OpenCV's PnP under simulated errors; some 12 seconds."""

import numpy as np
import pytest
from scipy.stats import chi2
from support.paper import paper_camera

from lmd.adjust.gauge import in_world
from lmd.core.checks import InputError
from lmd.detection.corner_errors import CORNER_ERRORS, MeasuredCorners, incidence, inward, pitch
from lmd.estimation.cramer_rao import pose_information
from lmd.estimation.pose_covariance import TagErrors, pose_covariances
from lmd.geometry.pose import body_from_corners
from lmd.geometry.projection import project, to_camera
from lmd.geometry.se3 import camera_pose, exp, inverse, log, skew
from lmd.geometry.squares import corners
from lmd.scene.deployment import Deployment
from lmd.scene.labels import Surveyed
from lmd.scene.tag import Tag

CAMERA = paper_camera(image_width=640, image_height=480, principal_point=(320.0, 240.0))
TAG, COUNT, FRAMES = Tag(0.15), 24, 300
ALONE = np.eye(4)[None]
TURNED = np.stack([np.eye(4), exp(np.array([0.1, 1.2, 0.0, 0.1, 0.05, 0.0]))])  # two cameras on a body
ZERO = np.zeros((COUNT, 6, 6))
LEVEL = 0.99
SURE = 0.1  # largest standard deviation of the position of a frame, metres; beyond it errors are not linear


def scene(seed, extrinsics=ALONE):
    """Tags on the walls of a room of 6 x 4 m, poses in its middle, and the tags seen: two or more, and `SURE`."""
    rng = np.random.default_rng(seed)
    wall, along = rng.integers(0, 4, COUNT), rng.uniform(0.1, 0.9, COUNT)
    normals = np.array([[1.0, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0]])[wall]
    places = np.stack([np.choose(wall, [0 * along, 6 + 0 * along, 6 * along, 6 * along]),
                       np.choose(wall, [4 * along, 4 * along, 0 * along, 4 + 0 * along]),
                       rng.uniform(0.5, 2.3, COUNT)], axis=1)  # fmt: skip
    tags = Deployment(places, normals)
    poses = camera_pose(rng.uniform([1.5, 1, 1], [4.5, 3, 1.8], (20 * FRAMES, 3)),
                        rng.uniform(-np.pi, np.pi, 20 * FRAMES), rng.uniform(-0.3, 0.3, 20 * FRAMES))  # fmt: skip
    seen = np.stack([visible(tags, poses @ mounted) for mounted in extrinsics])
    half_pixel = TagErrors(0.5, 0.0, ZERO)
    covariances = pose_covariances([CAMERA] * len(extrinsics), extrinsics, poses, tags, TAG, seen, half_pixel)[0]
    sure = np.trace(covariances[:, 3:, 3:], axis1=1, axis2=2) < SURE**2
    enough = np.flatnonzero(sure & (seen.any(axis=0).sum(axis=1) >= 2))[:FRAMES]
    assert len(enough) == FRAMES
    return tags, poses[enough], seen[:, enough]


def points_of(tags):
    return corners(tags.places, tags.normals, tags.ups, tags.edges_of(TAG))


def visible(tags, poses):
    """Tags wholly in the image and not too oblique, without occlusion, `(F, K)`."""
    points = points_of(tags).reshape(-1, 3)
    ahead = (to_camera(poses, points)[..., 2] > 0.1).reshape(len(poses), COUNT, 4).all(axis=2)
    with np.errstate(all="ignore"):
        image = project(CAMERA, poses, points).reshape(len(poses), COUNT, 8)
    inside = ((image > 5.0) & (image < np.tile([635.0, 475.0], 4))).all(axis=2)
    return ahead & inside & (incidence(poses, tags.places, tags.normals) < np.radians(65.0))


def moved(tags, motions):
    """Corners of tags after motions (p, r) `(K, 6)` of their places and rotations, world frame."""
    turns = exp(np.hstack([motions[:, 3:], np.zeros((COUNT, 3))]))[:, :3, :3]
    offset = points_of(tags) - tags.places[:, None]
    return offset @ np.swapaxes(turns, 1, 2) + (tags.places + motions[:, :3])[:, None]


def normalised(tags, poses, seen, extrinsics, errors, rng):
    """NEES of the pose, its rotation and its position in each frame, `(F, 3)`."""
    cameras = [CAMERA] * len(extrinsics)
    covariances, *_ = pose_covariances(cameras, extrinsics, poses, tags, TAG, seen, errors)
    known = points_of(tags)
    spread = np.linalg.cholesky(errors.places + 1e-18 * np.eye(6))
    found = []
    for f, pose in enumerate(poses):
        true = moved(tags, (spread @ rng.standard_normal((COUNT, 6, 1)))[..., 0])
        shots = []
        for mounted, mask in zip(extrinsics, seen[:, f], strict=True):
            _, single, _ = pose_covariances(
                [CAMERA], ALONE, (pose @ mounted)[None], tags, TAG, mask[None, None], errors
            )
            image = np.full((COUNT, 4, 2), np.nan)
            if mask.any():
                exact = project(CAMERA, pose @ mounted, true[mask].reshape(-1, 3)).reshape(-1, 4, 2)
                at = pitch(CAMERA, pose @ mounted, tags.places[mask], tags.normals[mask], TAG)
                slant = incidence(pose @ mounted, tags.places[mask], tags.normals[mask])
                noise = np.linalg.cholesky(errors.modes) @ rng.standard_normal((len(at), 8, 1))
                shift = errors.at(at, slant)[1] + errors.shift * rng.standard_normal()
                noise = single[0, mask, None, None] * noise.reshape(-1, 4, 2)
                image[mask] = exact + noise + shift[:, None, None] * inward(exact)
            shots.append(image)
        e = log(inverse(pose) @ body_from_corners(cameras, extrinsics, known, shots))
        blocks = (slice(None), slice(3), slice(3, 6))
        found.append([e[block] @ np.linalg.solve(covariances[f][block, block], e[block]) for block in blocks])
    return np.array(found)


# 1 mm and 3 mrad, as of a survey.
SURVEYED = np.broadcast_to(np.diag([1e-3] * 3 + [3e-3] * 3) ** 2, (COUNT, 6, 6))
# Smaller than ArUco's, with a shift and correlated corners.
MEASURED = MeasuredCorners((1.5, 4.0), (0.4, 0.2), (0.3, 0.1), (0.2, 1.0), (0.8, 1.3), (0.7, 1.25, 0.8))
CASES = {
    "constant": (ALONE, TagErrors(0.5, 0.0, ZERO)),
    "by pitch": (ALONE, TagErrors(CORNER_ERRORS["aruco"], 0.0, ZERO)),
    "shift": (ALONE, TagErrors(CORNER_ERRORS["apriltag"], 0.1, ZERO)),
    "modes": (ALONE, TagErrors(MEASURED, 0.0, ZERO)),
    "map": (ALONE, TagErrors(CORNER_ERRORS["apriltag"], 0.0, SURVEYED)),
    "rig": (TURNED, TagErrors(0.3, 0.1, SURVEYED)),
}


@pytest.mark.parametrize("case", CASES)
def test_normalised_errors_of_pnp_are_those_of_chi_square(case):
    """The mean over 300 views is within the 99 % bounds, for the pose, the rotation and the position."""
    extrinsics, errors = CASES[case]
    tags, poses, seen = scene(7, extrinsics)
    found = normalised(tags, poses, seen, extrinsics, errors, np.random.default_rng(11))
    for nees, freedom in zip(found.T, (6, 3, 3), strict=True):
        low, high = chi2.ppf([(1.0 - LEVEL) / 2.0, (1.0 + LEVEL) / 2.0], freedom * FRAMES) / FRAMES
        assert low < nees.mean() < high
        assert abs((nees < chi2.ppf(0.9, freedom)).mean() - 0.9) < 0.06  # 3.5 standard deviations


def test_the_bounds_refuse_covariances_that_ignore_the_map():
    tags, poses, seen = scene(7)
    errors = TagErrors(CORNER_ERRORS["apriltag"], 0.0, SURVEYED)
    ignored = pose_covariances([CAMERA], ALONE, poses, tags, TAG, seen, TagErrors(errors.noise, 0.0, ZERO))[0]
    known = pose_covariances([CAMERA], ALONE, poses, tags, TAG, seen, errors)[0]
    ratio = np.trace(np.linalg.solve(ignored, known), axis1=1, axis2=2) / 6.0  # expected NEES over 6
    assert np.median(ratio) > 1.0 + 5.0 * np.sqrt(2.0 / (6 * FRAMES))


def test_weights_by_noise_without_other_errors_give_the_cramer_rao_bound():
    tags, poses, seen = scene(3, TURNED)
    cameras = [CAMERA, CAMERA]
    found, *_ = pose_covariances(cameras, TURNED, poses, tags, TAG, seen, TagErrors(0.5, 0.0, ZERO, "noise"))
    points = points_of(tags).reshape(-1, 3)
    bound = np.linalg.inv(pose_information(cameras, TURNED, poses, points, seen.repeat(4, axis=2)) / 0.25)
    assert np.abs(found / bound - 1.0).max() < 1e-6


JOINT = np.einsum("aij,ab->aibj", SURVEYED, np.eye(COUNT)).reshape(6 * COUNT, 6 * COUNT)


def test_independent_errors_are_a_joint_covariance_too():
    tags, poses, seen = scene(5, TURNED)
    given = [CAMERA] * 2, TURNED, poses, tags, TAG, seen
    one = pose_covariances(*given, TagErrors(0.3, 0.1, SURVEYED))
    other = pose_covariances(*given, TagErrors(0.3, 0.1, ZERO, joint=JOINT))
    np.testing.assert_allclose(one[0], other[0], rtol=1e-6, atol=1e-10)


def test_a_motion_of_the_whole_map_is_the_error_of_each_pose():
    """A shift and a turn about the origin of all tags together: to first order the camera moves with them."""
    tags, poses, seen = scene(6)
    exact = 1e-9
    moved = [np.block([[np.eye(3), -skew(at)], [np.zeros((3, 3)), np.eye(3)]]) for at in tags.places]
    spread = np.vstack(moved) @ np.diag([0.01, 0.02, 0.03, 0.001, 0.002, 0.003])
    errors = TagErrors(exact, 0.0, ZERO, joint=spread @ spread.T)
    found = in_world(poses, pose_covariances([CAMERA], ALONE, poses, tags, TAG, seen, errors)[0])
    for pose, covariance in zip(poses[:50], found, strict=False):
        own = np.block([[np.eye(3), -skew(pose[:3, 3])], [np.zeros((3, 3)), np.eye(3)]])
        own = own @ np.diag([0.01, 0.02, 0.03, 0.001, 0.002, 0.003])
        np.testing.assert_allclose(covariance, own @ own.T, rtol=1e-5, atol=1e-10)


def test_views_without_tags_have_no_covariance_and_positions_turn_to_the_world():
    tags, poses, seen = scene(5)
    seen = seen.copy()
    seen[:, 0] = False
    covariances, *_ = pose_covariances([CAMERA], ALONE, poses, tags, TAG, seen, TagErrors(0.5, 0.0, ZERO))
    found = in_world(poses, covariances)
    assert np.isinf(found[0]).all()
    turn = poses[1, :3, :3]
    expected = turn @ covariances[1][3:, 3:] @ turn.T
    assert np.allclose(found[1, :3, :3], expected, rtol=1e-12, atol=0.0)


def test_turned_tags_use_their_own_ups():
    """A tag measured upside down has equal corners in another order, so the covariance is the same."""
    tags, poses, seen = scene(5)
    upside = Deployment(tags.positions, tags.normals, surveyed=Surveyed(tags.positions, tags.places, -tags.ups))
    errors = TagErrors(0.5, 0.2, SURVEYED)
    one, other = (pose_covariances([CAMERA], ALONE, poses, d, TAG, seen, errors)[0] for d in (tags, upside))
    assert (np.abs(one - other) < 1e-9 * np.abs(one).max(axis=(1, 2), keepdims=True)).all()


def test_measured_corner_errors_are_recovered():
    rng, count = np.random.default_rng(1), 20000
    pitches, slants = np.exp(rng.uniform(np.log(1.5), np.log(4.0), count)), rng.uniform(0.1, 1.1, count)
    image = 60.0 * np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]]) * np.ones((count, 1, 1))
    spread = np.linalg.cholesky(TagErrors(MEASURED, 0.0, ZERO).modes)
    noise = (spread @ rng.standard_normal((count, 8, 1))).reshape(-1, 4, 2)
    sigma, shift = MEASURED.independent_sigma(pitches, slants), MEASURED.inward_at(pitches)
    error = sigma[:, None, None] * noise + shift[:, None, None] * inward(image)
    found = MeasuredCorners.of(pitches, slants, error, image)
    assert found.modes == pytest.approx(MEASURED.modes, rel=0.03)
    assert found.independent_sigma(pitches, slants) == pytest.approx(sigma, rel=0.15)
    assert np.abs(found.inward_at(pitches) - shift).max() < 0.02
    with pytest.raises(InputError, match="frames: 39 tags were detected, but 40 are needed"):
        MeasuredCorners.of(pitches[:39], slants[:39], error[:39], image[:39])
