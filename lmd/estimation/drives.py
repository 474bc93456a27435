"""Drives (motions of the camera) for the objective `lmd.objectives.filtered`, the fraction of the time in which a
Kalman filter knows the pose. Drives are cut from recordings, or drawn from a source of trajectories.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from lmd.core.checks import InputError, integer, real, seed_number
from lmd.core.memory import check_memory
from lmd.estimation.flights import TrajectorySource
from lmd.estimation.recording import Odometry
from lmd.geometry.trajectory import Trajectory
from lmd.objectives.filtered import Drives, Filtered
from lmd.scene.scene import Scene
from lmd.space.changed import DrivenRoom, RecordedRoom

DRIVES_STREAM = 0x647269  # key that separates the random numbers of drives from other uses of a seed
FRAME_BYTES = 1000  # memory of a frame of a drive
FRESH_STREAM = 0x667265  # as `DRIVES_STREAM`, for the held-out drives of the validation


def filtered(
    scene: Scene,
    trajectory: TrajectorySource,
    odometry: Odometry,
    drives: int,
    fresh: int,
    seed: int,
    block: float,
    held_out: int,
    start_position: float,
    start_attitude: float,
    **settings: object,
) -> tuple[Filtered, Scene]:
    """Make the objective `Filtered` for drives, and a scene whose camera positions are those of the drives' frames.

    The scene is otherwise a copy of `scene`. A source of random trajectories provides `drives` drives for the
    objective, and `fresh` further drives for the validation. A recording, of the scene or from a file, is cut into
    drives of `block` seconds, and every `held_out`-th drive is kept for the validation.

    Args:
        scene: room, camera and orientations.
        trajectory: source of the drives; unused if the scene has a recording.
        odometry: errors of the odometry.
        drives, fresh: number of random drives for the objective, and number of further drives for the validation.
        seed: seed of the drives.
        block: length of a drive of a recording, seconds.
        held_out: every `held_out`-th drive of a recording is kept for the validation, at least 2.
        start_position, start_attitude: standard deviations of the initial position along each axis, metres, and of the
            initial attitude about each axis, rad.
        settings: further arguments of `Filtered`.

    Raises:
        InputError: a value is out of range, or the recording gives no drive.
    """
    if not callable(getattr(trajectory, "draw", None)):
        raise InputError(f"trajectory must be a source of trajectories, got {trajectory!r}.", "trajectory")
    if not isinstance(odometry, Odometry):
        raise InputError(f"odometry must be Odometry, got {odometry!r}.", "odometry")
    if scene.crowd is not None:
        raise InputError("an objective along drives cannot have a crowd: leave the crowd out.")
    count, others = integer("drives", drives, low=1), integer("fresh", fresh, low=0)
    every, length = integer("held_out", held_out, low=2), real("block", block, above=0.0)
    if scene.recorded is not None:
        room, parts = scene.room, cut(scene.recorded.trajectory, length)
        if isinstance(room, RecordedRoom):  # it would count the recorded time twice
            room = room.original
        chosen, kept = _divided(parts, every)
    else:
        room, start = scene.room, seed_number(seed)
        first = _draw(scene, trajectory, [start, DRIVES_STREAM], 2)
        if np.array_equal(first[0].poses, first[1].poses):
            chosen, kept = _divided(cut(first[0], length), every)
        else:
            for name, number in (("drives", count), ("fresh", others)):
                needed = FRAME_BYTES * number * len(first[0].time)
                check_memory(needed, f"{name} = {number} drives of {len(first[0].time)} frames", name)
            chosen = _draw(scene, trajectory, [start, DRIVES_STREAM], count)
            kept = _draw(scene, trajectory, [start, FRESH_STREAM], others)

    def driven(trajectories: Sequence[Trajectory]) -> Drives:
        noise = odometry.turn_noise, odometry.motion_noise
        return Drives(trajectories, *noise, start_position, start_attitude)

    along = driven(chosen)
    objective = Filtered(drives=along, fresh=driven(kept) if kept else None, **settings)  # type: ignore[arg-type]
    return objective, replace(scene, room=DrivenRoom(room, along.positions, along.seconds), recorded=None)


def _draw(scene: Scene, source: TrajectorySource, seed: Sequence[int], count: int) -> list[Trajectory]:
    """Draw `count` random trajectories. A greater `count` appends further trajectories and does not change the first
    ones.
    """
    return [source.draw(scene, np.random.default_rng([*seed, i])) for i in range(count)]


def cut(trajectory: Trajectory, seconds: float) -> list[Trajectory]:
    """Cut a trajectory into parts with a duration of `seconds` each; a part of fewer than two frames is left out.

    Raises:
        InputError: a part is shorter than the time between two frames.
    """
    if seconds < np.diff(trajectory.time).max():
        raise InputError(f"block = {seconds:g} s is shorter than the time between two frames.", "block")
    part = np.floor((trajectory.time - trajectory.time[0]) / seconds).astype(np.int64)
    rows = [np.flatnonzero(part == p) for p in np.unique(part)]
    return [Trajectory(trajectory.time[row], trajectory.poses[row]) for row in rows if len(row) > 1]


def _divided(parts: Sequence[Trajectory], every: int) -> tuple[list[Trajectory], list[Trajectory]]:
    """Divide the drives of a recording into drives for the objective, and held-out drives for the validation; return
    both lists. Every `every`-th drive is held out. Raises `InputError` if there are fewer than `every` drives.
    """
    kept = [part for i, part in enumerate(parts) if i % every == every - 1]
    if not kept:
        raise InputError(
            f"block: held_out = {every} needs {every} drives, but the recording gives {len(parts)}: shorten blocks.",
            "block",
        )
    return [part for i, part in enumerate(parts) if i % every != every - 1], kept
