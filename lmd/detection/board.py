"""Views of tags in photographs of a printed board with known geometry."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from lmd.core.checks import Checked, FloatArray, InputError, Positive, said_of
from lmd.core.tables import read_numbers, read_table
from lmd.detection.detectors import Detections, Detector
from lmd.detection.evaluation import CORNER_TOLERANCE, corner_error, match
from lmd.detection.frames import qualities
from lmd.detection.images import Photographs
from lmd.detection.tag_views import TagViews, only
from lmd.geometry.camera import Camera
from lmd.geometry.pose import pose_from_corners
from lmd.geometry.se3 import ROW, poses_from_rows
from lmd.geometry.squares import upright
from lmd.render.imaging import Imaging
from lmd.render.renderer import Renderer
from lmd.render.room import TaggedRoom
from lmd.scene.deployment import COLUMNS
from lmd.scene.tag import Tag


@dataclass(frozen=True)
class BoardImages(Checked):
    """Photographs of a board of tags; a `lmd.detection.tag_views.ViewSource`.

    Raises:
        InputError: a value is missing or out of range.
    """

    folder: str | None
    """Folder of the images, all of one camera."""
    tags: str | None
    """CSV with the columns id,x,y,z,nx,ny,nz: id, centre (metres) and unit normal of each tag in the board's frame. The
    up of a tag is +z, or +y for a normal along z."""
    poses: str | None = None
    """CSV with the columns image,x,y,z,qx,qy,qz,qw: name of each image, and pose of its camera (x right, y down, z the
    optical axis) in the board's frame. None to estimate poses from the detected corners of at least two tags."""
    tolerance: Positive = CORNER_TOLERANCE
    """Largest distance between a detected corner and its projection, pixels."""

    def _validate(self) -> None:
        if self.folder is None:
            raise InputError("folder is missing: a folder of images is needed.", "folder")
        _ = self.images  # raises an error for a folder without images
        if self.tags is None:
            raise InputError("tags is missing: a CSV of the tags on the board is needed.", "tags")

    def views(
        self, cameras: Sequence[Camera], tag: Tag, detector: Detector, imaging: Imaging, rng: np.random.Generator
    ) -> TagViews:
        """See `ViewSource.views`: views of the tags that are wholly in an image with a known pose."""
        camera = only(cameras)
        renderer = Renderer(camera, self.board(tag), imaging)
        known = None if self.poses is None else self._known_poses(self.poses)
        parts = []
        read = self.images.read(0, len(self.images.names), camera)
        for name, image in zip(self.images.names, read, strict=True):
            if name in self.images.repeated:  # a copy of an image adds no information
                continue
            found = detector.detect(image)
            pose = _pose_by(renderer, found, self.tolerance) if known is None else known.get(name)
            if pose is None:
                continue
            expected = renderer.corners(pose)
            matches = match(found, renderer.room.ids, expected, self.tolerance)
            whole = renderer.inside(pose)
            error = corner_error(matches.corners, expected)
            parts.append(TagViews(*qualities(renderer, pose), matches.detected, error)[whole])
        if not sum(map(len, parts)):
            raise InputError(
                f"folder: in no image of {str(self.folder)!r} is a tag of the board where it should be.", "folder"
            )
        return TagViews.concatenated(parts)

    @property
    def photographs(self) -> int:
        """See `ViewSource.photographs`."""
        return len(self.images.names) - len(self.images.repeated)

    @cached_property
    def images(self) -> Photographs:
        """Images of the folder."""
        assert self.folder is not None
        return Photographs(self.folder)

    def board(self, tag: Tag) -> TaggedRoom:
        """Tags of the board, in the board's frame."""
        assert self.tags is not None
        table = read_numbers(self.tags, ("id", *COLUMNS), name="tags")
        normals = table[:, 4:] / np.linalg.norm(table[:, 4:], axis=1, keepdims=True)
        with said_of(self.tags):
            return TaggedRoom(tag, table[:, 0].astype(np.int64), table[:, 1:4], normals, upright(normals)[1])

    def _known_poses(self, path: str) -> dict[str, FloatArray]:
        """Camera poses X by the name of the image."""
        table = read_table(path, name="poses")
        rows = table.numbers(ROW, ("image",))
        if "image" not in table:
            raise InputError(f"{path} lacks the column 'image'; expected image,{','.join(ROW)}.")
        names = table.texts["image"]
        missing = set(names) - set(self.images.names)
        if missing:
            raise InputError(f"{path}: {str(self.folder)!r} has no image {min(missing)!r}.")
        with said_of(path):
            return dict(zip(names, poses_from_rows(rows), strict=True))


def _pose_by(renderer: Renderer, found: Detections, tolerance: float) -> FloatArray | None:
    """Camera pose X from the detected corners of the board; None with fewer than two tags or inconsistent corners."""
    room = renderer.room
    corners = np.full((len(room.ids), 4, 2), np.nan)
    for k, number in enumerate(room.ids):
        at = np.flatnonzero(found.ids == number)
        if len(at) == 1:
            corners[k] = found.corners[at[0]]
    if np.isfinite(corners).all(axis=(1, 2)).sum() < 2:
        return None
    pose = pose_from_corners(renderer.camera, room.corners, corners)
    error = corner_error(corners, renderer.corners(pose))
    return pose if np.nanmedian(error) <= tolerance else None
