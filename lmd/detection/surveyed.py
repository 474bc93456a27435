"""Views of the tags of a survey in its own photographs."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np

from lmd.core.checks import InputError
from lmd.core.moments import in_order
from lmd.core.tables import Table, read_table
from lmd.detection.detectors import Detector
from lmd.detection.frames import blur
from lmd.detection.mosaic import Placed, Views
from lmd.geometry.camera import Camera
from lmd.render.imaging import Imaging
from lmd.scene.tag import Tag

FILE, FRAME, CAMERA = "in_view.csv", "time", "camera"
# Of each view: the tag, where its centre is imaged (pixels from the border), its depth (metres), pixels a module,
# incidence (degrees), edge of the square of the same area (pixels), distance of its corners from the border and
# diameter of the image circle that has it (pixels, see `lmd.detection.mosaic.Placed`), and whether it was detected.
COLUMNS = ("id", "u", "v", "depth", "pitch", "incidence", "edge", "border", "circle", "seen")


@dataclass(frozen=True)
class SurveyedViews:
    """The images that a survey could place, of one camera or several, a `lmd.detection.calibration.Source`.

    Args:
        folder: that of the survey, with its `in_view.csv`.

    Raises:
        InputError: there is no such file.
    """

    folder: str | None

    def __post_init__(self) -> None:
        if self.folder is None:
            raise InputError("folder is missing: that of a survey is needed.", "folder")
        if not (Path(self.folder) / FILE).is_file():
            raise InputError(f"folder: {str(self.folder)!r} is no survey: it holds no {FILE}.", "folder")

    @property
    def photographs(self) -> int:
        """See `Source.photographs`."""
        texts = self._table.texts
        return len(set(zip(texts[FRAME], texts[CAMERA], strict=True)))

    @cached_property
    def _table(self) -> Table:
        assert self.folder is not None
        return read_table(Path(self.folder) / FILE, name="folder")

    def views(
        self, cameras: Sequence[Camera], tag: Tag, detector: Detector, imaging: Imaging, rng: np.random.Generator
    ) -> Views:
        """See `Source.views`: what the survey's own detector made of them.

        Raises:
            InputError: the survey has more cameras.
        """
        number, *columns = self._table.numbers((CAMERA, *COLUMNS), (FRAME,)).T
        _, _, _, depth, pitch, incidence, edge, border, circle, seen = columns
        if (count := int(number.max(initial=0))) > len(cameras):
            raise InputError(
                f"folder: the survey {str(self.folder)!r} has {count} cameras, here {len(cameras)}.", "folder"
            )
        sigma = np.empty(len(depth))
        for index, camera in enumerate(cameras, 1):
            sigma[number == index] = blur(camera, depth[number == index], imaging)
        bends = np.array([camera.lens is not None for camera in cameras])
        own, times = number.astype(np.int64) - 1, self._table.texts[FRAME]
        rank = {text: index for index, text in enumerate(in_order(times))}
        moment = np.array([rank[text] for text in times])
        placed = Placed(own, moment, border, np.where(bends[own], circle, np.nan))
        nothing = np.full(len(pitch), np.nan)
        return Views(pitch, np.radians(incidence), edge, sigma, seen > 0.0, nothing, placed)
