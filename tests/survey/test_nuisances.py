"""Nuisance parameters: cameras, shifts of corners, shapes of tags; and errors alike in time; some 20 seconds."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import chi2
from support import thorough, walks

from lmd.adjust.intrinsics import intrinsics_of, with_intrinsics
from lmd.adjust.sightings import MODES, SHAPES, SQUARE, Observations
from lmd.detection.corner_errors import inward
from lmd.geometry.projection import project
from lmd.survey.results import to_text

TAGS, FRAMES, SIGMA, SPREAD = 16, 60, 0.2, 0.2
TRUE = replace(walks.CAMERA, distortion=(-0.1, 0.03, 0.0005, -0.0003, 0.0))
# Another camera of its kind: 0.3 % of the focal length, 2 pixels of the centre, some of the lens.
GIVEN = with_intrinsics(
    TRUE, intrinsics_of(TRUE) * [1.003, 1.003, *[1.0] * 7] + [0, 0, 2, -1.5, 0.004, -0.004, 0.0003, 0, 0.002]
)
ERRORS = replace(walks.constant_errors(SIGMA), inward_spread=SPREAD)
SEEDS = range(max(4, round(20 * thorough.SHARE)))


def surveyed(detected, camera=GIVEN, calibrate=None):
    return walks.surveyed(detected, cameras=[camera], errors=ERRORS, calibrate=calibrate)


def drawn(seed, shift=0.0):
    """Tags, and their detections with edges `shift` pixels too far inward."""
    rng = np.random.default_rng(seed)
    true = walks.spaced_tags(TAGS, rng)
    detected = walks.photographed(true, walks.walk(FRAMES, rng), rng, SIGMA, camera=TRUE)
    return true, replace(detected, corners=detected.corners + shift * inward(detected.corners))


def test_covariances_account_for_errors_of_calibration_and_corners():
    """With all of them at once the squared normalised errors are within the 99 % limits of their distribution."""
    squares = []
    for seed in SEEDS:
        true, detected = drawn(seed, 0.2)
        squares.append(walks.square_of(surveyed(detected).found, true))
    low, high = chi2.ppf([0.005, 0.995], 6 * len(squares))
    assert low < sum(squares) < high


def test_intrinsics_and_shifts_are_found_and_kept_cameras_do_not_change():
    _, detected = drawn(0, 0.2)
    (found,) = surveyed(detected).found.calibrated
    assert found.shift == pytest.approx(0.2, abs=4.0 * found.shift_sigma)
    assert found.shift_sigma < 0.5 * SPREAD
    assert (np.abs(intrinsics_of(found.found) - intrinsics_of(TRUE)) < 4.0 * found.sigma).all()
    assert found.sigma[0] < 0.5 * abs(intrinsics_of(GIVEN)[0] - intrinsics_of(TRUE)[0])
    (kept,) = surveyed(detected, calibrate=False).found.calibrated
    assert kept.found == GIVEN
    assert kept.sigma[0] > found.sigma[0]  # by the inflation


def test_a_lens_without_given_coefficients_is_found():
    true, detected = drawn(1)
    pinhole = replace(TRUE, distortion=())
    found, kept = (surveyed(detected, pinhole, calibrate) for calibrate in (None, False))
    assert found.found.calibrated[0].found.distortion[0] == pytest.approx(TRUE.distortion[0], abs=0.02)
    assert found.found.floor < 0.5 * kept.found.floor
    assert walks.square_of(found.found, true) < chi2.ppf(0.999, 6)


def test_shapes_of_tags_are_found():
    rng = np.random.default_rng(7)
    true, frames = walks.spaced_tags(TAGS, rng), walks.walk(90, rng)
    shapes = rng.normal(0.0, 0.0008, (TAGS, MODES))
    bent = SQUARE * walks.EDGE / 2.0 + np.tensordot(shapes, SHAPES[:MODES], axes=1)
    detected = walks.photographed(true, frames, rng, 0.05)
    points = bent @ np.swapaxes(true[:, :3, :3], 1, 2) + true[:, None, :3, 3]
    seen = np.stack(
        [project(walks.CAMERA, frames[f], points[k]) for f, k in zip(detected.frame, detected.ids, strict=True)]
    )
    found = walks.surveyed(replace(detected, corners=seen + rng.normal(0.0, 0.05, seen.shape)), 0.05).found
    assert found.sightings.shape_sigma == pytest.approx(0.0008, rel=0.25)
    often = found.sightings.counts(found.used) > 10
    assert often.sum() > 5
    assert np.sqrt(((found.sightings.shapes[often, :MODES] - shapes[often]) ** 2).mean()) < 0.0003


@pytest.mark.parametrize("seed", [0, pytest.param(1, marks=pytest.mark.thorough("lmd/survey", "lmd/adjust"))])
def test_errors_alike_in_time_inflate_covariances(seed):
    """The focal length changes by 2 % over the walk, as by an autofocus."""
    rng = np.random.default_rng(seed)
    true, frames = walks.spaced_tags(TAGS, rng), walks.walk(160, rng)
    detected = walks.photographed(true, frames, rng, 0.05, camera=TRUE)
    breath = 1.0 + 0.02 * np.sin(2.0 * np.pi * np.arange(len(frames)) / len(frames) * 1.5)
    middle = np.array(TRUE.principal_point)
    breathing = middle + (detected.corners - middle) * breath[detected.frame, None, None]
    quiet, moved = (
        walks.surveyed(one, 0.05, cameras=[TRUE]) for one in (detected, replace(detected, corners=breathing))
    )
    assert quiet.found.inflation < 1.5
    assert moved.found.inflation > max(1.5, 1.25 * quiet.found.inflation)
    assert f"of time disagree {moved.found.inflation:.1f} times" in to_text(moved)


def test_a_lens_that_images_fewer_corners_than_the_given_one_does_no_harm(monkeypatch):
    """As if a refined lens folded before a corner near the border, whose sighting is then lost."""
    true, detected = drawn(2)
    every, seen = Observations.through, []

    def fewer(self, optics=None):
        some = every(self, optics)
        seen.append(len(some))
        return some if optics is None or optics[0].camera == GIVEN else some.of(np.arange(len(some) - 3))

    monkeypatch.setattr(Observations, "through", fewer)
    found = surveyed(detected)
    assert len(found.found.sightings) == max(seen) - 3
    assert walks.square_of(found.found, true) < chi2.ppf(0.999, 6)
