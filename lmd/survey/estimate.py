"""Where the tags hang: the best poses of all that was seen, how well they are known, and what did not fit."""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from threadpoolctl import threadpool_limits

from lmd.core.checks import BoolArray, FloatArray, InputError, IntArray
from lmd.geometry.se3 import inverse, middle
from lmd.survey.adjustment import Adjustment
from lmd.survey.gauge import blocks_of, without_gauge
from lmd.survey.joining import joined_by_motion
from lmd.survey.known import aligned, turned_as
from lmd.survey.linked import LinkedAdjustment, adjustment_of, telling
from lmd.survey.residuals import EXACT_SIGMA, Poses, Prior, errors_at
from lmd.survey.sightings import Sightings
from lmd.survey.start import FLOOR_PIXELS, place
from lmd.survey.turns import as_seen

# A sighting whose chi^2 is larger, with eight degrees of freedom, and which is off by more, root mean square, does not
# show the tag where it hangs: so many pixels, and such a share of its side. Blur and lenses alone move corners by less.
MISFIT_CHI_SQUARE, MISFIT_PIXELS, MISFIT_SHARE = 60.0, 1.0, 0.02
STEPS, FINAL_STEPS = 40, 15
# Threads that share matrices of some hundred rows wait for each other longer than they work.
ONE_THREAD = 1


@dataclass(frozen=True)
class Estimate:
    """The tags of some sightings.

    Args:
        sightings: all that were given.
        prior: what was known of the tags.
        poses: of tags, frames and mounts; NaN for what is not placed.
        group: of each tag: 0 for those of the map, further numbers for those that no frame connects with it, -1 for
            those that are not placed, `(K,)`.
        used: which sightings count, `(N,)`: of tags and frames of the map, and not far off.
        misfits: which are of such tags and frames but do not show the tag where it hangs, `(N,)`.
        floor: standard deviation of the corners that the detector does not account for, pixels.
        inflation: factor of the standard deviations of sightings, see `lmd.survey.blocks`.
    """

    sightings: Sightings
    prior: Prior
    poses: Poses
    group: IntArray
    used: BoolArray
    misfits: BoolArray
    floor: float
    inflation: float = 1.0

    @property
    def _adjustment(self) -> Adjustment:
        return adjustment_of(self.sightings.of(self.used), self.prior, True, self.inflation)

    @cached_property
    def covariance(self) -> FloatArray:
        """The covariance of the twists of all tags, each in its own frame, then of all else, see `Adjustment`."""
        with threadpool_limits(limits=ONE_THREAD):
            return self._adjustment.covariance(self.poses, self.floor)

    @property
    def known(self) -> BoolArray:
        """The tags of the map whose covariance is known, `(K,)`."""
        of_tags = np.diag(self.covariance)[: 6 * len(self.group)].reshape(-1, 6)
        return np.asarray((self.group == 0) & np.isfinite(of_tags).all(axis=1))

    @property
    def covariances(self) -> FloatArray:
        """Those of each tag, turn first, `(K, 6, 6)`; NaN for those not in the map."""
        size = 6 * len(self.group)
        return np.where(self.known[:, None, None], blocks_of(self.covariance[:size, :size], len(self.group)), np.nan)

    @cached_property
    def precisions(self) -> FloatArray:
        """The same once the map as a whole is laid where it belongs, see `without_gauge`."""
        known, found = self.known, np.full((len(self.group), 6, 6), np.nan)
        rows = np.flatnonzero(np.repeat(known, 6))
        found[known] = blocks_of(
            without_gauge(self.covariance[np.ix_(rows, rows)], self.poses.tags[known]), int(known.sum())
        )
        return found

    @property
    def lenses(self) -> FloatArray:
        """Covariances of what is not known of each camera, in the units of `Sightings.lens`, `(C, 6 L, 6 L)`."""
        every = self._adjustment
        own = slice(6 * every.placed, 6 * every.flat)
        return blocks_of(self.covariance[own, own], self.sightings.cameras)

    @property
    def mapped(self) -> IntArray:
        """The tags of the map."""
        return np.flatnonzero(self.group == 0)

    @property
    def frames(self) -> IntArray:
        """The frames that the map is made from."""
        return np.unique(self.sightings.frame[self.used])

    @property
    def sigmas(self) -> FloatArray:
        """The standard deviation of the place of each tag beside the others, along the worst direction, metres."""
        known = np.asarray(np.isfinite(self.precisions).all(axis=(1, 2)))
        result = np.full(len(known), np.nan)
        largest = np.linalg.eigvalsh(self.precisions[known][:, 3:, 3:])[:, -1]
        result[known] = np.sqrt(np.maximum(largest, 0.0))
        return result

    def in_world(self, covariances: FloatArray) -> FloatArray:
        """Covariances of the position and of the turn of each tag, world frame, m^2 and rad^2, `(K, 6, 6)`.

        Args:
            covariances: of their twists, in their own frames, `(K, 6, 6)`.
        """
        turned = self.poses.tags[:, :3, :3]
        whole = np.zeros((len(turned), 6, 6))
        whole[:, :3, 3:] = whole[:, 3:, :3] = turned
        return np.asarray(whole @ covariances @ np.swapaxes(whole, 1, 2))

    def moved(self, motion: FloatArray) -> "Estimate":
        """The estimate in another world, to which a motion `(4, 4)` leads."""
        poses = replace(self.poses, tags=motion @ self.poses.tags, frames=motion @ self.poses.frames)
        return replace(self, poses=poses, prior=replace(self.prior, tags=motion @ self.prior.tags))

    def errors(self) -> FloatArray:
        """Root mean square reprojection error of the sightings that count, pixels."""
        return np.asarray(np.sqrt(errors_at(self.sightings.of(self.used), self.poses) / 4.0))


@dataclass(frozen=True)
class Start:
    """The beginning of an adjustment.

    Args:
        poses: rough ones, of each camera by itself, see `Sightings.apart`.
        group: of each tag, `(K,)`, -1 for those that are not placed. Each group has a world of its own.
    """

    poses: Poses
    group: IntArray


def started(sightings: Sightings, prior: Prior) -> Start:
    """The rough poses that an adjustment begins with.

    Raises:
        InputError: no two tags were seen together.
    """
    with threadpool_limits(limits=ONE_THREAD):
        known = np.asarray(prior.information[:, :3].any(axis=1))
        apart = sightings.apart()
        # Frames of two cameras must be placed to find how these are mounted.
        is_linked = prior.motion is not None and (sightings.cameras == 1 or prior.mounts is not None)
        rough, group = place(apart, np.where(known[:, None, None], prior.tags, np.nan), is_linked)
        if prior.motion is None:
            _check_groups(group)
        return Start(as_seen(apart, rough), group)


def estimate(sightings: Sightings, prior: Prior, origin: int | None = None, start: Start | None = None) -> Estimate:
    """Estimate all poses together.

    Args:
        sightings: at least one frame must show two tags.
        prior: what is known of the tags. What it knows nothing of hangs where the photographs say.
        origin: id of the tag whose frame is the world where the prior knows none of the tags; None for the one that
            was seen most often.
        start: where to begin; None for `started`.

    Raises:
        InputError: no two tags were seen together, `origin` could not be placed, or centres that are known are too few
            for a world.
    """
    start = started(sightings, prior) if start is None else start
    with threadpool_limits(limits=ONE_THREAD):
        poses, group, prior = in_one_world(sightings, *begun(sightings, start, prior), origin)
        return adjusted(sightings, prior, poses, group, FLOOR_PIXELS)


def begun(sightings: Sightings, start: Start, prior: Prior) -> tuple[Poses, IntArray, Prior]:
    """Rough poses of the body, the group of each tag once motion has joined some, and the prior as the drive tells it.

    Raises:
        InputError: a camera was never placed together with the first one.
    """
    rough = joined(sightings, start.poses, prior.mounts)
    if prior.motion is None:
        return rough, start.group, prior
    poses, group, prior = joined_by_motion(sightings, rough, start.group, prior)
    _check_groups(group)
    return poses, group, prior


def _check_groups(group: IntArray) -> None:
    """Raise `InputError` if nothing connects two tags."""
    if group.max(initial=-1) < 0:
        raise InputError("detections never show two tags at once, of which one leaves no doubt.", "detections")


def adjusted(
    sightings: Sightings, prior: Prior, poses: Poses, group: IntArray, floor: float, inflation: float = 1.0
) -> Estimate:
    """The estimate near some poses; arguments as of `Estimate`.

    Raises:
        InputError: no sightings agree.
    """
    of_map = (group[sightings.tag] == 0) & np.isfinite(poses.frames[sightings.frame, 0, 0])
    of_map = used = telling(sightings, of_map, prior.motion)
    misfits = np.zeros(len(sightings), dtype=bool)
    there = (group == 0) & (np.bincount(sightings.tag[of_map], minlength=len(group)) > 0)
    sheets = None if prior.sheets is None else prior.sheets.of(there)
    information = np.where((group == 0)[:, None], prior.information, 0.0)
    sheets = None if sheets is None or not len(sheets.tag) else sheets
    prior = replace(prior, information=information, sheets=sheets)
    for steps in (STEPS, FINAL_STEPS):
        used = telling(sightings, used, prior.motion)
        if not used.any():
            raise InputError(
                "detections: no two tags of a frame agree with one pose of the camera; are the corners in another "
                "order, or the calibration another one?",
                "detections",
            )
        adjustment = adjustment_of(sightings.of(used), prior, inflation=inflation)
        found = adjustment.run(poses, floor, steps)
        poses, floor = found.poses, found.floor
        if isinstance(adjustment, LinkedAdjustment) and steps == STEPS:
            prior = replace(prior, motion=adjustment.told(poses, floor))
        misfits = of_map & ~fitting(sightings, errors_at(sightings, poses), floor)
        used = of_map & ~misfits
    used = telling(sightings, used, prior.motion)
    frames = np.full_like(poses.frames, np.nan)
    frames[np.unique(sightings.frame[used])] = poses.frames[np.unique(sightings.frame[used])]
    poses = replace(poses, frames=frames)
    return Estimate(sightings, prior, poses, group, used, misfits, floor, inflation)


def fitting(sightings: Sightings, error: FloatArray, floor: float) -> BoolArray:
    """True for sightings whose error |e|^2 `(N,)` fits where their tags hang; false for NaN."""
    square = error / (sightings.noise**2 + floor**2)
    near = np.sqrt(error / 4.0) <= np.maximum(MISFIT_PIXELS, MISFIT_SHARE * sightings.sizes)
    return np.asarray((square <= MISFIT_CHI_SQUARE) | near)


def joined(sightings: Sightings, apart: Poses, known: FloatArray | None = None) -> Poses:
    """Poses of one body from those of its cameras by themselves.

    Args:
        apart: of `sightings.apart()`.
        known: how the cameras are mounted, `(C, 4, 4)`; None where that is to be found.

    Raises:
        InputError: a camera was never placed together with the first one.
    """
    views = apart.frames.reshape(sightings.cameras, sightings.frames, 4, 4)
    mounts, frames = np.tile(np.eye(4), (sightings.cameras, 1, 1)), views[0].copy()
    for camera in range(1, sightings.cameras):
        there = np.isfinite(views[camera, :, 0, 0])
        both = there & np.isfinite(frames[:, 0, 0])
        if known is not None:
            mounts[camera] = known[camera]
        elif both.any():
            mounts[camera] = middle(inverse(frames[both]) @ views[camera, both])
        else:
            raise InputError(f"detections have no frame that shows where camera {camera + 1} is mounted.", "detections")
        fresh = there & ~both
        frames[fresh] = views[camera, fresh] @ inverse(mounts[camera])
    return Poses(apart.tags, frames, mounts)


def in_one_world(
    sightings: Sightings, poses: Poses, group: IntArray, prior: Prior, origin: int | None
) -> tuple[Poses, IntArray, Prior]:
    """Every group that the prior knows a tag of, in its world, as group 0; the others behind them."""
    tags, frames = poses.tags.copy(), poses.frames.copy()
    owner = np.full(sightings.frames, -1)
    placed = group[sightings.tag] >= 0
    owner[sightings.frame[placed]] = group[sightings.tag[placed]]
    counts = np.bincount(sightings.tag, minlength=len(group))
    order = np.argsort(-np.bincount(group[group >= 0], counts[group >= 0]), kind="stable")
    motions = {g: aligned(np.where((group == g)[:, None, None], tags, np.nan), prior) for g in order.tolist()}
    if all(motion is None for motion in motions.values()):
        if prior.information[group >= 0].any():
            raise InputError(
                "points has too few tags that photographs connect: three that are not in a line.", "points"
            )
        first, prior = _origin(sightings, group, counts, order, prior, origin)
        motions[int(group[first])] = inverse(tags[first])
    number, others = np.full(len(order) + 1, -1), 1
    for g in order.tolist():
        motion = motions[g]
        if motion is None:
            number[g], others = others, others + 1
            continue
        number[g] = 0
        tags[group == g] = motion @ tags[group == g]
        frames[owner == g] = motion @ frames[owner == g]
    frames[(owner < 0) | (number[owner] != 0)] = np.nan
    return Poses(tags, frames, poses.mounts), number[group], turned_as(prior, tags)


def _origin(
    sightings: Sightings, group: IntArray, counts: IntArray, order: IntArray, prior: Prior, origin: int | None
) -> tuple[int, Prior]:
    """The tag whose frame is the world, and a prior that says so."""
    first = int(np.argmax(np.where(group == order[0], counts, -1)))
    if origin is not None:
        among = np.flatnonzero((sightings.ids == origin) & (group >= 0))
        if not among.size:
            raise InputError(f"origin = {origin} is no tag that could be placed.", "origin")
        first = int(among[0])
    information = prior.information.copy()
    information[first] = EXACT_SIGMA**-2.0
    tags = prior.tags.copy()
    tags[first] = np.eye(4)
    return first, replace(prior, tags=tags, information=information)
