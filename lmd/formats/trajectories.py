"""Recorded trajectories: a file of recorded poses is converted to poses of the camera in the frame of the room."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields
from functools import cached_property, partial
from typing import Annotated, Any

import numpy as np

from lmd.core.checks import ONE_TURN, Checked, FloatArray, InputError, choice, only_keys, real, said_of, vector
from lmd.formats.pose_files import Rows, read_rows, steep
from lmd.formats.rigs import read_mount
from lmd.geometry.frames import roll_pitch_yaw
from lmd.geometry.se3 import act, pose_of, poses_from_rows, rigid_alignment
from lmd.geometry.trajectory import Trajectory
from lmd.scene.recorded_poses import RecordedPoses
from lmd.scene.rig import OPTICAL
from lmd.space.space import Space, check_file_inside, check_positions

# Rotations from the frame of the camera (x right, y down, z the optical axis) to the frame of the orientations.
FRAMES = {"optical": np.eye(3), "body": OPTICAL}
FEWEST = 3  # minimum number of points that determine the pose of a frame
# Maximum distance between aligned points of two frames, relative to their extent; minimum relative width of their
# triangle.
MISS, THIN = 0.05, 0.02


@dataclass(frozen=True)
class TrajectoryFile(Checked):
    """File of a trajectory, with the settings of its frames.

    Args:
        path: file in a format of `lmd.formats.pose_files`, or a table with the columns time,x,y,z and a rotation. The
            rotation is qx,qy,qz,qw; roll,pitch,yaw of a body in ROS's convention; or yaw_from_y,pitch_up (and
            roll_left) of a camera as in `lmd.geometry.frames.rotation`. In a table with just time,x,y,z,yaw,pitch the
            angles are also those of a camera, unless `frame` is `body`. Units are seconds, metres and radians.
        frame: frame of the orientations: `optical` (x right, y down, z the optical axis) or `body` (x along the optical
            axis, y left, z up; yaw, pitch and roll are then ROS's). Not used with a `mount`.
        align: pose of the recording's frame in the room: [x, y, z, yaw] for a frame with z up, yaw counter-clockwise
            seen from above; or [x, y, z, qx, qy, qz, qw]. Alternatively at least three points: six numbers for each,
            its coordinates in the recording's frame and then in the room's frame.
        mount: pose of the camera on the recorded body: a calibration with extrinsics or {path, name}, see
            `lmd.formats.rigs`; or [x, y, z, yaw, pitch, roll] as in a rig (`lmd.scene.rig`).
        columns: for a text that does not name its columns, names of the columns, or name of a program, see
            `lmd.formats.columns.LAYOUTS`.

    Raises:
        InputError: a value is refused.
    """

    path: str | None
    frame: Annotated[str, partial(choice, options=list(FRAMES))] = "optical"
    align: Sequence[Any] | None = None
    mount: str | Mapping[str, Any] | Sequence[float] | None = None
    columns: str | Sequence[str] | None = None

    @cached_property
    def _read(self) -> tuple[Trajectory, Rows]:
        """Trajectory of the camera in the room's frame; and the rows of the file, with poses as recorded."""
        if self.path is None:
            raise InputError("path is missing: a file of poses is needed.", "path")
        rows = read_rows(self.path, frame=self.frame, columns=self.columns)
        if rows.frame == "optical" and self.frame == "body":
            raise InputError(f"frame must be optical: {self.path} has the poses of a camera.", "frame")
        poses = rows.poses
        if self.mount is not None:
            if rows.angles:  # the angles describe the direction of the x axis
                poses = _turned(poses, FRAMES["body"].T)
            elif rows.frame == "optical":
                raise InputError(f"mount must be left out: {self.path} has the poses of the camera itself.", "mount")
            poses = poses @ _mounted(self.mount)
        else:
            poses = _turned(poses, FRAMES[rows.frame or self.frame])
        if self.align is not None:
            poses = alignment(self.align) @ poses
        with said_of(self.path, "path"):
            return Trajectory(rows.time, poses), rows

    @property
    def trajectory(self) -> Trajectory:
        """Poses of the camera in the room.

        Raises:
            InputError: the file cannot be read, or has no trajectory; the message names the file.
        """
        return self._read[0]

    @property
    def note(self) -> str:
        """Note on omitted rows, assumptions and open questions about the file, or an empty text."""
        return self.note_of("")

    def note_of(self, group: str) -> str:
        """Note about the file for the user, in which `group` precedes names of settings, as in `trajectory.align`."""
        notes = (*self._read[1].notes, self._doubt(group))
        return "; ".join(filter(None, notes))

    def _doubt(self, group: str) -> str:
        """Question to the user if nearly all views look up or down; else "".

        `group` precedes names of settings, as in `trajectory.align`.
        """
        trajectory, rows = self._read
        if rows.angles or not (said := steep(trajectory.poses[:, 2, 2], self.path)):
            return ""
        cures = ["align (for a recording whose z does not point up)"]
        if self.mount is not None or rows.frame == "body" or self.frame == "body":
            cures.insert(0, "mount (for a camera that does not look ahead on the body)")
        elif rows.frame is None:
            cures.insert(0, "frame=body (for poses of a body with x ahead and z up)")
        return f"{said} If not, give {' or '.join(f'{group}{cure}' for cure in cures)}"

    def check_inside(self, room: Space, check: Callable[[Trajectory, Space], None] = check_positions) -> Trajectory:
        """Return the trajectory if it is inside a room.

        Args:
            check: function that raises `InputError` if the trajectory leaves the room, see `lmd.space.space`.

        Raises:
            InputError: the trajectory leaves the room; the message states the distance, and gives advice.
        """
        check_file_inside(self.path, self.trajectory, room, check)
        return self.trajectory


def read_recorded_poses(path: str | None, group: str = "", **more: Any) -> RecordedPoses:
    """Read recorded poses from a file.

    Args:
        path: path of the file, in a format that `TrajectoryFile` supports.
        group: prefix of the names of settings in the note for the user, such as `trajectory.`.
        more: other arguments of `TrajectoryFile` and of `RecordedPoses`.

    Raises:
        InputError: a value is refused, or the file is not a trajectory.
    """
    own = {field.name for field in fields(TrajectoryFile)}
    file = TrajectoryFile(path, **{name: value for name, value in more.items() if name in own})
    others = {name: value for name, value in more.items() if name not in own}
    return RecordedPoses(file.trajectory, path=path, note=file.note_of(group), **others)


def alignment(align: Sequence[Any]) -> FloatArray:
    """Transform from the frame of a recording to the frame of a room, `(4, 4)`.

    Args:
        align: pose or points in one of the forms of `TrajectoryFile.align`: [x, y, z, yaw], [x, y, z, qx, qy, qz, qw],
            or three or more points of six numbers.

    Raises:
        InputError: `align` has none of the forms, or its points are collinear or not related by a rigid motion.
    """
    if isinstance(align, str | Mapping) or not hasattr(align, "__len__"):
        raise InputError(f"align must be a list, got {align!r}.", "align")
    if len(align) and not isinstance(align[0], str) and hasattr(align[0], "__len__"):
        return _fitted(np.array([vector(f"align[{i}]", row, 6) for i, row in enumerate(align)]))
    if len(align) == 4:
        x, y, z, yaw = vector("align", align, 4)
        if abs(yaw) > ONE_TURN:
            raise InputError(f"align: yaw must be in radians, at most one turn from zero, got {yaw:g}.", "align")
        return pose_of(roll_pitch_yaw([0.0, 0.0, yaw]), np.array([x, y, z]))
    if len(align) == 7:
        try:
            return np.asarray(poses_from_rows(np.array([vector("align", align, 7)]))[0])
        except InputError as error:
            raise InputError(f"align: {str(error).removeprefix('frame 0: ')}", "align") from None
    raise InputError(
        "align must be [x, y, z, yaw], [x, y, z, qx, qy, qz, qw], or three or more points of six numbers, "
        f"got {len(align)} numbers.",
        "align",
    )


def _fitted(points: FloatArray) -> FloatArray:
    """Rigid motion `(4, 4)` fitted to N pairs of points; it maps the first point of each pair to the second.

    Args:
        points: the pairs, `(N, 6)`: first and second point in each row, metres.

    Raises:
        InputError: the pairs do not determine the motion, or do not agree on it.
    """
    if len(points) < FEWEST:
        raise InputError(f"align must have at least {FEWEST} points, got {len(points)}.", "align")
    own, room = points[:, :3], points[:, 3:]
    for name, side in (("the recording's frame", own), ("the room's frame", room)):
        spread = np.linalg.svd(side - side.mean(axis=0), compute_uv=False)
        if spread[1] <= THIN * spread[0]:
            raise InputError(f"align: its points are collinear in {name}: add a point off their line.", "align")
    motion = rigid_alignment(own, room)
    missed = np.linalg.norm(act(motion, own) - room, axis=1)
    worst, extent = int(np.argmax(missed)), float(np.linalg.norm(room - room.mean(axis=0), axis=1).max())
    if missed[worst] > MISS * extent:
        raise InputError(
            f"align: its points in the two frames do not match: after the best fit, align[{worst}] is "
            f"{missed[worst]:.3g} m off.",
            "align",
        )
    return motion


def _mounted(mount: str | Mapping[str, Any] | Sequence[float]) -> FloatArray:
    """Pose of the camera (x right, y down, z the optical axis) on the recorded body, `(4, 4)`.

    `mount` is a calibration with extrinsics, a mapping {path, name}, or [x, y, z, yaw, pitch, roll].
    """
    if isinstance(mount, str):
        return read_mount(mount)
    if isinstance(mount, Mapping):
        only_keys("mount", mount, ("path", "name"))
        return read_mount(mount.get("path"), mount.get("name"))
    x, y, z, yaw, pitch, roll = vector("mount", mount, 6)
    for name, angle in (("yaw", yaw), ("pitch", pitch), ("roll", roll)):
        real(f"mount: {name} in radians,", angle, low=-ONE_TURN, high=ONE_TURN)
    return pose_of(roll_pitch_yaw([roll, pitch, yaw]) @ FRAMES["body"], np.array([x, y, z]))


def _turned(poses: FloatArray, turn: FloatArray) -> FloatArray:
    return pose_of(poses[:, :3, :3] @ turn, poses[:, :3, 3])
