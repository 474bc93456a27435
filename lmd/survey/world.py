"""World frame of a map, defined by prior poses; and comparison of the tags' poses with their prior poses.

Sightings without other data do not determine the world frame. Exactly known tags, a plan, measured centres or
one tag determine this frame.

*Turns*: OpenCV numbers the corners of an AprilTag from the bottom right. Such a tag seems to hang upside down: its pose
is off by half a turn about the normal. Centres and normals do not depend on the order of corners, so they align the map
with the plan. If a tag still differs from the plan by quarter turns about the normal, the tag was hung rotated, or the
corners are in another order.
"""

from dataclasses import replace

import numpy as np

from lmd.adjust.corners import DEGREES_OF_FREEDOM, Poses
from lmd.adjust.gauge import align_tags, angle_between_normals
from lmd.adjust.prior import EXACT_SIGMA, Prior
from lmd.adjust.sightings import Sightings
from lmd.core.checks import FloatArray, InputError, IntArray
from lmd.geometry.se3 import inverse, rigid_alignment
from lmd.survey.knowledge import FEWEST_POINTS, are_in_line

# A tag gets a turn if it is nearer to the planned centre than NEAR, metres, and if the angles to the planned normal and
# to a multiple of 90 degrees are below FACING and IN_QUARTERS, rad. LEAST_SHARE is the minimum share of tags of a group
# that are NEAR; below it no tag of the group gets a turn.
NEAR, FACING, IN_QUARTERS, LEAST_SHARE = 0.3, 0.5, 0.35, 0.5


def motion_to_prior(tags: FloatArray, prior: Prior) -> FloatArray | None:
    """Rigid motion `(4, 4)` that moves the poses `tags` `(K, 4, 4)` into the world frame of the prior. None if the
    prior does not determine the motion.

    The fit uses centres and normals of the exactly known tags, or else of all tags with known orientation. If these do
    not determine the rotation, as with a single tag, each tag proposes the motion that takes it to its expected pose.
    The proposed motion with the least loss over all tags is returned. Without known orientations, three or more centres
    determine the motion.
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
    """Move the groups whose tags determine the prior's world frame into this frame, as group 0. Other groups keep their
    own world frames, and are numbered 1, 2, ...; frames that show them lose their poses.

    Args:
        sightings: sightings of the tags.
        poses: poses of tags, frames and mounts; each group has a world frame of its own.
        group: group of each tag, `(K,)`, -1 for tags without a pose.
        prior: prior of the tags. If it holds no tag, the tag `origin` is added to the prior.
        origin: id of the tag whose frame is the world if the prior holds no tag; None for the tag seen most often.

    Returns:
        poses; number of each tag's group, `(K,)`, -1 for tags without a pose; prior, which now determines the world.

    Raises:
        InputError: the tag `origin` has no pose, or the prior does not determine a world frame.
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


def turns_of(tags: FloatArray, group: IntArray, prior: Prior, in_order: bool) -> IntArray:
    """Numbers of quarter turns about the tags' normals by which poses differ from the prior poses. Turns are clockwise
    for a viewer in front of the tag.

    A turn that most tags share is attributed to the order of the corners, unless the order of the corners is known.
    Exactly known tags are assumed to hang as in the prior.

    Args:
        tags: rough poses, `(K, 4, 4)`.
        group: group of each tag, `(K,)`, -1 for tags that are not placed.
        prior: prior of the tags.
        in_order: True if the corners of detections are known to begin at the tag's top left.

    Returns:
        two rows, `(2, K)`: turns by which the corners of detections are renumbered, and turns by which tags hang
        rotated from their prior poses; 0 if unknown.
    """
    known = prior.is_posed & (group >= 0)
    seen = _quarters(tags, prior.tags, np.where(known, group, -1))
    on_sheets = np.full(len(group), -1)
    if (sheets := prior.sheets) is not None:
        own = np.where(group[sheets.tag] >= 0, sheets.board * (group.max() + 1) + group[sheets.tag], -1)
        on_sheets[sheets.tag] = _quarters(tags[sheets.tag], sheets.poses, own)
    either = np.where(seen < 0, on_sheets, seen)
    counts = np.bincount(either[either >= 0], minlength=4)
    shared = 0 if in_order or 2 * counts.max() <= counts.sum() else np.argmax(counts)
    renumbered = np.where(prior.exact & (seen >= 0), seen, shared)
    return np.stack([renumbered, np.where(seen < 0, 0, (seen - renumbered) % 4)])


def _quarters(tags: FloatArray, planned: FloatArray, group: IntArray) -> IntArray:
    """Numbers of clockwise quarter turns by which tags are rotated about their normals relative to the plan.

    Args:
        tags: poses of the tags, `(K, 4, 4)`.
        planned: planned poses of the tags, `(K, 4, 4)`.
        group: group of each tag, `(K,)`; each group is aligned with the plan by itself, tags with -1 are left out.

    Returns:
        numbers from 0 to 3, `(K,)`; -1 if unknown.
    """
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
