"""Initialisation: rough poses of tags and frames are found one after the other.

A single tag has two poses in front of a camera that look alike (IPPE). Often one of the two is far likelier; the pose
of the tag is then *beyond doubt*. A group of tags begins with the frame that shows the most tags whose pose is beyond
doubt. Tags and frames are *placed* when they get a pose. Two steps alternate: frames that show two or more placed tags
are placed, and tags that placed frames show are placed. The sightings of a frame or tag propose poses. The likeliest
pose is refined, and is accepted if enough sightings agree with it.

When no frame or tag can be placed this way, the likeliest single sighting places a tag or frame. At the end all tags
and frames with large errors are tried again. Placed tags and frames are adjusted as their number grows. Tags that no
frame connects with the group begin another group, in a world of its own.

With a plan, initialisation starts with the tags at their planned poses, and is accepted if nearly all sightings agree
with the poses. As detectors may number the corners from another corner, initialisation with a plan is tried with each
of the four quarter turns of all planned tags.
"""

from typing import NamedTuple

import numpy as np

from lmd.adjust.adjustment import Adjustment
from lmd.adjust.candidates import SinglePoses, place, single_poses
from lmd.adjust.corners import Poses, agreeing, squared_errors
from lmd.adjust.estimate import FLOOR_PIXELS
from lmd.adjust.prior import Prior
from lmd.adjust.sightings import QUARTERS, Sightings
from lmd.core.checks import BoolArray, FloatArray, InputError, IntArray
from lmd.geometry.se3 import inverse, median_pose
from lmd.survey.groups import join_groups
from lmd.survey.world import into_world

# Minimum log-likelihood ratio of the two poses of a sighting for the better pose to be beyond doubt, and to be likely.
BEYOND_DOUBT, LIKELY = 6.0, 1.5
FEWEST, LEAST_SHARE = 2, 0.3  # minimum number, and share, of sightings that must agree
# A tag or frame is tried again if the share `DISPUTED` of its sightings has squared errors above `MUCH_WORSE` medians.
DISPUTED, MUCH_WORSE = 0.2, 25.0
STEPS, FINAL_STEPS = 3, 8  # steps of bundle adjustment between placements, and after the last placement
GROWN = 1.2  # growth factor of the number of placed tags and frames after which all are adjusted again
AS_PLANNED = 0.97  # minimum share of sightings that must agree with an initialisation from the plan
ANCHOR_SIGMA = 1e-4  # prior standard deviation of the first tag of a group, metres and rad


class Start(NamedTuple):
    """Initial poses for the bundle adjustment."""

    poses: Poses
    """Rough poses, with each camera as a body of its own, see `Sightings.with_separate_cameras`."""
    group: IntArray
    """Group of each tag, `(K,)`; -1 for tags that are not placed. Each group has a world frame of its own."""
    agreed: int
    """Number of sightings that agree with the poses."""


def initialise(sightings: Sightings, prior: Prior) -> Start:
    """Find initial poses of tags and frames; each group of tags that images connect has a world frame of its own.

    Raises:
        InputError: no two tags were seen together.
    """
    apart = sightings.with_separate_cameras()
    # Mounts are found from frames that two cameras have, so frames of rigs must be placed even by single sightings.
    is_linked = prior.motion is not None and sightings.cameras == 1
    placed = place_all(apart, np.where(prior.is_posed[:, None, None], prior.tags, np.nan), is_linked)
    if prior.motion is None:
        _check_groups(placed.group)
    return Start(placed.poses, placed.group, placed.agreed())


def in_one_world(sightings: Sightings, start: Start, prior: Prior, origin: int | None) -> tuple[Poses, IntArray, Prior]:
    """Move initial poses into one world frame, which the prior of the tags defines. If the prior has a motion model,
    the motion between frames first joins groups of tags that no image connects.

    Args:
        sightings: sightings of the tags.
        start: initial poses, as `initialise` returns.
        prior: prior of the tags, and motion between frames, if any.
        origin: id of the tag whose frame is the world if no tag has a prior; None for the tag seen most often.

    Returns:
        initial poses with one body for all cameras; index of each tag's group, `(K,)`; prior with the estimated noise
        (spread) of the motion model. Tags of group 0 are in the prior's world frame. Each other group (1, 2, ...) keeps
        a world frame of its own. The index is -1 for tags without a pose.

    Raises:
        InputError: no tag has a pose, the prior determines no world frame, or a camera has no pose at any frame at
            which an earlier camera has one.
    """
    poses, group = _mounted(sightings, start.poses), start.group
    if prior.motion is not None:
        poses, group, prior = join_groups(sightings, poses, group, prior)
        _check_groups(group)
    return into_world(sightings, poses, group, prior, origin)


def _check_groups(group: IntArray) -> None:
    """Raise `InputError` if no tag has a group."""
    if group.max(initial=-1) < 0:
        raise InputError("detections have no frame with two tags, at least one with an unambiguous pose.", "detections")


def _mounted(sightings: Sightings, apart: Poses) -> Poses:
    """Poses with one body for all cameras, from poses that were found with each camera as a separate body.

    Args:
        sightings: sightings of the body.
        apart: poses of tags, and of each camera at each frame, found with `sightings.with_separate_cameras()`.

    Raises:
        InputError: a camera has no pose at any frame at which an earlier camera has one.
    """
    views = apart.frames.reshape(sightings.cameras, sightings.frames, 4, 4)
    found, frames = np.tile(np.eye(4), (sightings.cameras, 1, 1)), views[0].copy()
    for camera in range(1, sightings.cameras):
        there, here = np.isfinite(views[camera, :, 0, 0]), np.isfinite(frames[:, 0, 0])
        if not (both := there & here).any():
            raise InputError(f"detections have no frame that gives the mount of camera {camera + 1}.", "detections")
        found[camera] = median_pose(inverse(frames[both]) @ views[camera, both])
        frames[there & ~here] = views[camera, there & ~here] @ inverse(found[camera])
    return Poses(apart.tags, frames, found)


class Placing:
    """Process that gives poses to (*places*) tags and frames one after the other.

    Args:
        sightings: sightings of one camera, see `Sightings.with_separate_cameras`.
        single: two poses of each sighting's tag in the frame of the camera.
        is_linked: True if frames are linked by motion; a single sighting then places no tag or frame.
    """

    def __init__(self, sightings: Sightings, single: SinglePoses, is_linked: bool) -> None:
        self.sightings, self.single, self.is_linked = sightings, single, is_linked
        self.tags = np.full((len(sightings.ids), 4, 4), np.nan)
        self.frames = np.full((sightings.frames, 4, 4), np.nan)
        self.group = np.full(len(sightings.ids), -1)

    @property
    def poses(self) -> Poses:
        """Poses of tags and frames."""
        return Poses(self.tags, self.frames, np.eye(4)[None])

    @property
    def _placed(self) -> tuple[BoolArray, BoolArray]:
        """Masks of the sightings whose tag is placed (has a pose), and of those whose frame is placed, `(N,)` each."""
        return self.poses.known_tags[self.sightings.tag], self.poses.known_frames[self.sightings.frame]

    def _count(self) -> int:
        """Number of placed frames and tags."""
        return int(self.poses.known_frames.sum() + self.poses.known_tags.sum())

    def agreed(self) -> int:
        """Number of sightings that agree with the poses of their tags and frames."""
        return int(agreeing(self.sightings, squared_errors(self.sightings, self.poses)).sum())

    def fill(self) -> None:
        """Place all tags and frames that can be placed."""
        begun = bool(self._count())
        while begun or self._seed():
            begun, adjusted = False, 0
            while self._grow() or (not self.is_linked and self._risk()):
                if self._count() > GROWN * adjusted:  # adjusting each time would be quadratic in the number of frames
                    self._adjust(STEPS)
                    adjusted = self._count()
            for _ in range(2):
                self._retry()
                self._adjust(FINAL_STEPS)

    def _seed(self) -> bool:
        """Begin a new group of tags with one frame, and place its tags whose pose is beyond doubt. The frame is that
        with most such tags; tags that are large in the image count more. Return False if there is no such frame.
        """
        sightings, (tag, frame) = self.sightings, self._placed
        fresh = ~tag & ~frame
        usable = np.flatnonzero(fresh & (self.single.odds > BEYOND_DOUBT))
        value = np.bincount(sightings.frame[usable], np.sqrt(sightings.sizes[usable]), minlength=sightings.frames)
        value *= np.bincount(sightings.frame[fresh], minlength=sightings.frames) > 1
        if not value.any():
            return False
        best = int(np.argmax(value))
        own = usable[sightings.frame[usable] == best]
        self.frames[best] = np.eye(4)
        self.tags[sightings.tag[own]], self.group[sightings.tag[own]] = self.single.poses[own, 0], self.group.max() + 1
        return True

    def _grow(self) -> bool:
        """Place frames, then tags, where several sightings agree on a pose. Return False if nothing is placed."""
        placed = [self.place(self.waiting(by_frame), by_frame) for by_frame in (True, False)]
        return any(placed)

    def _risk(self) -> bool:
        """Place one tag, or else one frame, by the single sighting whose better pose is most certain. Return False if
        no sighting is certain enough.
        """
        for by_frame in (False, True):
            waiting = self.waiting(by_frame)
            best = waiting[np.argsort(-self.single.odds[waiting], kind="stable")][:1]
            if (self.single.odds[best] > LIKELY).any() and self.place(best, by_frame, fewest=1):
                return True
        return False

    def waiting(self, by_frame: bool) -> IntArray:
        """Indices of the sightings from which a frame or a tag could be placed.

        If `by_frame`, these are sightings of placed tags in frames that are not placed; otherwise sightings of tags
        that are not placed, in placed frames.
        """
        tag, frame = self._placed
        return np.flatnonzero(tag & ~frame if by_frame else frame & ~tag)

    def _retry(self) -> None:
        """Find better poses for the tags, then for the frames, in which many sightings have large errors."""
        for by_frame in (False, True):
            owner = self.sightings.frame if by_frame else self.sightings.tag
            error = squared_errors(self.sightings, self.poses)
            known = np.isfinite(error)
            if not known.any():  # no frame shows the tags that were placed from their plan
                return
            disagree = known & (error > MUCH_WORSE * np.median(error[known]))
            share = np.bincount(owner, disagree) / np.maximum(np.bincount(owner, known), 1)
            self.place(np.flatnonzero(known & (share[owner] > DISPUTED)), by_frame)

    def _adjust(self, steps: int) -> None:
        """Improve all placed tags and frames by bundle adjustment, at most `steps` steps. The first tag of each group
        is fixed.
        """
        both = np.logical_and(*self._placed)
        if not both.any():
            return
        _, first = np.unique(self.group, return_index=True)
        information = np.zeros((len(self.tags), 6))
        information[first[self.group[first] >= 0]] = 1.0 / ANCHOR_SIGMA**2
        adjustment = Adjustment(self.sightings.of(both), Prior(self.tags, information))
        poses, _ = adjustment.run(self.poses, FLOOR_PIXELS, steps)
        self.tags, self.frames = poses.tags, poses.frames

    def place(self, index: IntArray, by_frame: bool, fewest: int = FEWEST) -> bool:
        """Place the frames of the sightings `index` from placed tags, or the tags of these sightings from placed
        frames.

        Args:
            index: indices of sightings.
            by_frame: True to place frames, False to place tags.
            fewest: minimum number of a frame's or tag's sightings that must agree with its pose.

        Returns:
            True if a frame or tag that had no pose was placed.
        """
        some, single, before = self.sightings.of(index), self.single.poses[index], self._count()
        placed, poses = place(some, single, self.poses, by_frame, fewest, LEAST_SHARE)
        (self.frames if by_frame else self.tags)[placed] = poses
        if not by_frame:
            self.group[placed] = np.where(self.group[placed] < 0, self.group.max(), self.group[placed])
        return self._count() > before


def place_all(sightings: Sightings, planned: FloatArray, is_linked: bool) -> Placing:
    """Place all tags and frames that can be placed; return the placement with which most sightings agree.

    Args:
        sightings: sightings in which each camera is a separate body, see `Sightings.with_separate_cameras`.
        planned: planned poses of tags, `(K, 4, 4)`; NaN if unknown. A placement that starts from these poses is tried
            first, and accepted if nearly all sightings agree with it.
        is_linked: True if frames are linked by motion.
    """
    single, tried = single_poses(sightings), []
    known = (sightings.counts() > 0) & np.isfinite(planned[:, 0, 0])
    for quarter in QUARTERS if known.any() else ():
        tried.append(placing := Placing(sightings, single, is_linked))
        placing.tags[known], placing.group[known] = (planned @ quarter)[known], 0
        placing.place(placing.waiting(by_frame=True), by_frame=True)
    found = [max(tried, key=Placing.agreed)] if tried else []
    for placing in (*found, Placing(sightings, single, is_linked)):
        placing.fill()
        if placing.agreed() >= AS_PLANNED * len(sightings):
            return placing
    return max((*found, placing), key=Placing.agreed)
