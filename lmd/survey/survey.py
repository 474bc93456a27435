"""From detections to the map of the tags, all steps in order."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from lmd.core.checks import BoolArray, FloatArray, InputError, IntArray
from lmd.detection.corner_errors import CornerErrors
from lmd.geometry.camera import Camera
from lmd.geometry.trajectory import Trajectory
from lmd.mapping.detections import DetectedTags
from lmd.scene.deployment import Deployment
from lmd.scene.tag import Tag
from lmd.survey.between import Joined, joined_by
from lmd.survey.boards import Boards
from lmd.survey.estimate import Estimate, Start, estimate, started
from lmd.survey.faults import Faults, settled
from lmd.survey.fixed import off_fixed
from lmd.survey.held_out import Localised, held_out
from lmd.survey.intrinsics import Calibrated, judged, spreads
from lmd.survey.known import TAPE_SIGMA_M, Hanging, Points, levelled, poses_of
from lmd.survey.motion import Motion, seconds_of
from lmd.survey.refining import SMALL_SHARE, Optics, refined
from lmd.survey.residuals import EXACT_SIGMA, Prior, errors_at
from lmd.survey.sightings import Sightings, sightings_of
from lmd.survey.stages import Observer, Stage, unobserved
from lmd.survey.start import agreeing
from lmd.survey.turns import Turns, turns_of

# A tag of which nothing is known is believed if so many sightings agree where it hangs: ids are misread.
FEWEST_BELIEVED = 2
# A beginning with tags as they are turned may show that others are.
TURNING_STEPS = 3
# A tag of linked frames is not placed if it is known worse beside the others: metres, or share of the map's extent.
LOOSE_M, LOOSE_SHARE = 0.25, 0.01


@dataclass(frozen=True)
class Known:
    """What is known before anything is seen.

    Args:
        plan: where tags should hang; None for none.
        hanging: how far from there they may.
        fixed: where some hang exactly; None for none.
        points: where the centres of some are, as a tape measure says; None for none.
        boards: how those are to each other that were printed on one sheet; None for none.
        mounts: of the cameras to the body, which is the first of them, `(C, 4, 4)`; None where they are to be found.
        origin: id of the tag whose frame is the world where nothing else is known; None for the one seen most often.
        floor: ids of tags that lie on the floor: then z is up in that world, and 0 on the floor; none for no such.
        odometry: how the body moved, in a frame of its own; None where that is not known.
        steady: whether its velocity changes little between frames that are near in time; None to take that for granted
            where most sightings are alone in their frames, or where groups stay apart.

    Raises:
        InputError: the floor is named, and the world is that of a plan, of fixed tags or of points.
    """

    plan: Deployment | None = None
    hanging: Hanging = field(default_factory=Hanging)
    fixed: Deployment | None = None
    points: Points | None = None
    boards: Boards | None = None
    mounts: FloatArray | None = None
    origin: int | None = None
    floor: tuple[int, ...] = ()
    odometry: Trajectory | None = None
    steady: bool | None = None

    def __post_init__(self) -> None:
        if self.floor and any(known is not None for known in (self.plan, self.fixed, self.points)):
            raise InputError("floor says where z = 0 is, but the plan, or the tags that are known, do so too.", "floor")

    @property
    def ids(self) -> IntArray:
        """The tags that are named, ascending."""
        named = [known.ids for known in (self.plan, self.fixed, self.points) if known is not None]
        return np.unique(np.concatenate([np.empty(0, dtype=np.int64), *named]))

    def edges(self, ids: IntArray, tag: Tag) -> FloatArray:
        """The edges of tags, metres: their own where a plan or a map says so, else that of all."""
        edges = np.full(len(ids), tag.size)
        for known in (self.plan, self.fixed):
            if known is not None:
                own = dict(zip(known.ids.tolist(), known.edges.tolist(), strict=True))
                told = np.array([own.get(number, np.nan) for number in ids.tolist()])
                edges = np.where(np.isnan(told), edges, told)
        return edges

    def planned(self, ids: IntArray) -> FloatArray | None:
        """Planned poses, `(K, 4, 4)`; NaN for tags that are not in the plan, None without a plan."""
        if self.plan is None:
            return None
        poses = np.full((len(ids), 4, 4), np.nan)
        of, among = _shared(ids, self.plan.ids)
        poses[of] = poses_of(self.plan)[among]
        return poses

    def prior(self, ids: IntArray) -> Prior:
        """What is known of the tags with these `ids` `(K,)`, ascending, and of the cameras."""
        tags, information = np.tile(np.eye(4), (len(ids), 1, 1)), np.zeros((len(ids), 6))
        if self.plan is not None:
            of, among = _shared(ids, self.plan.ids)
            tags[of], information[of] = poses_of(self.plan)[among], self.hanging.deviations**-2.0
        if self.points is not None:
            of, among = _shared(ids, self.points.ids)
            tags[of, :3, 3], information[of, 3:] = self.points.places[among], TAPE_SIGMA_M**-2.0
        if self.fixed is not None:
            of, among = _shared(ids, self.fixed.ids)
            tags[of], information[of] = poses_of(self.fixed)[among], EXACT_SIGMA**-2.0
        return Prior(tags, information, None if self.boards is None else self.boards.among(ids), self.mounts)


def _shared(ids: IntArray, known: IntArray) -> tuple[IntArray, IntArray]:
    """Where tags that are known are among `ids`, and among themselves."""
    _, of, among = np.intersect1d(ids, known, return_indices=True)
    return of, among


@dataclass(frozen=True)
class Photograph:
    """A photograph that would help.

    Args:
        pose: of the (first) camera, to the world, `(4, 4)`.
        tags: that it shows, by their index.
        left: the root mean square standard deviation of the places of tags once it is taken, metres.
    """

    pose: FloatArray
    tags: IntArray
    left: float


@dataclass(frozen=True)
class Survey:
    """What came out, tags in the order of `found.sightings.ids`.

    Args:
        detected: what it was made from.
        known: what was known.
        found: the poses of all.
        faults: what did not fit.
        placed: which tags are in the map, `(K,)`.
        localised: frames held out, see `lmd.survey.held_out`.
        turns: how tags are turned beside their plan.
        off_fixed: how far photographs have tags from where they are fixed, `(K, 2)`, see `lmd.survey.fixed`.
        loose: which are in the map, but known too badly to be placed, `(K,)`.
        joined: what motion alone has joined; None where frames are not linked.
        calibrated: the cameras as the photographs have them.
        proposed: what to photograph next, see `lmd.survey.next_photographs`.
        interrupted: during which stage it was told to stop; what comes after is left out.
    """

    detected: DetectedTags
    known: Known
    found: Estimate
    faults: Faults
    placed: BoolArray
    localised: dict[str, Localised]
    turns: Turns
    off_fixed: FloatArray
    loose: BoolArray
    joined: Joined | None
    calibrated: tuple[Calibrated, ...]
    proposed: tuple[Photograph, ...] = ()
    interrupted: Stage | None = None

    @property
    def ids(self) -> IntArray:
        """The numbers of the tags."""
        return self.found.sightings.ids

    @property
    def used(self) -> IntArray:
        """How many sightings each tag is placed by, `(K,)`."""
        return np.asarray(np.bincount(self.found.sightings.tag[self.found.used], minlength=len(self.ids)))

    @property
    def planned(self) -> FloatArray | None:
        """See `Known.planned`."""
        return self.known.planned(self.ids)


def survey(
    detected: DetectedTags,
    cameras: Sequence[Camera],
    tag: Tag,
    errors: CornerErrors,
    known: Known,
    calibrate: bool | None = None,
    observer: Observer = unobserved,
) -> Survey:
    """Find where tags hang.

    Args:
        detected: what was seen of them.
        cameras: in the order of `detected.cameras`.
        tag: their family, and the edge of those of which nothing else is known.
        errors: what the detector's corners are off by.
        known: what else is known.
        calibrate: true if the intrinsics of the cameras are only a rough guess; false if they stay as they are given,
            which counts as little known as None, where they are refined.
        observer: told what is done, and asked whether to stop once there is a map; then the map so far is returned.

    Raises:
        InputError: the detections do not connect two tags, place none, or are of other tags or cameras; or tags that
            are fixed hang elsewhere beside each other.
    """
    often, counts = np.unique(detected.ids[detected.ids < tag.ids], return_counts=True)
    ids = np.union1d(known.ids, often[counts >= FEWEST_BELIEVED])
    if not np.isin(detected.ids, ids).any():
        raise InputError("detections has no tag of the plan, and no other one twice.", "detections")

    def sighted(through: Sequence[Optics]) -> Sightings:
        shifts = np.array([one.shifts for one in through])
        through_cameras = [one.camera for one in through]
        return sightings_of(shown, through_cameras, ids, known.edges(ids, tag), tag.modules, errors, shifts)

    shown, given = detected, tuple(Optics(camera) for camera in cameras)
    sightings = sighted(given)
    prior = replace(known.prior(ids), motion=_motion(detected, sightings, known))
    turns = Turns.none(len(ids))
    observer(Stage.PLACING, 0, 0)
    for _ in range(TURNING_STEPS):
        start = started(sightings, prior)
        more = turns_of(start.poses, start.group, prior, detected.in_order)
        if not more:
            break
        turns = turns + more
        shown = detected.renumbered(ids, turns.renumbered)
        sightings, prior = sighted(given), turns.planned(replace(known.prior(ids), motion=prior.motion))
    else:
        start = started(sightings, prior)
    observer(Stage.ADJUSTING, 0, 0)
    found = _estimate(sightings, prior, known, start, detected)
    shift = [errors.inward_spread, SMALL_SHARE * errors.inward_spread]
    spread = [np.append(spreads(camera, bool(calibrate)), shift) for camera in cameras]
    found, optics = refined(found, given, spread, sighted, calibrate is False, observer)
    observer(Stage.CHECKING, 0, 0)
    found, faults = settled(found)
    away = off_fixed(found, start)
    if known.floor:
        first = int(np.flatnonzero(found.prior.information.any(axis=1))[0])
        found = found.moved(levelled(found.poses.tags, np.flatnonzero(np.isin(ids, known.floor)), first))
    agreed = found.used | agreeing(found.sightings, errors_at(found.sightings, found.poses))
    counts = np.bincount(found.sightings.tag[agreed], minlength=len(ids))
    placed = (found.group == 0) & (counts >= np.where(np.isin(ids, known.ids), 1, FEWEST_BELIEVED))
    is_linked = found.prior.motion is not None
    loose = placed & (_hardly_known(found) if is_linked else np.zeros(len(ids), dtype=bool))
    placed &= ~loose
    if not placed.any() and loose.any():
        best = float(np.nanmin(found.sigmas[loose]))
        raise InputError(f"detections: no tag is known to better than {best:.2g} m beside the others.", "detections")
    if not placed.any():
        text = f"detections: no tag is placed, as no {FEWEST_BELIEVED} sightings of one agree: more frames are needed."
        raise InputError(text, "detections")
    localised = {} if observer(Stage.HOLDING_OUT, 0, 0) else held_out(found, known.planned(ids))
    through = tuple(
        judged(camera, one.camera, one.shifts[0], own[: len(off), : len(off)] * np.outer(off, off))
        for camera, one, own, off in zip(cameras, optics, found.lenses, spread, strict=True)
    )
    joined = joined_by(found, start.group) if is_linked else None
    return Survey(detected, known, found, faults, placed, localised, turns, away, loose, joined, through)


def _motion(detected: DetectedTags, sightings: Sightings, known: Known) -> Motion | None:
    """The motion that links frames from the beginning; None where they are independent, or are until it is needed."""
    if known.odometry is not None:
        return Motion.by_odometry(seconds_of(detected.times), known.odometry)
    counts = np.bincount(sightings.frame)
    most_alone = 2 * (counts == 1).sum() > len(sightings)
    return _steady(detected, sightings, known) if known.steady or most_alone else None


def _steady(detected: DetectedTags, sightings: Sightings, known: Known) -> Motion | None:
    """A steady motion; None if it is ruled out, or no frames have times that are near to each other."""
    motion = Motion.steady(seconds_of(detected.times))
    near = np.isfinite(motion.times).all() and motion.follows(np.unique(sightings.frame)).any()
    return motion if near and known.steady is not False else None


def _estimate(sightings: Sightings, prior: Prior, known: Known, start: Start, detected: DetectedTags) -> Estimate:
    """The estimate; groups that images leave apart are joined by a steady motion, where it joins any."""
    found = estimate(sightings, prior, known.origin, start)
    motion = _steady(detected, sightings, known) if prior.motion is None and (found.group > 0).any() else None
    if motion is None:
        return found
    linked = estimate(sightings, replace(prior, motion=motion), known.origin, start)
    return linked if (linked.group == 0).sum() > (found.group == 0).sum() else found


def _hardly_known(found: Estimate) -> BoolArray:
    """Tags whose places are known too badly beside the others, `(K,)`."""
    places = found.poses.tags[found.group == 0, :3, 3]
    extent = float(np.linalg.norm(np.ptp(places[np.isfinite(places[:, 0])], axis=0)))
    return np.asarray(found.sigmas > max(LOOSE_M, LOOSE_SHARE * extent))
