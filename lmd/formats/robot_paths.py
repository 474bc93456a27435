"""Planned paths of robots that compete in FRC: trajectories of Choreo, and paths and autos of PathPlanner.

A robot drives on the floor: its poses have z = 0, and the heading is the rotation about z. The origin is the corner of
the field on the right of the blue alliance.

A path of PathPlanner has no times. The speed along the path is the largest that keeps the limits of the path and of its
zones (speed, acceleration along the path, turn rate) and the speeds at both ends. Between two rotation targets the
heading is eased by a cosine over the distance driven, as in PathPlanner. The limits of wheels and motors, of the grip
in bends, and of the angular acceleration are left out. So PathPlanner's own times are longer where a robot turns while
it drives.
"""

from pathlib import Path
from typing import Any

import numpy as np
from scipy.interpolate import BPoly

from lmd.core.checks import FloatArray, InputError, bounded, real, said_of
from lmd.formats.placed_tag import mapping
from lmd.formats.pose_files import Rows
from lmd.formats.trees import File, Keys, entries, find, number_at
from lmd.geometry.frames import roll_pitch_yaw
from lmd.geometry.se3 import pose_of

STEPS = 1000  # number of points on the curve between two waypoints
RATE = 50.0  # poses per second; the loop of a robot's program runs as often
SHORTEST = 1e-9  # points that are closer to each other count as one, metres
MOST, LONGEST = 1000, 3600.0  # largest number of waypoints, and largest duration of a path or of a wait, seconds
LIMITS = ("maxVelocity", "maxAcceleration", "maxAngularVelocity")  # m/s, m/s^2, degrees per second
CURVE = (("anchor", 0), ("nextControl", 0), ("prevControl", 1), ("anchor", 1))  # control points after a waypoint
ZONE = ("minWaypointRelativePos", "maxWaypointRelativePos", "constraints")
TARGET = ("waypointRelativePos", "rotationDegrees")
ENDS = ("idealStartingState.{0}|previewStartingState.{0}", "goalEndState.{0}")


def read_robot_path(file: File) -> Rows:
    """Read the poses of a robot from a file of Choreo (`.traj`) or PathPlanner (`.path`, `.auto`).

    An auto is a sequence of paths and waits; its paths are read from the folder `paths` beside the folder of the auto.

    Raises:
        InputError: a value is missing or wrong, or a path that an auto names cannot be read.
    """
    with said_of(file.path):
        time, x, y, heading = {".traj": _sampled, ".path": _timed}.get(file.suffix, _joined)(file).T
    poses = pose_of(roll_pitch_yaw(np.outer(heading, [0.0, 0.0, 1.0])), np.stack([x, y, 0.0 * x], axis=1))
    note = f"{file.path} has the poses of a robot on the floor (z = 0), x ahead, for {np.ptp(time):.2f} s"
    return Rows(str(file.path), range(1, len(time) + 1), time, poses, "body", notes=(note,))


def _sampled(file: File) -> FloatArray:
    """Time (s), x, y (m) and heading (rad) of a robot in a trajectory of Choreo, `(T, 4)`."""
    if not (samples := _all(mapping("trajectory", file.data.get("trajectory", file.data)), "samples.*")):
        raise InputError("it has no samples: generate the trajectory in Choreo.")
    return np.array([[number_at(one, name) for name in ("t|timestamp", "x", "y", "heading")] for one in samples])


def _all(keys: Keys, path: str) -> list[Keys]:
    return [one for _, one in entries(keys, path)]


def _joined(file: File) -> FloatArray:
    """Motion of a robot in an auto of PathPlanner, along one path after the other.

    Returns:
        time (s), x, y (m) and heading (rad), `(T, 4)`.
    """
    clock, parts = 0.0, list[FloatArray]()
    for step in _steps(mapping("command", file.data.get("command"))):
        if isinstance(step, str):
            with said_of(path := Path(file.path).parent.parent / "paths" / f"{step}.path", known=("path",)):
                parts.append(_timed(File(path)) + np.array([clock, 0.0, 0.0, 0.0]))
        clock = parts[-1][-1, 0] if isinstance(step, str) else clock + step
    if not parts:
        raise InputError("its command follows no path.")
    motion = np.concatenate([parts[0][:1], *parts, parts[-1][-1:]])  # the robot may wait at both ends
    motion[[0, -1], 0] = 0.0, clock
    return np.asarray(motion[np.append(np.diff(motion[:, 0]) > 0.0, True)])


def _steps(command: Keys) -> list[str | float]:
    """Steps of a command of an auto, in order: the name of a path for a drive, a duration in seconds for a wait.

    An auto is a sequence of drives and waits. Of commands that run at the same time only one counts; one that begins
    with a drive is preferred.
    """
    kind, data = command.get("type"), mapping("data", command.get("data"))
    if kind == "path":
        return [str(data.get("pathName"))]
    if kind == "wait":
        return [real("waitTime", data.get("waitTime"), low=0.0, high=LONGEST)]
    parts = [_steps(one) for one in _all(data, "commands.*")]
    if kind == "sequential":
        return [step for part in parts for step in part]
    return max(parts, key=lambda part: [isinstance(step, str) for step in part], default=[])


def _timed(file: File) -> FloatArray:
    """Motion of a robot along a path of PathPlanner, at equal steps of time from 0.

    Returns:
        time (s), x, y (m) and heading (rad), `(T, 4)`.
    """
    data, waypoints = file.data, _all(file.data, "waypoints.*")
    if not 1 <= (last := len(waypoints) - 1) <= MOST:
        raise InputError(f"it must have at least two waypoints and at most {MOST}, but has {last + 1}.")
    points = [[_place(one, name) for one in waypoints[i : last + i]] for name, i in CURVE]
    curve, along = BPoly(np.array(points), np.arange(last + 1.0)), np.linspace(0.0, last, STEPS * last + 1)
    along = along[np.append(True, np.linalg.norm(np.diff(curve(along), axis=0), axis=1) > SHORTEST)]
    if len(along) < 3:
        raise InputError("its waypoints are all at one place.")
    places = curve(along)
    step = np.linalg.norm(np.diff(places, axis=0, prepend=places[:1]), axis=1)
    way, (fastest, pull, spin) = np.cumsum(step), _limits(data, along)
    heading = _headings(data, along, places, way)
    with np.errstate(divide="ignore"):
        energy = np.minimum(fastest, np.radians(spin) / np.abs(np.gradient(heading, way))) ** 2
    for i, state in zip((0, -1), ENDS, strict=True):
        energy[i] = min(energy[i], number_at(data, state.format("velocity")) ** 2)
    gained = np.cumsum(2.0 * pull * step)
    forwards = np.minimum.accumulate(energy - gained) + 2.0 * gained
    speed = np.sqrt(np.maximum(np.minimum.accumulate(forwards[::-1])[::-1] - gained, 0.0))
    time = np.append(0.0, np.cumsum(2.0 * step[1:] / (speed[1:] + speed[:-1])))
    bounded("seconds", time[-1], LONGEST, "it")
    even = np.linspace(0.0, time[-1], int(np.ceil(RATE * time[-1])) + 1)
    return np.stack([even, *(np.interp(even, time, each) for each in (*places.T, heading))], axis=1)


def _place(keys: Keys, name: str) -> list[float]:
    return [number_at(keys, f"{name}.{axis}") for axis in "xy"]


def _inside(zone: Keys, along: Any) -> Any:
    """Mask of the points of a path that are in a zone, a part of the path with limits or headings of its own.

    `along` is the location of each point: index of a waypoint from 0, with fractions between two waypoints.
    """
    return (along >= number_at(zone, ZONE[0])) & (along <= number_at(zone, ZONE[1]))


def _limits(data: Keys, along: FloatArray) -> FloatArray:
    """Limits of speed (m/s), acceleration (m/s^2) and turn rate (deg/s) at each of N points of a path, `(3, N)`.

    A zone is a part of the path with limits of its own; where zones overlap, the first zone counts.

    Args:
        data: content of the path's file.
        along: location of each point: index of a waypoint from 0, with fractions between two waypoints, `(N,)`.
    """
    found = np.ones((len(LIMITS), len(along)))
    whole = dict(zip(ZONE, (0.0, MOST, data.get("globalConstraints")), strict=True))
    for zone in (whole, *reversed(_all(data, "constraintZones.*"))):
        if find(zone, "constraints.unlimited") is True:
            raise InputError("its limits are off (unlimited), so the path has no times: set limits in PathPlanner.")
        limits = [[real(name, number_at(zone, f"constraints.{name}"), above=0.0)] for name in LIMITS]
        found[:, _inside(zone, along)] = limits
    return found


def _headings(data: Keys, along: FloatArray, places: FloatArray, way: FloatArray) -> FloatArray:
    """Heading of the robot at each of N points of a path, rad, `(N,)`.

    Args:
        data: content of the path's file.
        along: location of each point: index of a waypoint from 0, with fractions between two waypoints, `(N,)`.
        places: x and y of each point, metres, `(N, 2)`.
        way: length of the path from its start to each point, metres, `(N,)`.
    """
    ends = [(at, number_at(data, state.format("rotation"))) for at, state in zip(along[[0, -1]], ENDS, strict=True)]
    targets = [[number_at(one, name) for name in TARGET] for one in _all(data, "rotationTargets.*")]
    for zone in _all(data, "pointTowardsZones.*"):
        inside = _inside(zone, along)
        x, y = (_place(zone, "fieldPosition") - places[inside]).T
        turned = np.degrees(np.arctan2(y, x)) + number_at(zone, "rotationOffset")
        targets = [one for one in targets if not _inside(zone, one[0])] + np.stack([along[inside], turned], 1).tolist()
    at, angles = np.array([ends[0], *sorted(targets), ends[1]]).T
    angles, at = np.unwrap(np.radians(angles)), np.interp(at, along, way)
    place = np.interp(way, at, np.arange(len(at)))
    return np.asarray(np.interp(place // 1.0 + (1.0 - np.cos(np.pi * (place % 1.0))) / 2.0, np.arange(len(at)), angles))
