"""Faults: tags that were moved, hang twice, have a wrong size or id, or are fixed at a wrong pose.

If the outliers of a tag (`Estimate.misfits`) agree on a second pose, the tag was moved or two tags have its id. If they
do not agree, the id was misread. A tag has a wrong size if its sightings agree on another size, with all frames fixed.
A fixed tag is compared with a map in which its pose is not fixed.
"""

from dataclasses import dataclass, replace

import numpy as np
from threadpoolctl import threadpool_limits

from lmd.adjust.candidates import agreeing
from lmd.adjust.corners import squared_errors
from lmd.adjust.estimate import FLOOR_PIXELS, ONE_THREAD, Estimate, adjust
from lmd.adjust.second_places import SecondPlace, second_places
from lmd.adjust.sizes import estimated_sizes, other_sizes, resized
from lmd.core.checks import BoolArray, FloatArray, InputError, IntArray
from lmd.geometry.se3 import angle_between
from lmd.survey.gauge import align_tags, into_world
from lmd.survey.initialisation import Start, of_body

LOOSE_SIGMA = 1.0  # prior standard deviation, metres and rad, of fixed tags in the map used for comparison
# A fixed tag is off if its error exceeds `SIGMAS` standard deviations, and also `OFF_M`, metres, or `OFF_RAD`, rad.
SIGMAS, OFF_M, OFF_RAD = 5.0, 0.001, 0.02
MOST_M, MOST_RAD = 0.02, 0.15  # maximum error of a fixed tag, metres and rad; above it the survey is refused


@dataclass(frozen=True)
class Faults:
    """Faults of a survey; tags are named by their index."""

    second_places: tuple[SecondPlace, ...]
    """Second poses of tags that were moved or hang twice."""
    sizes: dict[int, float]
    """Estimated edges of tags with a wrong size, metres."""
    misread: IntArray
    """`(K,)` number of sightings with each id that fit no pose of the tag."""


def find_faults(found: Estimate, odd: BoolArray) -> tuple[Estimate, Faults]:
    """Find faults, and correct sizes and moved tags: a moved tag gets the later of its poses.

    Args:
        found: estimate.
        odd: mask of the tags whose size is an unknown of the estimate, `(K,)`.

    Returns:
        corrected estimate, and all faults.
    """
    with threadpool_limits(limits=ONE_THREAD):
        sizes, poses = estimated_sizes(found, np.zeros_like(odd))
        sizes = {tag: edge for tag, edge in sizes.items() if not odd[tag]}
        if sizes:
            found = resized(found, sizes, poses)
        sizes |= other_sizes(found, odd)
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
            found = found.adjusted(replace(found.poses, tags=tags))
    return found, Faults(tuple(places), sizes, misread)


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
