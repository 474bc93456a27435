"""Checks that a camera that moves stays inside a room."""

from collections.abc import Callable

import numpy as np

from lmd.core.checks import InputError
from lmd.geometry.trajectory import Trajectory
from lmd.space.space import Space


def check_positions(trajectory: Trajectory, room: Space) -> None:
    """Raise `InputError` if the camera leaves the closed room, or is inside something that stands in it."""
    positions = trajectory.poses[:, :3, 3]
    outside = np.flatnonzero(~room.contains(positions))
    if outside.size:
        x, y, z = positions[outside[0]]
        low, high = room.bounds()
        beyond = np.linalg.norm(np.maximum(np.maximum(low - positions, positions - high), 0.0), axis=1).max()
        far = f", up to {beyond:.3g} m beyond it" if beyond > 0.0 else ""
        more = f"; so are {outside.size} of {len(positions)} poses{far}" if outside.size > 1 or far else ""
        raise InputError(
            f"the camera at {trajectory.time[outside[0]]:.16g} s, ({x:.9g}, {y:.9g}, {z:.9g}), is outside the "
            f"{room.describe()}{more}."
        )


def check_inside(trajectory: Trajectory, room: Space) -> None:
    """Raise `InputError` as `check_positions`, or if it goes through something that stands in the room."""
    check_positions(trajectory, room)
    positions = trajectory.poses[:, :3, 3]
    through = np.flatnonzero(~room.clear(positions[:-1], positions[1:]))
    if through.size:
        x, y, z = positions[through[0]]
        raise InputError(
            f"the camera goes straight on from ({x:.9g}, {y:.9g}, {z:.9g}) at {trajectory.time[through[0]]:.16g} s, "
            f"through something that stands in the {room.describe()}."
        )


def check_file_inside(
    path: str | None, trajectory: Trajectory, room: Space, check: Callable[[Trajectory, Space], None] = check_positions
) -> None:
    """Raise `InputError` about the file `path` of a trajectory that does not pass a check of this module.

    The message names `align` where most of the trajectory is outside: the file may have a frame of its own.
    """
    try:
        check(trajectory, room)
    except InputError as error:
        lost = ~room.contains(trajectory.poses[:, :3, 3])
        hint = " If it has a frame of its own, align says where that is in the room." if lost.mean() > 0.5 else ""
        raise InputError(f"path: {path}: {error}{hint}", "path") from None
