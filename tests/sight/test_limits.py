import math

import numpy as np
import pytest
from support.tables import refusals

from lmd.scene.families import FAMILIES
from lmd.scene.tag import Tag
from lmd.sight.models.fiducial import Fiducial
from lmd.sight.models.limits import Limits, Preset, limits_of, measured

MINE = Limits(1.1, 1.9, 12.0, 82.0, 2.0)


def test_what_is_found_by_hand():
    limits = Limits(pitch=3.0, blur=2.0, edge=20.0, incidence=60.0, margin=0.0)
    pitch, edge = np.array([5.0, 4.99, 5.0, 5.0, math.nan]), np.array([20.0, 20.0, 19.9, 20.0, 20.0])
    incidence = np.radians([60.0, 60.0, 60.0, 60.1, 0.0])
    assert limits.found(pitch, incidence, edge, np.full(5, 2.0)).tolist() == [True, False, False, False, False]


def test_every_preset_is_of_a_family_and_serves_all_of_its_kind():
    assert {detector for detector, _ in measured()} == {"apriltag", "apriltag_decimate2", "aruco", "wpilib"}
    for (detector, family), preset in measured().items():
        served = [name for name in FAMILIES if name == family or (name.startswith(f"{family}_") and name[0].isdigit())]
        assert served
        assert all(limits_of(detector, name, {}) == preset.limits for name in served)


@pytest.fixture
def preset(tmp_path):
    path = tmp_path / "mine.yaml"
    path.write_text(Preset("mine", "7x7_50", MINE).to_yaml(["Measured on a Sunday."]))
    return path


def test_a_file_is_a_detector(preset):
    assert preset.read_text().startswith("# Measured on a Sunday.\ndetector: mine\n")
    assert Preset.from_yaml(preset) == Preset("mine", "7x7_50", MINE)
    assert limits_of(str(preset), "7x7_50", {}) == MINE
    assert limits_of(str(preset), "7x7_50", {"margin": 9}).margin == 9.0


def detector(edge=0.1, family="36h11", **fiducial):
    return Fiducial(Tag(edge, family), **fiducial)


CALLS = {"a detector": detector, "a file of limits": lambda path: limits_of(path, "7x7_50", {})}
test_what_cannot_be_is_refused_in_one_sentence = refusals(__file__, **CALLS)
