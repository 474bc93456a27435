"""Faults: tags that were moved, hang twice, have a wrong size or id, or are fixed at a wrong pose.

If the outliers of a tag (`Estimate.misfits`) agree on a second pose, the tag was moved or two tags have its id. If they
do not agree, the id was misread. A tag has a wrong size if its sightings agree on another size, with all frames fixed.
A fixed tag is compared with a map in which its pose is not fixed.
"""

from dataclasses import dataclass, replace

import numpy as np
from threadpoolctl import threadpool_limits

from lmd.core.checks import BoolArray, FloatArray, InputError, IntArray
from lmd.geometry.se3 import angle_between, exp
from lmd.survey.gauge import align_tags, into_world
from lmd.survey.initialisation import FLOOR_PIXELS, Placing, agreeing
from lmd.survey.map_estimate import ONE_THREAD, Estimate, Start, adjust, fitting, of_body
from lmd.survey.residuals import Poses, Reprojection, normal_equations, solved, squared_errors, student_weight, sums_by
from lmd.survey.sightings import Sightings
from lmd.survey.single_poses import single_poses

# Minimum number of outliers, and minimum share of a tag's outliers, that agree on a second pose.
FEWEST_SIGHTINGS, LEAST_SHARE = 3, 0.5
APART_EDGES, TURNED_RAD = 0.2, 0.3  # least distance, in edges, and least rotation, rad, between two poses that differ
OUT_OF_ORDER_SHARE = 0.1  # maximum share of frames before and after a move that are out of order
# A size is wrong if it differs from the estimated size by the share `SIZE_DIFFERS` and by `SIZE_SIGMAS` standard
# deviations, and if the share `SIZE_SHARE` of the sightings fits the estimated size.
SIZE_DIFFERS, SIZE_SIGMAS, SIZE_SHARE = 0.02, 5.0, 0.5
SIZE_STEPS = 15  # Gauss-Newton steps for sizes
LOOSE_SIGMA = 1.0  # prior standard deviation, metres and rad, of fixed tags in the map used for comparison
# A fixed tag is off if its error exceeds `SIGMAS` standard deviations, and also `OFF_M`, metres, or `OFF_RAD`, rad.
SIGMAS, OFF_M, OFF_RAD = 5.0, 0.001, 0.02
MOST_M, MOST_RAD = 0.02, 0.15  # maximum error of a fixed tag, metres and rad; above it the survey is refused


@dataclass(frozen=True)
class SecondPlace:
    """Second pose of a tag."""

    tag: int
    """Index of the tag."""
    pose: FloatArray
    """`(4, 4)` pose, tag to world."""
    sightings: int
    """Number of sightings that agree with the second pose."""
    moved: int | None
    """Index of the frame from which the tag hangs at the later pose; None if frames show the tag at both poses in
    turns, which means that two tags have its id.
    """
    later: bool
    """True if the second pose is the later pose."""


@dataclass(frozen=True)
class Faults:
    """Faults of a survey; tags are named by their index."""

    second_places: tuple[SecondPlace, ...]
    """Second poses of tags that were moved or hang twice."""
    sizes: dict[int, float]
    """Estimated edges of tags with a wrong size, metres."""
    misread: IntArray
    """`(K,)` number of sightings with each id that fit no pose of the tag."""


def find_faults(found: Estimate) -> tuple[Estimate, Faults]:
    """Find faults, and correct sizes and moved tags: a moved tag gets the later of its poses.

    Returns:
        corrected estimate, and all faults.
    """
    with threadpool_limits(limits=ONE_THREAD):
        sizes, poses = _sizes(found)
        if sizes:
            edges, group = found.sightings.edges.copy(), found.group.copy()
            edges[list(sizes)], group[list(sizes)] = list(sizes.values()), 0
            found = _adjusted(replace(found, sightings=replace(found.sightings, edges=edges), group=group), poses)
        error = squared_errors(found.sightings, found.poses)
        gross = found.misfits & np.isfinite(error) & ~agreeing(found.sightings, error)
        places = second_places(found, gross)
        last = [place for place in places if place.moved is not None and place.later]
        misread = found.sightings.counts(gross)
        for place in places:
            misread[place.tag] = max(misread[place.tag] - place.sightings, 0)
        if last:
            tags = found.poses.tags.copy()
            tags[[place.tag for place in last]] = [place.pose for place in last]
            found = _adjusted(found, replace(found.poses, tags=tags))
    return found, Faults(tuple(places), sizes, misread)


def _adjusted(found: Estimate, poses: Poses) -> Estimate:
    """Adjust an estimate again, from `poses`."""
    return adjust(found.sightings, found.prior, poses, found.group, found.floor, found.inflation)


def placed_beside(poses: Poses, some: Sightings, fewest: int, share: float = LEAST_SHARE) -> Poses:
    """Poses of the tags of some sightings, see `Sightings.with_separate_cameras`, with all frames of `poses` fixed."""
    placing = Placing(some, single_poses(some))
    placing.frames = np.asarray((poses.frames[None] @ poses.mounts[:, None]).reshape(-1, 4, 4))
    placing.place(np.arange(len(some)), by_frame=False, fewest=fewest, share=share)
    return placing.poses


def second_places(found: Estimate, gross: BoolArray) -> list[SecondPlace]:
    """Second poses of tags: poses on which several of the `gross` outliers, mask `(N,)`, agree."""
    counts = found.sightings.counts(gross)
    often = counts[found.sightings.tag] >= FEWEST_SIGHTINGS
    some = found.sightings.of(np.flatnonzero(gross & often)).with_separate_cameras()
    if not len(some):
        return []
    poses = placed_beside(found.poses, some, FEWEST_SIGHTINGS)
    agree, tags = fitting(some, squared_errors(some, poses), found.floor), poses.tags
    places = []
    for tag in np.unique(some.tag).tolist():
        there = some.frame[agree & (some.tag == tag)] % found.sightings.frames
        if len(there) < max(FEWEST_SIGHTINGS, LEAST_SHARE * counts[tag]):
            continue
        here = found.sightings.frame[found.used & (found.sightings.tag == tag)]
        own = found.poses.tags[tag]
        away = np.linalg.norm(own[:3, 3] - tags[tag, :3, 3]) / found.sightings.edges[tag]
        if not here.size or (away < APART_EDGES and angle_between(own, tags[tag]) < TURNED_RAD):
            continue
        later = bool(np.median(there) > np.median(here))
        moved = _change(here, there) if later else _change(there, here)
        places.append(SecondPlace(tag, tags[tag], len(there), moved, later))
    return places


def _change(first: IntArray, second: IntArray) -> int | None:
    """Frame at which a tag was moved: the `first` frames come before this frame, the `second` frames after; None if
    first and second frames are mixed.
    """
    begins = int(np.quantile(second, OUT_OF_ORDER_SHARE / 2.0))
    mixed = (first >= begins).mean() > OUT_OF_ORDER_SHARE
    mixed |= np.intersect1d(first, second).size > OUT_OF_ORDER_SHARE * len(first)
    return None if mixed else begins


def _sizes(found: Estimate) -> tuple[dict[int, float], Poses]:
    """Edges of tags with a wrong size, metres, and poses that fit these edges."""
    sightings = found.sightings
    known = np.isfinite(found.poses.frames[sightings.frame, 0, 0]) & (found.group[sightings.tag] <= 0)
    some = sightings.of(np.flatnonzero(known))
    tags, count = found.poses.tags.copy(), len(found.group)
    astray = sightings.counts(found.used) == 0
    lost = np.flatnonzero(astray[some.tag])
    if lost.size:
        apart = some.of(lost).with_separate_cameras()
        tags[astray] = placed_beside(found.poses, apart, fewest=0, share=0.0).tags[astray]
    edges, growth, summed = some.edges, np.zeros(count), sums_by(some.tag, count)
    for _ in range(SIZE_STEPS):
        scaled = replace(some, edges=edges * np.exp(growth))
        at = Reprojection(scaled, *replace(found.poses, tags=tags).of(some))
        variance = some.variance(found.floor)
        weight = student_weight(at.squared / variance) / variance
        jacobian = np.concatenate([at.by_tag, at.by_size], axis=-1)
        matrix, right = normal_equations(jacobian, at.error, weight, summed)
        matrix += np.diag([1e-6] * 6 + [1e-2])
        step = -solved(matrix, right)
        tags, growth = tags @ exp(step[:, :6]), growth + np.clip(step[:, 6], -0.2, 0.2)
    sigma = np.sqrt(np.linalg.inv(matrix)[:, 6, 6])
    other = (np.abs(growth) > SIZE_DIFFERS) & (np.abs(growth) > SIZE_SIGMAS * sigma)
    error = squared_errors(replace(some, edges=edges * np.exp(growth)), replace(found.poses, tags=tags))
    counts = some.counts()
    other &= (counts >= FEWEST_SIGHTINGS) & (some.counts(fitting(some, error, found.floor)) >= SIZE_SHARE * counts)
    changed = np.flatnonzero(other)
    kept = found.poses.tags.copy()
    kept[changed] = tags[changed]
    sizes = {int(tag): float(edges[tag] * np.exp(growth[tag])) for tag in changed}
    return sizes, replace(found.poses, tags=kept)


def errors_of_fixed(found: Estimate, start: Start) -> FloatArray:
    """Distance and rotation of each fixed tag from its pose in a map that the photographs and the other fixed tags
    give.

    Args:
        found: estimate with fixed tags.
        start: initial poses.

    Returns:
        metres and rad, `(K, 2)`; NaN for tags that are not fixed, or whose error is insignificant.

    Raises:
        InputError: a fixed tag is farther off than errors of measurement explain.
    """
    off = np.full((len(found.group), 2), np.nan)
    prior = found.prior
    known = prior.exact & (found.group == 0)
    if known.sum() < 2:
        return off
    information = np.where(known[:, None], LOOSE_SIGMA**-2.0, np.zeros(6))
    with threadpool_limits(limits=ONE_THREAD):
        poses, group, _ = into_world(found.sightings, *of_body(found.sightings, start, prior), None)
        free = adjust(found.sightings, replace(prior, information=information), poses, group, FLOOR_PIXELS)
    own = np.flatnonzero(known & np.isfinite(free.gauge_free_covariances).all(axis=(1, 2)))
    motion = align_tags(free.poses.tags[own], prior.tags[own])
    if motion is None:
        return off
    here, there, covariance = motion @ free.poses.tags[own], prior.tags[own], free.gauge_free_covariances[own]
    away = np.linalg.norm(here[:, :3, 3] - there[:, :3, 3], axis=1)
    between = np.stack([away, angle_between(here, there)], axis=1)
    parts = (slice(3, 6), slice(0, 3))
    sigma = np.stack([np.sqrt(np.linalg.eigvalsh(covariance[:, part, part])[:, -1]) for part in parts], axis=1)
    off[own] = np.where(between > np.maximum(SIGMAS * sigma, (OFF_M, OFF_RAD)), between, np.nan)
    # A tag with few sightings may be wrong in the map without fixed tags; then its sightings fit the fixed pose.
    fits = found.sightings.counts(found.used) > found.sightings.counts() / 2
    off[fits & (off > (MOST_M, MOST_RAD)).any(axis=1)] = np.nan
    _refuse(found.sightings.ids, off)
    return off


def _refuse(ids: IntArray, off: FloatArray) -> None:
    """Raise `InputError` if a fixed tag is farther off than errors of measurement explain."""
    away = np.nan_to_num(off)
    worst = int(np.argmax((away / (MOST_M, MOST_RAD)).max(axis=1)))
    metres, rad = away[worst]
    if metres <= MOST_M and rad <= MOST_RAD:
        return
    text = f"{1e3 * metres:.3g} mm" if metres > MOST_M else f"{np.degrees(rad):.3g} degrees"
    count = int((away > (MOST_M, MOST_RAD)).any(axis=1).sum())
    others = f", and {count - 1} more" if count > 1 else ""
    raise InputError(
        f"fixed has tag {ids[worst]} {text} from where the photographs have it beside the other fixed "
        f"tags{others}: correct the file or leave the tag out; points takes places that are good to 5 mm.",
        "fixed",
    )
