"""Trajectories whose meaning a file says by its kind or by the names of its columns, and what is asked otherwise."""

import re

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.spatial.transform import Rotation

from lmd.core.checks import InputError
from lmd.formats.trajectories import TrajectoryFile

AT = np.array([[1.0, 2.0, 0.5], [1.5, 2.25, 0.5], [2.0, 2.5, 0.75]])
RPY = np.array([[0.0, 0.1, 0.3], [0.05, 0.2, 0.7], [-0.1, -0.2, 1.3]])  # of a body: x ahead, y left, z up
BODY = Rotation.from_euler("ZYX", RPY[:, ::-1])  # intrinsic: yaw, then pitch, then roll
X, Y, Z, W = BODY.as_quat().T
# Columns are the axes of a camera that looks along x, in the body: right is -y, down is -z.
CAMERA = BODY * Rotation.from_matrix([[0, 0, 1], [-1, 0, 0], [0, -1, 0]])
STAMPS = np.array([1.7e9, 1.7e9 + 0.25, 1.7e9 + 0.5])


def text(*columns, between=",", head=""):
    rows = zip(*columns, strict=True)
    return head + "".join(between.join(v if isinstance(v, str) else f"{v:.15g}" for v in row) + "\n" for row in rows)


def read(path, *arguments, **settings):
    file = TrajectoryFile(path, *arguments, **settings)
    poses = file.trajectory.poses
    return file.trajectory.time, poses[:, :3, 3], poses[:, :3, :3], file.note


def images(numbers=(3, 4, 7), name="frame_{:04d}.png", points="12.5 7.25 -1 3.0 4.0 17"):
    """COLMAP's `images.txt` of the cameras at `AT`, out of order."""
    turns = CAMERA.inv()
    lines = [f"# IMAGE_ID, QW, QX, QY, QZ, TX, TY, TZ, CAMERA_ID, NAME\n#{points}\n"]
    for i in (2, 0, 1):
        x, y, z, w = turns[i].as_quat()
        shift = -turns[i].apply(AT[i])
        numbers_of = " ".join(f"{v:.15g}" for v in (w, x, y, z, *shift))
        lines.append(f"{numbers[i]} {numbers_of} 1 {name.format(numbers[i])}\n{points}\n")
    return "".join(lines)


@pytest.mark.parametrize("points", ["", "12.5 7.25 -1", "1 2 3 4 5 6 7 8 9 1 2 3"])
def test_images_of_colmap_are_world_to_camera_and_their_numbers_are_no_seconds(write, points):
    time, at, turn, note = read(write(images(points=points)), rate=2.0)
    assert_allclose(time, [0.0, 0.5, 2.0])  # the images 5 and 6 were not registered
    assert_allclose(at, AT, atol=1e-12)
    assert_allclose(turn, CAMERA.as_matrix(), atol=1e-12)
    assert "world to camera" in note
    assert "from frame_0003.png to frame_0007.png, at 2 numbers a second" in note
    timed = read(write(images()), times=write("5\n6\n9\n", "times.txt"))
    assert_allclose(timed[0], [5.0, 6.0, 9.0])


def test_an_image_at_rest_is_where_the_hand_puts_it(write):
    """The camera looks along y from (2, 1, 3): x_c = (x - 2, 3 - z, y - 1), so t = -R (2, 1, 3) = (-2, 3, -1)."""
    half = np.sqrt(0.5)
    lines = "".join(f"{i} {half} {half} 0 0 -2 3 -1 1 img{i}.jpg\n\n" for i in (9, 10))
    _, at, turn, _ = read(write(lines), rate=1)
    assert_allclose(at, [[2, 1, 3]] * 2, atol=1e-12)
    assert_allclose(turn[0] @ [0, 0, 1], [0, 1, 0], atol=1e-12)
    assert_allclose(turn[0] @ [0, 1, 0], [0, 0, -1], atol=1e-12)


@pytest.mark.parametrize(
    ("content", "settings", "message"),
    [
        (images(), {}, r"^rate \(poses a second\) or times \(a file\) must be given: .*images of COLMAP"),
        (images(), {"rate": 1, "frame": "body"}, "^frame must be optical: .* has the poses of a camera"),
        (images(), {"rate": 1, "mount": [0] * 6}, "^mount must be left out: .* has the poses of the camera itself"),
        (images(name="cam{0}/a.png"), {"rate": 1}, "its images are of several folders, such as cam3/a.png and cam4"),
        (
            images((3, 1, 2), "frame_0{0}.png").replace("_01", "_09"),
            {"rate": 1},
            "the order of its images is not clear",
        ),
        (images((3, 3, 4)), {"rate": 1}, "the image 3 is there twice"),
        (images() + "x\n\nfoo\n", {"rate": 1}, "line 9 is no image of COLMAP"),
        (images().replace("12.5 7.25 -1 3.0 4.0 17", "").replace(" 1 ", " 1 1 ", 1), {"rate": 1}, "line"),
    ],
)
def test_what_images_of_colmap_leave_open_is_asked(write, content, settings, message):
    with pytest.raises(InputError, match=message):
        read(write(content), **settings)


ROS = text(STAMPS, *AT.T, *RPY.T, head="time,x,y,z,roll,pitch,yaw\n")


@pytest.mark.parametrize(
    ("content", "frame"),
    [
        (ROS, "optical"),
        (ROS, "body"),
        (text(STAMPS, *AT.T, *RPY.T[::-1], head="time,x,y,z,yaw,pitch,roll\n"), "body"),
        (text(STAMPS, *AT.T, *np.degrees(RPY.T), head="stamp,x,y,z,roll_deg,pitch_deg,yaw_deg\n"), "optical"),
        (text(STAMPS, *AT.T, *np.degrees(RPY.T), head="t,x,y,z,roll [deg],pitch [deg],yaw [deg]\n"), "optical"),
        (text(STAMPS, *AT.T, *RPY.T, head="# time x y z roll pitch yaw\n", between=" "), "optical"),
        (text(STAMPS, *AT.T, *RPY.T, head="time x y z roll pitch yaw\n", between="\t"), "optical"),
    ],
)
def test_roll_pitch_and_yaw_are_those_of_ros(write, content, frame):
    time, at, turn, note = read(write(content), frame)
    assert_allclose(time, STAMPS)
    assert_allclose(at, AT)
    assert_allclose(turn, CAMERA.as_matrix(), atol=1e-12)
    assert "taken as ROS has them" in note
    quaternions = text(STAMPS, *AT.T, X, Y, Z, W, between=" ")
    assert_allclose(read(write(quaternions), "body")[2], turn, atol=1e-12)
    mounted = read(write(content), frame, mount=[0.0, 0.0, 0.0, np.pi / 2, 0.0, 0.0])[2]
    assert_allclose(mounted[:, :, 2], BODY.as_matrix()[:, :, 1], atol=1e-12)  # looks to the left of the body


def test_yaw_and_pitch_without_a_roll_are_ours_or_ros_as_the_frame_says(write):
    ours = text([0.0, 1.0], *np.ones((3, 2)), [0.3, 0.4], [0.1, 0.2], head="time,x,y,z,yaw,pitch\n")
    named = ours.replace("yaw,pitch", "yaw_from_y,pitch_up")
    turn = read(write(ours))[2]
    # Clockwise from y, and up, by hand.
    assert_allclose(turn[0, :, 2], [np.sin(0.3) * np.cos(0.1), np.cos(0.3) * np.cos(0.1), np.sin(0.1)])
    assert_allclose(read(write(named))[2], turn)
    body = read(write(ours), "body")[2]
    assert_allclose(body[0, :, 2], [np.cos(0.3) * np.cos(0.1), np.sin(0.3) * np.cos(0.1), -np.sin(0.1)])
    with pytest.raises(InputError, match=r"^frame must be optical: .* has the poses of a camera"):
        read(write(named), "body")
    for head in ("time,x,y,z,yaw,pitch,roll\n0,1,1,1,0,0,0\n", "stamp,x,y,z,yaw,pitch\n0,1,1,1,0,0\n"):
        message = r"^frame must be body if .*(pitch, yaw|roll, pitch, yaw) of .* are ROS's .* call them yaw_from_y"
        with pytest.raises(InputError, match=message):
            read(write(head))


@pytest.mark.parametrize(
    ("content", "frame"),
    [
        (
            text(
                [f"{round(t * 1e6):d}000" for t in STAMPS],
                *AT.T,
                W,
                X,
                Y,
                Z,
                *AT.T,
                between=", ",
                head="#nsecs,  x, y, z,  ori_w, ori_x, ori_y, ori_z,  mag_x, mag_y, mag_z\n",
            ),
            "body",
        ),
        (text(STAMPS, *AT.T, W, X, Y, Z, head="#secs, x, y, z, ori_w, ori_x, ori_y, ori_z\n"), "body"),
        (text(STAMPS, *AT.T, X, Y, Z, W, head="timestamp x y z qx qy qz qw\n", between=" "), "body"),
        (text(STAMPS * 1e6, *AT.T, X, Y, Z, W, head="# time_us x y z qx qy qz qw\n", between=" "), "body"),
        (text(STAMPS * 1e3, *AT.T, X, Y, Z, W, head="timestamp [ms],x,y,z,qx,qy,qz,qw\n"), "body"),
        (text(STAMPS, *(AT * 1e3).T, X, Y, Z, W, head="time,x_mm,y_mm,z_mm,qx,qy,qz,qw\n"), "body"),
        (text([0, 1, 2], STAMPS, *AT.T, X, Y, Z, W, head="num,t,x,y,z,qx,qy,qz,qw\n"), "body"),
        (
            text([1.7e9] * 3, [0, 25e7, 5e8], *AT.T, X, Y, Z, W, head="secs,nsecs,x,y,z,qx,qy,qz,qw\n"),
            "body",
        ),
        (
            text(["1700000000"] * 3, ["0", "250000000", "500000000"], ["map"] * 3, *AT.T, X, Y, Z, W),
            "body",
        ),
        (  # nav_msgs/Odometry of ros2 topic echo --csv
            text(
                ["1700000000"] * 3,
                ["0", "250000000", "500000000"],
                ["odom"] * 3,
                ["base_link"] * 3,
                *AT.T,
                X,
                Y,
                Z,
                W,
                *np.zeros((78, 3)),
            ),
            "optical",
        ),
        (text(STAMPS, *AT.T, W, X, Y, Z, head="t,/r/translation/x,/r/translation/y,/r/translation/z,"
              "/r/rotation/q/w,/r/rotation/q/x,/r/rotation/q/y,/r/rotation/q/z\n"), "body"),
    ],
)  # fmt: skip
def test_names_of_columns_say_order_and_units(write, content, frame):
    time, at, turn, _ = read(write(content), frame)
    assert_allclose(time, STAMPS, rtol=0, atol=3e-7)
    assert_allclose(at, AT)
    assert_allclose(turn, CAMERA.as_matrix(), atol=1e-12)


def test_landmarks_of_rtabmap_are_no_poses(write):
    head = "#timestamp x y z qx qy qz qw id\n"
    poses = text(STAMPS, *AT.T, X, Y, Z, W, [1, 2, 3], between=" ")
    landmark = "0 9 9 9 0 0 0 1 -7\n"
    for content in (head + landmark + poses, head + poses + landmark):
        time, at, _, note = read(write(content), "body")
        assert_allclose(time, STAMPS)
        assert_allclose(at, AT)
        assert "1 of 4 rows of" in note
        assert "have a negative id, as landmarks of RTAB-Map, and are left out" in note
    bare = text(STAMPS, *AT.T, X, Y, Z, W, between=" ") + "0 9 9 9 0 0 0 1\n"
    time, at, _, note = read(write(bare), "body")
    assert_allclose(at, AT)
    assert "have the time 0 among times since 1970" in note


def test_a_body_that_is_taken_for_a_camera_raises_a_question(write):
    drive = write(text(STAMPS, *AT.T, X, Y, Z, W, between=" "))
    assert re.search(r"100% of the views of .* look straight up, .*: does the camera\? .* frame=body", read(drive)[3])
    assert read(drive, "body")[3] == ""
    down = np.tile([[1.0], [0.0], [0.0], [0.0]], 3)  # a drone's camera
    assert (
        "look straight down, within 30 degrees: does the camera?"
        in read(write(text(STAMPS, *AT.T, *down, between=" ")))[3]
    )


def test_the_frame_that_ros_names_is_no_other_one(write):
    lines = text(
        ["1700000000", "1700000001"], ["0", "0"], ["map"] * 2, ["cam_optical_frame"] * 2, *AT[:2].T,
        *CAMERA.as_quat()[:2].T,
    )  # fmt: skip
    assert_allclose(read(write(lines))[2], CAMERA.as_matrix()[:2], atol=1e-12)
    with pytest.raises(InputError, match=r"^frame must be optical: .* are those of 'cam_optical_frame'"):
        read(write(lines), "body")


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"PK\x03\x04\x00\xff", "it is an archive"),
        (b"#ROSBAG V2.0\n\x00", "a bag of ROS: rostopic echo -b FILE -p TOPIC > drive.csv"),
        (b"SQLite format 3\x00", "a database, such as a bag of ROS 2"),
    ],
)
def test_what_is_no_text_names_its_kind(tmp_path, content, message):
    (tmp_path / "drive").write_bytes(content)
    with pytest.raises(InputError, match=message):
        read(tmp_path / "drive")
