"""Recordings of orientations: their files, their refusals, and the simulated one."""

import numpy as np
from numpy.testing import assert_allclose
from scipy.spatial.transform import Rotation
from support.recordings import MOVING, estimated, simulated
from support.tables import refusals

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


CALLS = {"a simulated recording": simulated, "an estimate": lambda **settings: estimated(simulated(), **settings)}
test_what_cannot_be_is_refused_in_one_sentence = refusals(__file__, **CALLS)
