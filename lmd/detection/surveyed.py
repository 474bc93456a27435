"""Views of the tags of a survey in its own photographs."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from lmd.core.checks import InputError
from lmd.core.tables import read_table
from lmd.detection.detectors import Detector
from lmd.detection.frames import blur
from lmd.detection.mosaic import Views
from lmd.render.imaging import Imaging
from lmd.scene.camera import Camera
from lmd.scene.tag import Tag

FILE, FRAME = "in_view.csv", "time"
# Of each view: the tag, where its centre is imaged (pixels from the border), its depth (metres), pixels a module,
# incidence (degrees), edge of the square of the same area (pixels), and whether it was detected.
COLUMNS = ("id", "u", "v", "depth", "pitch", "incidence", "edge", "seen")


@dataclass(frozen=True)
class SurveyedViews:
    """The frames that a survey could place, a `lmd.detection.calibration.Source`.

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
            raise InputError(f"folder: {str(self.folder)!r} is no survey of one camera: it holds no {FILE}.", "folder")

    @property
    def photographs(self) -> int:
        """See `Source.photographs`."""
        return len(set(read_table(self._file, name="folder").texts[FRAME]))

    @property
    def _file(self) -> Path:
        assert self.folder is not None
        return Path(self.folder) / FILE

    def views(self, camera: Camera, tag: Tag, detector: Detector, imaging: Imaging, rng: np.random.Generator) -> Views:
        """See `Source.views`: what the survey's own detector made of them."""
        _, _, _, depth, pitch, incidence, edge, seen = (
            read_table(self._file, name="folder").numbers(COLUMNS, (FRAME,)).T
        )
        nothing = np.full(len(pitch), np.nan)
        return Views(pitch, np.radians(incidence), edge, blur(camera, depth, imaging), seen > 0.0, nothing)
