"""Views of single tags, each with the information whether the tag was detected. A detector's limits are fitted to such
views.

Sources are a survey (`SurveyedViews`) and renderings (`lmd.detection.mosaic.Mosaics`).
"""

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from functools import cached_property
from pathlib import Path
from typing import Self

import numpy as np

from lmd.core.checks import BoolArray, FloatArray, InputError, IntArray
from lmd.core.tables import Table, in_order, read_table
from lmd.detection.detectors import Detector
from lmd.detection.frames import blur
from lmd.geometry.camera import Camera
from lmd.render.imaging import Imaging
from lmd.scene.tag import Tag

# File of a survey with the views of its tags, and the two columns that identify the image.
FILE, FRAME, CAMERA = "in_view.csv", "time", "camera"
# Further columns: id; image of the centre, pixels from the border; depth, metres; pitch, pixels per module; incidence
# angle, degrees; apparent edge, pixels; border and circle, pixels, see `Placed`; seen, 0 or 1.
COLUMNS = ("id", "u", "v", "depth", "pitch", "incidence", "edge", "border", "circle", "seen")


@dataclass(frozen=True)
class Placed:
    """For each of M views, the position of its tag in the image, and the time of the image in a recording."""

    camera: IntArray
    """Index of the camera in its rig, `(M,)`."""
    moment: IntArray
    """Index of the image's time among the times of all images, in ascending order, `(M,)`."""
    border: FloatArray
    """Distance between the border of the image and the nearest corner of the tag, pixels, `(M,)`."""
    circle: FloatArray
    """Diameter of the smallest image circle (`Camera.image_circle`) that contains the tag, pixels, `(M,)`; NaN if the
    camera's lens has no distortion.
    """

    def __getitem__(self, which: object) -> "Placed":
        return Placed(*(getattr(self, field.name)[which] for field in fields(self)))


@dataclass(frozen=True)
class TagViews:
    """M views of single tags, with detected and with missed tags."""

    pitch: FloatArray
    """Pitch, pixels per module, see `lmd.detection.corner_errors.pitch`, `(M,)`."""
    incidence: FloatArray
    """Angle between the normal of the tag and the direction to the camera, rad, `(M,)`."""
    edge: FloatArray
    """Edge length of a square whose area equals that of the tag's image, pixels, `(M,)`."""
    sigma: FloatArray
    """Standard deviation of the total blur, pixels, `(M,)`."""
    seen: BoolArray
    """Mask of the detected tags, which are found with their id and with corners within the tolerance, `(M,)`."""
    error: FloatArray
    """Root mean square error of the corners, pixels, `(M,)`; NaN for tags not detected."""
    placed: Placed | None = None
    """Position of each tag in its image, and time of the image, for views from a recording; None for other views, such
    as rendered views.
    """

    def __len__(self) -> int:
        return len(self.pitch)

    def __getitem__(self, which: object) -> Self:
        placed = None if self.placed is None else self.placed[which]
        return replace(self, placed=placed, **{name: getattr(self, name)[which] for name in _ARRAYS})

    @classmethod
    def concatenated(cls, parts: Sequence["TagViews"]) -> Self:
        """Concatenate the views of all `parts`; the positions of tags in images, `placed`, are dropped."""
        return cls(*(np.concatenate([getattr(part, name) for part in parts]) for name in _ARRAYS))


_ARRAYS = tuple(field.name for field in fields(TagViews))[:-1]


def only(cameras: Sequence[Camera]) -> Camera:
    """Return the only camera of the sequence `cameras`.

    Raises:
        InputError: there are several cameras.
    """
    if len(cameras) > 1:
        raise InputError(f"views must be of a single camera, not of a rig of {len(cameras)} cameras.")
    return cameras[0]


@dataclass(frozen=True)
class SurveyedViews:
    """Views of single tags in the images of a survey, which was made with one camera or with several cameras.

    Raises:
        InputError: the folder is not the folder of a survey.
    """

    folder: str | None
    """Folder of the survey; it contains the file `in_view.csv`, from which the views are read."""

    def __post_init__(self) -> None:
        if self.folder is None:
            raise InputError("folder is missing: give the folder of a survey.", "folder")
        if not (Path(self.folder) / FILE).is_file():
            raise InputError(f"folder: {str(self.folder)!r} is not a survey: it has no {FILE}.", "folder")

    @property
    def photographs(self) -> int:
        """Number of photographs that the views are taken from."""
        texts = self._table.texts
        return len(set(zip(texts[FRAME], texts[CAMERA], strict=True)))

    @cached_property
    def _table(self) -> Table:
        assert self.folder is not None
        return read_table(Path(self.folder) / FILE, name="folder")

    def views(
        self, cameras: Sequence[Camera], tag: Tag, detector: Detector, imaging: Imaging, rng: np.random.Generator
    ) -> TagViews:
        """Views of single tags in the images of the survey, with the detections that the survey recorded.

        Args:
            cameras: cameras of the images, several for a rig.
            tag, detector, rng: ignored.
            imaging: blur of the photographs.

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
