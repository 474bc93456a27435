"""Detections of a survey beside predictions, by one camera and by two; some 10 seconds."""

from dataclasses import replace

import numpy as np
import pytest
from support import walks

from lmd.core.checks import InputError
from lmd.core.tables import write_table
from lmd.detection.calibration import DetectorCalibration, fit
from lmd.detection.detectors import Matches
from lmd.detection.predictions import CameraPrediction, Prediction
from lmd.detection.tag_views import FILE, SurveyedViews
from lmd.evaluation.audit import Audit, audited, detections_of_map, in_the_open, view_columns
from lmd.evaluation.verdicts import verdicts
from lmd.geometry.camera import Camera
from lmd.geometry.se3 import axis_and_right, pose_of
from lmd.render.imaging import Imaging
from lmd.scene.deployment import Deployment
from lmd.scene.pdf import solid_angle
from lmd.scene.rig import Mount, Rig
from lmd.scene.scene import Scene
from lmd.scene.tag import Tag
from lmd.sight.models.fiducial import Fiducial
from lmd.sight.models.limits import Limits
from lmd.space.cuboid import Cuboid
from lmd.survey.knowledge import PriorKnowledge
from lmd.survey.results import map_of
from lmd.survey.survey import survey

CAMERA, TAG, SIGMA, COUNT = Camera(2.2, 0.0055, 0.0055, (320.0, 240.0), 640, 480, 0.0), Tag(0.16), 0.1, 24
LEAST = walks.SMALLEST / TAG.modules  # pixels per module of the smallest detected tags

ROOM = Cuboid((9.0, 4.0, 2.5), (6.0, 2.0, 0.5), 0.5)
# The second camera sits 15 cm to the right of the first, and looks a quarter of a turn to the right.
TO_THE_RIGHT = np.array([[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [-1.0, 0.0, 0.0]])
MOUNTS = np.stack([np.eye(4), pose_of(TO_THE_RIGHT, np.array([0.15, 0.0, 0.0]))])


def walked(mounts, photographs, known):
    """A walk through a long room, in which many tags are too far away: detections, prior knowledge and cameras."""
    rng = np.random.default_rng(2)
    true = np.stack([walks.on_wall(k % 4, (k // 4 + 0.5) / 6, 1.2, width=9.0, depth=4.0) for k in range(COUNT)])
    frames = walks.walk(photographs, rng, width=9.0)
    detected = walks.photographed(true, frames, rng, SIGMA, CAMERA, mounts, edges=TAG.size)
    return detected, known(true), [CAMERA] * len(mounts)


def surveyed(detected, cameras, known):
    return survey(detected, cameras, TAG, walks.constant_errors(SIGMA), known)


@pytest.fixture(scope="module", params=[1, 2])
def folder(request, tmp_path_factory):
    """Folder of a survey by one camera, and by two."""
    folder = tmp_path_factory.mktemp("surveyed")
    detected, known, cameras = walked(MOUNTS[: request.param], 80 // request.param, lambda _: PriorKnowledge())
    found = surveyed(detected, cameras, known)
    write_table(folder / FILE, view_columns(found, cameras, TAG, None))
    return folder, cameras


def test_limits_fitted_to_a_survey_are_those_of_its_detector(folder):
    (folder, cameras), rng = folder, np.random.default_rng(0)
    source = SurveyedViews(str(folder))
    views = source.views(cameras, TAG, None, Imaging(), rng)
    assert 100 < views.seen.sum() < len(views)
    fitted = fit(views, rng, 0.0)
    least = np.hypot(fitted.limits.pitch, fitted.limits.blur * views.sigma[0])
    by_edge = fitted.limits.edge / TAG.modules
    assert max(least, by_edge) == pytest.approx(LEAST, abs=0.3)
    assert fitted.accuracy > 0.9
    text = DetectorCalibration(views, fitted, {}, source.photographs).preset("apriltag", "36h11", "survey")
    assert f"# Measured on {source.photographs} photographs." in text


def test_a_survey_of_more_cameras_is_refused(folder):
    folder, cameras = folder
    with pytest.raises(
        InputError, match=rf"^folder: the survey .* has {len(cameras)} cameras, but {len(cameras) - 1} are given\.$"
    ):
        SurveyedViews(str(folder)).views(cameras[1:], TAG, None, Imaging(), np.random.default_rng(0))


def test_an_audit_covers_the_images_of_all_cameras():
    def planned(true):
        return PriorKnowledge(plan=Deployment(true[:, :3, 3], true[:, :3, 2]))

    detected, known, cameras = walked(MOUNTS, 40, planned)
    dirty = int(np.bincount(detected.ids).argmax())  # from here on found in few images only
    last = np.flatnonzero(detected.ids == dirty)[3]
    clean = detected.of(np.flatnonzero((detected.ids != dirty) | (np.arange(len(detected)) < last)))
    found = surveyed(clean, cameras, known)
    limits = Limits(pitch=LEAST, blur=0.0, edge=walks.SMALLEST, incidence=78.0, margin=2.0)
    scene = Scene(ROOM, Rig((Mount(CAMERA), Mount(CAMERA))), solid_angle(4), Fiducial(TAG, limits=limits))
    audit = audited(found, scene, verdicts)
    tags, poses = map_of(found).with_surfaces(ROOM, papers=TAG.paper_edge), found.found.poses.frames[found.found.frames]
    for c, told in enumerate(np.split(audit.prediction.visible, 2, axis=1)):
        at = poses @ found.found.poses.mounts[c]
        axes = axis_and_right(at)
        covered = [
            scene.visibility.covered(CAMERA, pose[:3, 3], axes[i : i + 1], tags.positions, tags.normals)[0]
            for i, pose in enumerate(at)
        ]
        np.testing.assert_array_equal(told, covered)
        own = clean.camera == c
        assert np.split(audit.seen.detected, 2, axis=1)[c].sum() == pytest.approx(own.sum(), abs=3)
    table = audit.tags.set_index("id")
    assert table.index[table.stands_out].tolist() == [dirty]
    assert audit.metrics()["audit/precision"] > 0.8
    assert audit.tables["audit_pitches"].tags.sum() == audit.prediction.whole.sum()
    # Images that were not taken show no tags, and the others do not change.
    taken = np.ones((len(clean.times), 2), dtype=bool)
    taken[::3, 1] = False
    kept = clean.of(np.flatnonzero(taken[clean.frame, clean.camera]))
    fewer = audited(replace(found, detected=replace(kept, taken=taken)), scene, verdicts).prediction
    shown = np.repeat(taken[found.found.frames], COUNT, axis=1)
    for name in ("visible", "whole"):
        np.testing.assert_array_equal(getattr(fewer, name), getattr(audit.prediction, name) & shown)
    assert np.isnan(fewer.pitch[~shown]).all()
    # An empty room need not be known.
    open_to_all = audited(*in_the_open(found, scene), verdicts)
    np.testing.assert_array_equal(open_to_all.prediction.visible, audit.prediction.visible)
    np.testing.assert_array_equal(open_to_all.seen.detected, audit.seen.detected)


def test_a_detection_some_pixels_off_counts_and_a_far_one_is_false():
    detected, known, cameras = walked(MOUNTS[:1], 80, lambda _: PriorKnowledge())
    corners = detected.corners.copy()
    many = np.bincount(detected.frame, minlength=len(detected.times))
    near, far = np.flatnonzero(many[detected.frame] == many.max())[[0, -1]]
    corners[near] += [2.5, 0.0]  # too far to place anything: 25 standard deviations
    corners[far] += [30.0, 0.0]
    found = surveyed(replace(detected, corners=corners), cameras, known)
    some = found.found.sightings
    for index in (near, far):
        own = (some.frame == detected.frame[index]) & (found.ids[some.tag] == detected.ids[index])
        assert own.sum() == 1
        assert not found.found.used[own].any()
    (seen,) = detections_of_map(found)
    frame = dict(zip(found.found.frames.tolist(), range(len(found.found.frames)), strict=True))
    tag = dict(zip(found.ids[found.placed].tolist(), range(COUNT), strict=False))
    for index, is_seen in ((near, True), (far, False)):
        f, k = frame[int(detected.frame[index])], tag[int(detected.ids[index])]
        assert seen.detected[f, k] == is_seen
        assert seen.false[f] == (not is_seen)
    columns = view_columns(found, [one.found for one in found.found.calibrated], TAG, None)
    own = (np.asarray(columns["time"]) == str(detected.frame[near])) & (columns["id"] == detected.ids[near])
    assert np.asarray(columns["seen"])[own].tolist() == [1]
    np.testing.assert_allclose(np.asarray(columns["border"])[own], edge_distance(corners[near] - [2.5, 0.0]), atol=1.0)
    diameter = 2.0 * np.linalg.norm(corners[near] - [2.5, 0.0] - [320.0, 240.0], axis=1).max()
    np.testing.assert_allclose(np.asarray(columns["circle"])[own], diameter, atol=4.0)  # about the estimated centre


def edge_distance(corners):
    return np.minimum(corners, [640.0, 480.0] - corners).min()


def test_successive_misses_are_counted_apart():
    """A tag that is hidden six times in a row, and another that is missed every third time."""
    visible, detected = np.ones((12, 2), dtype=bool), np.ones((12, 2), dtype=bool)
    visible[4, 0] = False  # not asked for: the row goes on
    detected[2:9, 0], detected[::3, 1] = False, False
    poses = np.tile(np.eye(4), (12, 1, 1))
    prediction = Prediction((CameraPrediction(None, poses, visible, {}),), np.eye(4)[None], poses)
    audit = Audit(prediction, Matches(detected, np.full((12, 2, 4, 2), np.nan), np.zeros(12, dtype=int)))
    assert audit.missed_in_a_row.sum(axis=0).tolist() == [6, 0]
    assert np.flatnonzero(audit.missed_in_a_row[:, 0]).tolist() == [2, 3, 5, 6, 7, 8]
