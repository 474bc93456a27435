"""Detections of all cameras of a rig at equal times, counted together; rendered, a few seconds."""

from dataclasses import replace

import numpy as np
import pytest
from support.paper import experiment_room, paper_scene

from lmd.detection.detectors import ArucoDetector, Matches
from lmd.detection.frames import detect_in_frames, draw_poses, tagged_room
from lmd.detection.predictions import CameraPrediction, Prediction, by_pitch, by_tag, figures
from lmd.evaluation.verdicts import verdicts
from lmd.geometry.camera import Camera
from lmd.render.imaging import Imaging
from lmd.render.renderer import Renderer
from lmd.scene import pdf
from lmd.scene.deployment_sources import UniformDeployment
from lmd.scene.rig import Mount, Rig
from lmd.scene.tag import Tag

CAMERA = Camera(5.0, 0.0116, 0.0116, (400.0, 300.0), 800.0, 600.0, 5.0, 1778.0)
RIG = Rig((Mount(CAMERA, (0.1, 0.0, 0.0)), Mount(CAMERA, (-0.1, 0.0, 0.0), yaw=np.pi)))
ROOM, TAG, IMAGING = experiment_room(), Tag(0.2), Imaging()
SCENE = replace(paper_scene(ROOM, orientations=pdf.level_flight()), camera=RIG, tag=TAG)


@pytest.fixture(scope="module")
def seen():
    deployment, poses = UniformDeployment(12).draw(ROOM, np.random.default_rng(0)), draw_poses(SCENE, 4, 0)
    renderer = Renderer(CAMERA, tagged_room(ROOM, deployment, TAG), IMAGING)
    parts, found = [], []
    for c, mounted in enumerate(RIG.extrinsics):
        met = verdicts(SCENE, deployment, poses @ mounted, CAMERA)
        parts.append(CameraPrediction(renderer, poses @ mounted, np.logical_and.reduce(list(met.values())), met))
        found.append(detect_in_frames(renderer, {"aruco": ArucoDetector()}, parts[-1].poses, 4 * c, 0)["aruco"])
    return Prediction(tuple(parts), RIG.extrinsics, poses), Matches.beside(found), found


def test_moments_count_what_any_camera_has_and_the_pose_is_of_the_body(seen):
    prediction, both, found = seen
    row = figures(prediction, both)
    by_any = found[0].detected | found[1].detected
    assert row["frames"] == 4
    assert row["tags"] == 12
    assert row["detected_3"] == (by_any.sum(axis=1) >= 3).mean()
    assert row["predicted_2"] == (prediction.visible.reshape(4, 2, 12).any(axis=1).sum(axis=1) >= 2).mean()
    assert row["pose_share"] == 1.0
    assert row["position_90"] < 0.02  # metres: it is that of the body, 0.1 m from its cameras


def test_tags_count_once_for_each_camera(seen):
    prediction, both, found = seen
    assert by_pitch(prediction, both).tags.sum() == sum(part.whole.sum() for part in prediction.parts)
    table = by_tag(prediction, both)
    np.testing.assert_array_equal(table.detected, (found[0].detected | found[1].detected).sum(axis=0))
    assert len(table) == 12
