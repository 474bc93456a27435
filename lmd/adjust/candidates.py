"""Candidate poses of frames and tags from single sightings, and measured poses of cameras on the body.

A sighting is one tag in one image. A sighting proposes poses of the frame if the tag has a pose, or of the tag if the
frame has one. Two poses of a tag in front of a camera have similar images (IPPE), so each sighting proposes two poses.

Source: Collins and Bartoli, "Infinitesimal Plane-Based Pose Estimation".
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from lmd.adjust.corners import Poses, Reprojection, agreeing, newton_step, sums_by
from lmd.adjust.links import turn_twist
from lmd.adjust.sightings import Sightings
from lmd.core.checks import FloatArray, InputError, IntArray
from lmd.core.optional import optional
from lmd.geometry.se3 import exp, inverse, log, median_pose, pose_of

ASSUMED_PIXELS = 0.3  # pixels, added in quadrature to the detector's standard deviation to weigh the two poses
# Maximum numbers, for a frame or tag, of sightings that propose poses, of sightings that judge poses (the largest
# sightings are used), and of poses that are refined.
PROPOSING, JUDGING, REFINED = 8, 60, 3
REFINING_STEPS, WIDE, NARROW = 12, 40.0, 3.0  # Gauss-Newton steps; first and last scale of the loss, pixels
DAMPING = 1e-6
# A mount is measured if at least `FEWEST_FRAMES` frames put the camera farther from it than `OFF_M`, metres, or than
# `OFF_RAD`, rad, which calibrations explain, and than `OFF_SIGMAS` standard deviations.
FEWEST_FRAMES, OFF_M, OFF_RAD, OFF_SIGMAS = 5, 0.05, 0.012, 5.0
OF_MEDIAN = 1.86  # for n values: standard deviation of the median, times sqrt(n), over the median absolute deviation


class SinglePoses(NamedTuple):
    """For each sighting, two poses of its tag in the frame of the camera."""

    poses: FloatArray
    """`(N, 2, 4, 4)` poses, the better pose first."""
    odds: FloatArray
    """`(N,)` logarithm of the likelihood ratio between the better and the worse pose."""


def single_poses(sightings: Sightings) -> SinglePoses:
    """Two poses of each sighting's tag in the frame of the camera, by IPPE. IPPE is applied to the image of a virtual
    pinhole camera that is turned towards the tag.

    Raises:
        InputError: the corners of a tag are not in order around the tag.
    """
    cv2 = optional("cv2", "estimators")
    axis = sightings.directions.mean(axis=1)
    axis /= np.linalg.norm(axis, axis=1, keepdims=True)
    side = np.cross(np.where(np.abs(axis[:, 1:2]) < 0.9, [[0.0, 1.0, 0.0]], [[1.0, 0.0, 0.0]]), axis)
    side /= np.linalg.norm(side, axis=1, keepdims=True)
    turned = np.stack([side, np.cross(axis, side), axis], axis=1)  # rotation from the camera to the turned camera
    rays = sightings.directions @ np.swapaxes(turned, 1, 2)
    flat = rays[..., :2] / rays[..., 2:]
    turns, ways = np.empty((2, len(sightings), 2, 3))
    for index, (corners, image) in enumerate(zip(sightings.corners, flat, strict=True)):
        _, turn, way, _ = cv2.solvePnPGeneric(corners, image, np.eye(3), None, flags=cv2.SOLVEPNP_IPPE_SQUARE)
        if not turn:
            tag = f"tag {sightings.ids[sightings.tag[index]]}"
            raise InputError(
                f"detections: the corners of {tag} do not form a square; list them in order around the tag.",
                "detections",
            )
        turns[index], ways[index] = (np.reshape([each[0], each[-1]], (2, 3)) for each in (turn, way))
    found = pose_of(exp(turn_twist(turns))[..., :3, :3], ways)
    poses = pose_of(np.swapaxes(turned, 1, 2), np.zeros(3))[:, None] @ found
    still = np.broadcast_to(np.eye(4), (len(sightings), 4, 4))
    error = np.stack([Reprojection(sightings, poses[:, which], still, still).squared for which in range(2)], axis=1)
    poses = np.take_along_axis(poses, np.argsort(error, axis=1)[..., None, None], axis=1)
    gap = np.diff(np.sort(error, axis=1), axis=1)[:, 0]
    return SinglePoses(poses, gap / (2.0 * sightings.variance(ASSUMED_PIXELS)))


class Candidates:
    """Candidate poses for *owners*: either frames whose tags have poses, or tags whose frames have poses. A sighting
    belongs to one owner, its frame or its tag.

    Args:
        some: the sightings with which candidates are compared.
        poses: known poses of tags and frames, and poses of the cameras on the body (mounts).
        by_frame: True if owners are frames, False if they are tags.
    """

    def __init__(self, some: Sightings, poses: Poses, by_frame: bool) -> None:
        self.some, self.by_frame = some, by_frame
        self._tags, self._frames, self._mounts = poses.of(some)
        owner = some.frame if by_frame else some.tag
        self.owners, self.owner, self.counts = np.unique(owner, return_inverse=True, return_counts=True)
        self._order, self._begins = np.argsort(self.owner, kind="stable"), np.cumsum(self.counts) - self.counts

    def _judges(self, owner: IntArray) -> tuple[Sightings, IntArray, Callable[[FloatArray], Reprojection]]:
        """Pair each of P candidate poses with all sightings of its owner (frame or tag). `owner` `(P,)` is the index of
        each candidate's owner.

        Returns:
            sightings of the owners, those of one candidate after another; index of each sighting's candidate; function
            that computes the sightings' reprojection from the candidate poses `(P, 4, 4)`.
        """
        pose = np.repeat(np.arange(len(owner)), self.counts[owner])
        pairs = self._order[self._begins[owner[pose]] + rank_within(pose)]
        some, tags, frames, mounts = self.some.of(pairs), self._tags[pairs], self._frames[pairs], self._mounts[pairs]

        def at(poses: FloatArray) -> Reprojection:
            own = poses[pose]
            return Reprojection(some, tags if self.by_frame else own, own if self.by_frame else frames, mounts)

        return some, pose, at

    def agreed(self, poses: FloatArray) -> FloatArray:
        """Number of sightings of each owner (frame or tag) that agree with the owner's pose, `(M,)`. `poses`
        `(M, 4, 4)` has one pose for each of the M owners.
        """
        some, pose, at = self._judges(np.arange(len(self.owners)))
        return np.asarray(np.bincount(pose, agreeing(some, at(poses).squared), minlength=len(self.owners)))

    def best(self, poses: FloatArray, owner: IntArray, count: int) -> IntArray:
        """Choose, for each owner (frame or tag), the `count` candidate poses with the least robust losses. `poses`
        `(P, 4, 4)` has the candidates of all owners, and `owner` `(P,)` the index of each candidate's owner. Returns
        indices of the chosen candidates, sorted by owner, then by loss.
        """
        _, pose, at = self._judges(owner)
        losses = np.bincount(pose, np.log1p(at(poses).squared / (4.0 * NARROW**2)), minlength=len(poses))
        order = np.lexsort((losses, owner))
        return np.asarray(order[rank_within(owner[order]) < count])

    def proposals(self, single: FloatArray) -> tuple[FloatArray, IntArray]:
        """Candidate poses of all owners (frames or tags), `(P, 4, 4)`, and the owner of each candidate, `(P,)`. For
        each owner, the sightings that are largest in the image propose poses. The best of these poses are refined by
        Gauss-Newton steps with robust losses of decreasing scale.

        Args:
            single: two poses of each sighting's tag in the frame of the camera, `(N, 2, 4, 4)`.
        """
        some = np.flatnonzero(rank(self.some, self.owner) < PROPOSING)
        owner, mounts = np.repeat(self.owner[some], 2), self._mounts[some, None]
        if self.by_frame:
            poses = self._tags[some, None] @ inverse(single[some]) @ inverse(mounts)
        else:
            poses = self._frames[some, None] @ mounts @ single[some]
        best = self.best(poses.reshape(-1, 4, 4), owner, REFINED)
        poses, owner = poses.reshape(-1, 4, 4)[best], owner[best]
        _, pose, at = self._judges(owner)
        summed = sums_by(pose, len(poses))
        for scale in np.geomspace(WIDE, NARROW, REFINING_STEPS):
            here = at(poses)
            weight = 1.0 / (1.0 + (here.error**2).mean(axis=1) / scale**2)
            jacobian = here.by_frame if self.by_frame else here.by_tag
            poses = np.asarray(poses @ exp(newton_step(jacobian, here.error, weight, summed, DAMPING * np.eye(6))[0]))
        return poses, owner


def place(
    some: Sightings, single: FloatArray, poses: Poses, by_frame: bool, fewest: int, share: float
) -> tuple[IntArray, FloatArray]:
    """Estimate poses of frames from tags with poses, or of tags from frames with poses. The present poses of these
    frames or tags are candidates as well.

    Args:
        some: sightings.
        single: two poses of each sighting's tag in the frame of the camera, `(N, 2, 4, 4)`.
        poses: present poses.
        by_frame: True to place frames, False to place tags.
        fewest: minimum number of a frame's or tag's sightings that must agree with its pose.
        share: minimum fraction of these sightings that must agree.

    Returns:
        indices `(m,)` and poses `(m, 4, 4)` of the frames or tags that are placed.
    """
    judging = np.flatnonzero(rank(some, some.frame if by_frame else some.tag) < JUDGING)
    if not judging.size:
        return np.empty(0, dtype=np.int64), np.empty((0, 4, 4))
    trial = Candidates(some.of(judging), poses, by_frame)
    found, owner = trial.proposals(single[judging])
    present = (poses.frames if by_frame else poses.tags)[trial.owners]
    own = np.flatnonzero(np.isfinite(present[:, 0, 0]))
    found, owner = np.concatenate([found, present[own]]), np.concatenate([owner, own])
    found = found[trial.best(found, owner, 1)]
    agreed = trial.agreed(found)
    enough = (agreed >= fewest) & (agreed >= share * trial.counts)
    return trial.owners[enough], found[enough]


def placed_tags(some: Sightings, poses: Poses, fewest: int, share: float) -> FloatArray:
    """Poses of tags, estimated from the sightings `some` with all frames fixed, `(K, 4, 4)`. NaN for a tag if fewer
    than `fewest` of its sightings, or a smaller fraction than `share`, agree with the pose.
    """
    nowhere = np.full((len(some.ids), 4, 4), np.nan)
    some = some.of(poses.known_frames[some.frame])
    around = Poses(nowhere, poses.frames, poses.mounts)
    tags, found = place(some, single_poses(some).poses, around, False, fewest, share)
    nowhere[tags] = found
    return nowhere


def rank(sightings: Sightings, owner: IntArray) -> IntArray:
    """Rank of each sighting by its size in the image among the sightings of its owner, `(N,)`: 0 for the largest.
    `owner` `(N,)` is the index of the frame or tag to which each sighting belongs.
    """
    order = np.lexsort((-sightings.sizes, owner))
    result = np.empty(len(sightings), dtype=np.int64)
    result[order] = rank_within(owner[order])
    return result


def rank_within(owner: IntArray) -> IntArray:
    """For each entry of the sorted array `owner`, the number of entries before it that have the same value."""
    return np.asarray(np.arange(len(owner)) - np.searchsorted(owner, owner))


def measured_mounts(views: FloatArray, mounts: FloatArray) -> FloatArray:
    """Poses of the cameras on the body, `(C, 4, 4)`: measured for a camera if images contradict its given pose, else as
    given. A camera is measured from the frames in which both this camera and the first camera show tags.

    Args:
        views: pose of each camera in the world at each frame, estimated from the camera's own images, `(C, F, 4, 4)`;
            NaN if not known.
        mounts: given poses of the cameras on the body, `(C, 4, 4)`; the first camera is the body.
    """
    found = mounts.copy()
    for camera in range(1, len(mounts)):
        between = inverse(views[0]) @ views[camera]
        between = between[np.isfinite(between[:, 0, 0])]
        if len(between) < FEWEST_FRAMES:
            continue
        middle = median_pose(between)
        spread = np.median(np.abs(log(inverse(middle) @ between)), axis=0) * OF_MEDIAN / np.sqrt(len(between))
        sure, off = OFF_SIGMAS * spread.reshape(2, 3), log(inverse(middle) @ mounts[camera])
        least = np.maximum((OFF_RAD, OFF_M), np.linalg.norm(sure, axis=1))
        if (np.linalg.norm(off.reshape(2, 3), axis=1) > least).any():
            found[camera] = middle
    return found
