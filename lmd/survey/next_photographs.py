"""Next photographs: camera poses that would reduce the covariance of the map most, chosen greedily.

P is the covariance of the twists of all tags: the covariance of the survey for placed tags, and the prior of hanging
for planned tags that are not placed. Let J be the Jacobian of a photograph's sightings by the tags, whitened by the
errors of corners and with the pose of the photograph projected out. The photograph reduces P by P J' (I + J P J')^-1 J
P. In each round, the candidate is chosen that most reduces the sum of the variances of the tags' places relative to
each other.
"""

from dataclasses import dataclass

import numpy as np
from threadpoolctl import threadpool_limits

from lmd.core.checks import BoolArray, FloatArray, IntArray
from lmd.detection.corner_errors import CornerErrors, shortest_side
from lmd.geometry.camera import Camera
from lmd.geometry.projection import bearings, project, slope
from lmd.geometry.se3 import pose_of
from lmd.space.space import Space
from lmd.survey.gauge import gauge_free
from lmd.survey.map_estimate import ONE_THREAD
from lmd.survey.residuals import Reprojection
from lmd.survey.sightings import RESIDUALS, SQUARE, Sightings
from lmd.survey.survey import Photograph, Survey

MOST_PHOTOGRAPHS = 5  # maximum number of photographs
LEAST_GAIN = 0.03  # minimum reduction of the sum of variances, relative
PLACES, TARGETS = 30, 8  # maximum numbers of earlier frames, and of tags that need a photograph, for candidates
# Places of candidates in front of a tag that needs a photograph: distances, metres, and angles, rad.
DISTANCES, SIDEWAYS = (0.8, 1.5, 2.5), (-0.7, 0.0, 0.7)
MOST_CANDIDATES = 200  # maximum number of candidates that are evaluated
# A candidate is too similar to a chosen candidate if nearer than `NEAR_ANOTHER`, metres, with a larger cosine of the
# angle between their directions than `SAME_WAY`: such photographs share errors that the covariance does not have.
NEAR_ANOTHER, SAME_WAY = 0.3, 0.966
# Minimum pixels per module, and minimum cosine of the incidence angle, for a tag that is expected to be detected.
LEAST_PITCH, LEAST_COSINE = 3.0, 0.3
MARGIN_PIXELS = 5.0  # minimum distance of corners from the image's border, pixels


@dataclass(frozen=True)
class _Candidate:
    """Candidate for a photograph to take."""

    pose: FloatArray
    """`(4, 4)` pose of the camera."""
    tags: IntArray
    """`(n,)` indices of the tags that the photograph shows."""
    jacobian: FloatArray
    """`(8 n, 6 n)` Jacobian J by the twists of the n tags."""


def next_photographs(
    survey: Survey, camera: Camera, modules: int, errors: CornerErrors, needy: IntArray, room: Space | None
) -> tuple[Photograph, ...]:
    """Photographs to take next, the best first.

    Args:
        survey: the survey.
        camera: camera that takes the photographs.
        modules: N of the tags' family.
        errors: errors of the detector's corners.
        needy: indices of the tags that need another photograph; tags of unknown pose are left out.
        room: room that contains the cameras and hides tags; None if unknown.
    """
    tags, covariance, known = _believed(survey)
    needy = needy[known[needy]]
    if not needy.size or known.sum() < 2:
        return ()
    with threadpool_limits(limits=ONE_THREAD):
        poses = _camera_poses(survey, tags, needy, room)
        square = survey.found.sightings.edges[:, None, None] / 2.0 * SQUARE
        points = square @ np.swapaxes(tags[:, :3, :3], 1, 2) + tags[:, None, :3, 3]
        image = project(camera, poses, points.reshape(-1, 3)).reshape(len(poses), len(tags), 4, 2)
        shown = _shown(camera, poses, tags, image, modules, room) & known
        useful = np.flatnonzero((shown.sum(axis=1) >= 2) & shown[:, needy].any(axis=1))
        order = np.lexsort((-shown[useful].sum(axis=1), -shown[useful][:, needy].sum(axis=1)))
        candidates = []
        for k in useful[order[:MOST_CANDIDATES]].tolist():
            own = np.flatnonzero(shown[k])
            jacobian = _jacobian(survey, camera, modules, errors, tags, poses[k], own, image[k, own])
            candidates.append(_Candidate(poses[k], own, jacobian))
        return _greedy(tags, covariance, known, candidates)


def _believed(survey: Survey) -> tuple[FloatArray, FloatArray, BoolArray]:
    """Poses of tags, estimated or planned, the covariance of their twists, `(6 K, 6 K)`, and True for known tags."""
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


def _camera_poses(survey: Survey, tags: FloatArray, needy: IntArray, room: Space | None) -> FloatArray:
    """Poses of level cameras that look at the `needy` tags, `(M, 4, 4)`, at places of earlier frames and in front of
    tags.
    """
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
    camera: Camera, poses: FloatArray, tags: FloatArray, image: FloatArray, modules: int, room: Space | None
) -> BoolArray:
    """True for tags with corners at `image` `(M, K, 4, 2)` that M cameras at `poses` will detect, `(M, K)`."""
    towards = poses[:, None, :3, 3] - tags[:, :3, 3]
    facing = (towards * tags[:, :3, 2]).sum(axis=-1) / np.linalg.norm(towards, axis=-1)
    most = np.array([camera.image_width, camera.image_height]) - MARGIN_PIXELS
    sides = shortest_side(image.reshape(-1, 4, 2)).reshape(facing.shape)
    inside = ((image > MARGIN_PIXELS) & (image < most)).all(axis=(2, 3))
    shown = np.asarray(inside & (facing > LEAST_COSINE) & (sides > LEAST_PITCH * modules))
    if room is not None:
        which, tag = np.nonzero(shown)
        before = tags[tag, :3, 3] + 1e-3 * tags[tag, :3, 2]
        shown[which, tag] = room.clear(poses[which, :3, 3], before)
    return shown


def _jacobian(
    survey: Survey,
    camera: Camera,
    modules: int,
    errors: CornerErrors,
    tags: FloatArray,
    pose: FloatArray,
    own: IntArray,
    corners: FloatArray,
) -> FloatArray:
    """J of a photograph at `pose` that shows the n tags `own` at `corners` `(n, 4, 2)`, `(8 n, 6 n)`."""
    count, sides, directions, every = (
        len(own),
        shortest_side(corners),
        bearings(camera, corners),
        survey.found.sightings,
    )
    noise = np.hypot(errors.sigma(sides / modules), survey.found.floor)
    zero = np.zeros(count, dtype=np.int64)
    some = Sightings(
        every.ids, every.edges, 1, 1, zero, zero, own, corners, directions, slope(camera, directions), sides,
        sides / modules, noise, np.empty((count, RESIDUALS, 0)), every.shapes, 0.0, 0.0,
    )  # fmt: skip
    still = np.broadcast_to(np.eye(4), (count, 4, 4))
    at = Reprojection(some, tags[own], np.broadcast_to(pose, (count, 4, 4)), still)
    by_tags = np.zeros((count, RESIDUALS, count, 6))
    by_tags[np.arange(count), :, np.arange(count)] = at.by_tag / noise[:, None, None]
    basis, _ = np.linalg.qr((at.by_frame / noise[:, None, None]).reshape(-1, 6))
    whole = by_tags.reshape(RESIDUALS * count, 6 * count)
    return np.asarray(whole - basis @ (basis.T @ whole))


def _greedy(
    tags: FloatArray, covariance: FloatArray, known: BoolArray, candidates: list[_Candidate]
) -> tuple[Photograph, ...]:
    """Choose candidates one after the other: each time the best candidate that is not similar to a chosen candidate."""
    rows = np.flatnonzero(np.repeat(known, 6))
    place = np.cumsum(known) - 1
    left = gauge_free(tags[known])[np.tile(np.arange(6) >= 3, int(known.sum()))]  # rows of places
    whole = covariance[np.ix_(rows, rows)]
    poses = np.reshape([one.pose for one in candidates], (-1, 4, 4))
    fresh = np.ones(len(candidates), dtype=bool)
    chosen: list[Photograph] = []

    def inner(one: _Candidate) -> tuple[IntArray, FloatArray]:
        """Rows of the candidate's tags in P, and I + J P J'."""
        index = (6 * place[one.tags][:, None] + np.arange(6)).ravel()
        return index, np.eye(len(one.jacobian)) + one.jacobian @ whole[np.ix_(index, index)] @ one.jacobian.T

    for _ in range(MOST_PHOTOGRAPHS):
        seen = left @ whole
        total = float((seen * left).sum())
        gains = np.zeros(len(candidates))
        for k in np.flatnonzero(fresh).tolist():
            index, matrix = inner(candidates[k])
            half = candidates[k].jacobian @ seen[:, index].T
            gains[k] = (half * np.linalg.solve(matrix, half)).sum()
        if not candidates or gains.max() < LEAST_GAIN * total:
            break
        best = int(np.argmax(gains))
        one = candidates[best]
        index, matrix = inner(one)
        half = one.jacobian @ whole[index]
        whole = whole - half.T @ np.linalg.solve(matrix, half)
        near = np.linalg.norm(poses[:, :3, 3] - one.pose[:3, 3], axis=1) < NEAR_ANOTHER
        fresh &= ~(near & (poses[:, :3, 2] @ one.pose[:3, 2] > SAME_WAY))
        chosen.append(Photograph(one.pose, one.tags, float(np.sqrt(max(total - gains[best], 0.0) / known.sum()))))
    return tuple(chosen)
