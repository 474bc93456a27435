"""Recordings of orientations: their files, their refusals, and the simulated one."""

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.spatial.transform import Rotation
from support.recordings import MOVING, simulated

from lmd.core.checks import InputError
from lmd.geometry.frames import rotation
from lmd.orientation.density import circular_difference
from lmd.orientation.recording import OrientationRecording


def test_a_simulated_recording_is_smooth_also_through_the_seam_and_the_same_for_the_same_seed():
    recording = simulated(rate=100.0, yaw_mean=3.0, yaw_concentration=0.5, pitch_std=0.2)
    assert np.abs(circular_difference(np.diff(recording.yaw), 0.0)).max() < 0.1
    assert np.abs(np.diff(recording.pitch)).max() < 0.02
    assert (np.abs(np.diff(recording.yaw)) > 6.0).any()
    assert (simulated(7).yaw == simulated(7).yaw).all()
    assert (simulated(7).yaw != simulated(8).yaw).any()


def test_a_recording_reads_back_what_it_wrote_and_ignores_positions(write, tmp_path):
    recording = simulated(duration=10.0, **MOVING)
    recording.to_csv(tmp_path / "flight.csv")
    again = OrientationRecording.from_csv(tmp_path / "flight.csv")
    for name in ("time", "yaw", "pitch"):
        assert (getattr(again, name) == getattr(recording, name)).all()
    posed = OrientationRecording.from_csv(write("time,x,y,z,pitch,yaw\n0,1,2,3,0.1,2\n1,1,2,3,0.2,3\n"))
    assert posed.yaw.tolist() == [2.0, 3.0]
    assert posed.pitch.tolist() == [0.1, 0.2]


def test_a_quaternion_is_that_of_the_optical_frame(write):
    yaw, pitch = np.array([0.3, -2.9, 1.0]), np.array([0.2, -1.0, 0.0])
    x, y, z, w = Rotation.from_matrix(np.swapaxes(rotation(yaw, pitch, 0.4), -1, -2)).as_quat().T
    rows = "\n".join(f"{i},{w[i]},{x[i]},{y[i]},{z[i]},1" for i in range(3))
    recording = OrientationRecording.from_csv(write(f"time,qw,qx,qy,qz,x\n{rows}\n"))
    assert_allclose(recording.yaw, yaw, atol=1e-9)
    assert_allclose(recording.pitch, pitch, atol=1e-9)


def test_angles_may_have_names_that_say_what_they_are_and_a_body_raises_a_question(write):
    rows = "0,0.3,0.1\n1,0.4,0.2\n"
    named = OrientationRecording.from_csv(write(f"time,yaw_from_y,pitch_up\n{rows}"))
    assert_allclose([named.yaw, named.pitch], [[0.3, 0.4], [0.1, 0.2]])
    assert named.note == ""
    body = OrientationRecording.from_csv(write("time,qw,qx,qy,qz\n0,1,0,0,0\n1,0.6,0,0,0.8\n"))
    assert "100% of the views of" in body.note
    assert "look straight up" in body.note


BAD_RECORDINGS = [
    ("time,yaw,pitch\n0,0,0\n", "has 1 records; a recording needs at least 2"),
    ("time,yaw,pitch\n0,0,0\n2,0,0\n1,0,0\n", "time must increase, but 2 s is followed by 1 s"),
    ("time,yaw,pitch\n0,0,0\n1,0,45\n", "pitch = 45 looks like degrees"),
    ("time,yaw,pitch\n0,0,0\n1,-350,0\n", "yaw = -350 looks like degrees; angles are in radians, at most one turn"),
    ("time,yaw,pitch\n0,0,0\n1,0,2\n", "pitch must be in .* radians, got 2"),
    ("# a flight\n\ntime,yaw,pitch\n0,0,0\n# turned here\n1,x,0\n", "line 6: yaw is 'x'"),
    ("time,yaw\n0,0\n", "lacks the column 'pitch'"),
    ("time,yaw,pitch,speed\n0,0,0,1\n", "unknown column 'speed'"),
    ("time,yaw,pitch\n0,nan,0\n", "line 2: yaw is 'nan', not a finite number"),
    (
        "time,x,y,z,roll,pitch,yaw\n0,0,0,0,0,0,0\n",
        "may be ROS's, of a body: call them yaw_from_y, pitch_up, roll_left",
    ),
    ("", "is empty"),
    ("time,qw,qx,qy,qz\n0,1,0,0,0\n1,1,1,0,0\n", "line 3: the quaternion must have length 1, it has 1.41421"),
]


@pytest.mark.parametrize(("text", "named"), BAD_RECORDINGS)
def test_a_bad_recording_is_refused_with_its_name_and_the_value(write, text, named):
    with pytest.raises(InputError, match=rf"flight\.csv.*{named}"):
        OrientationRecording.from_csv(write(text, "flight.csv"))


@pytest.mark.parametrize(
    ("changes", "named"),
    [
        ({"rate": 0.0}, "^rate must be greater than 0"),
        ({"duration": 0.1}, "^duration must be at least 0.2, got 0.1"),
        ({"pitch_std": -1.0}, "^pitch_std must be at least 0, got -1.0"),
        ({"coupling": 1.5}, r"^coupling must be in \[-1, 1\], got 1.5"),
    ],
)
def test_a_motion_that_cannot_be_is_refused(changes, named):
    with pytest.raises(InputError, match=named):
        simulated(**changes)
