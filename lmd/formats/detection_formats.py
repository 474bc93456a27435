"""Files of detections: tables, bags, and JSON of PhotonVision and Limelight; and files that list all images, including
images without tags.

PhotonVision's corners are counter-clockwise from the tag's bottom left. The AprilTag pipeline counts pixels from the
outer corner of the image's top left pixel, as AprilTag 3 does. (Its ArUco pipeline counts from the centre of the first
pixel, but files do not name the pipeline.) Limelight documents neither the order of the corners nor the origin of pixel
coordinates. The corners are assumed to have the order and the origin of AprilTag 3.

Sources: `PhotonPipelineResult`, `PhotonTrackedTarget` and `TrackedTarget` (PhotonVision/photonvision); "JSON Results
Specification" of Limelight.
"""

import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from decimal import Decimal
from functools import cached_property
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from lmd.core.checks import InputError, printable, real, vector
from lmd.core.tables import in_order, read_table, time_of, write_table
from lmd.core.words import few
from lmd.formats.bags import DETECTIONS, Bag
from lmd.formats.columns import FAMILY, TAGS, standard
from lmd.formats.detections import DetectedTags, signed_area
from lmd.formats.placed_tag import one_family
from lmd.formats.registry import read
from lmd.formats.trees import File
from lmd.geometry.camera import PIXEL_CENTRE
from lmd.scene.families import family_named

NAME, IMAGES = "detections", "images"  # names of the arguments with paths
# Columns of the corners, in OpenCV's pixels, clockwise from the top left of the tag's own picture.
CORNER_COLUMNS = tuple(f"{axis}{corner}" for corner in range(4) for axis in "xy")
TIMES, CAMERAS = ("time", "stamp", "timestamp", "image"), ("camera", "topic", "cam", "camera_id")
FROM_APRILTAG = [3, 2, 1, 0]
SHOWN = 80  # maximum number of characters of a file that a message shows
MOST_LACKING = 4  # maximum number of missing columns that a message names
LEAST_AREA = 1.0  # minimum area of a quadrilateral, square pixels; smaller ones are left out
DEEPEST = 3  # maximum number of levels of names and lists around results in JSON


class SeenTag(NamedTuple):
    """Detection of one tag in one image, as a file states it: camera, time, and the tag's id, corners and family."""

    camera: str
    """Name of the camera; empty if there is a single camera."""
    time: str
    """Time of the frame, seconds, or the name of the frame."""
    number: int
    """Number of the tag."""
    corners: Sequence[Sequence[float]]
    """Four corners (x, y) in the order of the file, pixels from the outer corner of the image's top left pixel."""
    family: str = ""
    """Tag family as the program names it; empty if the program names none."""


class DetectionsFile(File):
    """File of detections of an unknown format; its first line may name columns."""

    @cached_property
    def data(self) -> Mapping[str, Any]:
        """Mapping of the key "" to the JSON in the file: one document, or a list of documents if each line is one.

        The mapping is empty for a text that is not JSON.

        Raises:
            InputError: the text begins like JSON, but is broken.
        """
        if not self.text.lstrip().startswith(("{", "[")):
            return {}
        lines = [line for line in self.text.splitlines() if line.strip()]
        try:
            try:
                return {"": json.loads(self.text)}
            except ValueError:
                if len(lines) < 2 or not all(line.strip()[0] == "{" for line in lines):
                    raise
                return {"": [json.loads(line) for line in lines]}
        except (ValueError, RecursionError) as error:
            reason = " ".join(str(error).split())[:SHOWN]
            raise InputError(f"{self.argument}: {str(self.path)!r} is not JSON ({reason}).", self.argument) from None

    @cached_property
    def header(self) -> list[str]:
        """Names of the columns, from the first line."""
        return [column.strip().strip('"') for column in self.first.split(",")]

    @cached_property
    def lacks(self) -> list[str]:
        """Names of the columns that a table of detections needs but the header lacks."""
        lacks = [column for column in ("id", *CORNER_COLUMNS) if column not in self.header]
        return [" or ".join(TIMES)] * (not set(TIMES) & set(self.header)) + lacks

    def refused(self, reason: str) -> InputError:
        """Make an error about a file that is not a table of detections.

        In `reason`, the word `LACKS` is replaced by a clause with the missing columns, or by `is empty`.
        """
        lacks = f"lacks {few(self.lacks, MOST_LACKING)} in its first line, {self.first.strip()[:SHOWN]!r}"
        lacks = lacks if self.first else "is empty"
        return InputError(f"{self.argument}: {str(self.path)!r} {reason.replace('LACKS', lacks)}.", self.argument)


def is_table(file: DetectionsFile) -> bool:
    """True for a table of detections, even with semicolons, because its reader explains that commas are needed."""
    return not file.lacks or (len(file.header) == 1 and ";" in file.first)


def is_json(file: DetectionsFile) -> bool:
    """True for JSON; raises `InputError` if the JSON is broken."""
    return bool(file.data)


def has_rows_of_corners(file: DetectionsFile) -> bool:
    """True for a table with one row for each corner of a tag."""
    return {"corner", "x", "y"} <= set(file.header)


@dataclass(frozen=True)
class KeyedDetections:
    """Description of the JSON in which a program writes its results; a row of `tables/detections.yaml`."""

    tags: str
    """Key of the list of tags; a mapping with this key is a result, that is, the detections in one image."""
    number: str
    """Key of a tag's number; -1 marks a target that is not a tag."""
    corners: str
    """Key of a tag's four corners: pairs, or mappings with x and y."""
    times: Mapping[str, int]
    """Keys under which a result may state its time, in the order in which they are tried. The value of each key is the
    number of its time units in a second.
    """
    tag_family: str = ""
    """Key of a tag's family; empty if tags have none."""
    least: float = -np.inf
    """Minimum coordinate of a corner. Smaller coordinates are refused, as they count from the middle of the image."""

    def read(self, file: Any) -> DetectedTags:
        """Read the detections of tags in all images that a file of the program lists.

        Raises:
            InputError: a key is missing, a value is refused, or no tag has corners.
        """
        where = f"{file.argument}: {str(file.path)!r}"
        try:
            seen = list(self._seen(file.data))
        except InputError as error:
            raise InputError(f"{where} {error}.".replace("..", "."), file.argument) from None
        except KeyError as error:
            raise InputError(f"{where} lacks the key {str(error)[:SHOWN]}.", file.argument) from None
        except (IndexError, TypeError, ValueError, AttributeError, ArithmeticError):
            raise InputError(f"{where} has a value of the wrong type.", file.argument) from None
        if not seen:
            how = f"let the pipeline send {self.corners}"
            raise InputError(f"{where} has no detection of a tag with corners: {how}.", file.argument)
        return _detections(file, seen)

    def _seen(self, keys: Any) -> Iterator[SeenTag]:
        """Yield the tags with corners in all images of a file, each with the time at which its image was taken.

        `keys` is the content of the file, one or several JSON documents.
        """
        for camera, result in _results(keys, self.tags):
            metadata = result.get("metadata")
            keys = {**result, **({f"metadata.{key}": value for key, value in metadata.items()} if metadata else {})}
            name = next((name for name in self.times if name in keys and real(name, keys[name]) >= 0.0), "")
            if not name:
                raise InputError(f"has a result without {' or '.join(self.times)}, so its time is not known")
            written = keys[name] if isinstance(keys[name], int) else repr(real(name, keys[name]))
            time = f"{Decimal(written) / self.times[name]:f}"  # all digits of whole numbers are kept
            for tag in result[self.tags]:
                number, given = tag.get(self.number, -1), tag.get(self.corners)
                if number == -1 or not given:
                    continue  # not a tag, or a tag without corners
                if real(self.number, number, low=0.0) != int(number):
                    raise InputError(f"has the {self.number} {number!r}, which is not a whole number")
                if not isinstance(given, list) or len(given) != 4:
                    raise InputError(f"must have four corners in {self.corners}, got {given!r}"[: 2 * SHOWN])
                pairs = ([corner["x"], corner["y"]] if isinstance(corner, Mapping) else corner for corner in given)
                corners = [vector(f"{self.corners}[{i}]", pair, 2) for i, pair in enumerate(pairs)]
                if min(map(min, corners)) < self.least:
                    raise InputError(f"has negative corners: its {self.corners} count from the middle of the image")
                family = str(tag.get(self.tag_family, "")).upper().removesuffix("C")  # such as 36H11C
                yield SeenTag(camera, time, int(number), corners, family)


def read_detections(path: Any, topic: Any = None) -> DetectedTags:
    """Read detections from the JSON of a program such as PhotonVision, from a bag, or from a table.

    A table has the columns `time,id,x0,y0,...,x3,y3`. The corners are clockwise from the top left in OpenCV's pixels,
    whose origin is the centre of the first pixel. The column of the time may also be named `stamp` or `image`, and may
    hold any text, such as the name of a photograph. The column `camera` or `topic` names the camera; without this
    column there is one camera. Further columns are ignored.

    If most detections have counter-clockwise corners, the corners are read in the order of the AprilTag library, from
    the bottom left. Detections whose corners have the opposite sense of rotation are left out.

    Args:
        path: path of the file.
        topic: topic of a bag, or list of topics; None for all topics with detections.

    Raises:
        InputError: the file cannot be read, lacks a column, or a value is not a number.
    """
    found: DetectedTags = read("detections", DetectionsFile(path, NAME, {"topic": topic}))
    return found


def read_csv(file: File) -> DetectedTags:
    """Read detections from a table with commas, whose columns `read_detections` describes."""
    table = read_table(file.path, name=file.argument)
    time, camera = (next((known for known in known_as if known in table), "") for known_as in (TIMES, CAMERAS))
    values = table.numbers(("id", *CORNER_COLUMNS), None)
    if (wrong := np.flatnonzero((values[:, 0] != values[:, 0].astype(np.int64)) | (values[:, 0] < 0))).size:
        text = table.texts["id"][wrong[0]]
        line = f"{file.path} line {table.lines[wrong[0]]}"
        raise InputError(f"{line}: id is {text!r}, not a whole number from 0.", file.argument)
    corners = values[:, 1:9].reshape(-1, 4, 2) + PIXEL_CENTRE
    cameras = table.texts[camera] if camera else [""] * len(values)
    nameless = [""] * len(values)
    family = next((table.texts[key] for key in table.texts if standard(key, TAGS) == (FAMILY, None)), nameless)
    rows = zip(cameras, table.texts[time], values[:, 0].astype(np.int64), corners, family, strict=True)
    return _detections(file, [SeenTag(*row) for row in rows])


def _detections(file: File, seen: Sequence[SeenTag]) -> DetectedTags:
    """Convert the `seen` tags to detections, with corners that begin at the tag's top left.

    Tags are left out if their corners enclose less than `LEAST_AREA` square pixels, or if their corners have the
    opposite sense of rotation to those of most tags.

    Raises:
        InputError: no tag is left, or the tags have several families.
    """
    # Times are compared as texts: nanoseconds since 1970 have more digits than a float.
    texts = {text for tag in seen for text in (tag.time, tag.camera)}
    shown = {text: printable(text) for text in texts}
    moments = _as_first_written([shown[tag.time] for tag in seen])
    names = sorted({shown[tag.camera] for tag in seen})
    cameras = np.searchsorted(names, [shown[tag.camera] for tag in seen])
    ids, corners = np.array([tag.number for tag in seen], dtype=np.int64), np.array([tag.corners for tag in seen])
    if 2 * (signed_area(corners) < 0.0).sum() > len(corners):
        corners = corners[:, FROM_APRILTAG]
    usable = signed_area(corners) >= LEAST_AREA
    if not usable.any():
        raise InputError(f"{file.path} has no detection whose four corners enclose an area.", file.argument)
    place = {text: index for index, text in enumerate(in_order(moments))}
    frames = np.array([place[text] for text in moments])
    try:
        family = one_family(family_named(text) for text in {tag.family for tag in seen} - {""})
    except InputError as error:
        raise InputError(f"{file.argument}: {str(file.path)!r} {error}", file.argument) from None
    found = DetectedTags(tuple(place), tuple(names), frames, cameras.astype(np.int64), ids, corners, family=family)
    return found.of(np.flatnonzero(usable))


def _results(documents: Any, key: str, camera: str = "", depth: int = DEEPEST) -> Iterator[tuple[str, Any]]:
    """Yield the results (detections in one image) in JSON documents: pairs of a camera's name and a mapping.

    Args:
        documents: a document, or a list of documents.
        key: key by which the mapping of a result is recognised.
        camera: name of the camera for results without a key above them that names it.
        depth: number of levels of mappings and lists that are searched; an outermost list does not count.
    """
    if isinstance(documents, Mapping):
        if key in documents:
            yield camera, documents
        elif depth:
            for name, inner in documents.items():
                yield from _results(inner, key, camera if name == "Results" else str(name), depth - 1)
    elif isinstance(documents, list):
        for inner in documents:
            yield from _results(inner, key, camera, depth - (depth < DEEPEST))


def read_bag(file: File) -> DetectedTags:
    """Read detections from a bag: from one topic, from a list of topics (one for each camera), or from all topics."""
    bag, topic, seen, images = Bag(file.path, file.argument), file.asked.get("topic"), list[SeenTag](), []
    found = bag.topics_of(DETECTIONS) if topic is None else [topic] if isinstance(topic, str) else list(topic)
    topics = bag.chosen(topic, DETECTIONS, count=max(len(found), 1))
    for name in topics:
        camera = name if len(topics) > 1 else ""
        for stored in bag.messages(name):
            images.append((stored.stamp, name))
            for tag in bag.content(stored.raw, DETECTIONS).detections:  # corners count from the border of the image
                corners = [(float(corner.x), float(corner.y)) for corner in tag.corners]
                if not np.isfinite(corners).all():
                    raise bag.refused(f"has a corner that is not a number at {stored.stamp} s")
                seen.append(SeenTag(camera, stored.stamp, int(tag.id), corners, tag.family))
    if not seen:
        raise bag.refused(f"has no tag on {', '.join(topics)}")
    return _with_images(_detections(file, seen), images)


def _as_first_written(texts: Sequence[str]) -> list[str]:
    """Replace texts of times that state one number by the first of these texts: 9.50 becomes 9.5 if 9.5 came before."""
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
    """Copy of detections with a frame for each image that a CSV lists, also for images without a tag.

    The CSV has a row for each image, with the columns of `read_detections` for time and camera. Other columns are
    ignored.

    Raises:
        InputError: the file cannot be read, or lacks a column or an image in which a tag was detected.
    """
    table = read_table(path, name=IMAGES)
    time, camera = (next((known for known in known_as if known in table), "") for known_as in (TIMES, CAMERAS))
    if not time:
        raise InputError(f"{IMAGES}: {str(path)!r} has no column {' or '.join(TIMES)}.", IMAGES)
    if not camera and len(detected.cameras) > 1:
        reason = f"but the detections are of {len(detected.cameras)} cameras"
        raise InputError(f"{IMAGES}: {str(path)!r} has no column {' or '.join(CAMERAS)}, {reason}.", IMAGES)
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
    """Copy of detections with a frame for each of the `images`, also for images without a tag.

    An image is given by its time and its camera; the camera may be empty if there is only one. Images of cameras
    without detections are left out.
    """
    number = {name: index for index, name in enumerate(detected.cameras)}
    own = [(text, number.get(name, 0)) for text, name in images if len(number) == 1 or name in number]
    texts = dict.fromkeys((*detected.times, *(text for text, _ in own)))
    same = {time_of(text): text for text in reversed(texts)}  # times keep the texts of the detections
    times = in_order([same[time_of(text)] for text in texts])
    place = {time_of(text): index for index, text in enumerate(times)}
    taken = np.zeros((len(times), len(number)), dtype=bool)
    for text, camera in own:
        taken[place[time_of(text)], camera] = True
    frame = np.array([place[time_of(text)] for text in detected.times])[detected.frame]
    return replace(detected, times=tuple(times), frame=frame, taken=taken)
