"""Views of single tags, and detections of these tags, to which a detector's limits are fitted. Sources of views are a
survey, and photographs of a printed board with known geometry.
"""

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from functools import cached_property
from pathlib import Path
from typing import Protocol, Self

import numpy as np

from lmd.core.checks import BoolArray, Checked, FloatArray, InputError, IntArray, Positive, said_of
from lmd.core.tables import Table, in_order, read_numbers, read_table
from lmd.detection.detectors import CORNER_TOLERANCE, Detections, Detector, corner_error, match
from lmd.detection.frames import blur, qualities
from lmd.detection.images import Photographs
from lmd.geometry.camera import Camera
from lmd.geometry.pose import pose_from_corners
from lmd.geometry.se3 import ROW, poses_from_rows
from lmd.geometry.squares import upright
from lmd.render.imaging import Imaging
from lmd.render.renderer import Renderer
from lmd.render.room import TaggedRoom
from lmd.scene import deployment
from lmd.scene.tag import Tag

# File of a survey with the views of its tags, and the two columns that identify the image.
FILE, FRAME, CAMERA = "in_view.csv", "time", "camera"
# Further columns: id; image of the centre, pixels from the border; depth, metres; pitch, pixels per module; incidence
# angle, degrees; apparent edge, pixels; border and circle, pixels, see `Placed`; seen, 0 or 1.
COLUMNS = ("id", "u", "v", "depth", "pitch", "incidence", "edge", "border", "circle", "seen")


@dataclass(frozen=True)
class Placed:
    """Positions of M views in the images of a recording, and times of the images."""

    camera: IntArray
    """Index of the camera in its rig, `(M,)`."""
    moment: IntArray
    """Rank of the image's time among all times, `(M,)`."""
    border: FloatArray
    """Minimum distance of the tag's corners from the border of the image, pixels, `(M,)`."""
    circle: FloatArray
    """Diameter of the smallest `Camera.image_circle` that contains the tag, pixels, `(M,)`; NaN without distortion."""

    def __getitem__(self, which: object) -> "Placed":
        return Placed(*(getattr(self, field.name)[which] for field in fields(self)))


@dataclass(frozen=True)
class TagViews:
    """M views of single tags, with detected and missed tags."""

    pitch: FloatArray
    """Pitch, pixels per module, see `lmd.detection.corner_errors.pitch`, `(M,)`."""
    incidence: FloatArray
    """Angle between the normal of the tag and the direction to the camera, rad, `(M,)`."""
    edge: FloatArray
    """Edge of a square with the area of the tag's image, pixels, `(M,)`."""
    sigma: FloatArray
    """Standard deviation of the total blur, pixels, `(M,)`."""
    seen: BoolArray
    """True for detected tags: with their id, and with corners within the tolerance, `(M,)`."""
    error: FloatArray
    """Root mean square error of the corners, pixels, `(M,)`; NaN for tags not detected."""
    placed: Placed | None = None
    """Position and time in a recording; None for single views, rendered or photographed."""

    def __len__(self) -> int:
        return len(self.pitch)

    def __getitem__(self, which: object) -> Self:
        placed = None if self.placed is None else self.placed[which]
        return replace(self, placed=placed, **{name: getattr(self, name)[which] for name in _ARRAYS})

    @classmethod
    def concatenated(cls, parts: Sequence["TagViews"]) -> Self:
        """Concatenate views; `placed` is dropped."""
        return cls(*(np.concatenate([getattr(part, name) for part in parts]) for name in _ARRAYS))


_ARRAYS = tuple(field.name for field in fields(TagViews))[:-1]


class ViewSource(Protocol):
    """Source of views of tags in which a detector was run."""

    @property
    def photographs(self) -> int:
        """Number of photographs from which the views are; 0 for renderings."""

    def views(
        self, cameras: Sequence[Camera], tag: Tag, detector: Detector, imaging: Imaging, rng: np.random.Generator
    ) -> TagViews:
        """Collect views, and the detections of a detector in them.

        Args:
            cameras: cameras of the images, several for a rig.
            tag: family, size and quiet zone.
            detector: detector of this family.
            imaging: lens and light of rendered images; blur of photographs.
            rng: source of everything random.

        Raises:
            InputError: the source does not support these cameras.
        """


def only(cameras: Sequence[Camera]) -> Camera:
    """Return the only camera.

    Raises:
        InputError: there are several cameras.
    """
    if len(cameras) > 1:
        raise InputError(f"views are those of a single camera, not of a rig of {len(cameras)}.")
    return cameras[0]


@dataclass(frozen=True)
class SurveyedViews:
    """Views in the images of a survey, with one camera or several; a `ViewSource`.

    Raises:
        InputError: the folder is not the folder of a survey.
    """

    folder: str | None
    """Folder of the survey, which contains `in_view.csv`."""

    def __post_init__(self) -> None:
        if self.folder is None:
            raise InputError("folder is missing: that of a survey is needed.", "folder")
        if not (Path(self.folder) / FILE).is_file():
            raise InputError(f"folder: {str(self.folder)!r} is no survey: it holds no {FILE}.", "folder")

    @property
    def photographs(self) -> int:
        """See `ViewSource.photographs`."""
        texts = self._table.texts
        return len(set(zip(texts[FRAME], texts[CAMERA], strict=True)))

    @cached_property
    def _table(self) -> Table:
        assert self.folder is not None
        return read_table(Path(self.folder) / FILE, name="folder")

    def views(
        self, cameras: Sequence[Camera], tag: Tag, detector: Detector, imaging: Imaging, rng: np.random.Generator
    ) -> TagViews:
        """See `ViewSource.views`; `detector` is ignored, as the survey recorded the detections of its own detector.

        Raises:
            InputError: the survey has more cameras than `cameras`.
        """
        number, *columns = self._table.numbers((CAMERA, *COLUMNS), (FRAME,)).T
        _, _, _, depth, pitch, incidence, edge, border, circle, seen = columns
        if (count := int(number.max(initial=0))) > len(cameras):
            raise InputError(
                f"folder: the survey {str(self.folder)!r} has {count} cameras, but {len(cameras)} are given.", "folder"
            )
        sigma = np.empty(len(depth))
        for index, camera in enumerate(cameras, 1):
            sigma[number == index] = blur(camera, depth[number == index], imaging)
        distorts = np.array([camera.lens is not None for camera in cameras])
        own, times = number.astype(np.int64) - 1, self._table.texts[FRAME]
        rank = {text: index for index, text in enumerate(in_order(times))}
        moment = np.array([rank[text] for text in times])
        placed = Placed(own, moment, border, np.where(distorts[own], circle, np.nan))
        unknown = np.full(len(pitch), np.nan)
        return TagViews(pitch, np.radians(incidence), edge, sigma, seen > 0.0, unknown, placed)


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
            if name in self.images.repeated:  # a copy of an image has no new information
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
        table = read_numbers(self.tags, ("id", *deployment.COLUMNS), name="tags")
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
