"""Reference of filtered poses in NumPy; compiled code must equal it bit for bit."""

import numpy as np

from lmd.core.checks import FloatArray
from lmd.objectives.filtered.covariance import NUMBERS, predicted, update_beyond_rounding, updated
from lmd.objectives.filtered.drives import Drives
from lmd.objectives.filtered.evaluation import FilteredPoses, FrameInformation
from lmd.objectives.filtered.lanes import Tolerance, is_known
from lmd.objectives.localisation.body import about_body
from lmd.objectives.localisation.information import NUMBERS as CAMERA_NUMBERS
from lmd.objectives.localisation.information import Precision
from lmd.objectives.localisation.reference import information_of
from lmd.scene.deployment import Deployment
from lmd.scene.scene import Scene


def reference_information(
    scene: Scene, deployment: Deployment, asked: Precision, n: int, drives: Drives
) -> FrameInformation:
    """Information of each frame, frame by frame, by the reference of localisation."""
    sums, informed = np.zeros((len(drives.positions), NUMBERS)), np.zeros(len(drives.positions), dtype=np.bool_)
    for f, (position, axes) in enumerate(zip(drives.positions, drives.axes, strict=True)):
        numbers, covered = information_of(scene, deployment, asked, position, axes[None])
        if scene.rig is None:
            sums[f] = about_body(tuple(numbers[:CAMERA_NUMBERS, 0]), (0.0, 0.0, 0.0))
        else:
            sums[f] = numbers[:NUMBERS, 0]
        informed[f] = covered.sum() >= n
    return FrameInformation(sums, informed)


def reference_filter(drives: Drives, information: FrameInformation, tolerance: Tolerance) -> FilteredPoses:
    """Filter all drives; each step is done for all drives that are still under way."""
    known, kept = np.zeros(len(information.sums), dtype=np.bool_), np.zeros_like(information.sums)
    p: FloatArray = np.repeat(drives.start[:, None], len(drives), axis=1)
    for step in range(int(np.diff(drives.first).max())):
        under_way = np.flatnonzero(drives.first[:-1] + step < drives.first[1:])
        frames = drives.first[under_way] + step
        x, y, z, *noise = drives.moves[frames].T
        before = np.stack(predicted(tuple(p[:, under_way]), (x, y, z), *noise))
        sums, after = np.ascontiguousarray(information.sums[frames].T), before.copy()
        if tolerance.least is None:
            after = np.stack(updated(tuple(before), tuple(sums), tolerance.scale))
        else:
            for d in range(len(frames)):
                flat, limits = (after.reshape(-1), sums.reshape(-1)), (tolerance.scale, tolerance.least)
                update_beyond_rounding(*flat, d, len(frames), *limits, np.empty((3, 6, 6)))
        p[:, under_way] = np.where(information.informed[frames], after, before)
        known[frames], kept[frames] = is_known(p[:, under_way], tolerance), p[:, under_way].T
    return FilteredPoses(known, kept)
