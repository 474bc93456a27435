"""Files of detections by other programs: formats, and lists of the images that were taken."""

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import replace
from decimal import Decimal
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from lmd.core.checks import FloatArray, InputError, IntArray, printable
from lmd.core.tables import in_order, read_table, time_of, write_table
from lmd.formats.bag_contents import seen_in
from lmd.formats.bags import is_bag
from lmd.formats.detection_readers import (
    SeenTag,
    documents_of,
    has_results,
    limelight,
    photonvision,
    visual_marker_mapping,
)
from lmd.formats.detections import DetectedTags, signed_area
from lmd.formats.landmark_table import FAMILY, NAMES
from lmd.formats.placed_tag import one_family
from lmd.formats.registry import File, Format, anything, read
from lmd.geometry.camera import PIXEL_CENTRE
from lmd.scene.families import family_named

NAME, IMAGES = "detections", "images"  # names of the arguments with paths
# Columns of the corners, OpenCV's pixels, clockwise from the top left of the tag's picture.
CORNER_COLUMNS = tuple(f"{axis}{corner}" for corner in range(4) for axis in "xy")
TIMES, CAMERAS = ("time", "stamp", "timestamp", "image"), ("camera", "topic", "cam", "camera_id")
READ = (
    "what is read is a bag of ROS 2, JSON of PhotonVision, Limelight and Visual Marker Mapping, or a CSV with a row "
    f"for each tag and the columns {' or '.join(TIMES)}, id, x0, y0, ..., x3, y3, the corners clockwise from the tag's "
    "top left in OpenCV's pixels"
)
FROM_APRILTAG = [3, 2, 1, 0]
# A message names missing columns if they are at most `MOST_LACKING`; otherwise it shows `SHOWN` characters of the
# header.
MOST_LACKING, SHOWN = 4, 80
# Least area of a quadrilateral, square pixels; smaller quadrilaterals are left out.
LEAST_AREA = 1.0


class DetectionsFile(File):
    """File of detections, whose first line may name columns."""

    @cached_property
    def documents(self) -> list[Any] | None:
        """Values of JSON, of the whole text or of each line; None for another text.

        Raises:
            InputError: the text begins like JSON, but is broken.
        """
        try:
            return documents_of(self.text)
        except (ValueError, RecursionError) as error:
            reason = " ".join(str(error).split())[:SHOWN]
            raise InputError(f"{self.argument}: {str(self.path)!r} is no JSON ({reason}).", self.argument) from None

    @cached_property
    def header(self) -> list[str]:
        """Columns that the first line names."""
        return [column.strip().strip('"') for column in self.first.split(",")]

    @cached_property
    def lacks(self) -> list[str]:
        """Columns that the header lacks."""
        lacks = [column for column in ("id", *CORNER_COLUMNS) if column not in self.header]
        return [" or ".join(TIMES)] * (not set(TIMES) & set(self.header)) + lacks

    def refused(self, reason: str) -> InputError:
        """Error about a file that is no table of detections; the message lists the supported formats."""
        return InputError(f"{self.argument}: {str(self.path)!r} {reason}; {READ}.", self.argument)


def read_detections(path: Any, topic: Any = None) -> DetectedTags:
    """Read JSON of `lmd.formats.detection_readers`, a bag, or a table with the columns `time,id,x0,y0,...,x3,y3`.

    The corners of a table are clockwise from the top left in OpenCV's pixels.

    The column of the time may have the name `stamp` or `image`, and hold any text, such as the name of a photograph.

    Column `camera` or `topic` names the camera; without this column there is one camera. Further columns are ignored.
    If most detections have counter-clockwise corners, the corners are read in the order of the AprilTag library, from
    the bottom left. Detections with the opposite sense are left out.

    Raises:
        InputError: the file cannot be read, lacks a column, or a value is no number.
    """
    found: DetectedTags = read("detections", DetectionsFile(path, NAME, {"topic": topic}))
    return found


def _read_csv(file: File) -> DetectedTags:
    path, name = file.path, file.argument
    table = read_table(path, name=name)
    time, camera = (next((known for known in known_as if known in table), "") for known_as in (TIMES, CAMERAS))
    values = table.numbers(("id", *CORNER_COLUMNS), None)
    ids = values[:, 0].astype(np.int64)
    if (wrong := np.flatnonzero((ids != values[:, 0]) | (ids < 0))).size:
        text = table.texts["id"][wrong[0]]
        raise InputError(f"{path} line {table.lines[wrong[0]]}: id is {text!r}, not a whole number from 0.", name)
    # Nanoseconds since 1970 have more digits than a float, so frames are distinguished by the text.
    moments = _as_first_written(table.texts[time])
    names = sorted(set(table.texts[camera])) if camera else [""]
    cameras = np.searchsorted(names, table.texts[camera]) if camera else np.zeros(len(ids), dtype=np.int64)
    corners = values[:, 1:9].reshape(-1, 4, 2) + PIXEL_CENTRE
    found = _detections(path, name, moments, names, cameras, ids, corners)
    return _of_family(
        file, found, (text for key in table.texts if NAMES.get(key) == FAMILY for text in table.texts[key])
    )


def _detections(
    path: Any,
    name: str,
    moments: Sequence[str],
    names: Sequence[str],
    cameras: IntArray,
    ids: IntArray,
    corners: FloatArray,
) -> DetectedTags:
    """Make detections with corners from the tag's top left; quadrilaterals without an area are left out.

    Args:
        path, name: path of the file and its argument, for messages.
        moments: times of the frames, equal for one frame.
        names: names of the cameras.
        cameras: index of the camera of each detection.
        ids: numbers of the tags.
        corners: pixels from the border, in the order of OpenCV or of AprilTag, `(N, 4, 2)`.
    """
    place = {text: index for index, text in enumerate(in_order(moments))}
    if 2 * (signed_area(corners) < 0.0).sum() > len(corners):
        corners = corners[:, FROM_APRILTAG]
    usable = signed_area(corners) >= LEAST_AREA
    if not usable.any():
        raise InputError(f"{path} has no detection with four corners around an area.", name)
    frames = np.array([place[text] for text in moments])
    found = DetectedTags(tuple(place), tuple(names), frames, np.asarray(cameras, dtype=np.int64), ids, corners)
    return found.of(np.flatnonzero(usable))


def _from_json(read_tags: Callable[[list[Any]], Iterator[SeenTag]]) -> Callable[[DetectionsFile], DetectedTags]:
    """Make a reader of JSON."""

    def read_json(file: DetectionsFile) -> DetectedTags:
        where = f"{file.argument}: {str(file.path)!r}"
        try:
            seen = list(read_tags(file.documents or []))
        except InputError as error:
            raise InputError(f"{where} {error}.".replace("..", "."), file.argument) from None
        except KeyError as error:
            raise InputError(f"{where} lacks the key {str(error)[:SHOWN]}.", file.argument) from None
        except (IndexError, TypeError, ValueError, AttributeError, ArithmeticError):
            raise InputError(f"{where} has a value of another kind than its program writes.", file.argument) from None
        if not seen:
            raise InputError(f"{where} has no detection of a tag with corners.", file.argument)
        return _of_seen(file, seen)

    return read_json


def _of_seen(file: File, seen: Sequence[SeenTag]) -> DetectedTags:
    """Detections of tags that were seen."""
    seen = [tag._replace(camera=printable(tag.camera), time=printable(tag.time)) for tag in seen]
    names = sorted({tag.camera for tag in seen})
    cameras, ids = (
        np.array(of, dtype=np.int64) for of in zip(*((names.index(t.camera), t.number) for t in seen), strict=True)
    )
    corners = np.array([tag.corners for tag in seen])
    found = _detections(file.path, file.argument, [tag.time for tag in seen], names, cameras, ids, corners)
    return _of_family(file, found, (tag.family for tag in seen))


def _of_family(file: File, found: DetectedTags, named: Iterable[str]) -> DetectedTags:
    """Detections with their family, by its names in any library; empty names are ignored.

    Raises:
        InputError: the tags have several families.
    """
    try:
        return replace(found, family=one_family(family_named(text) for text in set(named) - {""}))
    except InputError as error:
        raise InputError(f"{file.argument}: {str(file.path)!r} {error}", file.argument) from None


def _read_bag(file: DetectionsFile) -> DetectedTags:
    seen, images = seen_in(file.path, file.argument, file.asked.get("topic"))
    return _with_images(_of_seen(file, seen), images)


def _as_first_written(texts: Sequence[str]) -> list[str]:
    """Texts of times, where equal numbers get the first of their texts: 9.5 and 9.50 are one time."""
    written: dict[Decimal | str, str] = {}
    return [written.setdefault(time_of(text), text) for text in texts]


def write_detections(path: Path, detected: DetectedTags) -> None:
    """Write a table that `read_detections` reads."""
    corners = (detected.corners - PIXEL_CENTRE).reshape(-1, 8)
    columns: dict[str, Any] = {TIMES[0]: [detected.times[frame] for frame in detected.frame.tolist()]}
    if len(detected.cameras) > 1:
        columns[CAMERAS[0]] = [detected.cameras[camera] for camera in detected.camera.tolist()]
    if detected.family is not None:
        columns[FAMILY] = [detected.family] * len(detected)
    write_table(path, {**columns, "id": detected.ids, **dict(zip(CORNER_COLUMNS, corners.T, strict=True))})


def with_images(detected: DetectedTags, path: Any) -> DetectedTags:
    """Detections with the list of all images, from a CSV with a row for each image.

    The CSV has the columns of `read_detections` for time and camera. Other columns are ignored. Images without a tag
    become frames as well.

    Raises:
        InputError: the file cannot be read, or lacks a column or an image in which a tag was detected.
    """
    table = read_table(path, name=IMAGES)
    time, camera = (next((known for known in known_as if known in table), "") for known_as in (TIMES, CAMERAS))
    if not time:
        raise InputError(f"{IMAGES}: {str(path)!r} has no column {' or '.join(TIMES)}.", IMAGES)
    if not camera and len(detected.cameras) > 1:
        raise InputError(
            f"{IMAGES}: {str(path)!r} has no column {' or '.join(CAMERAS)}, and detections are of "
            f"{len(detected.cameras)} cameras.",
            IMAGES,
        )
    named = table.texts[camera] if camera else [""] * len(table.lines)
    found = _with_images(detected, list(zip(_as_first_written(table.texts[time]), named, strict=True)))
    if (lacking := np.flatnonzero(~found.images[found.frame, found.camera])).size:
        first = lacking[0]
        of = f" of {found.cameras[found.camera[first]]}" if len(found.cameras) > 1 else ""
        raise InputError(
            f"{IMAGES}: {str(path)!r} lacks the image{of} at {found.times[found.frame[first]]}, in which a tag was "
            "detected.",
            IMAGES,
        )
    return found


def _with_images(detected: DetectedTags, images: Sequence[tuple[str, str]]) -> DetectedTags:
    """Detections with frames for all images, given the time and the camera of each; those of one camera need no name.

    Images of cameras without detections are left out.
    """
    number = {name: index for index, name in enumerate(detected.cameras)}
    own = [
        (text, 0 if len(number) == 1 else number[name]) for text, name in images if len(number) == 1 or name in number
    ]
    texts = dict.fromkeys((*detected.times, *(text for text, _ in own)))
    same = {time_of(text): text for text in reversed(texts)}  # the text of the detections counts
    times = in_order([same[time_of(text)] for text in texts])
    place = {time_of(text): index for index, text in enumerate(times)}
    taken = np.zeros((len(times), len(number)), dtype=bool)
    for text, camera in own:
        taken[place[time_of(text)], camera] = True
    frame = np.array([place[time_of(text)] for text in detected.times])[detected.frame]
    return replace(detected, times=tuple(times), frame=frame, taken=taken)


def _lacking(file: DetectionsFile) -> str:
    if not file.lines:
        return "is empty"
    if len(file.lacks) > MOST_LACKING:
        return f"has no such columns in its first line, {file.first.strip()[:SHOWN]!r}"
    return f"lacks the column{'s' * (len(file.lacks) > 1)} {', '.join(file.lacks)}"


FORMATS = (
    Format(
        "detections",
        "ROS 2",
        lambda file: is_bag(file.path),
        _read_bag,
        row="bag of ROS 2 (MCAP, `.db3`, a folder) | a topic of `apriltag_msgs/AprilTagDetectionArray`, or one for "
        "each camera of a rig; images without a tag count",
    ),
    Format(
        "detections",
        "table",
        # A file with semicolons is refused by the reader of tables.
        lambda file: not file.lacks or (len(file.header) == 1 and ";" in file.first),
        _read_csv,
        row="table (CSV) | a row for each tag, with `time` (`stamp`, `image`), `id`, `x0,y0,...,x3,y3`, and `camera` "
        "(`topic`) of a rig",
    ),
    Format(
        "detections",
        "PhotonVision",
        has_results("targets"),
        _from_json(photonvision),
        row="PhotonVision (JSON, or a line for each result) | `PhotonPipelineResult` with `metadata` and "
        "`detectedCorners`: a list, or one for each camera by name; of its AprilTag pipeline",
    ),
    Format(
        "detections",
        "Limelight",
        has_results("Fiducial"),
        _from_json(limelight),
        row="Limelight (JSON, or a line for each result) | `Fiducial` with `pts`, which its pipeline must send",
    ),
    Format(
        "detections",
        "Visual Marker Mapping",
        has_results("tag_observations"),
        _from_json(visual_marker_mapping),
        row="Visual Marker Mapping `marker_detections.json` | corners of `--do_corner_refinement`",
    ),
    Format(
        "detections",
        "other JSON",
        lambda file: file.documents is not None,
        why_not="is JSON without targets, Fiducial or tag_observations",
    ),
    Format(
        "detections",
        "a row for each corner",
        lambda file: {"corner", "x", "y"} <= set(file.header),
        why_not="has a row for each corner",
    ),
    Format("detections", "another file", anything, why_not=_lacking),
)
