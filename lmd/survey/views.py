"""What each image of a survey could have shown of its tags, and whether that was detected."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from lmd.core.checks import BoolArray, FloatArray, IntArray
from lmd.detection.frames import overlapping, qualities
from lmd.detection.views import CAMERA, COLUMNS, FRAME
from lmd.geometry.camera import Camera
from lmd.geometry.projection import image_size, intrinsics, to_camera
from lmd.render.imaging import Imaging
from lmd.render.renderer import Renderer
from lmd.render.room import TaggedRoom
from lmd.scene.tag import Tag
from lmd.space.space import Space
from lmd.survey.audit import seen_of
from lmd.survey.report import map_of
from lmd.survey.survey import Survey

OFF_WALL = 1e-3  # metres before a tag, where it is looked at
WHOLE_NUMBERS = (CAMERA, "id", "seen")


def view_columns(survey: Survey, cameras: Sequence[Camera], tag: Tag, room: Space | None) -> dict[str, ArrayLike]:
    """The columns of `in_view.csv`: a row for each tag that has all its corners in an image and faces the camera.

    Those that lie over others, or behind what stands in the room, are left out. See `lmd.detection.views`.

    Args:
        cameras: that took the images.
        tag: family, and edge of those that have none of their own.
        room: None where it is not known.
    """
    tags, found = map_of(survey), survey.found
    tagged = TaggedRoom(tag, tags.ids, tags.places, tags.normals, tags.ups, edges=tags.edges_of(tag))
    bodies = found.poses.frames[found.frames]
    times = np.array([survey.detected.times[frame] for frame in found.frames.tolist()])
    names, rows = [], []
    each = zip(cameras, found.poses.mounts, seen_of(survey), survey.detected.images[found.frames].T, strict=True)
    for number, (camera, mount, seen, taken) in enumerate(each, 1):
        frame, k, values = _in_images(Renderer(camera, tagged, Imaging()), bodies @ mount, taken, room)
        names.append(times[frame])
        rows.append(np.column_stack([np.full(len(frame), number), tags.ids[k], values, seen.detected[frame, k]]))
    columns = dict(zip((CAMERA, *COLUMNS), np.concatenate(rows).T, strict=True))
    return {FRAME: np.concatenate(names), **columns, **{name: columns[name].astype(int) for name in WHOLE_NUMBERS}}


def _in_images(
    renderer: Renderer, poses: FloatArray, taken: BoolArray, room: Space | None
) -> tuple[IntArray, IntArray, FloatArray]:
    """Which image shows which tag, `(M,)` each, and the columns from u to circle, `(M, 8)`.

    Args:
        renderer: one camera and the tags.
        poses: of its images, `(N, 4, 4)`.
        taken: which of them there are, `(N,)`.
        room: None where it is not known.
    """
    tags = renderer.room
    pitch, incidence, edge, _ = qualities(renderer, poses)
    frame, k = np.nonzero(renderer.inside(poses) & taken[:, None] & ~overlapping(tags))
    if room is not None:
        clear = room.clear(poses[frame, :3, 3], tags.centres[k] + OFF_WALL * tags.normals[k])
        frame, k = frame[clear], k[clear]
    corners, camera = renderer.corners(poses)[frame, k], renderer.camera
    depth = to_camera(poses, tags.centres)[frame, k, 2]
    sizes = pitch[frame, k], np.degrees(incidence[frame, k]), edge[frame, k]
    border = np.minimum(corners, image_size(camera) - corners).min(axis=(1, 2), initial=np.inf)
    matrix, focal = intrinsics(camera), camera.focal_pixels
    away = (corners - matrix[:2, 2]) / focal * focal.max()  # what `Camera.image_circle` is measured in
    circle = 2.0 * np.linalg.norm(away, axis=-1).max(axis=1, initial=0.0)
    return frame, k, np.column_stack([corners.mean(axis=1), depth, *sizes, border, circle])
