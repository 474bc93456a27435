"""Trajectories from files: their frames, the mount of the camera, and settings that are refused."""

import json
from pathlib import Path

import numpy as np
import pytest
import yaml
from numpy.testing import assert_allclose
from scipy.spatial.transform import Rotation
from support.paper import paper_room

from lmd.core.checks import InputError
from lmd.formats.trajectories import TrajectoryFile

REFUSED = yaml.safe_load(Path(__file__).with_name("files").joinpath("refused.yaml").read_text(encoding="utf-8"))
REAL = Path(__file__).parents[3] / "shared/real"
TIME = np.array([1520530308.25, 1520530308.5, 1520530308.75])
AT = np.array([[1.0, 2.0, 3.0], [1.5, 2.25, 3.0], [2.0, 2.5, 2.75]])
TURN = Rotation.from_euler("xyz", [[-1.5, 0.2, 0.3], [-1.4, -0.2, 0.7], [-1.9, 0.2, 1.3]])  # level, as cameras look


def text(*columns):
    return "".join(" ".join(f"{value:.15g}" for value in row) + "\n" for row in zip(*columns, strict=True))


def poses_of(path, *arguments, **settings):
    return TrajectoryFile(path, *arguments, **settings).trajectory.poses


TUM = text(TIME, *AT.T, *TURN.as_quat().T)


def test_a_recording_is_put_where_it_belongs_by_its_origin_or_by_points(write):
    path = write(TUM)
    own = poses_of(path)
    turned = poses_of(path, align=[1.0, 2.0, 0.5, np.pi / 2])
    assert_allclose(turned[:, :3, 3], np.column_stack([1.0 - AT[:, 1], 2.0 + AT[:, 0], 0.5 + AT[:, 2]]))  # by hand
    quarter = [1.0, 2.0, 0.5, 0.0, 0.0, np.sqrt(0.5), np.sqrt(0.5)]
    assert_allclose(poses_of(path, align=quarter), turned, atol=1e-12)
    points = [[*p, *q] for p, q in zip(own[:, :3, 3].tolist(), turned[:, :3, 3].tolist(), strict=True)]
    points.append([0.0, 0.0, 0.0, 1.0, 2.0, 0.5])
    assert_allclose(poses_of(path, align=points), turned, atol=1e-12)


def test_a_world_whose_y_points_down_is_stood_up_by_a_quaternion(write):
    """Its z is ahead and its y points down; in the room, ahead is y, and up is z."""
    ahead = write("0 0 0 0 0 0 0 1\n1 0 0 0 0 0 0 1\n")
    poses = TrajectoryFile(ahead, align=[3, 1, 1, -np.sqrt(0.5), 0, 0, np.sqrt(0.5)]).trajectory.poses
    assert_allclose(poses[0, :3, :3] @ [0, 0, 1], [0, 1, 0], atol=1e-12)
    assert_allclose(poses[0, :3, :3] @ [0, 1, 0], [0, 0, -1], atol=1e-12)
    assert_allclose(poses[0, :3, 3], [3, 1, 1])


ON_BODY = np.eye(4)
ON_BODY[:3, :3] = Rotation.from_euler("xyz", [0.3, -0.2, 0.5]).as_matrix()
ON_BODY[:3, 3] = [0.1, -0.05, 0.2]


def mounts(write):
    qx, qy, qz, qw = Rotation.from_matrix(ON_BODY[:3, :3]).as_quat().tolist()
    basalt = {"px": 0.1, "py": -0.05, "pz": 0.2, "qx": qx, "qy": qy, "qz": qz, "qw": qw}
    kalibr = {"camera_model": "pinhole", "T_cam_imu": np.linalg.inv(ON_BODY).tolist()}
    two = write(json.dumps({"cam0": {"T_cam_imu": np.eye(4).tolist()}, "cam1": kalibr}), "two.yaml")
    return [
        write(json.dumps({"cam0": kalibr}), "one.yaml"),
        {"path": two, "name": "cam1"},
        write(json.dumps({"T_BS": {"rows": 4, "cols": 4, "data": ON_BODY.ravel().tolist()}}), "sensor.yaml"),
        write(json.dumps({"value0": {"T_imu_cam": [basalt]}}), "basalt.json"),
    ]


def test_the_camera_sits_on_what_moves_as_its_calibration_says(write):
    path = write(TUM)
    body = poses_of(path)
    for mount in mounts(write):
        found = poses_of(path, mount=mount)
        # A point ahead of the camera, through the two frames by hand.
        point = np.array([0.2, -0.1, 3.0])
        through = ON_BODY[:3, :3] @ point + ON_BODY[:3, 3]
        assert_allclose(found[:, :3, :3] @ point + found[:, :3, 3], body[:, :3, :3] @ through + AT, atol=1e-12)


def test_a_mount_in_numbers_is_that_of_a_rig(write):
    path = write(TUM)
    level = poses_of(path, mount=[0, 0, 0, 0, 0, 0])
    assert_allclose(level, poses_of(path, "body"), atol=1e-12)
    left = poses_of(path, mount=[0.1, 0, 0.3, np.pi / 2, 0, 0])  # looks to the body's left, y
    assert_allclose(left[:, :3, 2], TURN.as_matrix()[:, :, 1], atol=1e-12)
    assert_allclose(left[:, :3, 3], AT + TURN.apply([0.1, 0.0, 0.3]), atol=1e-12)


def test_a_mount_turns_angles_as_it_turns_quaternions(write):
    angles = "time,x,y,z,yaw,pitch\n0,1,1,1,0.3,0.1\n1,2,1,1,0.5,0.1\n"
    own = poses_of(write(angles))
    assert_allclose(poses_of(write(angles), mount=[0, 0, 0, 0, 0, 0]), own, atol=1e-12)


def test_a_body_that_is_taken_for_a_camera_raises_a_question(write):
    body = TrajectoryFile(write(text(TIME, *AT.T, *np.tile([[0.0], [0.0], [0.0], [1.0]], 3))))
    assert "100% of the views" in body.note
    assert "look straight up, within 30 degrees: check that the camera does." in body.note
    assert "frame=body" in body.note
    assert TrajectoryFile(body.path, "body").note == ""
    down = write(text(TIME, *AT.T, *np.tile([[1.0], [0.0], [0.0], [0.0]], 3)))  # a drone's camera
    assert "look straight down, within 30 degrees: check that the camera does." in TrajectoryFile(down).note


def test_the_frame_that_ros_names_is_no_other_one(write):
    rows = zip(AT.tolist(), TURN.as_quat().tolist(), strict=True)
    lines = "".join(
        f"{i},0,map,cam_optical_frame,{','.join(map(str, at + turn))}\n" for i, (at, turn) in enumerate(rows)
    )
    assert_allclose(poses_of(write(lines))[:, :3, :3], TURN.as_matrix(), atol=1e-12)
    with pytest.raises(InputError, match=r"^frame = body contradicts .*, which is of the frame 'cam_optical_frame'"):
        poses_of(write(lines), "body")


@pytest.mark.parametrize("row", REFUSED["mount"], ids=lambda row: row["words"])
def test_a_calibration_without_extrinsics_or_with_several_cameras_is_refused(write, row):
    mount = {"path": write(json.dumps(row["keys"]), "mount.json"), "name": row.get("name")}
    with pytest.raises(InputError, match=f"^mount: .*{row['words']}"):
        poses_of(write(TUM), mount=mount)


def test_a_recording_in_another_frame_says_how_far_it_is_outside(write):
    away = write(text(TIME, *(AT + np.array([100.0, 0.0, 0.0])).T, *TURN.as_quat().T))
    message = (
        r"is outside the room of 7.5 x 5 x 6 m; so are 3 of 3 poses, up to 94.5 m beyond it. If the file has a frame "
        r"of its own, give its pose in the room as align\.$"
    )
    with pytest.raises(InputError, match=message):
        TrajectoryFile(away).check_inside(paper_room())
    TrajectoryFile(away, align=[-100, 0, 0, 0]).check_inside(paper_room())


@pytest.mark.skipif(not REAL.is_dir(), reason="files of others are not here")
def test_recordings_of_others_are_read():
    folder = REAL / "trajectories"
    euroc, tum = (TrajectoryFile(str(folder / f"tumvi_room1_512_16_{kind}")) for kind in ("euroc.csv", "tum.txt"))
    assert len(euroc.trajectory.time) == 16541
    assert_allclose(euroc.trajectory.time, tum.trajectory.time, atol=1e-5)  # one recording, written twice
    assert_allclose(euroc.trajectory.poses, tum.trajectory.poses, atol=1e-5)
    desk = TrajectoryFile(str(folder / "evo_fr2_desk_groundtruth.txt"))
    assert desk.note.startswith("1 of 20957 rows")
    chain = {"path": str(REAL / "calibration/kalibr_tumvi_equidistant_512.yaml"), "name": "cam1"}
    carried = poses_of(euroc.path, mount=chain)
    apart = np.linalg.norm(carried[:, :3, 3] - euroc.trajectory.poses[:, :3, 3], axis=1)
    assert_allclose(apart, apart[0])  # a lever keeps its length
    assert 0.01 < apart[0] < 0.2
