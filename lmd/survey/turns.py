"""Turns: tags that hang rotated from their plan by quarter turns, or whose corners are numbered from another corner.

OpenCV numbers the corners of an AprilTag from the bottom right. A tag then seems to hang upside down, and its pose is
off by half a turn about its normal. Centres and normals do not depend on the order of corners, so they align the map
with the plan. If a tag still differs from its plan by quarter turns, it hangs turned, or its corners are in another
order.
"""

from dataclasses import dataclass, replace

import numpy as np

from lmd.adjust.corners import Poses
from lmd.adjust.prior import Prior
from lmd.adjust.sightings import QUARTERS
from lmd.core.checks import FloatArray, IntArray
from lmd.geometry.se3 import inverse
from lmd.survey.gauge import align_tags, angle_between_normals

# A tag gets a turn if it is nearer to its planned centre than NEAR, metres, and if its angles to the planned normal and
# to a multiple of 90 degrees are below FACING and IN_QUARTERS, rad. LEAST_SHARE is the minimum share of tags of a group
# that are NEAR; below it no tag of the group gets a turn.
NEAR, FACING, IN_QUARTERS, LEAST_SHARE = 0.3, 0.5, 0.35, 0.5


@dataclass(frozen=True)
class Turns:
    """Turns of K tags, in quarters, clockwise as seen by the viewer."""

    renumbered: IntArray
    """`(K,)` turns by which the corners of detections are renumbered."""
    beside_plan: IntArray
    """`(K,)` turns of the tags from their planned poses; 0 if unknown."""
    beside_sheets: IntArray
    """`(K,)` turns of the tags from their poses on sheets; 0 if unknown."""

    @classmethod
    def none(cls, count: int) -> "Turns":
        """Turns of `count` tags that are not turned."""
        return cls(*np.zeros((3, count), dtype=np.int64))

    def __bool__(self) -> bool:
        return any(turned.any() for turned in (self.renumbered, self.beside_plan, self.beside_sheets))

    def __add__(self, other: "Turns") -> "Turns":
        """Sum of these turns and of the turns `other`, found after these turns were applied."""
        names = ("renumbered", "beside_plan", "beside_sheets")
        return Turns(*((getattr(self, name) + getattr(other, name)) % 4 for name in names))

    def applied(self, prior: Prior) -> Prior:
        """Prior of tags that hang turned."""
        sheets = prior.sheets
        if sheets is not None:
            sheets = replace(sheets, poses=sheets.poses @ QUARTERS[self.beside_sheets[sheets.tag]])
        return replace(prior, tags=prior.tags @ QUARTERS[self.beside_plan], sheets=sheets)


def turns_of(poses: Poses, group: IntArray, prior: Prior, in_order: bool) -> Turns:
    """Turns of tags from their prior poses.

    A turn that most tags share is attributed to the order of the corners, unless the order is known. Exactly known tags
    are assumed to hang as in the prior.

    Args:
        poses: rough poses.
        group: group of each tag, `(K,)`, -1 for tags that are not placed.
        prior: prior of the tags.
        in_order: True if corners are known to begin at the top left.
    """
    known = prior.is_posed & (group >= 0)
    seen = _quarters(poses.tags, prior.tags, np.where(known, group, -1))
    if (lost := prior.exact & (seen < 0)).any():  # the plan of the other tags is wrong
        seen = np.where(lost, _quarters(poses.tags, prior.tags, np.where(known & prior.exact, group, -1)), seen)
    on_sheets = np.full(len(group), -1)
    if (sheets := prior.sheets) is not None:
        own = np.where(group[sheets.tag] >= 0, sheets.board * (group.max() + 1) + group[sheets.tag], -1)
        on_sheets[sheets.tag] = _quarters(poses.tags[sheets.tag], sheets.poses, own)
    either = np.where(seen < 0, on_sheets, seen)
    counts = np.bincount(either[either >= 0], minlength=4)
    renumbered = np.zeros_like(seen)
    if not in_order and 2 * counts.max() > counts.sum():
        renumbered[:] = np.argmax(counts)
    exact = prior.exact & (seen >= 0)
    renumbered[exact] = seen[exact]
    remaining = (np.where(turned < 0, 0, (turned - renumbered) % 4) for turned in (seen, on_sheets))
    return Turns(renumbered, *remaining)


def _quarters(tags: FloatArray, planned: FloatArray, group: IntArray) -> IntArray:
    """Quarter turns of tags `(K, 4, 4)` from their planned poses, by group `(K,)`; -1 if unknown."""
    turned = np.full(len(group), -1)
    for g in np.unique(group[group >= 0]):
        own = np.flatnonzero(group == g)
        here, there = tags[own], planned[own]
        motion = align_tags(here, there)
        if motion is None:
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
