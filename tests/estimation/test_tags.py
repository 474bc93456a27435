"""Tags in flights: what was measured of real detectors, and what one reads in rendered frames."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from support.paper import paper_camera, paper_scene

from lmd.core.checks import InputError
from lmd.detection.corner_errors import CORNER_ERRORS, PITCH_MIDDLES, CornerErrors, inward, pitch, shortest_side
from lmd.detection.detectors import ArucoDetector, Detections, corner_error
from lmd.detection.predictions import PITCHES
from lmd.estimation.cramer_rao import CramerRaoBound
from lmd.estimation.flights import Pace, RandomMotion
from lmd.estimation.fusion import FixedLagSmoother
from lmd.estimation.pnp import PerspectiveNPoint
from lmd.estimation.recording import Flight, record
from lmd.estimation.rendered import RenderedDetector, believed, images
from lmd.estimation.sensors import PointDetector, TagDetector, noisy_detector, observation
from lmd.geometry import se3
from lmd.geometry.projection import project
from lmd.geometry.squares import CORNERS
from lmd.geometry.trajectory import Trajectory
from lmd.render.imaging import Imaging
from lmd.scene.deployment_sources import UniformDeployment
from lmd.scene.tag import Tag
from lmd.sight.evaluator import Evaluator

SCENE = paper_scene()
EVALUATOR = Evaluator(SCENE, threads=1)
UNIFORM = UniformDeployment(90).draw(SCENE.room, np.random.default_rng(0))
FLIGHT = RandomMotion(20.0, Pace(1.0, 1.0, 20.0)).draw(SCENE, np.random.default_rng(3))
BENT = Evaluator(replace(SCENE, camera=paper_camera(distortion=(-0.15, 0.02, 0.002, -0.003))), threads=1)
# 500 pixels a radian, and 60 degrees to the next border.
WIDE = paper_camera(
    pixel_width=0.01, pixel_height=0.01, distortion=(0.01, -0.02, 0.005, -0.001), distortion_model="equidistant"
)
FISHEYE = Evaluator(replace(SCENE, camera=WIDE), threads=1)
LENSES = {"pinhole": EVALUATOR, "distorted": BENT, "fisheye": FISHEYE}
TAG = Tag(0.2)


def flight(frames=slice(None), seed=0, all_visible=False, evaluator=EVALUATOR):
    trajectory = Trajectory(FLIGHT.time[frames], FLIGHT.poses[frames])
    return Flight(evaluator, UNIFORM, trajectory, np.random.default_rng(seed), all_visible)


def test_the_inward_shift_is_interpolated_in_the_logarithm_of_the_pitch():
    errors = CornerErrors((1.0, 4.0), (0.8, 0.2), (1.6, 0.3), (0.4, 0.1), 0.2)
    assert_allclose(errors.inward_at(np.array([0.5, 1.0, 2.0, 9.0])), [0.4, 0.4, 0.25, 0.1])
    assert_allclose(CornerErrors((1.0, 4.0), (0.8, 0.2), (1.6, 0.3)).inward_at(np.array([2.0])), [0.0])


@pytest.mark.parametrize("wrong", [{"inward": (0.1,)}, {"high": (1.0, 2.0, 3.0)}, {"inward_spread": -0.1}])
def test_corner_errors_have_a_value_for_each_pitch(wrong):
    with pytest.raises(InputError, match=next(iter(wrong))):
        CornerErrors(**{"pitch": (1.0, 4.0), "median": (0.8, 0.2), "high": (1.6, 0.3), **wrong})


def test_corner_errors_have_the_quantiles_of_their_table():
    errors, rng = CornerErrors((1.0, 4.0), (0.8, 0.2), (1.6, 0.3)), np.random.default_rng(0)
    zero = np.zeros((4, 2))
    for at, median, high in ((0.5, 0.8, 1.6), (1.0, 0.8, 1.6), (2.0, 0.4, np.sqrt(0.48)), (9.0, 0.2, 0.3)):
        drawn = errors.draw(np.full(40_000, at), rng)
        assert_allclose(np.quantile(corner_error(drawn, zero), [0.5, 0.9]), [median, high], rtol=0.03)
        assert_allclose(drawn.std(axis=0), errors.sigma(np.array(at)), rtol=0.05)
        assert_allclose(drawn.mean(axis=0), 0.0, atol=0.02)


def test_the_classes_are_those_that_detect_measures():
    assert_allclose(np.sqrt(PITCHES[3:-2] * PITCHES[4:-1]), PITCH_MIDDLES)


def test_noise_on_tags_is_that_of_their_pitch():
    recording = record(TagDetector(TAG, "apriltag"), [flight()])
    _, t, k = np.nonzero(recording.seen)
    assert_array_equal(recording.seen[0], flight().looks()[0].in_view)
    exact = project(SCENE.camera, FLIGHT.poses, recording.tags[0].reshape(-1, 3)).reshape(len(FLIGHT.time), -1, 4, 2)
    off = corner_error(recording.corners, exact[t, k])
    pitches = pitch(SCENE.camera, FLIGHT.poses, UNIFORM.positions, UNIFORM.normals, TAG)[t, k]
    assert_array_equal(recording.noise, CORNER_ERRORS["apriltag"].sigma(pitches))
    low, high = pitches < 4.0, pitches > 8.0
    assert min(low.sum(), high.sum()) > 100
    assert np.median(off[low]) > 1.5 * np.median(off[high])


def test_a_tags_place_is_as_uncertain_as_its_corners_say():
    turn = se3.exp(np.array([0.3, 2.9, 0.2, 0.0, 0.0, 0.0]))[:3, :3]  # from the tag's frame: its front faces the camera
    centre, rng, sigma = np.array([0.4, -0.3, 2.0]), np.random.default_rng(0), 0.2
    square = centre + np.pad(0.1 * CORNERS, ((0, 0), (0, 1))) @ turn.T
    exact = project(SCENE.camera, np.eye(4), square)
    found = exact + rng.normal(scale=sigma, size=(4000, 4, 2))
    seen = np.ones((4000, 1), dtype=bool)
    observed = observation(SCENE.camera, np.array([TAG.size]), seen, found, np.full(4000, sigma))
    truth = observation(SCENE.camera, np.array([TAG.size]), seen[:1], exact[None], np.zeros(1))
    assert_allclose(truth.points[0, 0], centre, atol=1e-6)
    deviation = np.linalg.solve(np.linalg.cholesky(sigma**2 * truth.covariance[0]), (observed.points[:, 0] - centre).T)
    assert_allclose(deviation.std(axis=1), 1.0, rtol=0.1)


def test_points_stay_points_where_tags_have_no_edge():
    settings = {"reader": "aruco", "pixel_noise": 0.5, "missed": 0.05, "edge": 0.1}
    assert noisy_detector(Tag(), **settings) == PointDetector(0.5, 0.05, 0.1)
    assert noisy_detector(TAG, **settings) == TagDetector(TAG, "aruco", 0.05)


def test_missed_tags_are_missed():
    assert record(TagDetector(TAG, missed=1.0), [flight()]).visible_counts.max() == 0
    seen = record(TagDetector(TAG, missed=0.3), [flight()]).seen
    assert seen.sum() / flight().looks()[0].in_view.sum() == pytest.approx(0.7, abs=0.05)


@pytest.mark.slow
@pytest.mark.parametrize("evaluator", LENSES.values(), ids=LENSES)
def test_a_real_detector_measures_where_tags_are(evaluator):
    camera, frames = evaluator.scene.camera, slice(0, 400, 160)
    coarse = replace(  # a quarter of its pixels: a lens that distorts is traced for each
        camera,
        pixel_width=2.0 * camera.pixel_width,
        pixel_height=2.0 * camera.pixel_height,
        principal_point=tuple(0.5 * at for at in camera.principal_point),
        image_width=0.5 * camera.image_width,
        image_height=0.5 * camera.image_height,
    )
    evaluator = Evaluator(replace(SCENE, camera=coarse), threads=1)
    recording = record(RenderedDetector(TAG, ArucoDetector(), Imaging()), [flight(frames, evaluator=evaluator)])
    seen, points = recording.seen[0], recording.points[0]
    assert seen.shape == (3, 90)
    assert seen.sum(axis=1).min() >= 1
    expected = se3.act(se3.inverse(FLIGHT.poses[frames]), UNIFORM.positions)
    off = np.linalg.norm(points - expected, axis=-1)[seen] / np.linalg.norm(expected, axis=-1)[seen]
    assert np.median(off) < 0.04
    found = PerspectiveNPoint().errors(recording, None).position[0]
    assert np.nanmedian(found) < 0.02


@pytest.mark.slow
def test_the_mean_shift_of_a_real_detector_is_taken_out_of_its_corners():
    frames = slice(0, 400, 40)
    detector = RenderedDetector(Tag(0.3), ArucoDetector(), Imaging())
    (look,) = flight(frames).looks()
    found = believed(list(map(detector.reader.detect, images(detector.batch(look)))), UNIFORM.ids)
    recording = record(detector, [flight(frames)])
    seen = recording.seen[0]
    exact = project(look.camera, look.poses, recording.tags[0].reshape(-1, 3)).reshape(*found.shape)[seen]
    unit = inward(exact)
    shifts = [((image - exact) * unit).sum() / (unit**2).sum() for image in (found[seen], recording.corners)]
    assert shifts[0] > 0.12
    assert abs(shifts[1]) < 0.08
    pitches = shortest_side(found[seen]) / TAG.modules
    assert_array_equal(recording.noise, CORNER_ERRORS["aruco"].independent_sigma(pitches))
    assert set(record(replace(detector, pixel_noise=0.7), [flight(frames)]).noise) == {0.7}


@pytest.mark.parametrize("evaluator", LENSES.values(), ids=LENSES)
def test_estimators_find_the_camera_through_any_lens(evaluator):
    recording = record(TagDetector(TAG, "apriltag"), [flight(slice(0, 400, 4), evaluator=evaluator)])
    enough = recording.visible_counts[0] >= 3
    assert enough.sum() > 10
    by_image = PerspectiveNPoint().errors(recording, None).position[0, enough]
    bound = CramerRaoBound().errors(recording, None).position[0, enough]
    assert 0.5 < np.median(by_image) / np.median(bound) < 1.2
    smoother = FixedLagSmoother(0.1, 0.1).errors(recording, recording.poses[:, 0])
    assert np.median(smoother.position) < 0.01


def test_the_larger_of_two_detections_with_one_id_is_believed_and_strange_ids_are_not():
    square = (CORNERS[:, ::1] + 1.0) * 10.0
    found = Detections([5, 7, 5, 99], np.stack([2.0 * square, square, square, square]))
    corners = believed([found, Detections([], np.empty((0, 4, 2)))], np.arange(90))
    assert corners.shape == (2, 90, 4, 2)
    assert np.argwhere(np.isfinite(corners[..., 0, 0])).tolist() == [[0, 5], [0, 7]]
    assert_array_equal(corners[0, 5], 2.0 * square)
    assert np.argwhere(np.isfinite(believed([found], np.array([99, 7, 3]))[..., 0, 0])).tolist() == [[0, 0], [0, 1]]


@pytest.mark.slow
def test_an_open_shutter_blurs_what_moves():
    frames = slice(60, 140, 40)
    counts = [
        record(RenderedDetector(Tag(0.1), ArucoDetector(), Imaging(), shutter=shutter), [flight(frames)]).seen.sum()
        for shutter in (0.0, 0.05)
    ]
    assert counts[1] < 0.6 * counts[0]


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: TagDetector(Tag()), "^tag.edge must be given, in metres"),
        (lambda: TagDetector(TAG, "eyes"), "^reader must be one of aruco, apriltag"),
        (lambda: TagDetector(TAG, missed=2.0), r"^missed must be in \[0, 1\], got 2"),
        (lambda: RenderedDetector(Tag(), ArucoDetector(), Imaging()), "^tag.edge must be given, in metres"),
        (lambda: RenderedDetector(TAG, object(), Imaging()), "^reader must have corner_errors; object has none"),
        (lambda: RenderedDetector(TAG, ArucoDetector(), Imaging(), 0.0), "^pixel_noise must be greater than 0"),
        (lambda: RenderedDetector(TAG, ArucoDetector(), Imaging(), shutter=-1.0), "^shutter must be at least 0"),
        (lambda: record(TagDetector(TAG), [flight(all_visible=True)]), "^all_visible must be false"),
    ],
)
def test_what_cannot_be_gets_one_sentence(make, message):
    with pytest.raises(InputError, match=message):
        make()
