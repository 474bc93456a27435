"""Survey: all steps from detections to a map of tags, in order.

*Faults*: if the outliers of a tag (`Estimate.misfits`) agree on a second pose, the tag was moved, or two tags share the
id. If the outliers do not agree, the id was misread. A tag has a wrong size if its sightings agree on another size,
with all frames fixed.

*Held-out frames* are localised in a map from the other frames, and in the plan.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from enum import Enum
from functools import partial
from typing import NamedTuple

import numpy as np
from threadpoolctl import threadpool_limits

from lmd.adjust.candidates import measured_mounts, single_poses
from lmd.adjust.corners import agreeing, resected, squared_errors
from lmd.adjust.estimate import FEWEST_FRAMES, ONE_THREAD, Estimate, constraining
from lmd.adjust.faults import FEWEST_SIGHTINGS, Faults, odd_sizes, with_sizes, without_faults
from lmd.adjust.intrinsics import Calibrated, Optics
from lmd.adjust.motion import Motion, seconds_of
from lmd.adjust.prior import Prior
from lmd.adjust.refinement import edge_doubts, refine, with_lenses
from lmd.adjust.sightings import Observations, Sightings, outside_doubts
from lmd.core.checks import BoolArray, FloatArray, InputError, IntArray
from lmd.detection.corner_errors import CornerErrors
from lmd.formats.detections import DetectedTags
from lmd.geometry.camera import Camera
from lmd.scene.tag import Tag
from lmd.survey.knowledge import PriorKnowledge
from lmd.survey.start import Start, in_one_world, initialise
from lmd.survey.world import Turns, errors_of_fixed, motion_to_floor, turns_of

FEWEST_BELIEVED = 2  # minimum number of agreeing sightings to accept a tag without prior, as ids may be misread
TURNING_STEPS = 3  # maximum number of initialisations; known turns may reveal further turns
# With linked frames, a tag is not placed if its standard deviation relative to the others exceeds `LOOSE_M`, metres,
# and the share `LOOSE_SHARE` of the map's extent.
LOOSE_M, LOOSE_SHARE = 0.25, 0.01
LOOSE_SIGMA = 1.0  # prior standard deviation, metres and rad, of fixed tags in the map with which they are compared
HELD_OUT_STEP = 5  # every fifth frame is held out


class SurveyStage(Enum):
    """Stages of a survey, in order."""

    PLACING = "placing tags"
    ADJUSTING = "adjusting"
    REFINING = "refining the cameras"
    COMPARING = "comparing blocks of time"
    CHECKING = "looking for faulty tags"
    HOLDING_OUT = "holding frames out"
    AUDITING = "comparing with predictions"

    @property
    def has_map(self) -> bool:
        """True if a map exists at this stage."""
        return self not in (SurveyStage.PLACING, SurveyStage.ADJUSTING)

    @property
    def has_final_map(self) -> bool:
        """True if neither this stage nor a later stage changes the map."""
        return self.has_map and self not in (SurveyStage.REFINING, SurveyStage.COMPARING)


# Called with the stage, the number of finished steps, and the maximum number of steps, 0 if unknown. The observer
# returns True to stop with the present map, and may raise an error if there is no map yet.
Observer = Callable[[SurveyStage, int, int], bool]


class HeldOut(NamedTuple):
    """Held-out frames, localised in a map."""

    errors: FloatArray
    """`(n,)` RMS reprojection errors of the sightings in held-out frames, pixels."""
    shifts: FloatArray
    """Distance of each frame from its position in the whole survey, metres, `(M,)`."""


@dataclass(frozen=True)
class Survey:
    """Result of a survey; tags in the order of `found.sightings.ids`."""

    detected: DetectedTags
    """Detections."""
    known: PriorKnowledge
    """Prior knowledge."""
    found: Estimate
    """Poses and covariances."""
    faults: Faults
    """Tags that were moved, share their id, or have a wrong size or id."""
    placed: BoolArray
    """`(K,)` True for tags in the map."""
    loose: BoolArray
    """`(K,)` True for tags that are not placed because their covariance is too large."""
    localised: dict[str, HeldOut]
    """Held-out frames localised in the map, `measured`, and in the plan, `planned`; empty if there are too few frames.
    """
    turns: Turns
    """Quarter turns of tags relative to the plan."""
    off_fixed: FloatArray
    """`(K, 2)` errors of fixed tags, see `lmd.survey.world.errors_of_fixed`."""
    joined: IntArray
    """Group of each tag of the map by images alone, `(K,)`, if motion links the frames; else -1."""
    doubts: tuple[str, ...] = ()
    """Sentences on contradictions to the photographs: calibrations, mounts, the tags' edge."""
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

    @property
    def planned(self) -> FloatArray:
        """See `PriorKnowledge.planned`."""
        return self.known.planned(self.ids)

    @property
    def calibrated(self) -> tuple[Calibrated, ...]:
        """Cameras as estimated from photographs."""
        return self.found.calibrated


def survey(
    detected: DetectedTags,
    cameras: Sequence[Camera],
    tag: Tag,
    errors: CornerErrors,
    known: PriorKnowledge,
    calibrate: bool | None = None,
    observer: Observer = lambda _stage, _done, _most: False,
) -> Survey:
    """Estimate the map of the tags in detections.

    Args:
        detected: detections.
        cameras: cameras in the order of `detected.cameras`.
        tag: family of the tags, and edge of the tags for which `known` has no edge.
        errors: errors of the detector's corners.
        known: prior knowledge.
        calibrate: True if the intrinsics are a rough guess; None to refine a calibration; False to keep the
            calibration, while its uncertainty still enters the covariance.
        observer: called at each stage, see `Observer`.

    Raises:
        InputError: the detections connect no two tags, place no tag, or are of other tags or cameras; or fixed tags
            contradict each other.
    """
    ids = _believed(detected, tag, known)
    seen = Observations(detected, tuple(map(Optics, cameras)), ids, known.edges(ids, tag), tag.modules, errors)
    observer(SurveyStage.PLACING, 0, 0)
    seen, prior, turns, start, odd = _started(seen, known)
    observer(SurveyStage.ADJUSTING, 0, 0)
    found = _estimate(seen, prior, known, start)
    found, odd = with_sizes(found, odd, others=0.0, tried=bool(odd.any()))
    on_round, on_block = (partial(observer, stage) for stage in (SurveyStage.REFINING, SurveyStage.COMPARING))
    found = refine(with_lenses(found, seen, bool(calibrate)), calibrate is False, on_round, on_block)
    doubts = outside_doubts(seen)
    if not doubts and known.mounts is not None:
        _, doubts = measured_mounts(start.views(seen.through()), known.mounts)
    doubts += [] if calibrate is False or doubts else edge_doubts(found)
    observer(SurveyStage.CHECKING, 0, 0)
    with threadpool_limits(limits=ONE_THREAD):
        found, faults = without_faults(found, odd)
        off_fixed = _off_fixed(found, start)
    if known.floor:
        first = int(np.flatnonzero(found.prior.known)[0])
        found = found.moved(motion_to_floor(found.poses.tags, np.flatnonzero(np.isin(ids, known.floor)), first))
    placed, loose = _placed(found, known)
    localised = {} if observer(SurveyStage.HOLDING_OUT, 0, 0) else _held_out(found, known.planned(ids))
    joined = np.full(len(ids), -1)
    if found.prior.motion is not None:  # tags that images connect with no other tag form groups of their own
        own = np.where(start.group < 0, len(ids) + np.arange(len(ids)), start.group)
        joined[found.known] = np.unique(own[found.known], return_inverse=True)[1]
    return Survey(detected, known, found, faults, placed, loose, localised, turns, off_fixed, joined, tuple(doubts))


def _believed(detected: DetectedTags, tag: Tag, known: PriorKnowledge) -> IntArray:
    """Ids of the tags in the prior knowledge and of the tags that were seen at least twice, ascending.

    Raises:
        InputError: there is no such tag, or an edge is given for a tag that is neither known nor seen.
    """
    often, counts = np.unique(detected.ids[detected.ids < tag.ids], return_counts=True)
    ids = np.union1d(known.ids, often[counts >= FEWEST_BELIEVED])
    if not np.isin(detected.ids, ids).any():
        raise InputError("detections show no tag of the plan, and no other tag twice.", "detections")
    if lacking := set(known.sizes) - {*detected.ids.tolist(), *known.ids.tolist()}:
        raise InputError(f"edges has tag {min(lacking)}, which is neither in detections nor in the plan.", "edges")
    return ids


def _started(seen: Observations, known: PriorKnowledge) -> tuple[Observations, Prior, Turns, Start, BoolArray]:
    """Initial poses, detections and prior after quarter turns of tags, these turns, and the mask of the tags with
    another edge than stated, `(K,)`. Of the stated and the estimated edges, those with which more sightings agree are
    taken.
    """
    best = *_turned(seen, known), np.zeros(len(seen.ids), dtype=bool)
    apart = best[0].through().with_separate_cameras()
    factors, odd = odd_sizes(apart, single_poses(apart).poses[:, 0])
    if odd.any():
        other = *_turned(replace(seen, edges=seen.edges * factors), known), odd
        counts = [one[3].agreed(one[0].through()) for one in (best, other)]
        best = other if counts[1] > counts[0] + FEWEST_SIGHTINGS else best
    return best


def _turned(seen: Observations, known: PriorKnowledge) -> tuple[Observations, Prior, Turns, Start]:
    """Initial poses, detections and prior after quarter turns of tags, and these turns."""
    given = replace(known.prior(seen.ids), motion=_motion(seen, known))
    turned, prior, turns = seen, given, Turns(*np.zeros((3, len(seen.ids)), dtype=np.int64))
    for _ in range(TURNING_STEPS):
        start = initialise(turned.through(), prior)
        more = turns_of(start.poses.tags, start.group, prior, seen.detected.in_order)
        if not np.any(more):
            return turned, prior, turns, start
        turns = Turns(*(np.add(turns, more) % 4))
        turned, prior = seen.renumbered(turns.renumbered), turns.applied(given)
    return turned, prior, turns, initialise(turned.through(), prior)


def estimate_map(sightings: Sightings, prior: Prior, origin: int | None = None, start: Start | None = None) -> Estimate:
    """Estimate the poses of all tags, frames and mounts together.

    Args:
        sightings: sightings; at least one frame must show two tags.
        prior: prior of the tags.
        origin: id of the tag whose frame is the world if no tag has a prior; None for the tag seen most often.
        start: initial poses; None for the poses of `initialise`.

    Raises:
        InputError: no two tags were seen together, `origin` is not placed, or known centres are too few for a world.
    """
    start = initialise(sightings, prior) if start is None else start
    with threadpool_limits(limits=ONE_THREAD):
        poses, group, prior = in_one_world(sightings, start, prior, origin)
        return Estimate.adjusted_from(sightings, prior, poses, group)


def _estimate(seen: Observations, prior: Prior, known: PriorKnowledge, start: Start) -> Estimate:
    """Estimate the map; where possible, a nearly constant velocity joins groups that images leave unconnected."""
    sightings = seen.through()
    found = estimate_map(sightings, prior, known.origin, start)
    motion = _steady(seen, known) if prior.motion is None and (found.group > 0).any() else None
    if motion is None:
        return found
    linked = estimate_map(sightings, replace(prior, motion=motion), known.origin, start)
    return linked if (linked.group == 0).sum() > (found.group == 0).sum() else found


def _motion(seen: Observations, known: PriorKnowledge) -> Motion | None:
    """Motion that links frames from the beginning; None if frames are independent, or if links may be added later."""
    if known.odometry is not None:
        return Motion.by_odometry(seconds_of(seen.detected.times), known.odometry)
    counts = np.bincount(seen.through().frame)
    most_alone = 2 * (counts == 1).sum() > counts.sum()
    return _steady(seen, known) if known.steady or most_alone else None


def _steady(seen: Observations, known: PriorKnowledge) -> Motion | None:
    """Motion at a nearly constant velocity; None if the user rules it out, or if no frames are near in time."""
    motion = Motion(seconds_of(seen.detected.times))
    near = np.isfinite(motion.times).all() and motion.follows(np.unique(seen.through().frame)).any()
    return motion if near and known.steady is not False else None


def _off_fixed(found: Estimate, start: Start) -> FloatArray:
    """Errors of fixed tags, see `errors_of_fixed`, from a map with a very loose prior of these tags."""
    known = found.prior.exact & (found.group == 0)
    if known.sum() < 2:
        return np.full((len(known), 2), np.nan)
    loose = replace(found.prior, information=np.where(known[:, None], LOOSE_SIGMA**-2.0, np.zeros(6)))
    poses, group, _ = in_one_world(found.sightings, start, found.prior, None)
    return errors_of_fixed(found, Estimate.adjusted_from(found.sightings, loose, poses, group))


def _placed(found: Estimate, known: PriorKnowledge) -> tuple[BoolArray, BoolArray]:
    """Mask of the tags of the map, `(K,)`, and mask of the tags left out only because their covariance is too large,
    `(K,)`.

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
        text = f"no tag is placed, as no {FEWEST_BELIEVED} sightings of a tag agree: take more frames."
        if loose.any():
            text = f"no tag is known to better than {float(np.nanmin(found.sigmas[loose])):.2g} m among the others."
        raise InputError(f"detections: {text}", "detections")
    return placed, loose


def _held_out(found: Estimate, planned: FloatArray) -> dict[str, HeldOut]:
    """Localise every fifth frame in a map from the other frames, and by the `planned` poses of tags, `(K, 4, 4)`."""
    if len(found.frames) < FEWEST_FRAMES:
        return {}
    every, result = found.sightings, {}
    out = np.isin(every.frame, found.frames[HELD_OUT_STEP // 2 :: HELD_OUT_STEP])
    with threadpool_limits(limits=ONE_THREAD):
        others = every.of(~out)
        rest = replace(found, sightings=others).adjusted(found.floor)
        measured = np.where((others.counts(rest.used) > 0)[:, None, None], rest.poses.tags, np.nan)
        for name, tags in (("measured", measured), ("planned", planned)):
            known = out & found.used & np.isfinite(tags[every.tag, 0, 0])
            some = every.of(constraining(every, known, Prior(tags, found.prior.information)))
            if len(some):
                poses, there = resected(some, replace(found.poses, tags=tags), found.floor), np.unique(some.frame)
                away = np.linalg.norm((poses.frames - found.poses.frames)[there, :3, 3], axis=1)
                result[name] = HeldOut(np.sqrt(squared_errors(some, poses) / 4.0), away)
    return result
