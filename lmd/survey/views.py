"""What each frame of a survey could have shown of its tags, and whether that was detected."""

import numpy as np
from numpy.typing import ArrayLike

from lmd.detection.frames import overlapping, qualities
from lmd.detection.surveyed import COLUMNS, FRAME
from lmd.render.imaging import Imaging
from lmd.render.optics import to_camera
from lmd.render.renderer import Renderer
from lmd.render.room import TaggedRoom
from lmd.scene.camera import Camera
from lmd.scene.tag import Tag
from lmd.space.space import Space
from lmd.survey.audit import seen_of
from lmd.survey.report import map_of
from lmd.survey.survey import Survey

OFF_WALL = 1e-3  # metres before a tag, where it is looked at


def view_columns(survey: Survey, camera: Camera, tag: Tag, room: Space | None) -> dict[str, ArrayLike]:
    """The columns of `in_view.csv`: a row for each tag that has all its corners in a frame and faces it.

    Those that lie over others, or behind what stands in the room, are left out. See `lmd.detection.surveyed`.

    Args:
        survey: of one camera.
        camera: it.
        tag: family, and edge of those that have none of their own.
        room: None where it is not known.
    """
    tags, found = map_of(survey), survey.found
    poses = found.poses.frames[found.frames]
    hung = TaggedRoom(tag, tags.ids, tags.places, tags.normals, tags.ups, edges=tags.edges_of(tag))
    renderer = Renderer(camera, hung, Imaging())
    pitch, incidence, edge, _ = qualities(renderer, poses)
    whole = renderer.inside(poses) & ~overlapping(renderer.room)
    frame, k = np.nonzero(whole)
    if room is not None:
        clear = room.clear(poses[frame, :3, 3], tags.places[k] + OFF_WALL * tags.normals[k])
        frame, k = frame[clear], k[clear]
    centres = renderer.corners(poses).mean(axis=2)[frame, k]
    depth = to_camera(poses, tags.places)[frame, k, 2]
    values = (centres[:, 0], centres[:, 1], depth, pitch[frame, k], np.degrees(incidence[frame, k]))
    names = [survey.detected.times[found.frames[index]] for index in frame.tolist()]
    rows = (tags.ids[k], *values, edge[frame, k], seen_of(survey).detected[frame, k].astype(int))
    return {FRAME: names, **dict(zip(COLUMNS, rows, strict=True))}
