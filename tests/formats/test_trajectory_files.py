"""Trajectories of other programs: their formats, their frames, what a camera sits on, and what is refused."""

import json
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from paper import paper_room
from scipy.spatial.transform import Rotation

from lmd.core.checks import InputError
from lmd.formats.trajectories import TrajectoryFile

REAL = Path(__file__).parents[3] / "shared/real"
TIME = np.array([1520530308.25, 1520530308.5, 1520530308.75])
AT = np.array([[1.0, 2.0, 3.0], [1.5, 2.25, 3.0], [2.0, 2.5, 2.75]])
TURN = Rotation.from_euler("xyz", [[-1.5, 0.2, 0.3], [-1.4, -0.2, 0.7], [-1.9, 0.2, 1.3]])  # level, as cameras look
X, Y, Z, W = TURN.as_quat().T


def text(*columns, between=" ", head=""):
    rows = zip(*columns, strict=True)
    return head + "".join(between.join(v if isinstance(v, str) else f"{v:.15g}" for v in row) + "\n" for row in rows)


def poses_of(path, *arguments, **settings):
    return TrajectoryFile(path, *arguments, **settings).trajectory.poses


NS = ["1520530308250000000", "1520530308500000000", "1520530308750000000"]
TUM = text(TIME, *AT.T, X, Y, Z, W)
EUROC_HEAD = (
    "#timestamp [ns], p_RS_R_x [m], p_RS_R_y [m], p_RS_R_z [m], q_RS_w [], q_RS_x [], q_RS_y [], q_RS_z [], "
    "v_RS_R_x [m s^-1], v_RS_R_y [m s^-1], v_RS_R_z [m s^-1]\n"
)
OKVIS_HEAD = "timestamp, p_WS_W_x, p_WS_W_y, p_WS_W_z, q_WS_x, q_WS_y, q_WS_z, q_WS_w, v_WS_W_x, v_WS_W_y, v_WS_W_z\n"
ROS_HEAD = (
    "%time,field.header.seq,field.header.stamp,field.pose.pose.position.x,field.pose.pose.position.y,"
    "field.pose.pose.position.z,field.pose.pose.orientation.x,field.pose.pose.orientation.y,"
    "field.pose.pose.orientation.z,field.pose.pose.orientation.w,field.pose.covariance0\n"
)
COUNT = np.arange(3.0)
KITTI = text(*np.concatenate([TURN.as_matrix(), AT[:, :, None]], axis=2).reshape(3, 12).T)


@pytest.mark.parametrize(
    "content",
    [
        TUM,
        text(TIME, *AT.T, X, Y, Z, W, *np.ones((21, 3)), head="# a recording\n# of a drive\n\n"),
        text(TIME, *AT.T, X, Y, Z, W, *np.ones((36, 3))),
        text(TIME, *AT.T, X, Y, Z, W, *np.ones((12, 3)), head="# timestamp(s) tx ty tz qx qy qz qw Pr11 ...\n"),
        text(TIME, *AT.T, W, X, Y, Z, head="# timestamp tx ty tz qw qx qy qz\n"),
        text(NS, *AT.T, X, Y, Z, W),  # as ORB-SLAM3 writes it
        text(NS, *AT.T, W, X, Y, Z, *AT.T, between=",", head=EUROC_HEAD),
        text(NS, *AT.T, W, X, Y, Z, between=", "),
        text(NS, *AT.T, W, X, Y, Z, [""] * 3, between=","),  # as VINS writes it
        text(NS, *AT.T, W, X, Y, Z, *AT.T, [""] * 3, between=","),
        text(NS, *AT.T, X, Y, Z, W, *AT.T, between=",", head=OKVIS_HEAD),
        text(NS, *AT.T, X, Y, Z, W, between=",", head="#timestamp_ns,tx,ty,tz,qx,qy,qz,qw\n"),
        text(TIME, *AT.T, W, X, Y, Z, head="# secs tx ty tz qw qx qy qz\n"),
        text(TIME, COUNT, *AT.T, X, Y, Z, W, between=",", head="timestamp,time_ns,x,y,z,qx,qy,qz,qw\n"),
        text(NS, *AT.T, W, X, Y, Z, between=",", head="timestamp,x,y,z,qw,qx,qy,qz\n"),
        text(NS, COUNT, NS, *AT.T, X, Y, Z, W, COUNT, between=",", head=ROS_HEAD),
        text(TIME, X, Y, Z, W, *AT.T, COUNT, between=",", head="time,qx,qy,qz,qw,x,y,z,speed\n"),
    ],
)
def test_a_format_gives_the_poses_that_were_written(write, content):
    file = TrajectoryFile(write(content))
    assert_allclose(file.trajectory.time, TIME, rtol=0, atol=3e-7)  # a unit in the last place of today's seconds
    assert_allclose(file.trajectory.poses[:, :3, 3], AT)
    assert_allclose(file.trajectory.poses[:, :3, :3], TURN.as_matrix(), atol=1e-12)
    assert file.note == "" or file.note.endswith("is read as EuRoC's: time x y z qw qx qy qz")


def test_kittis_poses_have_their_times_beside_them(write):
    path = write(KITTI, "poses.txt")
    timed = TrajectoryFile(path, times=write("0.0e+00\n1.0e-01\n3.0e-01\n", "times.txt")).trajectory
    assert_allclose(timed.time, [0.0, 0.1, 0.3])
    assert_allclose(timed.poses[:, :3, :3], TURN.as_matrix(), atol=1e-12)
    assert_allclose(timed.poses[:, :3, 3], AT)
    assert_allclose(TrajectoryFile(path, rate=10).trajectory.time, [0.0, 0.1, 0.2])


def test_poses_with_the_time_of_the_one_before_are_left_out_and_said(write):
    later = np.array([TIME[0], TIME[0], TIME[1]])
    file = TrajectoryFile(write(text(later, *AT.T, X, Y, Z, W)))
    assert_array_equal(file.trajectory.time, TIME[:2])
    assert_allclose(file.trajectory.poses[:, :3, 3], AT[[0, 2]])
    assert file.note.startswith("1 of 3 poses of")
    assert file.note.endswith("at most 559 mm away, and are left out; the first is in line 2")


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


def test_kittis_world_is_stood_up_by_a_quaternion(write):
    """Its z is ahead and its y points down; in the room, ahead is y, and up is z."""
    ahead = write(text(*np.tile([1, 0, 0, 0.0, 0, 1, 0, 0.0, 0, 0, 1, 0.0], (2, 1)).T + 0.0), "poses.txt")
    poses = TrajectoryFile(ahead, rate=1.0, align=[3, 1, 1, -np.sqrt(0.5), 0, 0, np.sqrt(0.5)]).trajectory.poses
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


@pytest.mark.parametrize(
    ("content", "settings", "message"),
    [
        (KITTI, {}, r"^rate \(poses a second\) or times \(a file\) must be given: .* has 12 numbers"),
        (KITTI, {"rate": 1.0, "times": "t.txt"}, "^rate must be left out where times is given"),
        (KITTI, {"rate": 0.0}, "^rate must be greater than 0"),
        (KITTI, {"times": "no.txt"}, "^times: there is no file 'no.txt'"),
        (KITTI.replace(KITTI.split()[0], "3", 1), {"rate": 1.0}, "line 1: the first three columns .* are no rotation"),
        (TUM, {"rate": 30.0}, "^rate must be left out: .* has a time in each line"),
        (TUM, {"align": [1, 2, 3]}, r"^align must be \[x, y, z, yaw\].*, got 3 numbers"),
        (TUM, {"align": [1, 2, 3, 90]}, "^align: yaw must be in radians"),
        (TUM, {"align": [1, 2, 3, 0, 0, 0, 2]}, "^align: the quaternion must have length 1, it has 2"),
        (TUM, {"align": [[0, 0, 0, 1, 1, 1]] * 2}, "^align must have at least 3 points, got 2"),
        (TUM, {"align": [[i, 0, 0, 0, i, 0] for i in range(4)]}, "^align: its points lie on a line in the recording's"),
        (
            TUM,
            {"align": [[0, 0, 0, 0, 0, 0], [1, 0, 0, 1, 0, 0], [0, 1, 0, 0, 3, 0]]},
            r"^align: its points do not fit each other: at best, align\[\d\] is [\d.]+ m from where",
        ),
        (TUM, {"mount": [0, 0, 0, 90, 0, 0]}, "^mount: yaw in radians, must be in"),
        (TUM, {"mount": {"file": "x"}}, "^mount has no key 'file', only path, name"),
        (TUM, {"mount": "none.yaml"}, "^mount: there is no file 'none.yaml'"),
        (TUM.replace(" ", " x", 1), {}, "line 1: x is 'x1', not a number"),
        ("1 2 3 4 5 6 7 8 9\n", {}, "line 1 has 9 values, not 8: time x y z qx qy qz qw"),
        (text(TIME[::-1], *AT.T, X, Y, Z, W), {}, "line 2: .*, but 1520530308.5 s follows 1520530308.75 s"),
    ],
)
def test_what_is_no_trajectory_gets_one_sentence(write, content, settings, message):
    with pytest.raises(InputError, match=message) as refused:
        poses_of(write(content), **settings)
    assert "\n" not in str(refused.value)


def test_a_calibration_without_extrinsics_or_with_several_cameras_is_refused(write):
    two = {f"cam{i}": {"T_cam_imu": np.eye(4).tolist()} for i in range(2)}
    for content, name, message in (
        ({"image_width": 640}, None, "has no T_cam_imu"),
        (two, None, "has cam0, cam1: name one, as in {path: .*, name: cam0}"),
        (two, "cam7", "has no camera 'cam7', only cam0, cam1"),
        ({"cam0": {"T_cam_imu": [1, 2]}}, None, "the pose of the camera cannot be read"),
        ({"cam0": {"T_cam_imu": (2 * np.eye(4)).tolist()}}, None, "its matrix is no rigid motion"),
        ({"T_imu_cam": [{"px": 1}]}, None, "the pose of the camera cannot be read"),
        ({"T_imu_cam": ["x"]}, None, "the pose of the camera cannot be read .it must have the keys px"),
        (
            {"T_imu_cam": [dict.fromkeys(("px", "py", "pz", "qx", "qy", "qz", "qw"), 10**400)]},
            None,
            "px must be finite",
        ),
        ({"T_BS": {"data": [10**400] * 16}}, None, r"its matrix\[0\] must be finite"),
    ):
        mount = {"path": write(json.dumps(content), "mount.json"), "name": name}
        with pytest.raises(InputError, match=f"^mount: .*{message}"):
            poses_of(write(TUM), mount=mount)


def test_a_recording_in_another_frame_says_how_far_it_is_outside(write):
    away = write(text(TIME, *(AT + np.array([100.0, 0.0, 0.0])).T, X, Y, Z, W))
    message = (
        r"is outside the room of 7.5 x 5 x 6 m; so are 3 of 3 poses, up to 94.5 m beyond it. If it has a frame of its "
        "own, align says where that is in the room.$"
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
    assert desk.note.startswith("1 of 20957 poses")
    chain = {"path": str(REAL / "calibration/kalibr_tumvi_equidistant_512.yaml"), "name": "cam1"}
    carried = poses_of(euroc.path, mount=chain)
    apart = np.linalg.norm(carried[:, :3, 3] - euroc.trajectory.poses[:, :3, 3], axis=1)
    assert_allclose(apart, apart[0])  # a lever keeps its length
    assert 0.01 < apart[0] < 0.2
