"""From where further photographs would tell most of the map, one after the other.

What is known of all tags is the covariance P of their twists: that of the survey, and for tags of the plan that it
could not place that of hanging. A photograph with the slopes J of its sightings by the tags, whitened by what corners
are off by and freed from its own pose, lowers it by P J' (I + J P J')^-1 J P. The best of many candidates is the one
that most lowers the sum of the variances of the places of all tags beside each other; the next one then begins with
what is left.
"""

from collections.abc import Sequence

import numpy as np
from threadpoolctl import threadpool_limits

from lmd.core.checks import BoolArray, FloatArray, IntArray
from lmd.detection.corner_errors import CornerErrors
from lmd.geometry.camera import Camera
from lmd.geometry.projection import bearings, project, slope
from lmd.geometry.se3 import pose_of
from lmd.geometry.squares import CORNERS
from lmd.space.space import Space
from lmd.survey.estimate import ONE_THREAD
from lmd.survey.gauge import gauge_free
from lmd.survey.residuals import linearise
from lmd.survey.sightings import Sightings, shortest_side
from lmd.survey.student import RESIDUALS
from lmd.survey.survey import Photograph, Survey

MOST_PHOTOGRAPHS = 5  # photographs that are proposed
LEAST_GAIN = 0.03  # of the sum of variances; a photograph that lowers it by less is not proposed
PLACES, TARGETS = 30, 8  # of earlier frames, and of tags that need a photograph: so many are tried
DISTANCES, SIDEWAYS = (0.8, 1.5, 2.5), (-0.7, 0.0, 0.7)  # metres and rad, from which such a tag is tried
MOST_CANDIDATES = 200  # candidates that are weighed
# Photographs from so near, metres, that look the same way, as a cosine, have errors in common that no covariance knows.
NEAR_ANOTHER, SAME_WAY = 0.3, 0.966
# A tag is counted on if its modules are so large, pixels, and it is not steeper, as a cosine.
LEAST_PITCH, LEAST_COSINE = 3.0, 0.3
MARGIN_PIXELS = 5.0  # pixels from the border of the image


def next_photographs(
    survey: Survey, camera: Camera, modules: int, errors: CornerErrors, needy: IntArray, room: Space | None
) -> tuple[Photograph, ...]:
    """The photographs to take next, the best first.

    Args:
        camera: that takes them.
        modules: N of the tags' family.
        errors: what the detector's corners are off by.
        needy: the tags that need another photograph, by their index; those of which nothing is known are left out.
        room: no camera stands outside of it, and what stands in it hides tags; None where it is not known.
    """
    tags, covariance, known = _believed(survey)
    needy = needy[known[needy]]
    if not needy.size or known.sum() < 2:
        return ()
    with threadpool_limits(limits=ONE_THREAD):
        poses = _candidates(survey, tags, needy, room)
        shown, image = _shown(camera, poses, tags, survey.found.sightings.edges, modules, known, room)
        worth = np.flatnonzero((shown.sum(axis=1) >= 2) & shown[:, needy].any(axis=1))
        order = np.lexsort((-shown[worth].sum(axis=1), -shown[worth][:, needy].sum(axis=1)))
        tried = worth[order[:MOST_CANDIDATES]]
        slopes = [
            _slopes(survey, camera, modules, errors, tags, poses[k], np.flatnonzero(shown[k]), image[k])
            for k in tried.tolist()
        ]
        return _greedy(tags, covariance, known, [(poses[k], np.flatnonzero(shown[k])) for k in tried.tolist()], slopes)


def _believed(survey: Survey) -> tuple[FloatArray, FloatArray, BoolArray]:
    """Poses of tags, found or planned, `(K, 4, 4)`; the covariance of their twists, `(6 K, 6 K)`; which are known."""
    found, size = survey.found, 6 * len(survey.ids)
    covariance = found.covariance[:size, :size].copy()
    tags = np.where(survey.placed[:, None, None], found.poses.tags, np.nan)
    if (planned := survey.planned) is not None:
        for k in np.flatnonzero(~survey.placed & np.isfinite(planned[:, 0, 0])):
            tags[k], rows = planned[k], slice(6 * k, 6 * k + 6)
            covariance[rows], covariance[:, rows] = 0.0, 0.0
            covariance[rows, rows] = np.diag(survey.known.hanging.deviations**2)
    known = np.isfinite(tags[:, 0, 0]) & np.isfinite(np.diag(covariance).reshape(-1, 6)).all(axis=1)
    return tags, covariance, known


def _candidates(survey: Survey, tags: FloatArray, needy: IntArray, room: Space | None) -> FloatArray:
    """Poses of level cameras that look at tags, `(M, 4, 4)`: where earlier frames were taken, and before tags."""
    frames = survey.found.poses.frames[survey.found.frames]
    up = -frames[:, :3, 1].mean(axis=0)
    up /= np.linalg.norm(up)
    needy = needy[np.linspace(0, len(needy) - 1, min(TARGETS, len(needy))).astype(int)]
    places = [frames[np.linspace(0, len(frames) - 1, min(PLACES, len(frames))).astype(int), :3, 3]]
    height = np.median(frames[:, :3, 3] @ up)
    for tag in tags[needy]:
        for turn in SIDEWAYS:
            way = np.cos(turn) * tag[:3, 2] + np.sin(turn) * np.cross(up, tag[:3, 2])
            at = tag[:3, 3] + np.outer(DISTANCES, way)
            places.append(at + (height - at @ up)[:, None] * up)
    stands = np.concatenate(places)
    if room is not None:
        stands = stands[room.contains(stands)]
    centres = tags[:, :3, 3]
    away = np.linalg.norm(centres[needy, None] - centres, axis=-1)
    neighbours = np.argsort(np.where(np.isfinite(away), away, np.inf), axis=1)[:, 1]
    targets = np.concatenate([centres[needy], (centres[needy] + centres[neighbours]) / 2.0])
    stands, targets = (array.reshape(-1, 3) for array in np.broadcast_arrays(stands[:, None], targets[None]))
    ahead = targets - stands
    ahead /= np.maximum(np.linalg.norm(ahead, axis=1, keepdims=True), 1e-9)
    right = np.cross(ahead, up)
    level = np.linalg.norm(right, axis=1) > 1e-3
    ahead, right, stands = ahead[level], right[level] / np.linalg.norm(right[level], axis=1)[:, None], stands[level]
    return pose_of(np.stack([right, np.cross(ahead, right), ahead], axis=-1), stands)


def _shown(
    camera: Camera,
    poses: FloatArray,
    tags: FloatArray,
    edges: FloatArray,
    modules: int,
    known: BoolArray,
    room: Space | None,
) -> tuple[BoolArray, FloatArray]:
    """Which tags each candidate shows, `(M, K)`, and where their corners are imaged, `(M, K, 4, 2)`."""
    square = np.hstack([CORNERS, np.zeros((4, 1))])
    points = (edges[:, None, None] / 2.0 * square) @ np.swapaxes(tags[:, :3, :3], 1, 2) + tags[:, None, :3, 3]
    image = project(camera, poses, points.reshape(-1, 3)).reshape(len(poses), len(tags), 4, 2)
    towards = poses[:, None, :3, 3] - tags[:, :3, 3]
    facing = (towards * tags[:, :3, 2]).sum(axis=-1) / np.linalg.norm(towards, axis=-1)
    most = np.array([camera.image_width, camera.image_height]) - MARGIN_PIXELS
    sides = np.linalg.norm(image - np.roll(image, 1, axis=2), axis=-1).min(axis=-1)
    inside = ((image > MARGIN_PIXELS) & (image < most)).all(axis=(2, 3))
    shown = inside & (facing > LEAST_COSINE) & (sides > LEAST_PITCH * modules) & known
    if room is not None:
        which, tag = np.nonzero(shown)
        before = tags[tag, :3, 3] + 1e-3 * tags[tag, :3, 2]
        shown[which, tag] = room.clear(poses[which, :3, 3], before)
    return shown, image


def _slopes(
    survey: Survey,
    camera: Camera,
    modules: int,
    errors: CornerErrors,
    tags: FloatArray,
    pose: FloatArray,
    own: IntArray,
    image: FloatArray,
) -> FloatArray:
    """Derivatives J of a photograph by the twists of the tags `own`, whitened and freed from its pose, `(8 n, 6 n)`."""
    count, corners = len(own), image[own]
    sides = shortest_side(corners)
    directions = bearings(camera, corners)
    noise = np.hypot(errors.sigma(sides / modules), survey.found.floor)
    every = survey.found.sightings
    zero = np.zeros(count, dtype=np.int64)
    some = Sightings(
        every.ids, every.edges, 1, 1, zero, zero, own, corners, directions, slope(camera, directions), sides,
        sides / modules, noise, np.empty((count, RESIDUALS, 0)), every.shapes, 0.0, 0.0,
    )  # fmt: skip
    still = np.broadcast_to(np.eye(4), (count, 4, 4))
    at = linearise(some, tags[own], np.broadcast_to(pose, (count, 4, 4)), still)
    by_tags = np.zeros((count, RESIDUALS, count, 6))
    by_tags[np.arange(count), :, np.arange(count)] = at.by_tag / noise[:, None, None]
    by_frame = (at.by_frame / noise[:, None, None]).reshape(-1, 6)
    basis, _ = np.linalg.qr(by_frame)
    whole = by_tags.reshape(RESIDUALS * count, 6 * count)
    return np.asarray(whole - basis @ (basis.T @ whole))


def _greedy(
    tags: FloatArray,
    covariance: FloatArray,
    known: BoolArray,
    candidates: Sequence[tuple[FloatArray, IntArray]],
    slopes: Sequence[FloatArray],
) -> tuple[Photograph, ...]:
    """The best candidate that is not like those before it, again and again."""
    rows = np.flatnonzero(np.repeat(known, 6))
    place = np.cumsum(known) - 1
    left = gauge_free(tags[known])
    left = left[np.tile(np.arange(6) >= 3, int(known.sum()))]  # what is counted: places
    whole = covariance[np.ix_(rows, rows)]
    poses = np.reshape([pose for pose, _ in candidates], (-1, 4, 4))
    fresh = np.ones(len(candidates), dtype=bool)
    chosen: list[Photograph] = []
    for _ in range(MOST_PHOTOGRAPHS):
        seen = left @ whole
        total = float((seen * left).sum())
        gains = np.zeros(len(candidates))
        for k, ((_, own), slopes_of) in enumerate(zip(candidates, slopes, strict=True)):
            index = (6 * place[own][:, None] + np.arange(6)).ravel()
            inner = np.eye(len(slopes_of)) + slopes_of @ whole[np.ix_(index, index)] @ slopes_of.T
            half = slopes_of @ seen[:, index].T
            gains[k] = fresh[k] * (half * np.linalg.solve(inner, half)).sum()
        if not len(candidates) or gains.max() < LEAST_GAIN * total:
            break
        best = int(np.argmax(gains))
        pose, own = candidates[best]
        index = (6 * place[own][:, None] + np.arange(6)).ravel()
        inner = np.eye(len(slopes[best])) + slopes[best] @ whole[np.ix_(index, index)] @ slopes[best].T
        half = slopes[best] @ whole[index]
        whole = whole - half.T @ np.linalg.solve(inner, half)
        near = np.linalg.norm(poses[:, :3, 3] - pose[:3, 3], axis=1) < NEAR_ANOTHER
        fresh &= ~(near & (poses[:, :3, 2] @ pose[:3, 2] > SAME_WAY))
        chosen.append(Photograph(pose, own, float(np.sqrt(max(total - gains[best], 0.0) / known.sum()))))
    return tuple(chosen)
