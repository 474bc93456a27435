"""Survey: all steps from detections to a map of tags, in order."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from enum import Enum
from functools import partial

import numpy as np
from threadpoolctl import threadpool_limits

from lmd.adjust.candidates import agreeing, single_poses
from lmd.adjust.estimate import FLOOR_PIXELS, ONE_THREAD, Estimate, adjust
from lmd.adjust.intrinsics import Calibrated, Optics
from lmd.adjust.motion import Motion, seconds_of
from lmd.adjust.mounts import measured_mounts
from lmd.adjust.prior import Prior
from lmd.adjust.refinement import Refined, edge_doubts, refine
from lmd.adjust.second_places import FEWEST_SIGHTINGS
from lmd.adjust.sightings import Observations, Sightings, outside_doubts
from lmd.adjust.sizes import odd_sizes, with_sizes
from lmd.core.checks import BoolArray, FloatArray, InputError, IntArray
from lmd.detection.corner_errors import CornerErrors
from lmd.formats.detections import DetectedTags
from lmd.geometry.camera import Camera
from lmd.scene.tag import Tag
from lmd.survey.faults import Faults, errors_of_fixed, find_faults
from lmd.survey.gauge import into_world, motion_to_floor
from lmd.survey.groups import JoinedGroups, joined_groups
from lmd.survey.held_out import HeldOut, hold_out
from lmd.survey.initialisation import Start, initialise, of_body
from lmd.survey.knowledge import PriorKnowledge
from lmd.survey.turns import Turns, turns_of

FEWEST_BELIEVED = 2  # minimum number of agreeing sightings to accept a tag without prior, as ids may be misread
TURNING_STEPS = 3  # maximum number of initialisations; further turns may be found once other turns are known
# With linked frames, a tag is not placed if its standard deviation relative to the others exceeds `LOOSE_M`, metres,
# and the share `LOOSE_SHARE` of the map's extent.
LOOSE_M, LOOSE_SHARE = 0.25, 0.01


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
        """True if this stage and later stages do not change the map."""
        return self.has_map and self not in (SurveyStage.REFINING, SurveyStage.COMPARING)


# Called with the stage, the number of its finished steps, and its maximum number of steps, 0 if unknown. The observer
# returns True to stop with the present map, and may raise an error if there is no map yet.
Observer = Callable[[SurveyStage, int, int], bool]


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
    """Tags that were moved, hang twice, or have a wrong size or id."""
    placed: BoolArray
    """`(K,)` True for tags in the map."""
    localised: dict[str, HeldOut]
    """Held-out frames, see `lmd.survey.held_out.hold_out`."""
    turns: Turns
    """Quarter turns of tags beside their plan."""
    off_fixed: FloatArray
    """`(K, 2)` errors of fixed tags, see `lmd.survey.faults.errors_of_fixed`."""
    loose: BoolArray
    """`(K,)` True for tags that are not placed because their covariance is too large."""
    joined: JoinedGroups | None
    """Groups that only motion joins; None if frames are not linked."""
    calibrated: tuple[Calibrated, ...]
    """Cameras as estimated from photographs."""
    doubts: tuple[str, ...] = ()
    """Sentences on what contradicts the photographs: calibrations, mounts, the tags' edge."""
    interrupted: SurveyStage | None = None
    """Stage at which the survey was stopped; results of later stages are missing."""

    @property
    def ids(self) -> IntArray:
        """Ids of the tags, `(K,)`."""
        return self.found.sightings.ids

    @property
    def used(self) -> IntArray:
        """Number of inliers of each tag, `(K,)`."""
        return self.found.sightings.counts(self.found.used)

    @property
    def planned(self) -> FloatArray | None:
        """See `PriorKnowledge.planned`."""
        return self.known.planned(self.ids)


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
        InputError: the detections do not connect two tags, place no tag, or belong to other tags or cameras; or fixed
            tags contradict each other.
    """
    ids = _believed(detected, tag, known)
    seen = Observations(detected, tuple(map(Optics, cameras)), ids, known.edges(ids, tag), tag.modules, errors)
    observer(SurveyStage.PLACING, 0, 0)
    seen, prior, turns, start, odd = _started(seen, known)
    observer(SurveyStage.ADJUSTING, 0, 0)
    found = _estimate(seen, prior, known, start)
    found, odd = with_sizes(found, odd, others=0.0, tried=bool(odd.any()))
    on_round, on_block = (partial(observer, stage) for stage in (SurveyStage.REFINING, SurveyStage.COMPARING))
    refined = refine(Refined.begin(found, seen, bool(calibrate)), calibrate is False, on_round, on_block)
    doubts = outside_doubts(seen) or _mount_doubts(seen, start, known)
    doubts += [] if calibrate is False or doubts else edge_doubts(refined, bool(calibrate))
    observer(SurveyStage.CHECKING, 0, 0)
    found, faults = find_faults(refined.found, odd)
    off_fixed = errors_of_fixed(found, start)
    if known.floor:
        first = int(np.flatnonzero(found.prior.information.any(axis=1))[0])
        found = found.moved(motion_to_floor(found.poses.tags, np.flatnonzero(np.isin(ids, known.floor)), first))
    placed, loose = _placed(found, known)
    localised = {} if observer(SurveyStage.HOLDING_OUT, 0, 0) else hold_out(found, known.planned(ids))
    calibrated = replace(refined, found=found).calibrated
    joined = None if found.prior.motion is None else joined_groups(found, start.group)
    return Survey(
        detected, known, found, faults, placed, localised, turns, off_fixed, loose, joined, calibrated, tuple(doubts)
    )


def _believed(detected: DetectedTags, tag: Tag, known: PriorKnowledge) -> IntArray:
    """Ids of the tags of the prior knowledge and of those that were seen twice, ascending.

    Raises:
        InputError: there is none, or an edge is given of a tag that is neither known nor seen.
    """
    often, counts = np.unique(detected.ids[detected.ids < tag.ids], return_counts=True)
    ids = np.union1d(known.ids, often[counts >= FEWEST_BELIEVED])
    if not np.isin(detected.ids, ids).any():
        raise InputError("detections has no tag of the plan, and no other one twice.", "detections")
    if lacking := set(known.sizes) - {*detected.ids.tolist(), *known.ids.tolist()}:
        raise InputError(f"edges has tag {min(lacking)}, which no detection and no plan has.", "edges")
    return ids


def _started(seen: Observations, known: PriorKnowledge) -> tuple[Observations, Prior, Turns, Start, BoolArray]:
    """Initial poses, with detections and prior after quarter turns of tags, these turns, and the mask of the tags with
    another edge than stated, `(K,)`: those by which more sightings agree.
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
    """Initial poses, with detections and prior after quarter turns of tags, and these turns."""
    sightings, ids, detected = seen.through(), seen.ids, seen.detected
    prior, turns = replace(known.prior(ids), motion=_motion(seen, known)), Turns.none(len(ids))
    for _ in range(TURNING_STEPS):
        start = initialise(sightings, prior)
        more = turns_of(start.poses, start.group, prior, detected.in_order)
        if not more:
            return seen, prior, turns, start
        turns = turns + more
        seen = replace(seen, detected=detected.renumbered(ids, turns.renumbered))
        sightings, prior = seen.through(), turns.applied(replace(known.prior(ids), motion=prior.motion))
    return seen, prior, turns, initialise(sightings, prior)


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
        poses, group, prior = into_world(sightings, *of_body(sightings, start, prior), origin)
        return adjust(sightings, prior, poses, group, FLOOR_PIXELS)


def _estimate(seen: Observations, prior: Prior, known: PriorKnowledge, start: Start) -> Estimate:
    """Estimate the map; groups that images leave unconnected are joined by a nearly constant velocity where
    possible.
    """
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
    """Nearly constant velocity; None if the user rules it out, or if no frames are near in time."""
    motion = Motion.steady(seconds_of(seen.detected.times))
    near = np.isfinite(motion.times).all() and motion.follows(np.unique(seen.through().frame)).any()
    return motion if near and known.steady is not False else None


def _mount_doubts(seen: Observations, start: Start, known: PriorKnowledge) -> list[str]:
    """Sentences on cameras that are mounted elsewhere than the user says, by frames whose tags are in one group."""
    if known.mounts is None:
        return []
    sightings = seen.through()
    apart, views = sightings.with_separate_cameras(), start.poses.frames.copy()
    group = np.full(len(views), -1)
    group[apart.frame] = start.group[apart.tag]
    views[group != np.tile(group[: sightings.frames], sightings.cameras)] = np.nan
    return measured_mounts(views.reshape(-1, sightings.frames, 4, 4), known.mounts)[1]


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
        places = found.poses.tags[found.group == 0, :3, 3]
        extent = float(np.linalg.norm(np.ptp(places[np.isfinite(places[:, 0])], axis=0)))
        loose = placed & (found.sigmas > max(LOOSE_M, LOOSE_SHARE * extent))
    placed &= ~loose
    if not placed.any() and loose.any():
        best = float(np.nanmin(found.sigmas[loose]))
        raise InputError(f"detections: no tag is known to better than {best:.2g} m beside the others.", "detections")
    if not placed.any():
        text = f"detections: no tag is placed, as no {FEWEST_BELIEVED} sightings of one agree: more frames are needed."
        raise InputError(text, "detections")
    return placed, loose
