"""A survey that estimates the intrinsics of its camera; some 11 seconds in all."""

from dataclasses import replace

import numpy as np
from scipy.spatial.distance import pdist
from scipy.stats import chi2
from support import walks

from lmd.adjust.intrinsics import intrinsics_of, with_intrinsics
from lmd.formats.calibrations import calibrated_camera, camera_info
from lmd.formats.tag_map import write_yaml
from lmd.geometry.se3 import camera_pose
from lmd.scene.deployment import Deployment
from lmd.survey.results import survey_document, to_text

COUNT, FRAMES = 24, 40
TRUE = replace(walks.CAMERA, distortion=(-0.1, 0.03, 0.0005, -0.0003, 0.0))
# The focal length is 4 % off, and the lens is a rough guess.
GIVEN = with_intrinsics(TRUE, intrinsics_of(TRUE) * [1.04, 1.04, *[1.0] * 7] + [0, 0, 4, -3, 0.02, -0.01, 0, 0, 0])


def relative(found, true):
    """Median relative error of the distances between tags."""
    here, there = found.found.poses.tags[found.placed, :3, 3], true[found.ids[found.placed], :3, 3]
    return np.median(np.abs(pdist(here) / pdist(there) - 1.0))


def test_a_wrong_focal_length_is_found_together_with_the_map():
    rng = np.random.default_rng(3)
    true = walks.wall_tags(COUNT, rng)
    detected = walks.photographed(true, walks.walk(FRAMES, rng), rng, camera=TRUE)
    found, kept = (walks.surveyed(detected, cameras=[GIVEN], calibrate=calibrate) for calibrate in (True, False))
    assert relative(kept, true) > 3.0 * relative(found, true)
    assert relative(found, true) < 0.0015
    (camera,) = found.found.calibrated
    off = intrinsics_of(camera.found) - intrinsics_of(TRUE)
    assert np.abs(off[:4]).max() < 4.0
    assert (np.abs(off) < chi2.ppf(0.9999, 1) ** 0.5 * camera.sigma).all()
    assert camera.unsure < 1.0
    assert "focal length" in to_text(found)
    assert survey_document(found)["intrinsics"][0]["unsure_pixels"] == camera.unsure


def test_photographs_that_do_not_fix_the_intrinsics_say_so():
    """One wall, always from in front: a longer lens farther away sees the same image."""
    rng = np.random.default_rng(5)
    true = np.stack([walks.on_wall(0, along, height) for along in (0.3, 0.5, 0.7) for height in (0.8, 1.6)])
    place = rng.uniform([1.8, 2.4, 1.0], [3.2, 2.5, 1.4], (12, 3))
    detected = walks.photographed(true, camera_pose(place, np.full(12, np.pi), np.zeros(12)), rng)
    found = walks.surveyed(detected, calibrate=True, plan=Deployment(true[:, :3, 3], true[:, :3, 2]))
    assert found.found.calibrated[0].unsure > 1.0


def test_the_calibration_file_is_the_camera(tmp_path):
    write_yaml(tmp_path / "camera.yaml", camera_info(GIVEN))
    again = calibrated_camera(str(tmp_path / "camera.yaml"))
    np.testing.assert_allclose(intrinsics_of(again), intrinsics_of(GIVEN), rtol=1e-12)


def test_covariances_of_the_intrinsics_hold():
    """The squared normalised errors over seeds are within the 99 % limits of their distribution; 5 seconds."""
    squares = []
    for seed in (20, 21, 22):
        rng = np.random.default_rng(seed)
        detected = walks.photographed(walks.spaced_tags(COUNT, rng), walks.walk(FRAMES, rng), rng, camera=TRUE)
        found = walks.surveyed(detected, cameras=[GIVEN], calibrate=True)
        (camera,) = found.found.calibrated
        off = intrinsics_of(camera.found) - intrinsics_of(TRUE)
        squares.append(off @ np.linalg.solve(camera.covariance[: len(off), : len(off)], off))
    low, high = chi2.ppf([0.005, 0.995], len(off) * len(squares))
    assert low < sum(squares) < high
