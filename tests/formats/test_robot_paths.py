"""Paths of FRC robots: times by hand and by PathPlanner's own generator, autos, trajectories of Choreo."""

import json

import numpy as np
import pytest
from numpy.testing import assert_allclose

from lmd.formats.trajectories import TrajectoryFile

LINE = [((1, 1), None, (3, 1)), ((7, 1), (5, 1), None)]
BEND = [((1, 1), None, (3, 1)), ((5, 4), (5, 2), (5, 6)), ((9, 6), (7, 6), None)]


def limits(speed, pull, spin=540.0):
    return {"maxVelocity": speed, "maxAcceleration": pull, "maxAngularVelocity": spin, "unlimited": False}


def zone(low, high, **more):
    return {"minWaypointRelativePos": low, "maxWaypointRelativePos": high, **more}


def path(points, start=(0.0, 0.0), goal=(0.0, 0.0), **more):
    """A path of PathPlanner; `start` and `goal` are speed and heading in degrees."""
    names = ("anchor", "prevControl", "nextControl")
    at = [{name: at and {"x": at[0], "y": at[1]} for name, at in zip(names, row, strict=True)} for row in points]
    ends = [{"velocity": speed, "rotation": turn} for speed, turn in (start, goal)]
    document = {"waypoints": at, "globalConstraints": limits(3.0, 3.0)}
    return json.dumps(document | {"idealStartingState": ends[0], "goalEndState": ends[1]} | more)


def motion(file):
    """Time, x, y and heading of a camera that looks ahead."""
    found = TrajectoryFile(str(file)).trajectory
    return np.stack([found.time, *found.poses[:, :2, 3].T, np.arctan2(found.poses[:, 1, 2], found.poses[:, 0, 2])])


@pytest.mark.parametrize(
    ("more", "seconds"),
    [
        ({}, 3.0),  # 1 s to 3 m/s over 1.5 m, 1 s over 3 m, 1 s to rest
        ({"globalConstraints": limits(9.0, 1.5), "goal": (0.0, 90.0)}, 4.0),  # a triangle, 2 s to 3 m/s
        ({"constraintZones": [zone(0.0, 1.0, constraints=limits(1.0, 2.0))]}, 6.5),  # 0.5 s over 0.25 m twice, 5.5 m
        ({"goal": (0.0, 180.0), "globalConstraints": limits(1e3, 1e6, 90.0)}, 2.0),  # 180 degrees at 90 a second
    ],
)
def test_a_straight_path_takes_the_time_of_a_trapezoid(more, seconds, write):
    time, x, *_ = motion(write(path(LINE, **more), "a.path"))
    assert time[-1] == pytest.approx(seconds, abs=3e-3)
    assert more or np.interp([0.5, 1.5, 2.5], time, x) == pytest.approx([1.375, 4.0, 6.625], abs=2e-3)


@pytest.mark.parametrize(  # seconds of `PathPlannerPath.getIdealTrajectory` of robotpy-pathplannerlib 2026.1.2
    ("more", "theirs"),
    [
        ({}, 4.560),
        ({"goal": (0.0, 90.0)}, 4.568),
        ({"constraintZones": [zone(0.5, 1.5, constraints=limits(1.0, 2.0))], "goal": (1.0, 0.0)}, 7.923),
        ({"pointTowardsZones": [zone(0.5, 1.5, fieldPosition={"x": 8, "y": 1}, rotationOffset=0.0)]}, 4.592),
    ],
)
def test_a_bent_path_takes_the_time_that_pathplanner_gives_it(more, theirs, write):
    time, x, y, heading = motion(write(path(BEND, **more), "a.path"))
    assert time[-1] == pytest.approx(theirs, rel=0.02)
    there = int(np.argmin(np.hypot(x - 5.0, y - 4.0)))
    if "pointTowardsZones" in more:
        assert np.degrees(heading[there]) == pytest.approx(-45.0, abs=1.0)
    if more.get("goal") == (0.0, 90.0):
        way = np.append(0.0, np.cumsum(np.hypot(np.diff(x), np.diff(y))))
        assert_allclose(np.degrees(heading), 45.0 * (1.0 - np.cos(np.pi * way / way[-1])), atol=0.2)


def test_an_auto_follows_its_paths_and_waits(tmp_path):
    for name in ("paths/go.path", "paths/on.path", "autos/a.auto"):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_text(path(LINE))

    def command(kind, *commands, **data):
        return {"type": kind, "data": data or {"commands": list(commands)}}

    go, on = (command("path", pathName=name) for name in ("go", "on"))
    wait, named = command("wait", waitTime=0.5), command("named", name="shoot")
    tree = command("sequential", wait, command("parallel", wait, named, go), command("race", wait, named), on, wait)
    (tmp_path / "autos" / "a.auto").write_text(json.dumps({"command": tree}))
    time, x, *_ = motion(tmp_path / "autos" / "a.auto")
    assert time[[0, -1]] == pytest.approx([0.0, 7.5], abs=4e-3)
    assert np.interp([0.4, 2.0, 3.5, 5.5, 7.4], time, x) == pytest.approx([1.0, 4.0, 7.0, 4.0, 7.0], abs=0.05)


def test_choreos_samples_are_the_poses_and_the_mount_carries_the_camera(write):
    samples = [{"t": 0.1 * k, "x": 1.0 + k, "y": 2.0, "heading": 0.25 * np.pi * k, "vx": 9.0} for k in range(3)]
    new = write(json.dumps({"name": "a", "version": 3, "trajectory": {"samples": samples, "splits": [0]}}), "new.traj")
    old = write(json.dumps({"samples": [{"timestamp": one.pop("t"), **one} for one in samples]}), "old.traj")
    for file in (new, old):
        assert_allclose(motion(file), [[0.0, 0.1, 0.2], [1, 2, 3], [2, 2, 2], np.pi * np.array([0.0, 0.25, 0.5])])
    camera = TrajectoryFile(str(new), mount=[0.3, 0.0, 0.5, 0.0, 0.0, 0.0]).trajectory.poses[2]
    assert_allclose(camera[:3, 3], [3.0, 2.3, 0.5])
