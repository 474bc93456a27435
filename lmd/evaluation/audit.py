"""Audit of a visibility model: detections in the frames of a survey are compared with the model's predictions. The
module also makes the columns of `in_view.csv`, the survey's table of tags in view.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike

from lmd.adjust.corners import squared_errors
from lmd.core.checks import BoolArray, FloatArray, IntArray
from lmd.detection.detectors import CORNER_TOLERANCE, Matches, precision_recall
from lmd.detection.frames import overlapping, qualities, tagged_room
from lmd.detection.predictions import PITCHES, CameraPrediction, Prediction, by_incidence, by_pitch, by_tag
from lmd.detection.tag_views import CAMERA, COLUMNS, FRAME
from lmd.geometry.camera import Camera
from lmd.geometry.projection import image_size, intrinsics, to_camera
from lmd.geometry.se3 import pose_of
from lmd.render.imaging import Imaging
from lmd.render.renderer import Renderer
from lmd.render.room import TaggedRoom
from lmd.scene.deployment import Deployment
from lmd.scene.scene import Scene
from lmd.scene.tag import Tag
from lmd.sight.views import visible_through
from lmd.space.cuboid import Cuboid
from lmd.space.space import Space
from lmd.survey.results import map_of
from lmd.survey.survey import Survey

# A tag stands out if it is detected less often than other tags of equal pitch: by `STANDS_OUT` standard deviations, and
# less than `HALF` as often.
STANDS_OUT, HALF = 4.0, 0.5
IN_A_ROW = 5  # least number of successive misses of a tag that are assumed to have one cause
AROUND = 1.0  # distance of the assumed walls of an unknown room from all cameras and tags, metres
LEAST_UP = 0.3  # minimum length of the mean of the tags' up vectors for which the mean defines the vertical
OFF_WALL = 1e-3  # distance before a tag at which lines of sight end, metres
WHOLE_NUMBERS = (CAMERA, "id", "seen")

Verdicts = Callable[[Scene, Deployment, FloatArray, Camera], dict[str, BoolArray]]


@dataclass(frozen=True)
class Audit:
    """Comparison of the tags that are predicted and detected in N frames of a survey, for the K tags of its map.

    With C cameras, arrays have C K columns, one for each pair of a camera and a tag; the columns of the first camera
    come first.
    """

    prediction: Prediction
    """Tags that are visible in each frame according to the visibility model."""
    seen: Matches
    """Detections in each frame. A detection is false if the map has no tag where it was seen."""

    @cached_property
    def expected(self) -> FloatArray:
        """Probability that each tag is detected in each frame, `(N, C K)`; 0 for tags that are not predicted.

        The probability is the fraction of detected tags among all predicted tags with about the same apparent size
        (pitch).
        """
        visible, detected = self.prediction.visible, self.seen.detected
        place = np.searchsorted(PITCHES, self.prediction.pitch, side="right") - 1
        chance = np.zeros(visible.shape)
        for b in np.unique(place[visible]):
            own = visible & (place == b)
            chance[own] = detected[own].mean()
        return chance

    @cached_property
    def tags(self) -> pd.DataFrame:
        """Table with a row for each tag: the columns of `by_tag`, and the columns `confirmed`, `expected` and
        `stands_out`.

        `confirmed` is the number of images in which the tag was predicted and detected. `expected` is the expected
        value of this number, estimated from all tags that appear with about the same pitch. `stands_out` is true if
        `confirmed` is far below `expected`.
        """
        chance, cameras = self.expected, len(self.prediction.parts)
        confirmed, expected, variance = (
            images.sum(axis=0).reshape(cameras, -1).sum(axis=0)
            for images in (self.prediction.visible & self.seen.detected, chance, chance * (1.0 - chance))
        )
        odd = (confirmed < expected - STANDS_OUT * np.sqrt(variance)) & (confirmed < HALF * expected)
        table = by_tag(self.prediction, self.seen)
        return table.assign(confirmed=confirmed, expected=expected, stands_out=odd)

    @cached_property
    def missed_in_a_row(self) -> BoolArray:
        """Mask of the misses in a row, `(N, C K)`. A predicted tag that is not detected is missed; a miss counts here
        if it belongs to at least `IN_A_ROW` misses in successive images for which the tag is predicted.

        A tag well within the detector's limits is rarely missed in many successive images unless it is hidden or in
        glare.
        """
        visible, missed = self.prediction.visible, self.prediction.visible & ~self.seen.detected
        result = np.zeros_like(missed)
        for k in range(missed.shape[1]):
            frames = np.flatnonzero(visible[:, k])
            ends = np.flatnonzero(np.diff(missed[frames, k], prepend=False, append=False))
            for first, last in zip(ends[::2], ends[1::2], strict=True):
                result[frames[first:last], k] = last - first >= IN_A_ROW
        return result

    @property
    def tables(self) -> dict[str, pd.DataFrame]:
        """Tables of the tags in bins of pitch, in bins of incidence angle, and one by one; keyed by file name."""
        return {
            "audit_pitches": by_pitch(self.prediction, self.seen),
            "audit_incidences": by_incidence(self.prediction, self.seen),
            "audit_tags": self.tags,
        }

    def metrics(self) -> dict[str, float]:
        """Precision and recall of the predictions; numbers of tags per frame, of misses, and of tags that stand out.

        A miss is a predicted tag that is not detected; misses in a row are also counted apart.
        """
        visible, detected = self.prediction.visible, self.seen.detected
        precision, recall = precision_recall(visible, detected)
        counts = {"predicted": visible.sum(axis=1).mean(), "detected": detected.sum(axis=1).mean()}
        missed = {"missed": (visible & ~detected).sum(), "missed_in_a_row": self.missed_in_a_row.sum()}
        figures = {"precision": precision, "recall": recall, **counts, **missed}
        figures["stand_out"] = self.tags.stands_out.sum()
        return {f"audit/{name}": float(value) for name, value in figures.items() if np.isfinite(value)}

    def to_text(self) -> str:
        """Summary for a terminal: the metrics, and the tags that stand out."""
        figures = self.metrics()
        head = (
            f"audit       {figures['audit/predicted']:.2f} tags per frame predicted, {figures['audit/detected']:.2f} "
            f"detected; {figures.get('audit/precision', np.nan):.1%} of the predicted tags were detected, "
            f"{figures.get('audit/recall', np.nan):.1%} of the detected tags were predicted"
        )
        if figures["audit/missed_in_a_row"]:
            missed, runs = figures["audit/missed"], figures["audit/missed_in_a_row"]
            head += (
                f"\nmissed      {missed:.0f} times, of these {runs:.0f} in {IN_A_ROW} or more images of a tag in a row"
            )
        odd = self.tags[self.tags.stands_out]
        named = ", ".join(
            f"{row.id} (in {row.confirmed} of {row.predicted} frames, others in {row.expected:.0f})"
            for row in odd.itertuples()
        )
        return head + (f"\nstand out   {named}" if named else "")


def audited(survey: Survey, scene: Scene, verdicts: Verdicts) -> Audit:
    """Compare the detections of a survey with the tags that the visibility model predicts in the images of all cameras.

    Args:
        survey: survey made with the scene's cameras; their mounts are taken from the survey.
        scene: room, cameras and visibility model.
        verdicts: function that returns, for each criterion of the visibility model, the mask of the tags that meet it,
            see `lmd.evaluation.verdicts`.

    Raises:
        InputError: the scene's tag is a point.
    """
    found = survey.found
    tags = map_of(survey)
    tags = tags.with_surfaces(scene.room, anywhere=True, papers=scene.footprints.papers(tags))
    room = tagged_room(scene.room, tags, scene.tag)
    bodies, mounts = found.poses.frames[found.frames], found.poses.mounts
    parts = []
    for camera, mount, taken in zip(scene.cameras, mounts, survey.detected.images[found.frames].T, strict=True):
        poses = bodies @ mount
        seen = visible_through(scene, camera, tags, poses) & taken[:, None]
        parts.append(CameraPrediction(Renderer(camera, room), poses, seen, verdicts(scene, tags, poses, camera), taken))
    return Audit(Prediction(tuple(parts), mounts, bodies), Matches.beside(detections_of_map(survey)))


def in_the_open(survey: Survey, scene: Scene) -> tuple[Survey, Scene]:
    """Replace an unknown room by an empty room around all tags and cameras, in which only other tags can hide a tag.
    Returns the survey and the scene in the frame of the empty room.

    The z axis of this frame is the mean up vector of the tags, as tags hang upright in the visibility model.
    """
    found = survey.found
    tags = found.poses.tags[survey.placed]
    up = tags[:, :3, 1].mean(axis=0)
    up = up / np.linalg.norm(up) if np.linalg.norm(up) > LEAST_UP else np.array([0.0, 0.0, 1.0])
    right = np.cross(np.eye(3)[np.abs(up).argmin()], up)
    right /= np.linalg.norm(right)
    turn = np.stack([right, np.cross(up, right), up])
    places = np.concatenate([tags, found.poses.frames[found.frames]])[:, :3, 3] @ turn.T
    low, high = places.min(axis=0) - AROUND, places.max(axis=0) + AROUND
    size = tuple(map(float, high - low))
    room = Cuboid(size, reachable_size=size, spacing=max(size))  # type: ignore[arg-type]
    return replace(survey, found=found.moved(pose_of(turn, -low))), replace(scene, room=room)


def detections_of_map(survey: Survey) -> list[Matches]:
    """For each camera, the detections of the map's tags in those frames whose poses the survey has estimated.

    A detection counts as a sighting of the tag if the RMS reprojection error of its corners is at most
    `CORNER_TOLERANCE`, even if the map treats the detection as an outlier.
    """
    found, some = survey.found, survey.found.sightings
    frame = np.full(some.frames, -1)
    frame[found.frames] = np.arange(len(found.frames))
    tag = np.full(len(survey.ids), -1)
    tag[survey.placed] = np.arange(survey.placed.sum())
    known = np.flatnonzero((frame[some.frame] >= 0) & survey.placed[some.tag])
    off = np.full(len(some), np.inf)
    off[known] = np.sqrt(squared_errors(some.of(known), found.poses) / 4.0)
    each = []
    for camera in range(some.cameras):
        detected = np.zeros((len(found.frames), int(survey.placed.sum())), dtype=bool)
        corners = np.full((*detected.shape, 4, 2), np.nan)
        own = some.camera == camera
        right = np.flatnonzero(own & (off <= CORNER_TOLERANCE))
        right = right[np.argsort(-off[right], kind="stable")]  # the detection nearest to the tag wins
        at = frame[some.frame[right]], tag[some.tag[right]]
        detected[at], corners[at] = True, some.image[right]
        wrong = own & found.misfits & (frame[some.frame] >= 0) & (off > CORNER_TOLERANCE)
        each.append(Matches(detected, corners, np.bincount(frame[some.frame[wrong]], minlength=len(detected))))
    return each


def view_columns(survey: Survey, cameras: Sequence[Camera], tag: Tag, room: Space | None) -> dict[str, ArrayLike]:
    """Columns of `in_view.csv`: a row for each image and each tag that faces the camera and has all four corners in the
    image.

    Tags that overlap another tag on the wall, and tags hidden by the room, are left out. See `lmd.detection.tag_views`.

    Args:
        survey: the survey.
        cameras: cameras that took the images.
        tag: family of the tags, and edge length of the tags that have no length of their own.
        room: the room; None if unknown.
    """
    tags, found = map_of(survey), survey.found
    tagged = TaggedRoom(tag, tags.ids, tags.places, tags.normals, tags.ups, edges=tags.edges_of(tag))
    bodies = found.poses.frames[found.frames]
    times = np.array([survey.detected.times[frame] for frame in found.frames.tolist()])
    names, rows = [], []
    images = survey.detected.images[found.frames].T
    each = zip(cameras, found.poses.mounts, detections_of_map(survey), images, strict=True)
    for number, (camera, mount, seen, taken) in enumerate(each, 1):
        frame, k, values = _in_images(Renderer(camera, tagged, Imaging()), bodies @ mount, taken, room)
        names.append(times[frame])
        rows.append(np.column_stack([np.full(len(frame), number), tags.ids[k], values, seen.detected[frame, k]]))
    columns = dict(zip((CAMERA, *COLUMNS), np.concatenate(rows).T, strict=True))
    return {FRAME: np.concatenate(names), **columns, **{name: columns[name].astype(int) for name in WHOLE_NUMBERS}}


def _in_images(
    renderer: Renderer, poses: FloatArray, taken: BoolArray, room: Space | None
) -> tuple[IntArray, IntArray, FloatArray]:
    """Find the M pairs of an image and a tag that is in view in this image.

    Args:
        renderer: renderer of one camera and the tags.
        poses: poses of the camera in N frames of a survey, `(N, 4, 4)`.
        taken: mask of the frames of which this camera has an image, `(N,)`; a camera of a rig may lack images.
        room: the room; None if unknown.

    Returns:
        indices of the frames, and of the tags, `(M,)` each; and the values of the columns `u` to `circle` of
        `in_view.csv` for each pair, `(M, 8)`.
    """
    tags = renderer.room
    pitch, incidence, edge, _ = qualities(renderer, poses)
    frame, k = np.nonzero(renderer.inside(poses) & taken[:, None] & ~overlapping(tags))
    if room is not None:
        clear = room.clear(poses[frame, :3, 3], tags.centres[k] + OFF_WALL * tags.normals[k])
        frame, k = frame[clear], k[clear]
    corners, camera = renderer.picture_corners(poses)[frame, k], renderer.camera
    depth = to_camera(poses, tags.centres)[frame, k, 2]
    sizes = pitch[frame, k], np.degrees(incidence[frame, k]), edge[frame, k]
    border = np.minimum(corners, image_size(camera) - corners).min(axis=(1, 2), initial=np.inf)
    matrix, focal = intrinsics(camera), camera.focal_pixels
    away = (corners - matrix[:2, 2]) / focal * focal.max()  # in the units of `Camera.image_circle`
    circle = 2.0 * np.linalg.norm(away, axis=-1).max(axis=1, initial=0.0)
    return frame, k, np.column_stack([corners.mean(axis=1), depth, *sizes, border, circle])
