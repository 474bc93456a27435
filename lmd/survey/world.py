"""World frame of a map, defined by prior poses or by tags on the floor; and comparison of tags with their prior poses.

Sightings alone do not determine the world frame. Exactly known tags, a plan, measured centres, the floor or one tag
determine it.

*Turns*: OpenCV numbers the corners of an AprilTag from the bottom right. Such a tag seems to hang upside down: its pose
is off by half a turn about the normal. Centres and normals do not depend on the order of corners, so they align the map
with the plan. If a tag still differs from its plan by quarter turns, it hangs turned, or its corners are in another
order.

*Fixed tags* are compared with a map in which the poses of these tags are not fixed.
"""

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from lmd.adjust.corners import DEGREES_OF_FREEDOM, Poses
from lmd.adjust.estimate import Estimate
from lmd.adjust.gauge import align_tags, angle_between_normals, worst_sigmas
from lmd.adjust.prior import EXACT_SIGMA, Prior
from lmd.adjust.sightings import QUARTERS, Sightings
from lmd.core.checks import FloatArray, InputError, IntArray
from lmd.geometry.se3 import angle_between, inverse, pose_of, rigid_alignment
from lmd.survey.knowledge import FEWEST_POINTS, are_in_line

LEVEL_TOLERANCE = 1e-3  # two directions count as parallel if the sine of their angle is smaller
# A tag gets a turn if it is nearer to the planned centre than NEAR, metres, and if the angles to the planned normal and
# to a multiple of 90 degrees are below FACING and IN_QUARTERS, rad. LEAST_SHARE is the minimum share of tags of a group
# that are NEAR; below it no tag of the group gets a turn.
NEAR, FACING, IN_QUARTERS, LEAST_SHARE = 0.3, 0.5, 0.35, 0.5
# A fixed tag is off if its error exceeds `SIGMAS` standard deviations, and also `OFF`, metres and rad; above `MOST` the
# survey is refused.
SIGMAS, OFF, MOST = 5.0, (0.001, 0.02), (0.02, 0.15)


def motion_to_prior(tags: FloatArray, prior: Prior) -> FloatArray | None:
    """Motion `(4, 4)` from the world of `tags` `(K, 4, 4)` to the world of the prior; None if the prior does not
    determine the motion.

    The fit uses centres and normals of the exactly known tags, or else of all tags with known orientation. If these
    tags determine no rotation, each tag proposes the motion to its expected pose, and the motion with the least loss is
    taken. Without known orientations, three or more centres determine the motion.
    """
    there = np.isfinite(tags[:, 0, 0])
    posed = prior.is_posed & there
    known = np.flatnonzero(posed & prior.exact if (posed & prior.exact).any() else posed)
    if not known.size:
        known = np.flatnonzero(prior.known & there)
        here = tags[known, :3, 3]
        fixes = len(known) >= FEWEST_POINTS and not are_in_line(here)
        return rigid_alignment(here, prior.tags[known, :3, 3]) if fixes else None
    if (motion := align_tags(tags[known], prior.tags[known])) is not None:
        return motion
    some = Prior(prior.tags[known], prior.information[known])

    def loss(motion: FloatArray) -> float:
        return float(np.log1p(some.squares(some.off(motion @ tags[known])) / DEGREES_OF_FREEDOM).sum())

    return np.asarray(min(prior.tags[known] @ inverse(tags[known]), key=loss))


def into_world(
    sightings: Sightings, poses: Poses, group: IntArray, prior: Prior, origin: int | None
) -> tuple[Poses, IntArray, Prior]:
    """Move all groups that the prior places into the world of the prior, as group 0; other groups keep their worlds,
    and are numbered 1, 2, ...

    Args:
        sightings: sightings of the tags.
        poses: poses; each group has a world of its own.
        group: group of each tag, `(K,)`, -1 for tags without a pose.
        prior: prior of the tags. If it holds no tag, the tag `origin` is added to the prior.
        origin: id of the tag whose frame is the world if the prior holds no tag; None for the tag seen most often.

    Raises:
        InputError: `origin` has no pose, or the prior does not determine a world.
    """
    tags, frames, counts = poses.tags.copy(), poses.frames.copy(), sightings.counts()
    owner, placed = np.full(sightings.frames, -1), group[sightings.tag] >= 0
    owner[sightings.frame[placed]] = group[sightings.tag[placed]]
    order = np.argsort(-np.bincount(group[group >= 0], counts[group >= 0]), kind="stable").tolist()
    motions = {g: motion_to_prior(np.where((group == g)[:, None, None], tags, np.nan), prior) for g in order}
    if all(motion is None for motion in motions.values()):
        if prior.known[group >= 0].any():
            text = "points needs three tags that are not collinear and that photographs connect."
            raise InputError(text, "points")
        among = (group == order[0]) if origin is None else (sightings.ids == origin) & (group >= 0)
        if not among.any():
            raise InputError(f"origin = {origin} is not among the placed tags.", "origin")
        first = int(np.argmax(np.where(among, counts, -1)))
        motions[int(group[first])] = inverse(tags[first])
        prior = replace(prior, tags=prior.tags.copy(), information=prior.information.copy())
        prior.tags[first], prior.information[first] = np.eye(4), EXACT_SIGMA**-2.0
    number = np.full(len(order) + 1, -1)
    for g in order:
        number[g] = 0 if motions[g] is not None else number.max(initial=0) + 1
        if (motion := motions[g]) is not None:
            tags[group == g], frames[owner == g] = motion @ tags[group == g], motion @ frames[owner == g]
    frames[(owner < 0) | (number[owner] != 0)] = np.nan
    # Tags with only a known centre need an orientation, on which the derivative of the centre by a twist depends.
    only, expected = ~prior.is_posed & prior.known & np.isfinite(tags[:, 0, 0]), prior.tags.copy()
    expected[only, :3, :3] = tags[only, :3, :3]
    return Poses(tags, frames, poses.mounts), number[group], replace(prior, tags=expected)


def motion_to_floor(tags: FloatArray, floor: IntArray, origin: int) -> FloatArray:
    """Motion `(4, 4)` to a world with z up and z = 0 through the centres of the tags `floor`.

    The origin of the world is below the centre of the tag `origin`; if that tag hangs on a wall, x points to its right.

    Args:
        tags: poses, `(K, 4, 4)`.
        floor: indices of tags on the floor.
        origin: index of a tag.

    Raises:
        InputError: fewer than three tags of the floor have a pose, or these tags are collinear.
    """
    places = tags[floor, :3, 3]
    if len(floor) < FEWEST_POINTS or not np.isfinite(places).all():
        raise InputError(f"floor must name at least {FEWEST_POINTS} tags that are in the map.", "floor")
    if are_in_line(places):
        raise InputError("floor must name tags that are not collinear.", "floor")
    axes = np.linalg.svd(places - places.mean(axis=0))[2]
    up = axes[2] * np.sign((tags[floor, :3, 2] @ axes[2]).sum())
    ahead = np.cross(up, tags[origin, :3, 0])
    if np.linalg.norm(ahead) < LEVEL_TOLERANCE:  # the tag's x axis is vertical
        ahead = np.cross(up, tags[origin, :3, 1])
    ahead /= np.linalg.norm(ahead)
    turn = np.stack([np.cross(ahead, up), ahead, up])
    below = tags[origin, :3, 3] - up * (up @ (tags[origin, :3, 3] - places.mean(axis=0)))
    return pose_of(turn, -turn @ below)


class Turns(NamedTuple):
    """Turns of K tags, `(K,)` each: numbers of quarter turns, clockwise as seen by the viewer."""

    renumbered: IntArray
    """Turns by which the corners of detections are renumbered."""
    beside_plan: IntArray
    """Turns of the tags from their planned poses; 0 if unknown."""
    beside_sheets: IntArray
    """Turns of the tags from their poses on sheets; 0 if unknown."""

    def applied(self, prior: Prior) -> Prior:
        """Prior after the turns: the prior of tags that hang turned is turned."""
        sheets = prior.sheets
        if sheets is not None:
            sheets = replace(sheets, poses=sheets.poses @ QUARTERS[self.beside_sheets[sheets.tag]])
        return replace(prior, tags=prior.tags @ QUARTERS[self.beside_plan], sheets=sheets)


def turns_of(tags: FloatArray, group: IntArray, prior: Prior, in_order: bool) -> Turns:
    """Quarter turns of tags from their prior poses.

    A turn that most tags share is attributed to the order of the corners, unless the order of the corners is known.
    Exactly known tags are assumed to hang as in the prior.

    Args:
        tags: rough poses, `(K, 4, 4)`.
        group: group of each tag, `(K,)`, -1 for tags that are not placed.
        prior: prior of the tags.
        in_order: True if corners are known to begin at the top left.
    """
    known = prior.is_posed & (group >= 0)
    seen = _quarters(tags, prior.tags, np.where(known, group, -1))
    if (lost := prior.exact & (seen < 0)).any():  # the plan of the other tags is wrong
        seen = np.where(lost, _quarters(tags, prior.tags, np.where(known & prior.exact, group, -1)), seen)
    on_sheets = np.full(len(group), -1)
    if (sheets := prior.sheets) is not None:
        own = np.where(group[sheets.tag] >= 0, sheets.board * (group.max() + 1) + group[sheets.tag], -1)
        on_sheets[sheets.tag] = _quarters(tags[sheets.tag], sheets.poses, own)
    either = np.where(seen < 0, on_sheets, seen)
    counts = np.bincount(either[either >= 0], minlength=4)
    shared = 0 if in_order or 2 * counts.max() <= counts.sum() else np.argmax(counts)
    renumbered = np.where(prior.exact & (seen >= 0), seen, shared)
    return Turns(renumbered, *(np.where(turned < 0, 0, (turned - renumbered) % 4) for turned in (seen, on_sheets)))


def _quarters(tags: FloatArray, planned: FloatArray, group: IntArray) -> IntArray:
    """Quarter turns of tags `(K, 4, 4)` from their planned poses, by group `(K,)`; -1 if unknown."""
    turned = np.full(len(group), -1)
    for g in np.unique(group[group >= 0]):
        own = np.flatnonzero(group == g)
        here, there = tags[own], planned[own]
        if (motion := align_tags(here, there)) is None:
            continue
        between = inverse(there) @ motion @ here
        near = np.linalg.norm(between[:, :3, 3], axis=1) < NEAR
        if near.sum() < 2 or near.mean() < LEAST_SHARE:
            continue
        angle = np.arctan2(between[:, 1, 0] - between[:, 0, 1], between[:, 0, 0] + between[:, 1, 1])
        quarters = np.round(-2.0 * angle / np.pi).astype(np.int64)
        whole = near & (angle_between_normals(motion @ here, there) < FACING)
        whole &= np.abs(angle + quarters * np.pi / 2.0) < IN_QUARTERS
        turned[own[whole]] = quarters[whole] % 4
    return turned


def errors_of_fixed(found: Estimate, free: Estimate) -> FloatArray:
    """Errors of fixed tags: distance and rotation from the pose in a map from the photographs and the other fixed tags.

    Args:
        found: estimate with fixed tags.
        free: estimate in which these tags are not fixed.

    Returns:
        errors, metres and rad, `(K, 2)`; NaN for tags that are not fixed, or whose error is insignificant.

    Raises:
        InputError: a fixed tag is farther off than errors of measurement explain.
    """
    off, sigma = np.full((len(found.group), 2), np.nan), worst_sigmas(free.gauge_free_covariances)
    own = np.flatnonzero(found.prior.exact & (found.group == 0) & np.isfinite(sigma[:, 0]))
    here, there = free.poses.tags[own], found.prior.tags[own]
    if (motion := align_tags(here, there)) is None:
        return off
    moved = motion @ here
    between = np.stack([np.linalg.norm((moved - there)[:, :3, 3], axis=1), angle_between(moved, there)], axis=1)
    off[own] = np.where(between > np.maximum(SIGMAS * sigma[own], OFF), between, np.nan)
    # In the map without fixed tags, a tag with few sightings may be wrong; then the sightings still fit the fixed pose.
    fits = found.sightings.counts(found.used) > found.sightings.counts() / 2
    off[fits & (off > MOST).any(axis=1)] = np.nan
    ratio = np.nan_to_num(off) / MOST
    worst, count = int(np.argmax(ratio.max(axis=1))), int((ratio > 1.0).any(axis=1).sum())
    if count:
        metres, rad = off[worst]
        text = f"{1e3 * metres:.3g} mm" if metres > MOST[0] else f"{np.degrees(rad):.3g} degrees"
        others = f", and {count - 1} more" if count > 1 else ""
        raise InputError(
            f"fixed has tag {found.sightings.ids[worst]} {text} away from its pose by the photographs and the other "
            f"fixed tags{others}: correct or remove it, or give inexact places as points.",
            "fixed",
        )
    return off
