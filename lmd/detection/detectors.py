"""Detectors of tags behind one interface.

All corners are in image coordinates from the border (see `lmd.geometry.projection`) and in the order top-left,
top-right, bottom-right, bottom-left of the tag as it hangs (see `lmd.scene.tag`), whatever the conventions of the
library are.
"""

from dataclasses import dataclass
from functools import lru_cache
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from lmd.core.checks import FloatArray, InputError, check_fields, choice, integer, real
from lmd.core.optional import optional
from lmd.geometry.camera import PIXEL_CENTRE
from lmd.render.imaging import UInt8Array
from lmd.scene.tag import FAMILIES, dictionary

# What cv2.aruco calls top-left in a picture of an AprilTag is the bottom-right corner of AprilTag's own.
HALF_TURN = [2, 3, 0, 1]
# AprilTag begins at the bottom left and goes round counter-clockwise.
APRILTAG_ORDER = [3, 2, 1, 0]
# Settings of cv2.aruco. By default it leaves out tags whose perimeter is below 3 % of the image's longer side.
ARUCO_PRESETS: dict[str, dict[str, Any]] = {
    "default": {},
    "fine": {"minMarkerPerimeterRate": 0.008, "adaptiveThreshWinSizeStep": 4},
}


@dataclass(frozen=True)
class Detections:
    """What a detector finds in one image.

    Args:
        ids: numbers of the tags in their family, `(M,)`; one may occur twice.
        corners: pixels from the border, order as above, `(M, 4, 2)`.

    Raises:
        InputError: shapes do not match.
    """

    ids: NDArray[np.int64]
    corners: FloatArray

    def __post_init__(self) -> None:
        ids, corners = np.asarray(self.ids, dtype=np.int64), np.asarray(self.corners, dtype=np.float64)
        if ids.ndim != 1 or corners.shape != (len(ids), 4, 2):
            raise InputError(f"corners must have the shape (M, 4, 2) for M ids, got {corners.shape} for {ids.shape}.")
        object.__setattr__(self, "ids", ids)
        object.__setattr__(self, "corners", corners)

    def __len__(self) -> int:
        return len(self.ids)


class Detector(Protocol):
    """Something that finds tags in an image."""

    def detect(self, image: UInt8Array) -> Detections:
        """The tags in a grey image `(h, w)`.

        Raises:
            InputError: the image is no grey 8-bit image, or a package is missing.
        """


@dataclass(frozen=True)
class ArucoDetector:
    """`cv2.aruco`, corners refined by `CORNER_REFINE_SUBPIX`.

    `CORNER_REFINE_APRILTAG` is no choice: it counts pixels from the border, half a pixel from the rest of OpenCV.

    Args:
        family: one of `lmd.scene.tag.FAMILIES`.
        preset: `default`, or `fine` for smaller tags.

    Raises:
        InputError: an unknown family or preset.
    """

    family: str = "36h11"
    preset: str = "default"

    def __post_init__(self) -> None:
        choice("family", self.family, tuple(FAMILIES))
        choice("preset", self.preset, tuple(ARUCO_PRESETS))

    def detect(self, image: UInt8Array) -> Detections:
        """See `Detector.detect`."""
        found, ids, _ = _aruco(self.family, self.preset).detectMarkers(_grey(image))
        if ids is None:
            return _nothing()
        corners = np.concatenate(found).astype(np.float64) + PIXEL_CENTRE
        return Detections(ids.ravel(), corners[:, HALF_TURN] if FAMILIES[self.family].apriltag else corners)


@dataclass(frozen=True)
class AprilTagDetector:
    """The AprilTag 3 library, by `pyapriltags`.

    Args:
        family: one of `lmd.scene.tag.FAMILIES` that the library knows.
        quad_decimate: factor by which the image is made smaller before quadrilaterals are looked for.
        most_errors: wrong bits in a tag that are corrected, at most; the library itself corrects two.

    Raises:
        InputError: a family that is not AprilTag's, or a value out of range.
    """

    family: str = "36h11"
    quad_decimate: float = 1.0
    most_errors: int = 2

    def __post_init__(self) -> None:
        if self.family in FAMILIES and not FAMILIES[self.family].apriltag:
            raise InputError(f"family {self.family} is one of ArUco's, which only ArucoDetector reads.", "family")
        choice("family", self.family, tuple(name for name, family in FAMILIES.items() if family.apriltag))
        check_fields(self, real, "quad_decimate", low=1.0)
        check_fields(self, integer, "most_errors", low=0, high=2)

    def detect(self, image: UInt8Array) -> Detections:
        """See `Detector.detect`."""
        tags = _apriltag(self.family, self.quad_decimate).detect(_grey(image))
        found = [tag for tag in tags if tag.hamming <= self.most_errors]
        if not found:
            return _nothing()
        return Detections(np.array([t.tag_id for t in found]), np.stack([t.corners[APRILTAG_ORDER] for t in found]))


@lru_cache(maxsize=8)
def _aruco(family: str, preset: str) -> Any:
    """The detector of OpenCV; kept here, so that an `ArucoDetector` is only its settings and can go to a process."""
    aruco = optional("cv2", "detection").aruco
    parameters = aruco.DetectorParameters()
    parameters.cornerRefinementMethod = aruco.CORNER_REFINE_SUBPIX
    for name, value in ARUCO_PRESETS[preset].items():
        setattr(parameters, name, value)
    return aruco.ArucoDetector(dictionary(family), parameters)


@lru_cache(maxsize=8)
def _apriltag(family: str, quad_decimate: float) -> Any:
    """The detector of AprilTag, kept as that of OpenCV is."""
    library = optional("pyapriltags", "detection")
    return library.Detector(families=FAMILIES[family].apriltag, nthreads=1, quad_decimate=quad_decimate)


def _grey(image: UInt8Array) -> UInt8Array:
    if not isinstance(image, np.ndarray) or image.ndim != 2 or image.dtype != np.uint8:
        raise InputError(f"image must be a grey image of 8-bit numbers, got {getattr(image, 'dtype', type(image))}.")
    return np.ascontiguousarray(image)


def _nothing() -> Detections:
    return Detections(np.empty(0, dtype=np.int64), np.empty((0, 4, 2)))
