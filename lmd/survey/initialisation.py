"""Initialisation: rough poses of tags and frames, one after the other.

A single tag has two poses in front of a camera that look alike (IPPE). A group of tags begins with the frame that shows
the most tags whose pose is beyond doubt. Then frames that show two or more placed tags are placed, and tags that placed
frames show, in turns. For each frame or tag, the poses that its sightings propose are tried, the likeliest pose is
refined, and the frame or tag is placed there if enough sightings agree. When no frame or tag can be placed this way,
the likeliest single sighting places a tag or frame. At last all tags and frames with large errors are tried again.
Placed tags and frames are adjusted as their number grows. Tags that no frame connects with the group begin another
group, in a world of its own.

With a plan, initialisation starts with the tags at their planned poses, and is accepted if nearly all sightings agree.
As detectors may number corners from another corner, all planned tags are tried at each of the four quarter turns.
"""

import numpy as np

from lmd.core.checks import BoolArray, FloatArray, IntArray
from lmd.geometry.se3 import exp, inverse
from lmd.survey.adjustment import Adjustment
from lmd.survey.prior import Prior
from lmd.survey.residuals import Poses, Reprojection, normal_equations, solved, squared_errors, sums_by
from lmd.survey.sightings import QUARTERS, Sightings
from lmd.survey.single_poses import SinglePoses, single_poses

# Least log-likelihood ratios of the two poses of a sighting at which the better pose is beyond doubt, and is likely.
BEYOND_DOUBT, LIKELY = 6.0, 1.5
# A sighting agrees with a pose if the RMS error is at most `AGREES` times its size plus `AGREES_PIXELS`, pixels.
AGREES, AGREES_PIXELS = 0.15, 2.0
FEWEST, LEAST_SHARE = 2, 0.3  # minimum number, and share, of sightings that must agree
# A tag or frame is tried again if the share `DISPUTED` of its sightings has squared errors above `MUCH_WORSE` medians.
DISPUTED, MUCH_WORSE = 0.2, 25.0
# Maximum numbers, for a frame or tag, of sightings that propose poses, of sightings that judge poses (the largest
# sightings are used), and of poses that are refined.
PROPOSING, JUDGING, REFINED = 8, 60, 3
REFINING_STEPS, WIDE, NARROW = 12, 40.0, 3.0  # Gauss-Newton steps; first and last scale of the loss, pixels
STEPS, FINAL_STEPS = 3, 8  # steps of bundle adjustment between placements, and after the last placement
GROWN = 1.2  # growth factor of the number of placed tags and frames after which all are adjusted again
AS_PLANNED = 0.97  # least share of sightings that must agree with an initialisation by the plan
FLOOR_PIXELS = 3.0  # maximum of the floor in adjustments during the initialisation, pixels
ANCHOR_SIGMA = 1e-4  # prior standard deviation of the first tag of a group, metres and rad


def agreeing(sightings: Sightings, error: FloatArray) -> BoolArray:
    """True for sightings with squared errors `(N,)` that agree with a rough pose."""
    return np.asarray(np.sqrt(error / 4.0) < AGREES * sightings.sizes + AGREES_PIXELS)


class Placing:
    """Placement of the tags and frames of some sightings, one after the other.

    Args:
        sightings: sightings of one camera, see `Sightings.with_separate_cameras`.
        single: poses of the tags by single sightings.
        is_linked: True if frames are linked by motion, so that no single sighting is trusted.
    """

    def __init__(self, sightings: Sightings, single: SinglePoses, is_linked: bool = False) -> None:
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
        """Masks of the sightings whose tag is placed and of the sightings whose frame is placed, `(N,)` each."""
        tags, frames = np.isfinite(self.tags[:, 0, 0]), np.isfinite(self.frames[:, 0, 0])
        return tags[self.sightings.tag], frames[self.sightings.frame]

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

    def agreed(self) -> int:
        """Number of sightings that agree with the poses of their tags and frames."""
        return int(agreeing(self.sightings, squared_errors(self.sightings, self.poses)).sum())

    def _seed(self) -> bool:
        """Begin a group with the frame that shows the most new tags with poses beyond doubt; False if there is no such
        frame.
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
        self.tags[sightings.tag[own]] = self.single.poses[own, 0]
        self.group[sightings.tag[own]] = self.group.max() + 1
        return True

    def _grow(self) -> bool:
        """Place frames, then tags, on whose pose several sightings agree; False if none is placed."""
        before = self._count()
        for by_frame in (True, False):
            self.place(self.waiting(by_frame), by_frame, fewest=FEWEST)
        return self._count() > before

    def _risk(self) -> bool:
        """Place one tag, or else one frame, by the likeliest single sighting; False if no sighting is likely enough."""
        for by_frame in (False, True):
            waiting = self.waiting(by_frame)
            waiting = waiting[self.single.odds[waiting] > LIKELY]
            if waiting.size:
                before = self._count()
                self.place(waiting[[np.argmax(self.single.odds[waiting])]], by_frame, fewest=1)
                if self._count() > before:
                    return True
        return False

    def _count(self) -> int:
        """Number of placed frames and tags."""
        return int(np.isfinite(self.frames[:, 0, 0]).sum() + np.isfinite(self.tags[:, 0, 0]).sum())

    def waiting(self, by_frame: bool) -> IntArray:
        """Sightings of placed tags in frames that are not placed; if not `by_frame`, sightings of other tags in placed
        frames.
        """
        tag, frame = self._placed
        return np.flatnonzero(tag & ~frame if by_frame else frame & ~tag)

    def _retry(self) -> None:
        """Give tags, then frames, with many large errors a better pose."""
        for by_frame in (False, True):
            owner = self.sightings.frame if by_frame else self.sightings.tag
            error = squared_errors(self.sightings, self.poses)
            known = np.isfinite(error)
            if not known.any():  # no frame shows the tags that were placed by their plan
                return
            disagree = known & (error > MUCH_WORSE * np.median(error[known]))
            share = np.bincount(owner, disagree) / np.maximum(np.bincount(owner, known), 1)
            self.place(np.flatnonzero(known & (share[owner] > DISPUTED)), by_frame, fewest=FEWEST)

    def _adjust(self, steps: int) -> None:
        """Adjust all placed tags and frames, with the first tag of each group fixed."""
        tag, frame = self._placed
        if not (tag & frame).any():
            return
        _, first = np.unique(self.group, return_index=True)
        information = np.zeros((len(self.tags), 6))
        information[first[self.group[first] >= 0]] = 1.0 / ANCHOR_SIGMA**2
        adjustment = Adjustment(self.sightings.of(tag & frame), Prior(self.tags, information))
        poses, _ = adjustment.run(self.poses, FLOOR_PIXELS, steps)
        self.tags, self.frames = poses.tags, poses.frames

    def place(self, index: IntArray, by_frame: bool, fewest: int, share: float = LEAST_SHARE) -> None:
        """Place the frames of the sightings `index` by placed tags, or the tags of the sightings by placed frames.

        Args:
            index: indices of sightings.
            by_frame: True to place frames, False to place tags.
            fewest: minimum number of sightings that must agree.
            share: minimum share of the sightings that must agree.
        """
        index = index[_rank(self.sightings, index, by_frame) < JUDGING]
        if not index.size:
            return
        trial = _Trial(self, self.sightings.of(index), by_frame)
        target = self.frames if by_frame else self.tags
        proposing = np.flatnonzero(_rank(self.sightings, index, by_frame) < PROPOSING)
        poses = trial.candidates(proposing, self.single.poses[index[proposing]]).reshape(-1, 4, 4)
        owner = np.repeat(trial.owner[proposing], 2)
        order = np.lexsort((trial.loss(poses, owner), owner))
        best = order[_rank_within(owner[order]) < REFINED]
        poses, owner = trial.refined(poses[best], owner[best]), owner[best]
        own = np.flatnonzero(np.isfinite(target[trial.owners, 0, 0]))
        poses, owner = np.concatenate([poses, target[trial.owners[own]]]), np.concatenate([owner, own])
        order = np.lexsort((trial.loss(poses, owner), owner))
        poses = poses[order[_rank_within(owner[order]) == 0]]
        agreed = trial.agreed(poses)
        enough = (agreed >= fewest) & (agreed >= share * trial.counts)
        placed = trial.owners[enough]
        target[placed] = poses[enough]
        if not by_frame:
            self.group[placed] = np.where(self.group[placed] < 0, self.group.max(), self.group[placed])


class _Trial:
    """Candidate poses for the owners of some sightings: frames whose tags are placed, or tags whose frames are
    placed.
    """

    def __init__(self, placing: Placing, some: Sightings, by_frame: bool) -> None:
        self.some, self.by_frame = some, by_frame
        self.given = placing.tags[some.tag] if by_frame else placing.frames[some.frame]
        self.owners, self.owner, self.counts = np.unique(
            some.frame if by_frame else some.tag, return_inverse=True, return_counts=True
        )
        self.order = np.argsort(self.owner, kind="stable")

    def candidates(self, index: IntArray, single: FloatArray) -> FloatArray:
        """Poses of the owners of the sightings `index`, `(n, 2, 4, 4)`, from the two poses of each tag in its
        camera.
        """
        given = self.given[index, None]
        return np.asarray(given @ (inverse(single) if self.by_frame else single))

    def _pairs(self, owner: IntArray) -> tuple[IntArray, IntArray]:
        """Indices of all pairs of a pose and a sighting of its owner; `owner` `(P,)` has the owner of each pose."""
        counts = self.counts[owner]
        pose = np.repeat(np.arange(len(owner)), counts)
        within = np.arange(len(pose)) - np.repeat(np.cumsum(counts) - counts, counts)
        return self.order[(np.cumsum(self.counts) - self.counts)[owner][pose] + within], pose

    def _reprojection(self, poses: FloatArray, pairs: IntArray, pose: IntArray) -> Reprojection:
        """Reprojection of each pair of a sighting and a pose."""
        still = np.broadcast_to(np.eye(4), (len(pairs), 4, 4))
        own, given = poses[pose], self.given[pairs]
        tags, frames = (given, own) if self.by_frame else (own, given)
        return Reprojection(self.some.of(pairs), tags, frames, still)

    def loss(self, poses: FloatArray, owner: IntArray) -> FloatArray:
        """Robust losses `(P,)` of poses `(P, 4, 4)` of the owners `(P,)`."""
        pairs, pose = self._pairs(owner)
        error = self._reprojection(poses, pairs, pose).squared
        return np.asarray(np.bincount(pose, np.log1p(error / (4.0 * NARROW**2)), minlength=len(poses)))

    def agreed(self, poses: FloatArray) -> FloatArray:
        """Number of sightings of each of M owners that agree with the owner's pose, `(M,)`."""
        pairs, pose = self._pairs(np.arange(len(self.owners)))
        agree = agreeing(self.some.of(pairs), self._reprojection(poses, pairs, pose).squared)
        return np.asarray(np.bincount(pose, agree, minlength=len(self.owners)))

    def refined(self, poses: FloatArray, owner: IntArray) -> FloatArray:
        """Poses after Gauss-Newton steps with robust losses of decreasing scale."""
        pairs, pose = self._pairs(owner)
        summed = sums_by(pose, len(poses))
        for scale in np.geomspace(WIDE, NARROW, REFINING_STEPS):
            at = self._reprojection(poses, pairs, pose)
            weight = 1.0 / (1.0 + (at.error**2).mean(axis=1) / scale**2)
            jacobian = at.by_frame if self.by_frame else at.by_tag
            matrix, right = normal_equations(jacobian, at.error, weight, summed)
            poses = np.asarray(poses @ exp(-solved(matrix + 1e-6 * np.eye(6), right)))
        return poses


def _rank(sightings: Sightings, index: IntArray, by_frame: bool) -> IntArray:
    """Rank of the sightings `index` by size, from the largest, among the sightings of their frame or tag."""
    owner = (sightings.frame if by_frame else sightings.tag)[index]
    order = np.lexsort((-sightings.sizes[index], owner))
    rank = np.empty(len(index), dtype=np.int64)
    rank[order] = _rank_within(owner[order])
    return rank


def _rank_within(owner: IntArray) -> IntArray:
    """Position of each entry among the entries with an equal owner; `owner` is sorted."""
    return np.asarray(np.arange(len(owner)) - np.searchsorted(owner, owner))


def place(sightings: Sightings, planned: FloatArray, is_linked: bool) -> tuple[Poses, IntArray]:
    """Place all tags and frames that can be placed.

    Args:
        sightings: sightings in which each camera is a body of its own, see `Sightings.with_separate_cameras`.
        planned: planned poses of tags, `(K, 4, 4)`; NaN if unknown.
        is_linked: True if frames are linked by motion.

    Returns:
        the poses, NaN if not placed; and the group of each tag, `(K,)`, -1 for none. Each group has a world of its own.
    """
    single = single_poses(sightings)
    tried: list[Placing] = []
    known = (np.bincount(sightings.tag, minlength=len(planned)) > 0) & np.isfinite(planned[:, 0, 0])
    for quarter in QUARTERS if known.any() else ():
        placing = Placing(sightings, single, is_linked)
        placing.tags[known], placing.group[known] = (planned @ quarter)[known], 0
        placing.place(placing.waiting(by_frame=True), by_frame=True, fewest=FEWEST)
        tried.append(placing)
    if tried:
        tried = [max(tried, key=Placing.agreed)]
        tried[0].fill()
        if tried[0].agreed() >= AS_PLANNED * len(sightings):
            return tried[0].poses, tried[0].group
    alone = Placing(sightings, single, is_linked)
    alone.fill()
    best = max([alone, *tried], key=Placing.agreed)
    return best.poses, best.group
