"""Tags that vanished: tags of the map that were detected in no image, although several images should show them.

A tag should be seen in an image if it lies wholly within the image, is as large and as little oblique as tags that the
drive did detect, and is not hidden by a surface of the room. The share of such views in which other tags were detected
is the probability of a detection; views from nearly one place count once.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from lmd.adjust.estimate import Estimate
from lmd.adjust.intrinsics import Optics
from lmd.adjust.sightings import SQUARE
from lmd.core.checks import BoolArray, FloatArray
from lmd.detection.corner_errors import shortest_side
from lmd.geometry.camera import Camera
from lmd.geometry.projection import project
from lmd.geometry.se3 import act, angle_between
from lmd.localise.fixed_map import FixedMap
from lmd.space.space import Space

VANISHED = 1e-3  # greatest probability that a tag was missed in all views by chance
MOST_RATE = 0.9  # greatest probability of a detection that is assumed
FEWEST_VIEWS = 4  # minimum number of views, not counting views from nearly one place
LOWEST = 0.1  # quantile of the sizes, and of the obliquities, of detected tags below which a tag need not be detected
BORDER = 5.0  # least distance of corners from the border of the image, pixels
OFF_WALL = 0.02  # distance before a tag at which lines of sight end, metres
APART_M, APART_RAD = 0.2, 0.2  # least distance and rotation of views that count separately


def vanished_tags(found: Estimate, known: FixedMap, optics: Sequence[Optics], room: Space) -> dict[int, int]:
    """Find tags that vanished.

    Args:
        found: estimate of the frames, with the present poses of the tags that were seen.
        known: map.
        optics: cameras of the body.
        room: room of the map, whose surfaces hide tags.

    Returns:
        number of views, in which the tag should have been detected, by the id of each tag that vanished.
    """
    some = found.sightings.of(np.isin(found.sightings.ids, known.ids)[found.sightings.tag])
    used = found.used[np.isin(found.sightings.ids, known.ids)[found.sightings.tag]]
    frames, count = np.flatnonzero(np.isfinite(found.poses.frames[:, 0, 0])), len(known.ids)
    if not len(frames) or not used.any():
        return {}
    _, own, there = np.intersect1d(known.ids, found.sightings.ids, return_indices=True)
    present, tag = known.poses.copy(), np.searchsorted(known.ids, found.sightings.ids)[some.tag]
    present[own] = np.where(np.isfinite(found.poses.tags[there]), found.poses.tags[there], present[own])
    known = replace(known, poses=present)
    views = np.zeros((2, len(frames), count), dtype=bool)  # in view, and detected
    least_size = float(np.quantile(some.sizes[used], LOWEST))
    towards = _cosines(found.poses.frames[some.frame] @ found.poses.mounts[some.camera], known.poses[tag])
    least_cosine = float(np.quantile(towards[used], LOWEST))
    for number, one in enumerate(optics):
        poses = found.poses.frames[frames] @ found.poses.mounts[number]
        seen = np.zeros((some.frames, count), dtype=bool)
        shown = some.camera == number
        seen[some.frame[shown], tag[shown]] = True
        inside = np.stack(
            [_inside(one.camera, poses, known, k, least_size, least_cosine) for k in range(count)], axis=1
        )
        views[0] |= inside & _clear(room, poses, known, inside)
        views[1] |= seen[frames]
    detected = np.bincount(tag, minlength=count) > 0
    rate = min(float(views[1][:, detected][views[0][:, detected]].mean()), MOST_RATE) if views[0].any() else 0.0
    result = {}
    for k in np.flatnonzero(~detected):
        number = _separate(found.poses.frames[frames[views[0][:, k]]])
        if number >= FEWEST_VIEWS and (1.0 - rate) ** number < VANISHED:
            result[int(known.ids[k])] = number
    return result


def _cosines(poses: FloatArray, tags: FloatArray) -> FloatArray:
    """Cosine of the angle between the normal of each tag and the direction to the camera, `(n,)`."""
    way = poses[:, :3, 3] - tags[:, :3, 3]
    return np.asarray((way * tags[:, :3, 2]).sum(axis=1) / np.linalg.norm(way, axis=1))


def _inside(camera: Camera, poses: FloatArray, known: FixedMap, k: int, size: float, cosine: float) -> BoolArray:
    """Mask of the poses `(n, 4, 4)` from which tag k is wholly within the image, large and frontal enough, `(n,)`."""
    corners = act(known.poses[k], known.edges[k] / 2.0 * SQUARE)
    result = np.zeros(len(poses), dtype=bool)
    ahead = np.flatnonzero(_cosines(poses, np.broadcast_to(known.poses[k], poses.shape)) >= cosine)
    image = project(camera, poses[ahead], corners[None])
    low, high = BORDER, np.array([camera.image_width, camera.image_height]) - BORDER
    result[ahead] = ((image >= low) & (image <= high)).all(axis=(1, 2)) & (shortest_side(image) >= size)
    return result


def _clear(room: Space, poses: FloatArray, known: FixedMap, inside: BoolArray) -> BoolArray:
    """Mask of the tags that no surface of the room hides, `(n, K)`."""
    result = np.zeros_like(inside)
    view, tag = np.nonzero(inside)
    ends = known.poses[tag, :3, 3] + OFF_WALL * known.poses[tag, :3, 2]
    if len(view):
        result[view, tag] = room.contains(ends) & room.clear(poses[view, :3, 3], ends)
    return result


def _separate(poses: FloatArray) -> int:
    """Number of poses that differ from all earlier poses that are counted."""
    kept: list[FloatArray] = []
    for pose in poses:
        there: FloatArray = np.array(kept).reshape(-1, 4, 4)
        near = np.linalg.norm(there[:, :3, 3] - pose[:3, 3], axis=1) < APART_M
        near &= angle_between(there, np.broadcast_to(pose, there.shape)) < APART_RAD
        if not near.any():
            kept.append(pose)
    return len(kept)
