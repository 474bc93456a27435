"""Tags that are exactly known, beside where photographs alone have them."""

from dataclasses import replace

import numpy as np
from threadpoolctl import threadpool_limits

from lmd.core.checks import FloatArray, InputError
from lmd.geometry.se3 import angle_between
from lmd.survey.estimate import ONE_THREAD, Estimate, Start, adjusted, begun, in_one_world
from lmd.survey.start import FLOOR_PIXELS
from lmd.survey.turns import by_places

# What a map without exact tags is held by, metres and rad: its world is then about theirs.
LOOSE_SIGMA = 1.0
# A tag is off if it is by so many standard deviations, and by so much: metres and rad.
SIGMAS, OFF_M, OFF_RAD = 5.0, 0.001, 0.02
# More than that is no error of measuring, metres and rad.
MOST_M, MOST_RAD = 0.02, 0.15


def off_fixed(found: Estimate, start: Start) -> FloatArray:
    """Distance of each tag by photographs alone from where it is fixed, beside the other fixed ones: metres and rad.

    Returns:
        `(K, 2)`; NaN for tags that are not exactly known, or that are there within the errors.

    Raises:
        InputError: one is so far off that it hangs elsewhere, or the file is of another room.
    """
    off = np.full((len(found.group), 2), np.nan)
    prior = found.prior
    known = prior.exact & (found.group == 0)
    if known.sum() < 2:
        return off
    information = np.where(known[:, None], LOOSE_SIGMA**-2.0, np.zeros(6))
    with threadpool_limits(limits=ONE_THREAD):
        poses, group, _ = in_one_world(found.sightings, *begun(found.sightings, start, prior), None)
        free = adjusted(found.sightings, replace(prior, information=information), poses, group, FLOOR_PIXELS)
    own = np.flatnonzero(known & np.isfinite(free.precisions).all(axis=(1, 2)))
    motion = by_places(free.poses.tags[own], prior.tags[own])
    if motion is None:
        return off
    here, there, covariance = motion @ free.poses.tags[own], prior.tags[own], free.precisions[own]
    away = np.linalg.norm(here[:, :3, 3] - there[:, :3, 3], axis=1)
    between = np.stack([away, angle_between(here, there)], axis=1)
    parts = (slice(3, 6), slice(0, 3))
    sigma = np.stack([np.sqrt(np.linalg.eigvalsh(covariance[:, part, part])[:, -1]) for part in parts], axis=1)
    off[own] = np.where(between > np.maximum(SIGMAS * sigma, (OFF_M, OFF_RAD)), between, np.nan)
    # A tag that few sightings place may have been placed wrongly. Where it is fixed they fit.
    fits = (
        np.bincount(found.sightings.tag, found.used, len(off))
        > np.bincount(found.sightings.tag, minlength=len(off)) / 2
    )
    off[fits & (off > (MOST_M, MOST_RAD)).any(axis=1)] = np.nan
    _refuse(found, off)
    return off


def _refuse(found: Estimate, off: FloatArray) -> None:
    """Raise `InputError` if a tag is farther off than errors of measuring."""
    worst = int(np.argmax(np.nan_to_num(off / (MOST_M, MOST_RAD)).max(axis=1)))
    metres, rad = np.nan_to_num(off[worst])
    if metres <= MOST_M and rad <= MOST_RAD:
        return
    said = f"{1e3 * metres:.3g} mm" if metres > MOST_M else f"{np.degrees(rad):.3g} degrees"
    count = int((np.nan_to_num(off) > (MOST_M, MOST_RAD)).any(axis=1).sum())
    others = f", and {count - 1} more" if count > 1 else ""
    raise InputError(
        f"fixed has tag {found.sightings.ids[worst]} {said} from where the photographs have it beside the other fixed "
        f"tags{others}: correct the file or leave the tag out; points takes places that are good to 5 mm.",
        "fixed",
    )
