"""Rooms of tags, frames of them, and figures that compare what detectors find with predictions."""

import math
import pickle
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

from lmd.core.checks import InputError
from lmd.detection.calibration import DetectorCalibration, Fit, frame_scores, predicted_in_frames
from lmd.detection.detectors import AprilTagDetector, ArucoDetector, Matches, agreement
from lmd.detection.frames import (
    detect_in_frames,
    draw_poses,
    overlapping,
    qualities,
    rendered_frame,
    tagged_room,
)
from lmd.detection.predictions import (
    CameraPrediction,
    Prediction,
    by_pitch,
    by_tag,
    figures,
    to_markdown,
)
from lmd.detection.tag_views import TagViews
from lmd.evaluation.verdicts import verdicts
from lmd.geometry.camera import Camera
from lmd.geometry.se3 import axis_and_right
from lmd.geometry.squares import upright
from lmd.render.imaging import Imaging
from lmd.render.renderer import Renderer
from lmd.scene import pdf
from lmd.scene.deployment import Deployment
from lmd.scene.deployment_sources import UniformDeployment
from lmd.scene.scene import Scene
from lmd.scene.tag import Tag
from lmd.sight.evaluator import Evaluator
from lmd.sight.models.fiducial import Fiducial
from lmd.sight.models.limits import Limits, Preset
from lmd.sight.models.paper import Visibility
from lmd.sight.views import visible
from lmd.space.cuboid import Cuboid

pytestmark = pytest.mark.slow  # images, or kernels of a second model of sight

CAMERA = Camera(5.0, 0.0116, 0.0116, (400.0, 300.0), 800.0, 600.0, 5.0, 1778.0)
ROOM = Cuboid((4.0, 3.0, 3.0), (2.0, 1.0, 1.0), 0.5)
SCENE = Scene(ROOM, CAMERA, pdf.solid_angle(), Visibility(0.28))
IMAGING = Imaging(texture=4.0)
DETECTORS = {"aruco": ArucoDetector(), "apriltag": AprilTagDetector(quad_decimate=2.0)}


def uniform(count=24):
    return UniformDeployment(count).draw(ROOM, np.random.default_rng(0))


def test_tags_hang_along_v_of_their_surfaces():
    deployment = uniform()
    room = tagged_room(ROOM, deployment, Tag(0.15))
    expected = [ROOM.surfaces()[number].v for number in deployment.surfaces]
    np.testing.assert_allclose(room.ups, expected)
    np.testing.assert_allclose(upright(deployment.normals)[1], expected)
    # Where no surface is known, and where a tag leans off its wall.
    loose = Deployment(deployment.positions, deployment.normals)
    np.testing.assert_allclose(tagged_room(ROOM, loose, Tag(0.15)).ups, expected)
    leaning = np.array([[0.6, 0.0, 0.8]])
    np.testing.assert_allclose(upright(leaning)[1], [[-0.8, 0.0, 0.6]])
    with pytest.raises(InputError, match="family 16h5 has 30 different tags, too few for 36"):
        tagged_room(ROOM, uniform(36), Tag(0.15, "16h5"))


def test_tags_overlap_in_one_plane_only():
    # Paper of 0.125 m: the second is 0.12 m beside the first, the third 0.13 m above it, the fourth on another wall.
    centres = np.array([[1.0, 3.0, 1.0], [1.12, 3.0, 1.0], [1.0, 3.0, 1.13], [1.0, 0.0, 1.0], [1.0, 0.0, 2.0]])
    normals = np.array([[0.0, -1.0, 0.0]] * 3 + [[0.0, 1.0, 0.0]] * 2)
    room = tagged_room(ROOM, Deployment(centres, normals), Tag(0.1))
    assert overlapping(room).tolist() == [True, True, False, False, False]
    touching = Deployment(np.array([[1.0, 3.0, 1.0], [1.125, 3.0, 1.0]]), normals[:2])
    assert not overlapping(tagged_room(ROOM, touching, Tag(0.1))).any()


def test_poses_are_those_of_the_seed_and_inside():
    poses = draw_poses(SCENE, 200, 3)
    np.testing.assert_array_equal(poses, draw_poses(SCENE, 200, 3))
    assert (draw_poses(SCENE, 200, 4) != poses).any()
    position = poses[:, :3, 3]
    assert ((position >= ROOM.reachable_low) & (position <= ROOM.reachable_high)).all()
    np.testing.assert_allclose(poses[:, 2, 0], 0.0, atol=1e-12)  # the camera's x axis stays level: no roll


@pytest.fixture(scope="module")
def seen():
    deployment, poses = uniform(), draw_poses(SCENE, 12, 0)
    renderer = Renderer(CAMERA, tagged_room(ROOM, deployment, Tag(0.2)), IMAGING)
    met = verdicts(SCENE, deployment, poses)
    visible = np.logical_and.reduce(list(met.values()))
    part = CameraPrediction(renderer, poses, visible, met)
    return Prediction((part,), np.eye(4)[None], poses), detect_in_frames(renderer, DETECTORS, poses, 0, 7)


def test_frames_are_the_same_in_parts_and_after_a_journey(seen):
    prediction, whole = seen
    renderer = pickle.loads(pickle.dumps(prediction.parts[0].renderer))
    parts = [
        detect_in_frames(renderer, pickle.loads(pickle.dumps(DETECTORS)), prediction.poses[i : i + 5], i, 7)
        for i in (0, 5, 10)
    ]
    for name, together in whole.items():
        joined = Matches.concatenated([part[name] for part in parts])
        np.testing.assert_array_equal(joined.detected, together.detected)
        np.testing.assert_array_equal(joined.corners, together.corners)
        np.testing.assert_array_equal(joined.false, together.false)
    assert (
        rendered_frame(renderer, prediction.poses[0], 0, 7) != rendered_frame(renderer, prediction.poses[0], 1, 7)
    ).any()


def test_figures_count_what_happened(seen):
    prediction, found = seen
    for sightings in found.values():
        row = figures(prediction, sightings)
        both = (prediction.visible & sightings.detected).sum()
        assert row["left_out"] == sightings.detected.sum() - both
        assert row["overrated"] == prediction.visible.sum() - both
        assert row["recall"] == pytest.approx(both / sightings.detected.sum())
        assert row["detected_2"] == (sightings.detected.sum(axis=1) >= 2).mean()
        assert row["pose_share"] == row["detected_1"]
        assert row["position_median"] < 0.02
        tags = by_tag(prediction, sightings)
        assert tags.detected.sum() == sightings.detected.sum()
        pitches = by_pitch(prediction, sightings)
        assert pitches.tags.sum() == prediction.whole.sum()
        assert (pitches.detected * pitches.tags).sum() <= sightings.detected.sum()
    rows = [{"deployment": "uniform", "detector": name} | figures(prediction, s) for name, s in found.items()]
    lines = to_markdown(pd.DataFrame(rows)).splitlines()
    assert len(lines) == 9
    assert {line.count("|") for line in lines[:4]} == {13}


def test_what_a_detector_sees_through_a_lens_that_distorts_is_foreseen():
    bent, tag = replace(CAMERA, distortion=(-0.25, 0.05, 0.003, -0.004)), Tag(0.12)
    deployment, poses = uniform(60), draw_poses(SCENE, 10, 0)
    renderer = Renderer(bent, tagged_room(ROOM, deployment, tag), IMAGING)
    found = detect_in_frames(renderer, {"apriltag": AprilTagDetector()}, poses, 0, 7)["apriltag"].detected
    right = []
    for camera in (bent, CAMERA):
        scene = Scene(ROOM, camera, pdf.solid_angle(4), Fiducial(tag, "apriltag"))
        told = visible(Evaluator(scene), deployment, poses[:, :3, 3], axis_and_right(poses))
        right.append((told & found).sum() / (told | found).sum())
    assert right[0] > 0.94
    assert right[1] < 0.85  # who leaves out the distortion is wrong


def test_limits_foresee_whole_frames(seen):
    prediction, found = seen
    limits = Limits(0.8, 1.8, 12.0, 84.0, 3.0)
    predicted = predicted_in_frames(limits, prediction.parts[0].renderer, prediction.poses)
    pitch, incidence, edge, sigma = qualities(prediction.parts[0].renderer, prediction.poses)
    assert (incidence[predicted] <= math.radians(84.0)).all()
    assert (edge[predicted] >= 12.0).all()
    assert (pitch[predicted] >= np.hypot(0.8, 1.8 * sigma[predicted])).all()
    row = frame_scores(predicted, found["aruco"])
    assert row["precision"] > 0.85
    assert row["recall"] > 0.85
    assert row["agreement_2"] > figures(prediction, found["aruco"])["agreement_2"] - 1e-9


def test_motion_blur_lowers_detections_as_predicted():
    deployment, poses, tag = uniform(40), draw_poses(SCENE, 16, 0), Tag(0.15)
    counts = []
    for blur in (0.0, 5.0):
        renderer = Renderer(CAMERA, tagged_room(ROOM, deployment, tag), replace(IMAGING, motion_blur=blur))
        scene = replace(SCENE, visibility=Fiducial(tag, motion_blur=blur), tag=tag)
        predicted = visible(Evaluator(scene, 1), deployment, poses[:, :3, 3], axis_and_right(poses))
        found = detect_in_frames(renderer, {"aruco": ArucoDetector()}, poses, 0, 7)["aruco"].detected
        assert agreement(predicted, found) >= 0.9
        counts.append((predicted.sum(), found.sum()))
        # The blur of single tags, to which limits are fitted, contains motion blur too.
        sigma = qualities(renderer, poses)[3]
        still = qualities(replace(renderer, imaging=IMAGING), poses)[3]
        np.testing.assert_allclose(sigma**2, still**2 + blur**2 / 12.0)
    (sharp, sharp_found), (blurred, blurred_found) = counts
    assert blurred_found < 0.8 * sharp_found
    assert blurred_found / sharp_found == pytest.approx(blurred / sharp, abs=0.1)


def test_a_preset_has_its_evidence(tmp_path):
    views, limits = TagViews(*np.ones((4, 6)), np.ones(6, dtype=bool), np.zeros(6)), Limits(0.8, 1.8, 14.0, 84.0, 3.0)
    calibration = DetectorCalibration(views, Fit(limits, 0.95, 0.94, 0.93), {})
    text = calibration.preset("aruco", "36h11", "seed 0")
    assert text.startswith(
        "# Limits of aruco for tags of the family 36h11: seed 0.\n# Measured on renderings, not on photographs.\n"
        "# Fitted to half of 6 views; on the other half accuracy 0.950"
    )
    (tmp_path / "a.yaml").write_text(text)
    assert Preset.from_yaml(tmp_path / "a.yaml") == Preset("aruco", "36h11", limits)
    assert calibration.figures()["seen"] == 1.0
