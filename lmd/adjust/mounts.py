"""Mounts: poses of the cameras of a rig on its body, which is the first camera."""

from dataclasses import dataclass

import numpy as np

from lmd.core.checks import FloatArray
from lmd.geometry.se3 import inverse, log, median_pose

# A mount is doubted if at least `FEWEST_FRAMES` frames put the camera farther from it than `OFF_M`, metres, or than
# `OFF_RAD`, rad, which calibrations explain, and than `OFF_SIGMAS` standard deviations.
FEWEST_FRAMES, OFF_M, OFF_RAD, OFF_SIGMAS = 5, 0.05, 0.012, 5.0
OF_MEDIAN = 1.86  # standard deviation of a median of n values, times sqrt(n), over their median absolute deviation


@dataclass(frozen=True)
class Mounts:
    """Poses of C cameras on the body, which is the first camera."""

    poses: FloatArray
    """`(C, 4, 4)` expected poses, camera to body."""
    sigmas: tuple[float, float] | None = None
    """Standard deviations of rotation, rad, and position, metres; None for exact mounts."""

    @property
    def information(self) -> FloatArray:
        """Inverse variances of a twist of each of the C - 1 unknown mounts, `(C - 1, 6)`."""
        assert self.sigmas is not None
        return np.tile(np.repeat(self.sigmas, 3) ** -2.0, (len(self.poses) - 1, 1))

    def off(self, mounts: FloatArray) -> FloatArray:
        """Twists from the expected poses to `mounts` `(C, 4, 4)`, `(C - 1, 6)`."""
        return log(inverse(self.poses[1:]) @ mounts[1:])


def measured_mounts(views: FloatArray, mounts: FloatArray) -> tuple[FloatArray, list[str]]:
    """Mounts by frames in which two cameras show tags, and sentences on cameras that are mounted elsewhere.

    Args:
        views: poses of each camera in each frame by its own images, `(C, F, 4, 4)`; NaN if not known.
        mounts: poses of the cameras on the body, which is the first camera, `(C, 4, 4)`.

    Returns:
        the given mounts, `(C, 4, 4)`, but the measured ones of cameras that are mounted elsewhere.
    """
    found, doubts = mounts.copy(), []
    for camera in range(1, len(mounts)):
        between = inverse(views[0]) @ views[camera]
        between = between[np.isfinite(between[:, 0, 0])]
        if len(between) < FEWEST_FRAMES:
            continue
        middle = median_pose(between)
        spread = np.median(np.abs(log(inverse(middle) @ between)), axis=0) * OF_MEDIAN / np.sqrt(len(between))
        sure_turn, sure_way = OFF_SIGMAS * np.linalg.norm(spread.reshape(2, 3), axis=1)
        off = log(inverse(middle) @ mounts[camera])
        turn, way = np.linalg.norm(off.reshape(2, 3), axis=1)
        if turn > max(OFF_RAD, sure_turn) or way > max(OFF_M, sure_way):
            found[camera] = middle
            by = f"by {len(between)} frames in which camera 1 sees tags, too"
            doubts.append(mount_doubt(camera, off, by))
    return found, doubts


def mount_doubt(camera: int, off: FloatArray, by: str) -> str:
    """Sentence on a camera that is a twist `off` `(6,)` from its mount."""
    turn, way = np.linalg.norm(off.reshape(2, 3), axis=1)
    where = f"camera {camera + 1} is {1e3 * way:.0f} mm and {np.degrees(turn):.3g} degrees from its mount, {by}"
    return f"{where}: is the rig right in sign, unit and order?"
