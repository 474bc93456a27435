"""Tag detectors with one interface, matching of detections with expected corners, and scores of predictions."""

from collections.abc import Sequence
from dataclasses import dataclass, fields
from functools import lru_cache, partial
from typing import Annotated, Any, NamedTuple, Protocol, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lmd.core.checks import BoolArray, Checked, FloatArray, InputError, IntArray, choice, integer, real
from lmd.core.optional import optional
from lmd.detection.corner_errors import CORNER_ERRORS, CornerErrors
from lmd.geometry.camera import PIXEL_CENTRE
from lmd.render.imaging import UInt8Array
from lmd.scene.families import FAMILIES, dictionary, family_named

# cv2.aruco rotates AprilTags by 180 degrees: its first corner, the top left, is the bottom right of the AprilTag.
HALF_TURN = [2, 3, 0, 1]
# AprilTag's corners start at the bottom left, counter-clockwise.
APRILTAG_ORDER = [3, 2, 1, 0]
# Settings of cv2.aruco, which by default ignores tags with a perimeter below 3 % of the longer side of the image.
ARUCO_PRESETS: dict[str, dict[str, Any]] = {
    "default": {},
    "fine": {"minMarkerPerimeterRate": 0.008, "adaptiveThreshWinSizeStep": 4},
}


@dataclass(frozen=True)
class Detections:
    """Detections in one image.

    Raises:
        InputError: shapes do not match.
    """

    ids: NDArray[np.int64]
    """Ids of the tags within their family, `(M,)`; an id may occur several times."""
    corners: FloatArray
    """Corners, pixels from the outer corner of the image's top left pixel, in the order top left, top right, bottom
    right, bottom left of the tag, `(M, 4, 2)`.
    """

    def __post_init__(self) -> None:
        ids, corners = np.asarray(self.ids, dtype=np.int64), np.asarray(self.corners, dtype=np.float64)
        if ids.ndim != 1 or corners.shape != (len(ids), 4, 2):
            raise InputError(f"corners must have the shape (M, 4, 2) for M ids, got {corners.shape} for {ids.shape}.")
        object.__setattr__(self, "ids", ids)
        object.__setattr__(self, "corners", corners)

    def __len__(self) -> int:
        return len(self.ids)


class Detector(Protocol):
    """Interface of detectors of tags in an image."""

    def detect(self, image: UInt8Array) -> Detections:
        """Detect the tags in a grey image `(h, w)`.

        Raises:
            InputError: the image is not a grey 8-bit image, or a package is missing.
        """

    @property
    def corner_errors(self) -> CornerErrors:
        """Measured errors of the detector's corners."""


def read_family(name: str, value: Any, table: str, other: str) -> str:
    """Check that a library of tag detectors supports a tag family, and return the name of the family in `FAMILIES`.

    Args:
        name: name of the argument that gave the family, for messages.
        value: name of the family.
        table: name of an attribute of a family in `FAMILIES`: the family's name in the library, empty if the library
            does not support the family.
        other: name of another library, which the error message proposes.

    Raises:
        InputError: the library does not support the family.
    """
    family, known = family_named(value), [name for name, kind in FAMILIES.items() if getattr(kind, table)]
    if family in FAMILIES and family not in known:
        reader = f"_target_={__name__}.{other.replace('U', 'u')}Detector"
        raise InputError(f"{name} {family} belongs to {other}: only {reader} reads it.", name)
    return choice(name, family, known)


@dataclass(frozen=True)
class ArucoDetector(Checked):
    """Detector `cv2.aruco` of OpenCV, with corners refined by `CORNER_REFINE_SUBPIX`.

    `CORNER_REFINE_APRILTAG` is not used: it counts pixels from the outer corner of the first pixel instead of its
    centre, so its corners are half a pixel off.

    Raises:
        InputError: OpenCV lacks the family, or there are no detector settings with the name `preset`.
    """

    family: Annotated[str, partial(read_family, table="dictionary", other="AprilTag")] = "36h11"
    """Tag family: one of those in `lmd.scene.families.FAMILIES` that OpenCV supports."""
    preset: Annotated[str, partial(choice, options=tuple(ARUCO_PRESETS))] = "default"
    """Name of the settings of `cv2.aruco`: `default`, or `fine` to detect smaller tags as well."""

    @property
    def corner_errors(self) -> CornerErrors:
        """See `Detector.corner_errors`."""
        return CORNER_ERRORS["aruco"]

    def detect(self, image: UInt8Array) -> Detections:
        """See `Detector.detect`."""
        found, ids, _ = _aruco(self.family, self.preset).detectMarkers(_grey(image))
        if ids is None:
            return _nothing()
        corners = np.concatenate(found).astype(np.float64) + PIXEL_CENTRE
        return Detections(ids.ravel(), corners[:, HALF_TURN] if FAMILIES[self.family].apriltag else corners)


@dataclass(frozen=True)
class AprilTagDetector(Checked):
    """Detector of the AprilTag 3 library, called through `pyapriltags`.

    Raises:
        InputError: the library lacks the family, or a value is out of range.
    """

    family: Annotated[str, partial(read_family, table="apriltag", other="ArUco")] = "36h11"
    """Tag family: one of those in `lmd.scene.families.FAMILIES` that the library supports."""
    quad_decimate: Annotated[float, partial(real, low=1.0)] = 1.0
    """Factor by which the image is downscaled for the detection of quadrilaterals."""
    most_errors: Annotated[int, partial(integer, low=0, high=2)] = 2
    """Maximum number of wrong bits in a tag's code that are corrected; the library corrects up to two."""

    @property
    def corner_errors(self) -> CornerErrors:
        """See `Detector.corner_errors`."""
        return CORNER_ERRORS["apriltag" if self.quad_decimate == 1.0 else "apriltag_decimate2"]

    def detect(self, image: UInt8Array) -> Detections:
        """See `Detector.detect`."""
        tags = _apriltag(self.family, self.quad_decimate).detect(_grey(image))
        found = [tag for tag in tags if tag.hamming <= self.most_errors]
        if not found:
            return _nothing()
        return Detections(np.array([t.tag_id for t in found]), np.stack([t.corners[APRILTAG_ORDER] for t in found]))


@lru_cache(maxsize=8)
def _aruco(family: str, preset: str) -> Any:
    """Detector object of OpenCV, cached here and not in `ArucoDetector`, so that an `ArucoDetector` can be pickled."""
    aruco = optional("cv2", "detection").aruco
    parameters = aruco.DetectorParameters()
    parameters.cornerRefinementMethod = aruco.CORNER_REFINE_SUBPIX
    for name, value in ARUCO_PRESETS[preset].items():
        setattr(parameters, name, value)
    return aruco.ArucoDetector(dictionary(family), parameters)


@lru_cache(maxsize=8)
def _apriltag(family: str, quad_decimate: float) -> Any:
    """Detector object of the AprilTag library, cached here and not in `AprilTagDetector`, so that an `AprilTagDetector`
    can be pickled.
    """
    library = optional("pyapriltags", "detection")
    return library.Detector(families=FAMILIES[family].apriltag, nthreads=1, quad_decimate=quad_decimate)


def _grey(image: UInt8Array) -> UInt8Array:
    if not isinstance(image, np.ndarray) or image.ndim != 2 or image.dtype != np.uint8:
        got = f"{image.dtype} of shape {image.shape}" if isinstance(image, np.ndarray) else type(image)
        raise InputError(f"image must be a grey image of 8-bit numbers, with two axes, got {got}.")
    return np.ascontiguousarray(image)


def _nothing() -> Detections:
    return Detections(np.empty(0, dtype=np.int64), np.empty((0, 4, 2)))


# Numbers n of tags for which P(>= n) is reported.
TAG_NUMBERS = np.arange(1, 5)
# Maximum distance of a detected corner from its projection, pixels; a detection farther away is false.
CORNER_TOLERANCE = 5.0


@dataclass(frozen=True)
class Matches:
    """Tags that a detector found, with their corners, and number of false detections, in one frame or in N frames.

    For N frames the arrays have a leading axis of length N.
    """

    detected: BoolArray
    """True for tags detected with their id and with corners within the tolerance, `(..., K)`."""
    corners: FloatArray
    """Detected corners, pixels, `(..., K, 4, 2)`, with the origin and the order of `Detections.corners`; NaN for tags
    not detected.
    """
    false: IntArray
    """Number of false detections: those that match no tag of the room in both id and corners, `(...)`."""

    @classmethod
    def stacked(cls, frames: Sequence["Matches"]) -> Self:
        """Stack the matches of N single frames along a new first axis."""
        return cls(*(np.stack([getattr(one, field.name) for one in frames]) for field in fields(cls)))

    @classmethod
    def concatenated(cls, parts: Sequence["Matches"]) -> Self:
        """Concatenate the matches of several sequences of frames along the axis of the frames."""
        return cls(*(np.concatenate([getattr(part, field.name) for part in parts]) for field in fields(cls)))

    @classmethod
    def beside(cls, parts: Sequence["Matches"]) -> Self:
        """Join the matches of C cameras, each with N frames and K tags, to one object with C K tags in each frame.

        The numbers of false detections in a frame are summed over the cameras.
        """
        detected = np.concatenate([part.detected for part in parts], axis=1)
        corners = np.concatenate([part.corners for part in parts], axis=1)
        return cls(detected, corners, np.sum([part.false for part in parts], axis=0))


def match(
    detections: Detections, ids: NDArray[np.int64], expected: FloatArray, tolerance: float = CORNER_TOLERANCE
) -> Matches:
    """Assign the detections of one frame to tags by id and corners.

    If a tag has several detections, the nearest one is assigned to the tag; the others are false.

    Args:
        detections: detections of the frame.
        ids: ids of the K tags, all different, `(K,)`.
        expected: exact corners, pixels, `(K, 4, 2)`, with the origin and the order of `Detections.corners`; tags with
            NaN are never matched.
        tolerance: largest distance between detected and exact corner, pixels.
    """
    corners = np.full((len(ids), 4, 2), np.nan)
    distance = np.full(len(ids), np.inf)
    index = {int(number): k for k, number in enumerate(ids)}
    for number, found in zip(detections.ids, detections.corners, strict=True):
        k = index.get(int(number))
        if k is None:
            continue
        off = float(np.linalg.norm(found - expected[k], axis=-1).max())
        if off <= tolerance and off < distance[k]:
            corners[k], distance[k] = found, off
    detected = np.isfinite(distance)
    return Matches(detected, corners, np.asarray(len(detections) - int(detected.sum())))


def precision_recall(
    predicted: BoolArray, detected: BoolArray, axis: int | None = None
) -> tuple[FloatArray, FloatArray]:
    """Precision and recall of predicted detections.

    Precision is the fraction of the predicted tags that are detected; NaN if no tag is predicted. Recall is the
    fraction of the detected tags that are predicted; NaN if no tag is detected.

    Args:
        predicted: mask of the tags that are predicted as detected, for K tags in N frames, `(N, K)`.
        detected: mask of the tags that the detector found, `(N, K)`.
        axis: None for one value over all frames and tags, 0 for a value for each tag `(K,)`, 1 for each frame `(N,)`.
    """
    both = (predicted & detected).sum(axis=axis)
    with np.errstate(invalid="ignore"):
        return np.asarray(both / predicted.sum(axis=axis)), np.asarray(both / detected.sum(axis=axis))


class Shares(NamedTuple):
    """Fractions of frames in which at least n tags are predicted or detected, for n = 1, 2, 3, 4."""

    share: FloatArray
    """Fractions p = P(>= n) of frames with at least n tags, `(4,)`."""
    error: FloatArray
    """Standard errors sqrt(p (1 - p) / N), `(4,)`."""


def shares_of_frames(seen: BoolArray) -> Shares:
    """Fractions of the frames with at least n tags, for n = 1, 2, 3, 4, with their standard errors.

    Args:
        seen: mask of the predicted or detected tags, `(N, K)`.
    """
    share = (seen.sum(axis=1)[:, None] >= TAG_NUMBERS).mean(axis=0)
    return Shares(share, np.sqrt(share * (1.0 - share) / len(seen)))


def agreement(predicted: BoolArray, detected: BoolArray, n: int = 2) -> float:
    """Fraction of the N frames in which prediction and detection agree on whether at least `n` tags are found.
    `predicted` and `detected` are masks of the K tags, `(N, K)` each.
    """
    return float(((predicted.sum(axis=1) >= n) == (detected.sum(axis=1) >= n)).mean())


def corner_error(found: FloatArray, expected: FloatArray) -> FloatArray:
    """Root mean square distance of the four detected corners of each tag from its exact corners, pixels, `(...)`.

    `found` has the detected corners, `expected` the exact corners, `(..., 4, 2)` each.
    """
    return np.asarray(np.sqrt(((found - expected) ** 2).sum(axis=-1).mean(axis=-1)))


def quantiles_by(value: FloatArray, error: FloatArray, bounds: ArrayLike, quantiles: Sequence[float]) -> FloatArray:
    """Quantiles of an error within B bins of another quantity, `(B, Q)`; NaN for empty bins.

    Args:
        value, error: the other quantity and the error, arrays of equal shape; pairs with a NaN are left out.
        bounds: edges of the bins, ascending, `(B + 1,)`; a bin contains its lower edge.
        quantiles: Q probabilities.
    """
    edges = np.asarray(bounds, dtype=np.float64)
    known = np.isfinite(value) & np.isfinite(error)
    place = np.searchsorted(edges, value[known], side="right") - 1
    classes = [error[known][place == b] for b in range(len(edges) - 1)]
    empty = np.full(len(quantiles), np.nan)
    return np.array([np.quantile(c, quantiles) if len(c) else empty for c in classes])
