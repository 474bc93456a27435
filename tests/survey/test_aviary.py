"""Detections of a hand-held camera in UPenn's Aviary, by TagSLAM's author: 96 tags on printed boards of 2 x 3."""

from pathlib import Path

import numpy as np
import pytest
import yaml

from lmd.detection.corner_errors import CORNER_ERRORS
from lmd.formats.calibrations import Calibration
from lmd.formats.detection_formats import read_detections
from lmd.scene.tag import Tag
from lmd.survey.knowledge import PriorKnowledge
from lmd.survey.survey import survey

REAL = Path(__file__).parents[2] / "../shared/real/detections/test_13"
FIRST, EACH, COLUMNS, PITCH = 6, 6, 3, 0.15  # first id, tags of a board and of a row, spacing in metres
STRIDE = 15  # frames; with all of them the error of the spacing is a third
pytestmark = [
    pytest.mark.skipif(not REAL.exists(), reason="the recording is not available"),
    pytest.mark.thorough("lmd/adjust", "lmd/survey"),
]


@pytest.fixture(scope="module")
def some():
    """Every fifteenth frame, the camera, the tags and the corner errors."""
    camera = yaml.safe_load((REAL / "cameras.yaml").read_text())["cam0"]
    (width, height), numbers = camera["resolution"], camera["intrinsics"]
    calibration = Calibration(width, height, tuple(numbers[:2]), tuple(numbers[2:]), tuple(camera["distortion_coeffs"]))
    detected = read_detections(REAL / "detections.csv")
    chosen = detected.of(np.flatnonzero(detected.frame % STRIDE == 0))
    return chosen, [calibration.camera()], Tag(0.12), CORNER_ERRORS["apriltag"]


@pytest.fixture(scope="module")
def found(some):
    return survey(*some, PriorKnowledge())


def test_all_tags_and_frames_are_placed(found):
    assert found.placed.sum() == len(found.ids) == 96
    assert len(found.found.frames) >= 500 // STRIDE
    assert not found.faults.second_places
    assert found.faults.sizes == {}


def test_unknown_boards_have_their_spacing(found):
    places = dict(zip(found.ids.tolist(), found.found.poses.tags[:, :3, 3], strict=True))
    off = []
    for number, place in places.items():
        board, tag = divmod(number - FIRST, EACH)
        row, column = divmod(tag, COLUMNS)
        for other in ((row + 1, column), (row, column + 1)):
            neighbour = FIRST + EACH * board + COLUMNS * other[0] + other[1]
            if other[0] < EACH // COLUMNS and other[1] < COLUMNS and neighbour in places:
                off.append(abs(np.linalg.norm(place - places[neighbour]) - PITCH))
    assert len(off) > 100
    assert np.median(off) < 0.0006
    assert np.quantile(off, 0.9) < 0.0016


def test_frames_held_out_agree_with_the_map(found):
    assert np.median(found.held_out.errors) < 0.4
    assert np.median(found.held_out.shifts) < 0.005


@pytest.mark.thorough("lmd/survey", "lmd/adjust")
def test_photographs_calibrate_the_camera(some, found):
    """The pixels of this sensor are square, but those of the given calibration are 0.1 % off; 5 seconds."""
    calibrated = survey(*some, PriorKnowledge(), calibrate=True)
    (camera,) = calibrated.found.calibrated
    assert camera.unsure < 1.0
    given, own = (np.diff(one.focal_pixels)[0] / one.focal_pixels[0] for one in (camera.given, camera.found))
    assert abs(own) < 0.3 * abs(given)
    kept = survey(*some, PriorKnowledge(), calibrate=False)
    before, after, refined = (np.median(one.held_out.errors) for one in (kept, calibrated, found))
    assert after < 0.75 * before
    assert refined < 0.75 * before
