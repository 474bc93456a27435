"""Detections by other programs in JSON: PhotonVision, Limelight, Visual Marker Mapping.

PhotonVision's corners are counter-clockwise from the tag's bottom left. The pixels of its AprilTag pipeline count from
the border of the image, as in AprilTag 3. (The pixels of its ArUco pipeline count from the centre of the first pixel,
but files do not name the pipeline.) Limelight documents neither order nor origin; its corners are assumed to have the
order and the origin of AprilTag 3. Visual Marker Mapping writes corners counter-clockwise from the bottom left, from
the centre of the first pixel where `cv2.cornerSubPix` has refined them.

Sources: `PhotonPipelineResult`, `PhotonTrackedTarget`, `TrackedTarget` and `PhotonArucoDetector`
(PhotonVision/photonvision); "JSON Results Specification" of Limelight; `DetectionIO.cpp` and `TagDetector_Umich.cpp`
(cfneuhaus/visual_marker_mapping).
"""

import json
from collections.abc import Callable, Iterator, Mapping
from decimal import Decimal
from typing import Any, NamedTuple

from lmd.core.checks import InputError, real, vector
from lmd.geometry.camera import PIXEL_CENTRE

MICROSECONDS, MILLISECONDS = Decimal(1_000_000), Decimal(1_000)  # units in a second
# Times of a result of Limelight, in the order in which they are tried, and their units.
LIMELIGHT_TIMES = (("ts_us", MICROSECONDS), ("ts", MILLISECONDS))
SHOWN = 160  # greatest number of characters shown in a message
DEEPEST = 3  # greatest number of levels of names and lists around the results


class SeenTag(NamedTuple):
    """Detection of a tag."""

    camera: str
    """Name of the camera; empty for a single camera."""
    time: str
    """Time of the frame, seconds, or the name of the frame."""
    number: int
    """Number of the tag."""
    corners: list[tuple[float, ...]]
    """Four corners in the order of the file, pixels from the border of the image, (x, y)."""
    family: str = ""
    """Family as the program writes it; empty if it does not."""


def documents_of(text: str) -> list[Any] | None:
    """JSON of a text, or of each of its lines; None if the text is no JSON.

    Raises:
        ValueError, RecursionError: the text begins like JSON, but is broken.
    """
    if not text.lstrip().startswith(("{", "[")):
        return None
    try:
        return [json.loads(text)]
    except ValueError as error:
        lines = [line for line in text.splitlines() if line.strip()]
        if len(lines) < 2 or not all(line.strip()[0] == "{" for line in lines):
            raise error
        return [json.loads(line) for line in lines]


def _results(documents: Any, key: str, camera: str = "", depth: int = DEEPEST) -> Iterator[tuple[str, Any]]:
    """Results within documents, with the names of their cameras: the mappings that have a given key."""
    if isinstance(documents, Mapping):
        if key in documents:
            yield camera, documents
        elif depth:
            for name, inner in documents.items():
                yield from _results(inner, key, camera if name == "Results" else str(name), depth - 1)
    elif isinstance(documents, list):
        for inner in documents:
            yield from _results(inner, key, camera, depth - (depth < DEEPEST))


def has_results(key: str) -> Callable[[Any], bool]:
    """Make a test for files of results with a key."""
    return lambda file: file.documents is not None and any(True for _ in _results(file.documents, key))


def photonvision(documents: list[Any]) -> Iterator[SeenTag]:
    """AprilTags of PhotonVision's results, with the times of capture."""
    for camera, result in _results(documents, "targets"):
        time = _photon_time(result)
        for target in result["targets"]:
            number = target.get("fiducialId", -1)
            corners = target.get("detectedCorners") or []
            if number == -1 or not corners:
                continue  # a shape, or an object
            yield SeenTag(camera, time, _number("fiducialId", number), _corners("detectedCorners", corners, 0.0))


def _photon_time(result: Mapping[str, Any]) -> str:
    metadata = result.get("metadata")
    known = (metadata, "captureTimestampMicros", MICROSECONDS), (result, "timestampSeconds", Decimal(1))
    for keys, name, unit in known:
        if isinstance(keys, Mapping) and name in keys and (time := real(name, keys[name])) >= 0.0:
            return _seconds(keys[name], time, unit)
    raise InputError("has a result without captureTimestampMicros in its metadata, so its time is not known")


def _seconds(written: Any, time: float, unit: Decimal) -> str:
    """Time as a text of seconds, exact to the last digit for whole numbers."""
    return f"{Decimal(written if isinstance(written, int) else repr(time)) / unit:f}"


def limelight(documents: list[Any]) -> Iterator[SeenTag]:
    """Fiducials with corners in Limelight's results.

    Raises:
        InputError: no fiducial has corners, or the corners count from the middle of the image.
    """
    empty = False
    found = False
    for camera, result in _results(documents, "Fiducial"):
        name, unit = next((pair for pair in LIMELIGHT_TIMES if pair[0] in result), ("", Decimal(1)))
        if not name:
            raise InputError("has a result without ts, so its time is not known")
        time = _seconds(result[name], real(name, result[name]), unit)
        for fiducial in result["Fiducial"]:
            if not (points := fiducial.get("pts")):
                empty = True
                continue
            corners = _corners("pts", points, 0.0)
            if min(map(min, corners)) < 0.0:
                raise InputError("has corners below 0: its pts count from the middle of the image")
            found = True
            family = str(fiducial.get("fam", "")).upper().removesuffix("C")  # such as 36H11C
            yield SeenTag(camera, time, _number("fID", fiducial["fID"]), corners, family)
    if empty and not found:
        raise InputError("has no corners, pts is empty: let the pipeline send corners, and record again")


def visual_marker_mapping(documents: list[Any]) -> Iterator[SeenTag]:
    """Observations of Visual Marker Mapping, whose numbers are texts; a frame has the name of its image."""
    for _, keys in _results(documents, "tag_observations"):
        images = {int(image["id"]): str(image["filename"]) for image in keys.get("images") or []}
        family = next((str(tag.get("tag_type", "")) for tag in keys.get("tags") or []), "")  # one for all tags
        for seen in keys["tag_observations"] or []:
            read = [[float(number) for number in corner] for corner in seen["observations"]]
            number, image = int(seen["tag_id"]), int(seen["image_id"])
            if image not in images:
                raise InputError(f"has an observation in the image {image}, which is not among its images")
            corners = _corners("observations", read, PIXEL_CENTRE)
            yield SeenTag("", images[image], _number("tag_id", number), corners, family)


def _number(name: str, value: Any) -> int:
    number = real(name, value, low=0.0)
    if number != int(number):
        raise InputError(f"has the {name} {value!r}, which is not a whole number")
    return int(number)


def _corners(name: str, corners: Any, offset: float) -> list[tuple[float, ...]]:
    """Four corners as pixels from the border, from pairs or mappings with x and y."""
    if not isinstance(corners, list) or len(corners) != 4:
        raise InputError(f"must have four corners in {name}, got {corners!r}"[:SHOWN])
    pairs = ([corner["x"], corner["y"]] if isinstance(corner, Mapping) else corner for corner in corners)
    return [tuple(number + offset for number in vector(f"{name}[{i}]", pair, 2)) for i, pair in enumerate(pairs)]
