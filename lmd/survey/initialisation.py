"""Where an adjustment begins: each frame and each tag, one after the other, from those that are best connected.

A single tag has two poses in front of a camera that look alike (IPPE). A group of tags begins with the frame that shows
the most tags whose pose is beyond doubt. Then, in turns, every frame that shows at least two placed tags is placed, and
every tag that placed frames show; each of them tries the poses that its sightings propose, improves the likeliest, and
is placed if enough sightings agree. Where that comes to an end, the likeliest of single sightings is taken at its word:
at last all try again among all that is placed. After each turn what is placed is adjusted. What no frame connects with
the group begins another one, in a world of its own.

With a plan all begins with the tags where they were planned, and that is taken if nearly all sightings agree with what
comes of it. All corners may be numbered from another one, so the tags are turned by the quarters with which most agree.
"""

import numpy as np

from lmd.core.checks import BoolArray, FloatArray, IntArray
from lmd.geometry.se3 import exp, inverse
from lmd.survey.adjustment import Adjustment
from lmd.survey.proposals import Proposals, proposals
from lmd.survey.residuals import Poses, Prior, errors_at, in_cameras, linearise, residuals, summing
from lmd.survey.sightings import QUARTERS, Sightings
from lmd.survey.student import solved

# A pose is beyond doubt, or likely, if the likelihood of the other one is less by so many powers of e.
BEYOND_DOUBT, LIKELY = 6.0, 1.5
# A sighting agrees with a pose if it is not farther off, root mean square, than this share of its size and some pixels.
AGREES, AGREES_PIXELS = 0.15, 2.0
# At least so many sightings, and so much of all, must agree.
FEWEST, LEAST_SHARE = 2, 0.3
# Frames and tags try again at last where so many sightings are off by so much more than the median, squared.
DISPUTED, MUCH_WORSE = 0.2, 25.0
# Of a frame or tag, the proposals come from so many of its sightings, the largest; the best are improved.
PROPOSING, IMPROVED = 8, 3
# It is judged by so many, the largest.
JUDGED_BY = 60
IMPROVING_STEPS, WIDE, NARROW = 12, 40.0, 3.0  # the scale of the weights goes from wide to narrow, pixels
STEPS, FINAL_STEPS = 3, 8
GROWN = 1.2  # what is placed is adjusted anew once it has grown so much
# A beginning with all tags where they were planned is good enough if such a share of sightings agrees.
AS_PLANNED = 0.97
FLOOR_PIXELS = 3.0  # pixels; adjustments on the way take that much to be unexplained, at most
ANCHOR_SIGMA = 1e-4  # metres and rad, by which the first tag of a group may move


def agreeing(sightings: Sightings, error: FloatArray) -> BoolArray:
    """Whether sightings with the error |e|^2 `(N,)` agree with a pose that is not exact yet."""
    return np.asarray(np.sqrt(error / 4.0) < AGREES * sightings.sizes + AGREES_PIXELS)


class Placing:
    """The frames and tags of some sightings that are placed one after the other."""

    def __init__(self, sightings: Sightings, proposed: Proposals, is_linked: bool = False) -> None:
        self.sightings, self.proposed, self.is_linked = sightings, proposed, is_linked
        nowhere = np.full((4, 4), np.nan)
        self.tags = np.tile(nowhere, (len(sightings.ids), 1, 1))
        self.frames = np.tile(nowhere, (sightings.frames, 1, 1))
        self.group = np.full(len(sightings.ids), -1)

    @property
    def poses(self) -> Poses:
        """Where everything is; frames are those of their only camera."""
        return Poses(self.tags, self.frames, np.eye(4)[None])

    def placed(self, poses: FloatArray) -> BoolArray:
        """Which of some poses are known."""
        return np.asarray(np.isfinite(poses[:, 0, 0]))

    def fill(self) -> None:
        """Place all that can be, from what is placed already."""
        begun = bool(self.count())
        while begun or self.seed():
            begun, adjusted = False, 0
            while self.grow() or (not self.is_linked and self.risk()):
                if self.count() > GROWN * adjusted:  # adjusting each time would take time that is quadratic in frames
                    self.adjust(STEPS)
                    adjusted = self.count()
            for _ in range(2):
                self.reseat()
                self.adjust(FINAL_STEPS)

    def agreed(self) -> int:
        """How many sightings agree with where their tags and frames are."""
        return int(agreeing(self.sightings, errors_at(self.sightings, self.poses)).sum())

    def seed(self) -> bool:
        """Begin a group with the tags of the frame that shows most new ones beyond doubt; whether there is one."""
        sightings = self.sightings
        fresh = ~self.placed(self.tags)[sightings.tag] & ~self.placed(self.frames)[sightings.frame]
        usable = np.flatnonzero(fresh & (self.proposed.odds > BEYOND_DOUBT))
        if not usable.size:
            return False
        worth = np.bincount(sightings.frame[usable], np.sqrt(sightings.sizes[usable]), minlength=sightings.frames)
        counted = np.bincount(sightings.frame[fresh], minlength=sightings.frames)
        worth *= counted > 1
        if not worth.any():
            return False
        frame = int(np.argmax(worth))
        own = usable[sightings.frame[usable] == frame]
        self.frames[frame] = np.eye(4)
        self.tags[sightings.tag[own]] = self.proposed.poses[own, 0]
        self.group[sightings.tag[own]] = self.group.max() + 1
        return True

    def grow(self) -> bool:
        """Place what several sightings agree on; whether anything was placed."""
        before = self.count()
        self.settle(self.waiting(by_frame=True), by_frame=True, fewest=FEWEST)
        self.settle(self.waiting(by_frame=False), by_frame=False, fewest=FEWEST)
        return self.count() > before

    def risk(self) -> bool:
        """Place one tag, or else one frame, by the likeliest of single sightings; whether there was one."""
        for by_frame in (False, True):
            waiting = self.waiting(by_frame)
            waiting = waiting[self.proposed.odds[waiting] > LIKELY]
            if waiting.size:
                before = self.count()
                self.settle(waiting[[np.argmax(self.proposed.odds[waiting])]], by_frame, fewest=1)
                if self.count() > before:
                    return True
        return False

    def count(self) -> int:
        """How many frames and tags are placed."""
        return int(self.placed(self.frames).sum() + self.placed(self.tags).sum())

    def waiting(self, by_frame: bool) -> IntArray:
        """The sightings of placed tags in other frames, or of other tags in placed frames."""
        tag, frame = self.placed(self.tags)[self.sightings.tag], self.placed(self.frames)[self.sightings.frame]
        return np.flatnonzero(tag & ~frame if by_frame else frame & ~tag)

    def reseat(self) -> None:
        """Let tags, then frames, whose sightings fit badly try again, and take a pose that fits better."""
        for by_frame in (False, True):
            owner = self.sightings.frame if by_frame else self.sightings.tag
            error = errors_at(self.sightings, self.poses)
            known = np.isfinite(error)
            if not known.any():  # no frame shows the tags that were placed by their plan
                return
            disagree = known & (error > MUCH_WORSE * np.median(error[known]))
            share = np.bincount(owner, disagree) / np.maximum(np.bincount(owner, known), 1)
            self.settle(np.flatnonzero(known & (share[owner] > DISPUTED)), by_frame, fewest=FEWEST)

    def adjust(self, steps: int) -> None:
        """Adjust all that is placed; the first tag of each group stays."""
        both = self.placed(self.tags)[self.sightings.tag] & self.placed(self.frames)[self.sightings.frame]
        if not both.any():
            return
        _, first = np.unique(self.group, return_index=True)
        information = np.zeros((len(self.tags), 6))
        information[first[self.group[first] >= 0]] = 1.0 / ANCHOR_SIGMA**2
        adjustment = Adjustment(self.sightings.of(both), Prior(self.tags, information))
        adjusted = adjustment.run(self.poses, FLOOR_PIXELS, steps)
        self.tags, self.frames = adjusted.poses.tags, adjusted.poses.frames

    def settle(self, index: IntArray, by_frame: bool, fewest: int, share: float = LEAST_SHARE) -> None:
        """Place the frames, or the tags, of the sightings `index`, whose tags, or frames, are placed.

        Args:
            by_frame: whether it is the frames that are to be placed.
            fewest: how many sightings must agree.
            share: how many of all must.
        """
        index = index[_rank(self.sightings, index, by_frame) < JUDGED_BY]
        if not index.size:
            return
        trial = _Trial(self, self.sightings.of(index), by_frame)
        target = self.frames if by_frame else self.tags
        proposing = np.flatnonzero(_rank(self.sightings, index, by_frame) < PROPOSING)
        poses = trial.candidates(proposing, self.proposed.poses[index[proposing]])
        owner = np.repeat(trial.of[proposing], poses.shape[1])
        poses = poses.reshape(-1, 4, 4)
        order = np.lexsort((trial.cost(poses, owner), owner))
        best = order[_rank_within(owner[order]) < IMPROVED]
        poses, owner = trial.improved(poses[best], owner[best]), owner[best]
        own = np.flatnonzero(self.placed(target)[trial.owners])
        poses, owner = np.concatenate([poses, target[trial.owners[own]]]), np.concatenate([owner, own])
        order = np.lexsort((trial.cost(poses, owner), owner))
        poses = poses[order[_rank_within(owner[order]) == 0]]
        agreed = trial.agreed(poses)
        enough = (agreed >= fewest) & (agreed >= share * trial.sizes)
        target[trial.owners[enough]] = poses[enough]
        if not by_frame:
            fresh = trial.owners[enough]
            self.group[fresh] = np.where(self.group[fresh] < 0, self.group.max(), self.group[fresh])


class _Trial:
    """Poses that are tried for frames whose tags are placed, or for tags whose frames are.

    `owners` are these frames or tags, `of` says which of them each sighting is of, and `sizes` how many each has.
    """

    def __init__(self, placing: Placing, some: Sightings, by_frame: bool) -> None:
        self.some, self.by_frame = some, by_frame
        self.given = placing.tags[some.tag] if by_frame else placing.frames[some.frame]
        self.owners, self.of, self.sizes = np.unique(
            some.frame if by_frame else some.tag, return_inverse=True, return_counts=True
        )
        self.order = np.argsort(self.of, kind="stable")

    def candidates(self, index: IntArray, proposed: FloatArray) -> FloatArray:
        """The poses `(n, 2, 4, 4)` of the owners of the sightings `index` that the tags' in their cameras lead to."""
        given = self.given[index, None]
        return np.asarray(given @ (inverse(proposed) if self.by_frame else proposed))

    def _pairs(self, owner: IntArray) -> tuple[IntArray, IntArray]:
        """For poses of these owners `(P,)` every sighting that each is judged by: which sighting, and which pose."""
        counts = self.sizes[owner]
        pose = np.repeat(np.arange(len(owner)), counts)
        within = np.arange(len(pose)) - np.repeat(np.cumsum(counts) - counts, counts)
        return self.order[(np.cumsum(self.sizes) - self.sizes)[owner][pose] + within], pose

    def _placed(self, poses: FloatArray, pairs: IntArray, pose: IntArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Poses of the tag, the frame and the mount of each pair."""
        still = np.broadcast_to(np.eye(4), (len(pairs), 4, 4))
        given = self.given[pairs]
        return (given, poses[pose], still) if self.by_frame else (poses[pose], given, still)

    def _errors(self, poses: FloatArray, owner: IntArray) -> tuple[IntArray, IntArray, FloatArray]:
        pairs, pose = self._pairs(owner)
        some = self.some.of(pairs)
        seen = in_cameras(some, *self._placed(poses, pairs, pose))
        return pairs, pose, (residuals(some, seen) ** 2).sum(axis=(1, 2))

    def cost(self, poses: FloatArray, owner: IntArray) -> FloatArray:
        """How badly poses `(P, 4, 4)` of these owners fit, `(P,)`; far off is little worse than off."""
        _, pose, error = self._errors(poses, owner)
        return np.asarray(np.bincount(pose, np.log1p(error / (4.0 * NARROW**2)), minlength=len(poses)))

    def agreed(self, poses: FloatArray) -> FloatArray:
        """How many sightings of each owner agree with its pose, `(M,)`."""
        pairs, pose, error = self._errors(poses, np.arange(len(self.owners)))
        return np.asarray(np.bincount(pose, agreeing(self.some.of(pairs), error), minlength=len(self.owners)))

    def improved(self, poses: FloatArray, owner: IntArray) -> FloatArray:
        """The poses after some steps of Gauss and Newton with weights that grow narrow."""
        pairs, pose = self._pairs(owner)
        some, summed = self.some.of(pairs), summing(pose, len(poses))
        for scale in np.geomspace(WIDE, NARROW, IMPROVING_STEPS):
            linear = linearise(some, *self._placed(poses, pairs, pose))
            slope = linear.by_frame if self.by_frame else linear.by_tag
            weight = 1.0 / (1.0 + (linear.error**2).mean(axis=1) / scale**2)
            turned = np.swapaxes(slope, 1, 2) * weight[:, None, None]
            matrix = summed(turned @ slope) + 1e-6 * np.eye(6)
            right = summed((turned @ linear.error[..., None])[..., 0])
            poses = np.asarray(poses @ exp(-solved(matrix, right)))
        return poses


def _rank(sightings: Sightings, index: IntArray, by_frame: bool) -> IntArray:
    """The rank of each of the sightings `index` among those of its frame, or tag, the largest first."""
    owner = (sightings.frame if by_frame else sightings.tag)[index]
    order = np.lexsort((-sightings.sizes[index], owner))
    rank = np.empty(len(index), dtype=np.int64)
    rank[order] = _rank_within(owner[order])
    return rank


def _rank_within(owner: IntArray) -> IntArray:
    """The places of entries among those of the same owner; they are sorted by it."""
    return np.asarray(np.arange(len(owner)) - np.searchsorted(owner, owner))


def place(sightings: Sightings, planned: FloatArray, is_linked: bool = False) -> tuple[Poses, IntArray]:
    """Rough poses of all tags and frames that can be placed.

    Args:
        sightings: of cameras each of which is a body of its own (`mounts` are not asked for).
        planned: where tags should hang, `(K, 4, 4)`; NaN where that is not known.
        is_linked: whether frames are linked, so that no single sighting has to be taken at its word.

    Returns:
        the poses, NaN where nothing is known; and the group of each tag, -1 for none, `(K,)`. Each group has a world
        of its own.
    """
    proposed = proposals(sightings)
    tried: list[Placing] = []
    known = (np.bincount(sightings.tag, minlength=len(planned)) > 0) & np.isfinite(planned[:, 0, 0])
    for quarter in QUARTERS if known.any() else ():
        placing = Placing(sightings, proposed, is_linked)
        placing.tags[known], placing.group[known] = (planned @ quarter)[known], 0
        placing.settle(placing.waiting(by_frame=True), by_frame=True, fewest=FEWEST)
        tried.append(placing)
    if tried:
        tried = [max(tried, key=Placing.agreed)]
        tried[0].fill()
        if tried[0].agreed() >= AS_PLANNED * len(sightings):
            return tried[0].poses, tried[0].group
    alone = Placing(sightings, proposed, is_linked)
    alone.fill()
    best = max([alone, *tried], key=Placing.agreed)
    return best.poses, best.group
