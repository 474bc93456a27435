"""What is known of tags before they are photographed: a plan, tags that were measured, or the frame of one tag."""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from lmd.core.checks import FloatArray, InputError, IntArray, boolean, check_fields, real
from lmd.core.tables import read_table
from lmd.geometry.se3 import inverse, laid_over, pose_of
from lmd.scene.deployment import Deployment
from lmd.scene.labels import Labels
from lmd.survey.residuals import Prior
from lmd.survey.student import DEGREES_OF_FREEDOM
from lmd.survey.turns import by_places

# Standard deviation of a centre that a tape measure says, metres.
TAPE_SIGMA_M = 0.005
# Points fix a world if there are three, which extend so far beside a line, metres.
FEWEST_POINTS, NO_LINE = 3, 0.05
LEVEL_TOLERANCE = 1e-3


@dataclass(frozen=True)
class Hanging:
    """How far tags may hang from their plan: standard deviations, along each axis of the tag.

    Args:
        place: in the plane of the wall, metres.
        turn: in the plane of the wall, rad.
        flush: whether tags lie flat on their walls, so that those below hold; else `place` and `turn` do for all axes.
        depth: off the wall, metres, if flush.
        tilt: out of the wall, rad, if flush.

    Raises:
        InputError: one of them is not positive.
    """

    place: float = 0.02
    turn: float = 0.05
    flush: bool = True
    depth: float = 0.005
    tilt: float = 0.02

    def __post_init__(self) -> None:
        check_fields(self, real, "place", "turn", "depth", "tilt", above=0.0)
        boolean("flush", self.flush)

    @property
    def deviations(self) -> FloatArray:
        """Standard deviations of a tag's rotations about its x, y and z, and of its shifts along them, `(6,)`."""
        tilt, depth = (self.tilt, self.depth) if self.flush else (self.turn, self.place)
        return np.array([tilt, tilt, self.turn, self.place, self.place, depth])


def poses_of(deployment: Deployment) -> FloatArray:
    """The poses of tags in the world, `(K, 4, 4)`. Of a tag x is right, y up and z out of it."""
    up, normal = deployment.ups, deployment.normals
    return pose_of(np.stack([np.cross(up, normal), up, normal], axis=-1), deployment.places)


@dataclass(frozen=True)
class Points:
    """Where the centres of some tags are, as a tape measure says.

    Args:
        ids: of the tags, `(n,)`, all different.
        places: `(n, 3)`, metres.

    Raises:
        InputError: there are fewer than three, an id occurs twice, or all are in a line.
    """

    ids: IntArray
    places: FloatArray

    def __post_init__(self) -> None:
        if len(self.ids) < FEWEST_POINTS:
            raise InputError(f"points must have at least {FEWEST_POINTS} tags, got {len(self.ids)}.", "points")
        if len(np.unique(self.ids)) < len(self.ids):
            raise InputError("points has a tag twice.", "points")
        if np.linalg.svd(self.places - self.places.mean(axis=0), compute_uv=False)[1] < NO_LINE:
            raise InputError("points must not lie in a line.", "points")

    @classmethod
    def from_csv(cls, path: Any) -> "Points":
        """Read `id,x,y,z`; further columns are ignored.

        Raises:
            InputError: the file cannot be read, or what it holds are no such points.
        """
        table = read_table(path, name="points")
        rows = table.numbers(("id", "x", "y", "z"), None)
        return cls(Labels.of(table, ()).ids, rows[:, 1:])


def aligned(tags: FloatArray, prior: Prior) -> FloatArray | None:
    """The motion, `(4, 4)`, from the world of `tags` `(K, 4, 4)` to the prior's; None if the prior does not fix it.

    Centres and normals of the tags that are exactly known, or else of all, say where the world is. Where these fix no
    turn, each tag whose pose is known proposes a motion, and the one with which most of the others are where they are
    expected is taken. Without any, it is the one that brings centres best to where they are known to be, three or more.
    """
    there = np.isfinite(tags[:, 0, 0])
    posed = prior.information[:, :3].any(axis=1) & there
    known = np.flatnonzero(posed & prior.exact if (posed & prior.exact).any() else posed)
    if not known.size:
        return _laid_over(tags, prior, np.flatnonzero(prior.information.any(axis=1) & there))
    if (motion := by_places(tags[known], prior.tags[known])) is not None:
        return motion
    motions = prior.tags[known] @ inverse(tags[known])
    some = Prior(prior.tags[known], prior.information[known])
    costs = [np.log1p(some.squares(some.off(motion @ tags[known])) / DEGREES_OF_FREEDOM).sum() for motion in motions]
    return np.asarray(motions[int(np.argmin(costs))])


def _laid_over(tags: FloatArray, prior: Prior, known: IntArray) -> FloatArray | None:
    """The motion that brings the centres of the tags `known` nearest to where the prior has them."""
    here, there = tags[known, :3, 3], prior.tags[known, :3, 3]
    if len(known) < FEWEST_POINTS or np.linalg.svd(here - here.mean(axis=0), compute_uv=False)[1] < NO_LINE:
        return None
    return laid_over(here, there)


def turned_as(prior: Prior, tags: FloatArray) -> Prior:
    """The prior with those tags of which only the centre is known turned as `tags` `(K, 4, 4)` are, if these are known.

    How a twist changes the way to a centre depends on how the tag is turned.
    """
    only = ~prior.information[:, :3].any(axis=1) & prior.information.any(axis=1) & np.isfinite(tags[:, 0, 0])
    poses = prior.tags.copy()
    poses[only, :3, :3] = tags[only, :3, :3]
    return replace(prior, tags=poses)


def levelled(tags: FloatArray, floor: IntArray, origin: int) -> FloatArray:
    """The motion to a world whose floor z = 0 goes through the centres of the tags `floor`, z up, `(4, 4)`.

    Its origin is below the centre of the tag `origin`, and x points to the right of that, if it hangs on a wall.

    Args:
        tags: `(K, 4, 4)`.
        floor: indices of three tags or more.
        origin: index of a tag.

    Raises:
        InputError: a tag of the floor is not placed, or they are in a line.
    """
    places = tags[floor, :3, 3]
    if len(floor) < FEWEST_POINTS or not np.isfinite(places).all():
        raise InputError(f"floor must be at least {FEWEST_POINTS} tags that are in the map.", "floor")
    _, spread, axes = np.linalg.svd(places - places.mean(axis=0))
    if spread[1] < NO_LINE:
        raise InputError("floor has tags that lie in a line.", "floor")
    up = axes[2] * np.sign((tags[floor, :3, 2] @ axes[2]).sum())
    ahead = np.cross(up, tags[origin, :3, 0])
    if np.linalg.norm(ahead) < LEVEL_TOLERANCE:  # the tag is turned with its right up
        ahead = np.cross(up, tags[origin, :3, 1])
    ahead /= np.linalg.norm(ahead)
    turn = np.stack([np.cross(ahead, up), ahead, up])
    below = tags[origin, :3, 3] - up * (up @ (tags[origin, :3, 3] - places.mean(axis=0)))
    return pose_of(turn, -turn @ below)
