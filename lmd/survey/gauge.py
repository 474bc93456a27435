"""The gauge of a map: the choice of its world frame, and covariances that do not depend on this choice.

Sightings alone do not determine the world frame. Exactly known tags, a plan, measured centres, the floor or one tag
determine it.
"""

from dataclasses import replace

import numpy as np

from lmd.adjust.corners import DEGREES_OF_FREEDOM, Poses
from lmd.adjust.prior import EXACT_SIGMA, Prior
from lmd.adjust.sightings import Sightings
from lmd.core.checks import BoolArray, FloatArray, InputError, IntArray
from lmd.geometry.se3 import inverse, pose_of, rigid_alignment
from lmd.survey.knowledge import FEWEST_POINTS, are_in_line

ARM = 0.1  # distance of a point on a tag's normal from the centre, metres; the point represents the normal in fits
NO_TURN = 0.05**2  # points with a smaller sum of squared distances from a line, m^2, determine no rotation
PLACE_SCALE, NORMAL_SCALE = 0.05, 0.2  # scales of the robust loss of centres, metres, and of normals, rad
PAIRS = 600  # maximum number of pairs of tags that propose a motion
REFINING_STEPS = 8
LEVEL_TOLERANCE = 1e-3  # two directions count as parallel if the sine of their angle is smaller


def align_tags(here: FloatArray, there: FloatArray) -> FloatArray | None:
    """Motion `(4, 4)` that aligns centres and normals of the tags `here` with the tags `there`, by a robust fit.

    Pairs of tags propose motions. The motion with the least loss is refined by reweighted least squares over all tags.

    Args:
        here, there: poses of K tags in two worlds, `(K, 4, 4)`; rotations about the normals do not matter.

    Returns:
        None if the tags determine no rotation.
    """
    points, others = _points(here), _points(there)
    one, other = np.triu_indices(len(here), 1)
    some = np.unique(np.linspace(0, len(one) - 1, PAIRS).astype(np.int64)) if len(one) else one
    pairs = np.stack([one[some], other[some]], axis=1)
    turns, ways, fixed = _fitted(points[pairs].reshape(-1, 4, 3), others[pairs].reshape(-1, 4, 3), np.ones((1, 4)))
    if not fixed.any():
        return None
    motions = pose_of(turns[fixed], ways[fixed])
    best: FloatArray = motions[int(np.argmin([np.log1p(_squares(motion @ here, there)).sum() for motion in motions]))]
    for _ in range(REFINING_STEPS):
        weights = np.repeat(1.0 / (1.0 + _squares(best @ here, there)), 2)[None]
        turns, ways, fixed = _fitted(points.reshape(1, -1, 3), others.reshape(1, -1, 3), weights)
        if not fixed[0]:
            break
        best = pose_of(turns[0], ways[0])
    return best


def _points(tags: FloatArray) -> FloatArray:
    """Centre of each tag and a point before it, `(K, 2, 3)`."""
    return np.stack([tags[:, :3, 3], tags[:, :3, 3] + ARM * tags[:, :3, 2]], axis=1)


def _squares(here: FloatArray, there: FloatArray) -> FloatArray:
    """Squared distances of centres and normals, relative to their scales, `(K,)`."""
    away = np.linalg.norm(here[:, :3, 3] - there[:, :3, 3], axis=1) / PLACE_SCALE
    return np.asarray(away**2 + (angle_between_normals(here, there) / NORMAL_SCALE) ** 2)


def angle_between_normals(here: FloatArray, there: FloatArray) -> FloatArray:
    """Angles between the normals of tags, rad, `(K,)`."""
    return np.asarray(np.arccos(np.clip((here[:, :3, 2] * there[:, :3, 2]).sum(axis=1), -1.0, 1.0)))


def _fitted(points: FloatArray, others: FloatArray, weights: FloatArray) -> tuple[FloatArray, FloatArray, BoolArray]:
    """Least-squares motions from points `(n, m, 3)` to others (Kabsch).

    Returns:
        rotations `(n, 3, 3)`, translations `(n, 3)`, and True where the points determine the rotation, `(n,)`.
    """
    share = weights / weights.sum(axis=1, keepdims=True)
    middles = [(share[..., None] * each).sum(axis=1, keepdims=True) for each in (points, others)]
    away, towards = points - middles[0], others - middles[1]
    left, spread, right = np.linalg.svd(np.swapaxes(weights[..., None] * away, 1, 2) @ towards)
    right[:, 2] *= np.sign(np.linalg.det(left @ right))[:, None]
    turns = np.swapaxes(left @ right, 1, 2)
    ways = middles[1][:, 0] - (turns @ middles[0][:, 0, :, None])[..., 0]
    return turns, ways, spread[:, 1] > NO_TURN


def motion_to_prior(tags: FloatArray, prior: Prior) -> FloatArray | None:
    """Motion `(4, 4)` from the world of `tags` `(K, 4, 4)` to the world of the prior; None if the prior does not
    determine it.

    The fit uses centres and normals of the exactly known tags, or else of all tags with known orientation. If these
    tags determine no rotation, each tag proposes the motion to its expected pose, and the motion with the least loss is
    taken. Without known orientations, three or more centres determine the motion.
    """
    there = np.isfinite(tags[:, 0, 0])
    posed = prior.is_posed & there
    known = np.flatnonzero(posed & prior.exact if (posed & prior.exact).any() else posed)
    if not known.size:
        return _motion_of_centres(tags, prior, np.flatnonzero(prior.information.any(axis=1) & there))
    if (motion := align_tags(tags[known], prior.tags[known])) is not None:
        return motion
    motions = prior.tags[known] @ inverse(tags[known])
    some = Prior(prior.tags[known], prior.information[known])
    losses = [np.log1p(some.squares(some.off(motion @ tags[known])) / DEGREES_OF_FREEDOM).sum() for motion in motions]
    return np.asarray(motions[int(np.argmin(losses))])


def _motion_of_centres(tags: FloatArray, prior: Prior, known: IntArray) -> FloatArray | None:
    """Motion that best aligns the centres of the tags `known` with the expected centres; None if they determine no
    motion.
    """
    here = tags[known, :3, 3]
    return None if len(known) < FEWEST_POINTS or are_in_line(here) else rigid_alignment(here, prior.tags[known, :3, 3])


def into_world(
    sightings: Sightings, poses: Poses, group: IntArray, prior: Prior, origin: int | None
) -> tuple[Poses, IntArray, Prior]:
    """Move all groups that the prior places into the world of the prior, as group 0; other groups keep their worlds, as
    1, 2, ...

    Args:
        sightings: sightings of the tags.
        poses: poses; each group has a world of its own.
        group: group of each tag, `(K,)`, -1 for tags without a pose.
        prior: prior of the tags. If it holds no tag, the tag `origin` is added to the prior.
        origin: id of the tag whose frame is the world if the prior holds no tag; None for the tag seen most often.

    Raises:
        InputError: `origin` has no pose, or the prior does not determine a world.
    """
    tags, frames = poses.tags.copy(), poses.frames.copy()
    owner = np.full(sightings.frames, -1)
    placed = group[sightings.tag] >= 0
    owner[sightings.frame[placed]] = group[sightings.tag[placed]]
    counts = sightings.counts()
    order = np.argsort(-np.bincount(group[group >= 0], counts[group >= 0]), kind="stable")
    motions = {g: motion_to_prior(np.where((group == g)[:, None, None], tags, np.nan), prior) for g in order.tolist()}
    if all(motion is None for motion in motions.values()):
        if prior.information[group >= 0].any():
            raise InputError(
                "points has too few tags that photographs connect: three that are not in a line.", "points"
            )
        first = int(np.argmax(np.where(group == order[0], counts, -1)))
        if origin is not None:
            among = np.flatnonzero((sightings.ids == origin) & (group >= 0))
            if not among.size:
                raise InputError(f"origin = {origin} is no tag that could be placed.", "origin")
            first = int(among[0])
        motions[int(group[first])] = inverse(tags[first])
        prior = replace(prior, tags=prior.tags.copy(), information=prior.information.copy())
        prior.tags[first], prior.information[first] = np.eye(4), EXACT_SIGMA**-2.0
    number, others = np.full(len(order) + 1, -1), 1
    for g in order.tolist():
        motion = motions[g]
        if motion is None:
            number[g], others = others, others + 1
            continue
        number[g] = 0
        tags[group == g] = motion @ tags[group == g]
        frames[owner == g] = motion @ frames[owner == g]
    frames[(owner < 0) | (number[owner] != 0)] = np.nan
    return Poses(tags, frames, poses.mounts), number[group], _with_turns_of(prior, tags)


def _with_turns_of(prior: Prior, tags: FloatArray) -> Prior:
    """Prior in which tags with only a known centre have the orientation of `tags` `(K, 4, 4)`.

    Such tags need an orientation, as the derivative of a centre by a twist depends on the orientation.
    """
    only = ~prior.is_posed & prior.information.any(axis=1) & np.isfinite(tags[:, 0, 0])
    poses = prior.tags.copy()
    poses[only, :3, :3] = tags[only, :3, :3]
    return replace(prior, tags=poses)


def motion_to_floor(tags: FloatArray, floor: IntArray, origin: int) -> FloatArray:
    """Motion `(4, 4)` to a world with z up and z = 0 through the centres of the tags `floor`.

    The origin of the world is below the centre of the tag `origin`; if that tag hangs on a wall, x points to its right.

    Args:
        tags: poses, `(K, 4, 4)`.
        floor: indices of tags on the floor.
        origin: index of a tag.

    Raises:
        InputError: fewer than three tags of the floor have a pose, or they lie in a line.
    """
    places = tags[floor, :3, 3]
    if len(floor) < FEWEST_POINTS or not np.isfinite(places).all():
        raise InputError(f"floor must be at least {FEWEST_POINTS} tags that are in the map.", "floor")
    if are_in_line(places):
        raise InputError("floor has tags that lie in a line.", "floor")
    axes = np.linalg.svd(places - places.mean(axis=0))[2]
    up = axes[2] * np.sign((tags[floor, :3, 2] @ axes[2]).sum())
    ahead = np.cross(up, tags[origin, :3, 0])
    if np.linalg.norm(ahead) < LEVEL_TOLERANCE:  # the right of the tag points up
        ahead = np.cross(up, tags[origin, :3, 1])
    ahead /= np.linalg.norm(ahead)
    turn = np.stack([np.cross(ahead, up), ahead, up])
    below = tags[origin, :3, 3] - up * (up @ (tags[origin, :3, 3] - places.mean(axis=0)))
    return pose_of(turn, -turn @ below)
