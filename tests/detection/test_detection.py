import math
from dataclasses import replace

import numpy as np
import pytest
from support.tables import rows

from lmd.core.checks import InputError
from lmd.detection.calibration import fit
from lmd.detection.detectors import (
    AprilTagDetector,
    ArucoDetector,
    Detections,
    agreement,
    corner_error,
    match,
    precision_recall,
    quantiles_by,
    shares_of_frames,
)
from lmd.detection.mosaic import ViewRanges, sample_views
from lmd.detection.tag_views import TagViews
from lmd.geometry.camera import Camera
from lmd.geometry.pose import body_from_corners, pose_error
from lmd.geometry.se3 import camera_pose
from lmd.render.imaging import Imaging
from lmd.render.renderer import Renderer
from lmd.render.room import TaggedRoom
from lmd.scene.tag import Tag
from lmd.sight.models.limits import Limits
from lmd.space.cuboid import Cuboid

pytestmark = pytest.mark.slow  # images, or kernels of a second model of sight

CAMERA = Camera(5.0, 0.0116, 0.0116, (400.0, 300.0), 800.0, 600.0, 5.0, 1778.0)
WALLS = Cuboid((4.0, 3.0, 3.0), (2.0, 1.0, 1.0), 0.5).surfaces()
TURNS = np.radians([0.0, 90.0, 180.0, 270.0, 37.0, 201.0, 333.0, 119.0])
POSE = camera_pose([1.9, 1.0, 1.45], 0.1, 0.05, 0.1)
KINDS = {"aruco": (ArucoDetector, 0.6), "apriltag": (AprilTagDetector, 0.3)}  # and how far corners may be off, pixels


def pose_from(renderer, corners):
    return body_from_corners([renderer.camera], np.eye(4)[None], renderer.room.corners, [corners])


def room(family):
    """Eight tags, differently turned, on the wall y = 3."""
    a, b = np.meshgrid([1.1, 1.6, 2.1, 2.6], [1.2, 1.8])
    centres = np.stack([a.ravel(), np.full(8, 3.0), b.ravel()], axis=-1)
    ups = np.stack([np.sin(TURNS), np.zeros(8), np.cos(TURNS)], axis=-1)
    return TaggedRoom(Tag(0.2, family), np.arange(3, 11), centres, np.tile([0.0, -1.0, 0.0], (8, 1)), ups, WALLS)


@pytest.mark.thorough("lmd/scene/families.py", "lmd/detection/detectors.py")
def test_the_largest_family_is_found_too():
    check_known_answers(AprilTagDetector("52h13"), "52h13", 0.3)  # its table takes 3.2 GB


@pytest.mark.parametrize(("kind", "settings"), rows(__file__, "detectors"))
def test_known_answers(kind, settings):
    make, tolerance = KINDS[kind]
    check_known_answers(make(**settings), settings["family"], tolerance)


def check_known_answers(detector, family, tolerance):
    renderer = Renderer(CAMERA, room(family), Imaging(texture=4.0))
    found = detector.detect(renderer.frame(POSE, np.random.default_rng(0)))
    expected = renderer.corners(POSE)
    assert renderer.inside(POSE, 3.0).all()
    assert sorted(found.ids) == list(range(3, 11))
    matches = match(found, renderer.room.ids, expected)
    assert matches.detected.all()
    assert matches.false == 0
    assert corner_error(matches.corners, expected).max() < tolerance
    # A systematic half pixel would show in the mean.
    assert np.abs((matches.corners - expected).mean(axis=(0, 1))).max() < 0.15
    away, angle = pose_error(POSE, pose_from(renderer, matches.corners))
    assert away < 0.01
    assert angle < 0.01


def test_an_image_without_tags():
    blank = np.full((240, 320), 150, dtype=np.uint8)
    for detector in (ArucoDetector(), AprilTagDetector()):
        assert len(detector.detect(blank)) == 0
        with pytest.raises(InputError, match="image must be a grey image of 8-bit numbers"):
            detector.detect(blank.astype(float))


@pytest.mark.parametrize("lens", rows(__file__, "lenses"))
def test_pose_by_exact_corners(lens):
    renderer = Renderer(replace(CAMERA, **lens), room("36h11"))
    image = renderer.corners(POSE)
    found = pose_from(renderer, image)
    np.testing.assert_allclose(found, POSE, atol=1e-5)
    only_one = np.where(np.arange(8)[:, None, None] == 2, image, np.nan)
    found = pose_from(renderer, only_one)
    np.testing.assert_allclose(found, POSE, atol=1e-3)
    none = pose_from(renderer, np.full_like(image, np.nan))
    assert np.isnan(none).all()
    assert np.isnan(pose_error(POSE, none)).all()


def test_matches_by_hand():
    square = np.array([[0.0, 0.0], [10.0, 0.0], [10.0, 10.0], [0.0, 10.0]])
    expected = np.stack([square, square + 50.0, square + 100.0, np.full((4, 2), np.nan)])
    found = Detections(
        np.array([5, 5, 6, 7, 99, 8]),
        # Tag 5 twice, tag 6 turned by a quarter, tag 7 elsewhere, no tag 99, and tag 8 is behind the camera.
        np.stack([square + 2.0, square + 1.0, square[[1, 2, 3, 0]] + 50.0, square + 120.0, square, square]),
    )
    matches = match(found, np.array([5, 6, 7, 8]), expected)
    assert matches.detected.tolist() == [True, False, False, False]
    assert matches.false == 5
    np.testing.assert_allclose(matches.corners[0], square + 1.0)
    np.testing.assert_allclose(corner_error(matches.corners, expected), [math.sqrt(2.0), *[math.nan] * 3])


def test_figures_by_hand():
    predicted = np.array([[1, 1, 0], [1, 0, 0], [1, 1, 1], [0, 0, 0]], dtype=bool)
    detected = np.array([[1, 0, 0], [1, 1, 0], [1, 1, 1], [0, 0, 0]], dtype=bool)
    assert precision_recall(predicted, detected) == (5 / 6, 5 / 6)
    precision, recall = precision_recall(predicted, detected, axis=0)
    np.testing.assert_allclose(precision, [1.0, 0.5, 1.0])
    np.testing.assert_allclose(recall, [1.0, 0.5, 1.0])
    assert np.isnan(precision_recall(predicted, detected, axis=1)[0][3])
    share, error = shares_of_frames(predicted)
    np.testing.assert_allclose(share, [0.75, 0.5, 0.25, 0.0])
    np.testing.assert_allclose(error, [math.sqrt(0.75 * 0.25 / 4), 0.25, math.sqrt(0.25 * 0.75 / 4), 0.0])
    assert agreement(predicted, detected) == 0.5
    assert agreement(predicted, detected, n=1) == 1.0


def test_quantiles_by_hand():
    value = np.array([1.0, 1.5, 2.0, 2.5, 9.0, np.nan])
    error = np.array([0.1, 0.3, 1.0, np.nan, 5.0, 1.0])
    table = quantiles_by(value, error, [1.0, 2.0, 3.0, 4.0], (0.5, 1.0))
    np.testing.assert_allclose(table, [[0.2, 0.3], [1.0, 1.0], [np.nan, np.nan]])


def test_limits_of_known_views_are_found():
    rng = np.random.default_rng(0)
    true = Limits(pitch=0.8, blur=1.8, edge=20.0, incidence=80.0, margin=3.0)
    pitch, incidence, sigma = rng.uniform([0.5, 0.0, 0.3], [6.0, 1.55, 2.0], (20000, 3)).T
    edge = pitch * rng.uniform(4.0, 16.0, len(pitch))
    found = true.found(pitch, incidence, edge, sigma)
    seen = found.copy()
    for outcome in (True, False):  # as many errors of either kind
        seen[rng.choice(np.flatnonzero(found == outcome), 200, replace=False)] = not outcome
    views = TagViews(pitch, incidence, edge, sigma, seen, np.zeros(len(pitch)))
    result = fit(views, rng, margin=3.0)
    limits = result.limits
    assert limits.pitch == pytest.approx(0.8, abs=0.3)
    assert limits.blur == pytest.approx(1.8, abs=0.15)
    assert limits.edge == pytest.approx(20.0, abs=1.0)
    assert limits.incidence == pytest.approx(80.0, abs=1.0)
    assert limits.margin == 3.0
    assert result.accuracy == pytest.approx(0.98, abs=0.01)
    assert not true.found(*(np.array([math.nan]),) * 4)


def test_neither_kind_of_error_outweighs_the_other():
    rng = np.random.default_rng(0)
    pitch, incidence, sigma = rng.uniform([0.5, 0.0, 0.5], [6.0, 1.4, 0.5], (20000, 3)).T
    seen = rng.random(len(pitch)) < np.clip((pitch - 1.0) / 4.0, 0.0, 0.7)  # the most accurate limit sees too few
    views = TagViews(pitch, incidence, np.full(len(pitch), 50.0), sigma, seen, np.zeros(len(pitch)))
    result = fit(views, rng, margin=0.0)
    assert result.precision == pytest.approx(result.recall, abs=0.05)


@pytest.mark.parametrize("detector", [ArucoDetector(), AprilTagDetector()])
def test_easy_views_are_seen_and_hard_ones_are_not(detector):
    easy = ViewRanges(pitch=(4.0, 6.0), incidence=(0.0, 1.0), sigma=(0.4, 0.6), noise=(1.0, 2.0))
    views = sample_views(CAMERA, Tag(0.1), detector, 60, np.random.default_rng(0), easy)
    assert len(views) == 60
    assert views.seen.mean() > 0.95
    assert np.nanmedian(views.error) < (0.5 if isinstance(detector, ArucoDetector) else 0.05)
    assert (easy.pitch[0] - 1e-9 <= views.pitch).all()
    assert (views.pitch <= easy.pitch[1] + 1e-9).all()
    assert (views.incidence <= 1.0 + 1e-9).all()
    hard = ViewRanges(pitch=(0.8, 1.2), sigma=(1.5, 2.0))
    again = [sample_views(CAMERA, Tag(0.1), detector, 60, np.random.default_rng(0), hard) for _ in range(2)]
    assert again[0].seen.mean() < 0.1
    np.testing.assert_array_equal(again[0].pitch, again[1].pitch)
    np.testing.assert_array_equal(again[0].seen, again[1].seen)
