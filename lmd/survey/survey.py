"""Survey: all steps from detections to a map of tags, in order.

*Faults*: if the outliers of a tag (`Estimate.misfits`) agree on a second pose, the tag was moved, or two tags share the
id. If they do not agree, the detector misread the id. A tag has a wrong size if its sightings agree on another size
while the poses of all frames are fixed.

*Held-out frames* check the map: they are localised in a map that is made from the other frames.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from enum import Enum
from functools import partial
from typing import NamedTuple

import numpy as np
from threadpoolctl import threadpool_limits

from lmd.adjust.corners import agreeing, resected, squared_errors
from lmd.adjust.estimate import FEWEST_FRAMES, ONE_THREAD, Estimate, constraining
from lmd.adjust.faults import Faults, with_best_edges, with_sizes, without_faults
from lmd.adjust.intrinsics import Optics
from lmd.adjust.motion import Motion, seconds_of
from lmd.adjust.prior import Prior
from lmd.adjust.refinement import edge_doubts, refine, synchronised, with_lenses
from lmd.adjust.sightings import QUARTERS, Observations, Sightings, outside_doubts
from lmd.core.checks import BoolArray, FloatArray, InputError, IntArray
from lmd.detection.corner_errors import CornerErrors
from lmd.formats.detections import DetectedTags
from lmd.geometry.camera import Camera
from lmd.scene.tag import Tag
from lmd.survey.knowledge import PriorKnowledge
from lmd.survey.start import Start, in_one_world, initialise
from lmd.survey.world import turns_of

FEWEST_BELIEVED = 2  # minimum number of agreeing sightings to accept a tag without prior, as ids may be misread
TURNING_STEPS = 3  # maximum number of initialisations; known turns may reveal further turns
# With linked frames, a tag is not placed if its standard deviation relative to the others exceeds `LOOSE_M`, metres,
# and the share `LOOSE_SHARE` of the map's extent.
LOOSE_M, LOOSE_SHARE = 0.25, 0.01
HELD_OUT_STEP = 5  # every fifth frame is held out


class SurveyStage(Enum):
    """Stages of a survey, in the order in which they are run."""

    PLACING = "placing tags"
    ADJUSTING = "adjusting"
    REFINING = "refining the cameras"
    CHECKING = "looking for faulty tags"
    HOLDING_OUT = "holding frames out"
    AUDITING = "comparing with predictions"

    @property
    def has_map(self) -> bool:
        """True if a map exists at this stage."""
        return self not in (SurveyStage.PLACING, SurveyStage.ADJUSTING)


# Called with the stage, the number of finished steps, and the maximum number of steps, 0 if unknown. The observer
# returns True to stop with the present map, and may raise an error if there is no map yet.
Observer = Callable[[SurveyStage, int, int], bool]


class HeldOut(NamedTuple):
    """Errors of frames that are held out to check the map, localised in a map that is made from the other frames."""

    errors: FloatArray
    """`(n,)` RMS reprojection errors of the n sightings in held-out frames, pixels."""
    shifts: FloatArray
    """For each of the M held-out frames, distance between its localised position and its position in the survey of all
    frames, metres, `(M,)`.
    """


@dataclass(frozen=True)
class Survey:
    """Result of a survey; arrays over K tags have the order of `found.sightings.ids`."""

    detected: DetectedTags
    """Detections."""
    known: PriorKnowledge
    """Prior knowledge."""
    found: Estimate
    """Poses and covariances."""
    faults: Faults
    """Tags that were moved, that share an id, or that have a wrong size; and misread ids."""
    placed: BoolArray
    """`(K,)` mask of the tags in the map."""
    loose: BoolArray
    """`(K,)` mask of the tags that are not in the map because their covariance is too large."""
    held_out: HeldOut | None
    """Check of the map by held-out frames; None if there are too few frames."""
    turns: IntArray
    """`(2, K)` quarter turns of tags relative to the plan, see `lmd.survey.world.turns_of`."""
    joined: IntArray
    """Index of each tag's group if groups are formed by images alone, without the links of motion, `(K,)`; -1 if motion
    does not link the frames.
    """
    doubts: tuple[str, ...] = ()
    """Sentences on values that the photographs contradict: calibrations, mounts, the tags' edge length."""
    interrupted: SurveyStage | None = None
    """Stage at which the survey was stopped early; results of later stages are missing."""

    @property
    def ids(self) -> IntArray:
        """Ids of the tags, `(K,)`."""
        return self.found.sightings.ids

    @property
    def used(self) -> IntArray:
        """Number of inliers of each tag, `(K,)`."""
        return self.found.sightings.counts(self.found.used)


def survey(
    detected: DetectedTags,
    cameras: Sequence[Camera],
    tag: Tag,
    errors: CornerErrors,
    known: PriorKnowledge,
    calibrate: bool | None = None,
    observer: Observer = lambda _stage, _done, _most: False,
) -> Survey:
    """Estimate a map of tags from their detections.

    Args:
        detected: detections.
        cameras: cameras in the order of `detected.cameras`.
        tag: family of the tags, and edge length of the tags for which `known` has none.
        errors: errors of the detector's corners.
        known: prior knowledge of the user, such as a plan.
        calibrate: True if the intrinsics are a rough guess; None to refine a calibration; False to keep the
            calibration, while its uncertainty still enters the covariance.
        observer: called at each stage, see `Observer`.

    Raises:
        InputError: the detections connect no two tags, do not determine the pose of any tag, or do not match `tag` and
            `cameras`.
    """
    ids = _believed(detected, tag, known)
    seen = Observations(detected, tuple(map(Optics, cameras)), ids, known.edges(ids, tag), tag.modules, errors)
    observer(SurveyStage.PLACING, 0, 0)
    with threadpool_limits(limits=ONE_THREAD):
        (seen, prior, turns, start), odd = with_best_edges(seen, partial(_turned, known=known))
        observer(SurveyStage.ADJUSTING, 0, 0)
        found = _estimate(seen, prior, known, start)
        found, odd = with_sizes(found, odd, others=0.0, tried=bool(odd.any()))
        is_stopped = partial(observer, SurveyStage.REFINING)
        refined = partial(refine, keep=calibrate is False, is_stopped=is_stopped)
        found = synchronised(refined(with_lenses(found, seen, bool(calibrate))), refined)
        doubts = outside_doubts(seen) or ([] if calibrate is False else edge_doubts(found))
        observer(SurveyStage.CHECKING, 0, 0)
        found, faults = without_faults(found, odd)
        placed, loose = _placed(found, known)
        held_out = None if observer(SurveyStage.HOLDING_OUT, 0, 0) else _held_out(found)
    joined = np.full(len(ids), -1)
    if found.prior.motion is not None:  # tags that images connect with no other tag form groups of their own
        own = np.where(start.group < 0, len(ids) + np.arange(len(ids)), start.group)
        joined[found.known] = np.unique(own[found.known], return_inverse=True)[1]
    return Survey(detected, known, found, faults, placed, loose, held_out, turns, joined, tuple(doubts))


def _believed(detected: DetectedTags, tag: Tag, known: PriorKnowledge) -> IntArray:
    """Ids of the tags in the prior knowledge and of the tags that were seen at least twice, ascending.

    Raises:
        InputError: no tag with one of these ids was seen, or an edge length is given for a tag that is neither in the
            prior knowledge nor seen.
    """
    often, counts = np.unique(detected.ids[detected.ids < tag.ids], return_counts=True)
    ids = np.union1d(known.ids, often[counts >= FEWEST_BELIEVED])
    if not np.isin(detected.ids, ids).any():
        raise InputError("detections must show a tag of the plan, or another tag at least twice.", "detections")
    if lacking := set(known.sizes) - {*detected.ids.tolist(), *known.ids.tolist()}:
        raise InputError(f"edges has tag {min(lacking)}, which is neither in detections nor in the plan.", "edges")
    return ids


def _turned(seen: Observations, known: PriorKnowledge) -> tuple[tuple[Observations, Prior, IntArray, Start], int]:
    """Find initial poses, and quarter turns: tags may hang rotated, and corners may be numbered from another corner.

    Returns:
        a tuple; number of sightings that agree with the initial poses. The tuple has the detections with renumbered
        corners, the prior with rotated tags, the quarter turns `(2, K)`, see `lmd.survey.world.turns_of`, and the
        initial poses.
    """
    given = replace(known.prior(seen.ids), motion=_motion(seen, known))
    turned, prior, turns = seen, given, np.zeros((2, len(seen.ids)), dtype=np.int64)
    for number in range(TURNING_STEPS + 1):
        start = initialise(turned.through(), prior)
        more = turns_of(start.poses.tags, start.group, prior, seen.detected.in_order)
        if number == TURNING_STEPS or not more.any():
            break
        turns = (turns + more) % 4
        turned, prior = seen.renumbered(turns[0]), replace(given, tags=given.tags @ QUARTERS[turns[1]])
    return (turned, prior, turns, start), start.agreed


def estimate_map(sightings: Sightings, prior: Prior, origin: int | None = None, start: Start | None = None) -> Estimate:
    """Estimate the poses of all tags, of the body at all frames, and of the cameras on the body together.

    Args:
        sightings: sightings; at least one frame must show two tags.
        prior: prior of the tags.
        origin: id of the tag whose frame is the world if no tag has a prior; None for the tag seen most often.
        start: initial poses; None for the poses of `initialise`.

    Raises:
        InputError: no two tags were seen together, the tag `origin` is not placed, or there are too few measured
            centres to determine a world frame.
    """
    start = initialise(sightings, prior) if start is None else start
    poses, group, prior = in_one_world(sightings, start, prior, origin)
    return Estimate(sightings, prior, poses, group).adjusted()


def _estimate(seen: Observations, prior: Prior, known: PriorKnowledge, start: Start) -> Estimate:
    """Estimate the map. If images leave groups of tags unconnected, a nearly constant velocity between frames joins
    groups where possible.
    """
    sightings = seen.through()
    found = estimate_map(sightings, prior, known.origin, start)
    motion = _steady(seen, known) if prior.motion is None and (found.group > 0).any() else None
    if motion is None:
        return found
    linked = estimate_map(sightings, replace(prior, motion=motion), known.origin, start)
    return linked if (linked.group == 0).sum() > (found.group == 0).sum() else found


def _motion(seen: Observations, known: PriorKnowledge) -> Motion | None:
    """Motion model that links frames from the beginning of the survey; None if frames are independent, or if links may
    be added later.
    """
    if known.odometry is not None:
        return Motion.by_odometry(seconds_of(seen.detected.times), known.odometry)
    counts = np.bincount(seen.through().frame)
    most_alone = 2 * (counts == 1).sum() > counts.sum()
    return _steady(seen, known) if known.steady or most_alone else None


def _steady(seen: Observations, known: PriorKnowledge) -> Motion | None:
    """Motion model of a nearly constant velocity; None if the user rules it out, or if no frames are near in time."""
    motion = Motion(seconds_of(seen.detected.times))
    near = np.isfinite(motion.times).all() and motion.follows(np.unique(seen.through().frame)).any()
    return motion if near and known.steady is not False else None


def _placed(found: Estimate, known: PriorKnowledge) -> tuple[BoolArray, BoolArray]:
    """Decide which tags are in the map.

    Returns:
        mask of the tags in the map, `(K,)`; mask of the tags that are left out only because their covariance is too
        large, `(K,)`.

    Raises:
        InputError: no tag is placed.
    """
    ids = found.sightings.ids
    agreed = found.used | agreeing(found.sightings, found.squares)
    fewest = np.where(np.isin(ids, known.ids), 1, FEWEST_BELIEVED)
    placed = (found.group == 0) & (found.sightings.counts(agreed) >= fewest)
    loose = np.zeros(len(ids), dtype=bool)
    if found.prior.motion is not None:
        places = found.poses.tags[(found.group == 0) & found.poses.known_tags, :3, 3]
        extent = float(np.linalg.norm(np.ptp(places, axis=0)))
        loose = placed & (found.sigmas > max(LOOSE_M, LOOSE_SHARE * extent))
    placed &= ~loose
    if not placed.any():
        text = f"no {FEWEST_BELIEVED} sightings of a tag agree, or no tag's pose relative to the others is accurate"
        raise InputError(f"detections: no tag is placed, as {text}: take more frames.", "detections")
    return placed, loose


def _held_out(found: Estimate) -> HeldOut | None:
    """Localise every fifth frame in a map that is made from the other frames; None if there are too few frames."""
    if len(found.frames) < FEWEST_FRAMES:
        return None
    every = found.sightings
    out = np.isin(every.frame, found.frames[HELD_OUT_STEP // 2 :: HELD_OUT_STEP])
    others = every.of(~out)
    rest = replace(found, sightings=others).adjusted(found.floor)
    known = out & found.used & (others.counts(rest.used) > 0)[every.tag]
    some = every.of(constraining(every, known, replace(found.prior, motion=None)))
    if not len(some):
        return None
    poses, there = resected(some, replace(found.poses, tags=rest.poses.tags), found.floor), np.unique(some.frame)
    away = np.linalg.norm((poses.frames - found.poses.frames)[there, :3, 3], axis=1)
    return HeldOut(np.sqrt(squared_errors(some, poses) / 4.0), away)
