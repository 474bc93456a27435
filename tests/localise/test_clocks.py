"""Offset of the camera's clock from the odometry's clock: value, deviation, and motion that does not show it."""

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import opencv_rooms as rooms
import pytest
from support import drives, walks
from support.processes import ROOT

from lmd.adjust.motion import Motion, seconds_of
from lmd.geometry.se3 import exp
from lmd.geometry.trajectory import Trajectory
from lmd.localise.fixed_map import FixedMap
from lmd.localise.localise import Drive, localise
from lmd.localise.results import localise_document, metrics, to_text
from lmd.scene.tag import Tag
from lmd.survey import results
from lmd.survey.knowledge import PriorKnowledge
from lmd.survey.survey import survey

REAL = Path(__file__).parents[2] / "../shared/real/detections/test_13"
ERRORS, TAG = walks.constant_errors(0.2), Tag(drives.EDGE)
HIDDEN = "the motion does not show an offset of the camera's clock from the odometry's"
more_clocks = pytest.mark.thorough("lmd/adjust", "lmd/localise", "benchmarks/clocks.py")


def driven(later=0.0, sway=1.0):
    """A drive, and its odometry by a clock that is ahead of the camera's by `later` seconds."""
    rng = np.random.default_rng(1)
    drive = drives.drive(8.0, 8, rng, alone=0.5, dark=0.1, sway=sway)
    odometry = drives.odometry(drive, rng)
    return drive, replace(odometry, time=odometry.time + later)


def localised(drive, odometry):
    count = len(drive.tags)
    known = FixedMap(np.arange(count), drive.tags, np.full(count, drives.EDGE), np.full((count, 6), 1e-4))
    path = Drive(odometry=odometry)
    return localise(drive.detected, [drives.CAMERA], TAG, ERRORS, known, path, calibrate=False)


@pytest.mark.parametrize(("later", "said"), [(0.0, "not significant"), (-0.03, "corrected"), (0.2, "corrected")])
def test_the_offset_is_found_and_corrected_if_it_is_significant(later, said):
    result = localised(*driven(later))
    figures, clock = metrics(result), result.smoothed.clock
    assert clock.sigma < 0.003
    assert abs(clock.offset - later) < 3.0 * clock.sigma
    assert (figures["clock_offset"], figures["clock_sigma"]) == clock[:2]
    assert localise_document(result)["clock"] == clock.sentence
    side = "behind" if clock.offset > 0.0 else "ahead of"
    size, spread = f"{1e3 * abs(clock.offset):.1f} ms", f"({1e3 * clock.sigma:.1f} ms)"
    assert f"the camera's clock is {size} {side} the odometry's {spread}, which is {said}" in to_text(result)
    motion = result.smoothed.prior.motion
    assert abs(motion.offset - clock.offset) < clock.sigma if said == "corrected" else motion.offset == 0.0


def test_a_straight_drive_does_not_show_the_offset():
    """Drift of odometry looks like changes of the velocity, but tells nothing about the clock."""
    result = localised(*driven(0.03, sway=0.0))
    assert HIDDEN in to_text(result)
    assert result.smoothed.prior.motion.offset == 0.0


def test_a_survey_finds_the_offset():
    drive, odometry = driven(0.1)
    found = survey(drive.detected, [drives.CAMERA], TAG, ERRORS, PriorKnowledge(odometry=odometry))
    clock = found.found.clock
    assert abs(clock.offset - 0.1) < 3.0 * clock.sigma < 0.009
    assert clock.is_corrected
    assert clock.sentence in results.to_text(found)
    assert results.survey_document(found)["clock"] == clock.sentence
    assert results.metrics(found)["clock_offset"] == clock.offset
    assert (walks.apart(found.found.poses.tags[found.placed], drive.tags[found.ids[found.placed]]) < 0.05).all()


def test_without_odometry_there_is_no_offset():
    result = localised(driven()[0], None)
    assert result.smoothed.clock is None
    assert localise_document(result)["clock"] is None
    assert "clock_offset" not in metrics(result)


def test_velocities_are_those_of_the_motion():
    """Half the odometry has a gap, and the last frame comes after its end."""
    twist, times = np.array([0.1, -0.4, 0.2, 0.5, 0.2, -0.3]), np.arange(200) / 100.0
    motion = Motion.by_odometry(np.array([0.333, 0.5, 1.234, 3.0]), Trajectory(times, exp(times[:, None] * twist)), 0.1)
    np.testing.assert_allclose(motion.velocities[:3], np.tile(twist[:, None], (3, 1, 2)), atol=1e-9)
    assert not motion.velocities[3].any()
    two = Trajectory(times[:2], exp(times[:2, None] * twist))
    np.testing.assert_allclose(Motion.by_odometry(times[:2], two).velocities[1], np.stack([twist] * 2, 1), atol=1e-9)


@more_clocks
@pytest.mark.parametrize("later", [0.0, 0.03])
def test_all_cameras_of_a_rig_share_the_offset(later):
    squares = []
    for seed in range(6):
        one = rooms.scenario("rig", seed)
        drive = drives.Drive(one.true, one.frames, seconds_of(one.detected.times), one.detected)
        odometry = drives.odometry(drive, np.random.default_rng(seed))
        clock = one.localised(odometry=replace(odometry, time=odometry.time + later)).smoothed.clock
        squares.append(((clock.offset - later) / clock.sigma) ** 2)
        assert clock.is_corrected == (later > 0.0)
    assert np.sum(squares) < 22.5  # six degrees of freedom


@more_clocks
@pytest.mark.skipif(not REAL.exists(), reason="the recording is not available")
def test_the_offset_of_a_recording_is_found(capsys):
    """A hand-held camera with simulated odometry; two minutes."""
    sys.path.append(str(ROOT / "benchmarks"))
    import clocks

    clocks.recorded(REAL, 0.12, 1)
    rows = [line.split(" | ")[3:6] for line in capsys.readouterr().out.splitlines()[2:]]
    assert [row[1:] for row in rows] == [["0.0%", "100.0%"], ["100.0%", "100.0%"]] * 2
