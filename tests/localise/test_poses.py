"""Poses of images in a fixed map: errors within their covariances, and images that are refused."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import chi2
from support import drives, walks
from support import localisations as ld

from lmd.adjust.intrinsics import intrinsics_of, with_intrinsics
from lmd.adjust.motion import seconds_of
from lmd.adjust.prior import Hanging
from lmd.core.checks import InputError
from lmd.detection.corner_errors import inward
from lmd.formats.pose_files import tum_text
from lmd.formats.tag_maps import write_map_covariance
from lmd.geometry.se3 import angle_between, camera_pose, exp, inverse, log
from lmd.localise.fixed_map import FixedMap, surveyed_covariance
from lmd.localise.images import State
from lmd.localise.localise import Drive, localise
from lmd.localise.results import frame_columns, localise_document, to_text
from lmd.scene.deployment import Deployment
from lmd.scene.labels import Labels, Surveyed
from lmd.scene.tag import Tag


def test_normalised_errors_of_single_images_are_within_their_bounds():
    """Of 6 walks with a sure map, all images together: jointly, of rotation, and of position."""
    every = []
    for seed in range(6):
        walk = ld.walked(seed, place=1e-5, turn=1e-5)
        found = ld.localised(walk, calibrate=False).found
        assert found.poses.known_frames.sum() > 50
        every.append(ld.squares(found.poses.frames, found.frame_covariances, walk.frames))
    for column, freedom in enumerate((6, 3, 3)):
        ld.check_bounds(np.concatenate(every)[:, column], freedom)


def test_errors_of_the_map_are_in_the_covariance():
    """Errors of one map are alike in all images, so each of 24 walks counts with one image."""
    first = []
    for seed in range(24):
        walk = ld.walked(seed, frames=3, place=0.004, turn=0.008)
        found = ld.localised(walk, calibrate=False).found
        first.append(ld.squares(found.poses.frames, found.frame_covariances, walk.frames)[0])
    for column, freedom in enumerate((6, 3, 3)):
        ld.check_bounds(np.stack(first)[:, column], freedom)


@pytest.mark.thorough("lmd/adjust", "lmd/localise")
def test_a_calibration_that_is_off_is_refined():
    """Cameras are off as a calibration may be, and corners lie too far inward; the errors of a camera are alike in all
    images, so each of 6 walks counts with one image. Five seconds.
    """
    errors = replace(walks.constant_errors(ld.NOISE), inward_spread=0.1)
    first, exact = [], []
    for seed in range(6):
        rng = np.random.default_rng(50 + seed)
        walk = ld.walked(seed, frames=40, place=1e-4, turn=1e-4)
        off = rng.normal(size=9) * [5.0, 5.0, 6.0, 6.0, *[0.0] * 5]
        given = with_intrinsics(walks.CAMERA, intrinsics_of(walks.CAMERA) + off)
        inner = walk.detected.corners + rng.normal(0.0, 0.1) * inward(walk.detected.corners)
        detected = replace(walk.detected, corners=inner)
        for calibrate, found in ((True, first), (False, exact)):
            some = localise(detected, [given], Tag(walks.EDGE), errors, walk.known, calibrate=calibrate).found
            found.append(ld.squares(some.poses.frames, some.frame_covariances, walk.frames)[0])
    for column, freedom in enumerate((6, 3, 3)):
        ld.check_bounds(np.stack(first)[:, column], freedom)
    assert np.stack(exact)[:, 0].mean() > 60.0


@pytest.mark.parametrize("by", ["constant velocity", "odometry"])
def test_smoothed_poses_are_nearer_and_their_covariances_hold(by):
    """A drive in which most images show one tag; its errors are correlated, so bounds are those of its seconds."""
    rng = np.random.default_rng(7)
    driven = drives.drive(15.0, 12, rng)
    known = FixedMap(np.arange(12), driven.tags, np.full(12, drives.EDGE), np.full((12, 6), 1e-4))
    path = drives.odometry(driven, rng) if by == "odometry" else None
    errors = walks.constant_errors(0.2)
    result = localise(
        driven.detected, [drives.CAMERA], Tag(drives.EDGE), errors, known, Drive(odometry=path), calibrate=False
    )
    single, smoothed = result.found, result.smoothed
    assert smoothed is not None
    away = [np.nanmedian(np.linalg.norm(one[:, :3, 3] - driven.frames[:, :3, 3], axis=1))
            for one in (single.poses.frames, smoothed.poses.frames)]  # fmt: skip
    assert away[1] < 0.6 * away[0]
    square = ld.squares(smoothed.poses.frames, smoothed.frame_covariances, driven.frames)[:, 0]
    seconds = round(len(driven.times) / drives.RATE)
    low, high = chi2.ppf([0.005, 0.995], 6 * seconds) / (6 * seconds)
    assert low < square.mean() / 6.0 < high
    lines = tum_text(seconds_of(driven.detected.times), smoothed.poses.frames).splitlines()
    assert len(lines) == 1 + smoothed.poses.known_frames.sum()
    assert "smoothed" in to_text(result)
    assert set(frame_columns(result, result.smoothed)["state"]) == {"smoothed", State.NO_TAG.value}


def shown(walk, frames, seed=0):
    """The walk's detections from other poses of the camera."""
    detected = walks.photographed(walk.true, frames, np.random.default_rng(seed), ld.NOISE)
    return replace(detected, times=tuple(f"{k}.png" for k in range(len(frames))))


def test_one_distant_tag_from_in_front_has_two_poses():
    """A tag that is seen from 3.5 m in front is refused, and the same tag from the side is not."""
    walk = ld.walked(0, tags=1, place=1e-4, turn=1e-4)
    tag = walk.true[0]
    ahead = tag @ np.array([[1.0, 0, 0, 0], [0, -1, 0, 0], [0, 0, -1, 0], [0, 0, 0, 1]])
    far = ahead @ exp(np.array([0, 0, 0, 0, 0, -3.5]))
    aside = ahead @ exp(np.array([0, 1.0, 0, 0, 0, 0])) @ exp(np.array([0, 0, 0, 0, 0, -1.0]))
    result = ld.localised(walk, shown(walk, np.stack([far, aside])))
    assert result.states == (State.TWO_POSES, State.LOCALISED)
    assert angle_between(result.found.poses.frames[1], aside) < 0.02
    assert localise_document(result)["refused"] == {"0.png": State.TWO_POSES.value}
    assert "1 (0.png): two poses that cannot be told apart" in to_text(result)
    table = frame_columns(result, result.found)
    assert table["tags"][1] == 1
    assert np.isnan(table["cov_x_x"][0])
    assert len(tum_text(np.full(2, np.nan), result.found.poses.frames).splitlines()) == 1  # images without times


def test_images_are_refused_without_a_tag_and_where_tags_contradict_each_other():
    walk = ld.walked(3)
    detected = walk.detected
    counts = np.bincount(detected.frame, minlength=60)
    contradicted, unknown = np.flatnonzero(counts == 2)[0], np.flatnonzero(counts > 2)[0]
    ids, corners = detected.ids.copy(), detected.corners.copy()
    ids[detected.frame == unknown] += 100
    corners[np.flatnonzero(detected.frame == contradicted)[0]] += [150.0, 90.0]
    result = ld.localised(walk, replace(detected, ids=ids, corners=corners))
    assert result.states[unknown] is State.NO_TAG
    assert result.states[contradicted] in (State.RESIDUAL, State.TWO_POSES)
    assert np.isnan(result.found.frame_covariances[[unknown, contradicted]]).all()
    assert result.found.poses.known_frames.sum() > 50


@pytest.mark.parametrize("quarters", [1, 2, 3])
def test_corners_that_begin_elsewhere_are_renumbered(quarters):
    walk = ld.walked(2)
    turned = replace(walk.detected.renumbered(walk.known.ids, np.full(16, quarters)), in_order=False)
    result = ld.localised(walk, turned)
    assert (result.renumbered + quarters) % 4 == 0
    expected = ld.localised(walk)
    np.testing.assert_allclose(result.found.poses.frames, expected.found.poses.frames, atol=1e-9)


@pytest.mark.parametrize(("turn", "said"), [(-2.0, "131 degrees"), (2.08, "4.5"), (2.01, ""), (2.0, "")])
def test_a_camera_that_is_mounted_elsewhere_is_found_and_named(turn, said):
    """The second camera is turned by 2 rad; 4 rad off is 2.28 rad, or 131 degrees, the other way round. A tape measure
    is good to a degree.
    """
    walk = ld.walked(5)
    mounts, given = (np.stack([np.eye(4), camera_pose([0.1, 0.0, 0.0], by, 0.0, 0.0)]) for by in (2.0, turn))
    detected = walks.photographed(walk.true, walk.frames, np.random.default_rng(1), ld.NOISE, mounts=mounts)
    detected = replace(detected, times=tuple(f"{k}.png" for k in range(len(detected.times))))
    arguments = [walks.CAMERA] * 2, Tag(walks.EDGE), walks.constant_errors(ld.NOISE), walk.known, Drive(given)
    result = localise(detected, *arguments)
    assert [doubt.partition(" mm and ")[2][: len(said)] for doubt in result.doubts] == [said] * bool(said)
    assert all(doubt in to_text(result) for doubt in result.doubts)
    off = log(inverse(mounts[1]) @ result.found.poses.mounts[1])
    own = slice(6 * len(result.found.group), 6 * len(result.found.group) + 6)
    assert off @ np.linalg.solve(result.found.covariance[own, own], off) < chi2.ppf(0.999, 6)
    ld.check_bounds(
        ld.squares(result.found.poses.frames, result.found.frame_covariances, walk.frames)[::6, 0], 6, slack=1.3
    )
    assert result.smoothed is None


def test_detections_beyond_the_image_of_a_calibration_are_counted():
    small = replace(walks.CAMERA, image_width=800, image_height=600, principal_point=(400.0, 300.0))
    walk = ld.walked(5)
    beyond = int((walk.detected.corners > [800, 600]).any(axis=(1, 2)).sum())
    result = localise(walk.detected, [small], Tag(walks.EDGE), walks.constant_errors(ld.NOISE), walk.known)
    assert result.doubts[0].startswith(f"{beyond} of {len(walk.detected)} detections of camera 1 lie outside")


def test_a_surveyed_map_brings_the_covariance_of_its_tags(tmp_path):
    file, beside = tmp_path / "map.csv", tmp_path / "map.npz"
    half = np.random.default_rng(0).normal(size=(12, 12)) * 0.01
    covariance, errors = half @ half.T, Hanging(0.01, 0.05, 0.01, 0.05)
    file.write_text("id,x,y,z,nx,ny,nz,edge\n5,0,0,1,0,1,0,0.1\n2,1,0,1,0,1,0,0.1\n9,2,0,1,0,1,0,.1\n")
    assert FixedMap.read(file, Tag(0.2), errors).covariance is None
    places = np.array([[1.0, 0.0, 1.0], [0.0, 0.0, 1.0]])  # of tags 2 and 5
    write_map_covariance(beside, np.array([2, 5]), places, covariance)
    known = FixedMap.read(file, Tag(0.2), errors)
    assert known.ids.tolist() == [2, 5, 9]
    np.testing.assert_allclose(known.joint[:12, :12], covariance, rtol=1e-6)
    np.testing.assert_allclose(known.joint[12:, 12:], np.diag([0.05**2] * 3 + [0.01**2] * 3))
    np.testing.assert_allclose(known.sigmas.ravel() ** 2, np.diag(known.joint), rtol=1e-6)
    assert not known.joint[12:, :12].any()
    for content in (b"", b"PK\x03\x04", beside.read_bytes()[:200]):
        beside.write_bytes(content)
        with pytest.raises(InputError, match=r"map\.npz' is not a covariance of a map"):
            FixedMap.read(file, Tag(0.2), Hanging())
    write_map_covariance(beside, np.array([2, 5]), places + np.array([0.0, 1e-3, 0.0]), covariance)
    with pytest.raises(InputError, match=r"map\.npz' is of another survey than the map beside it"):
        FixedMap.read(file, Tag(0.2), Hanging())
    np.savez(beside, ids=np.array([2, 5]), positions=places, upper=np.full(78, np.nan))
    with pytest.raises(InputError, match=r"map\.npz' is not a covariance of a map"):
        FixedMap.read(file, Tag(0.2), Hanging())


def test_maps_without_an_edge_or_with_a_tag_twice_are_refused(tmp_path):
    file = tmp_path / "map.csv"
    file.write_text("id,x,y,z,nx,ny,nz\n1,0,0,1,0,1,0\n1,1,0,1,0,1,0\n")
    with pytest.raises(InputError, match=r"\b1\b"):
        FixedMap.read(file, Tag(0.2), Hanging())
    file.write_text("id,x,y,z,nx,ny,nz\n1,0,0,1,0,1,0\n")
    with pytest.raises(InputError, match=r"edge must be given, in metres: the map has no edge of tag 1"):
        FixedMap.read(file, Tag(None), Hanging())


def test_other_tags_than_those_of_the_map_are_refused():
    walk = ld.walked(1)
    with pytest.raises(InputError, match="detections has no tag of the map, only tags such as 100, 101"):
        ld.localised(walk, replace(walk.detected, ids=walk.detected.ids + 100))
    with pytest.raises(InputError, match="cameras must have one camera for each"):
        localise(walk.detected, [], Tag(walks.EDGE), walks.constant_errors(0.2), walk.known)


def test_the_joint_covariance_of_a_map_is_in_the_world_frame_and_in_the_order_of_the_deployment(tmp_path):
    """Two tags of a survey and one that is fixed by other means, out of order."""
    normals, ups = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, -1.0, 0.0]]), np.tile([0.0, 0.0, 1.0], (3, 1))
    labels = Labels(np.array([9, 2, 5]), {})
    on_walls = np.eye(3) + 0.01 * normals  # the map has the measured places
    deployment = Deployment(on_walls, normals, labels=labels, surveyed=Surveyed(on_walls, np.eye(3), ups))
    sigmas = np.array([[1.0, 2.0, 3.0, 4.0, 5.0, 6.0], [6.0, 5.0, 4.0, 3.0, 2.0, 1.0]]) * 1e-3  # of tags 5 and 9
    shared = 0.5 * np.outer(sigmas.ravel(), sigmas.ravel()) + 0.5 * np.diag(sigmas.ravel() ** 2)
    file = tmp_path / "map.csv"
    assert surveyed_covariance(str(file), deployment) is None
    write_map_covariance(tmp_path / "map.npz", np.array([5, 9]), np.eye(3)[[2, 0]], shared)
    found = surveyed_covariance(str(file), deployment)
    assert not found[6:12].any()  # tag 2 is not of the survey
    deviations = np.sqrt(np.diag(found)).reshape(3, 6)
    # Tag 9 faces y: its right is -x, its up z. Tag 5 faces -y.
    np.testing.assert_allclose(deviations[0], np.array([3.0, 1.0, 2.0, 6.0, 4.0, 5.0]) * 1e-3, rtol=1e-5)
    np.testing.assert_allclose(deviations[2], np.array([4.0, 6.0, 5.0, 1.0, 3.0, 2.0]) * 1e-3, rtol=1e-5)
    assert found[0, 12] == pytest.approx(-0.5 * 3e-3 * 4e-3, rel=1e-5)  # to the right of both, which face each other
