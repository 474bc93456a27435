"""Detections that others made: the corners of tags in the frames of one or several cameras, from a CSV."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from decimal import Decimal
from pathlib import Path
from typing import Any

import numpy as np

from lmd.core.checks import BoolArray, FloatArray, InputError, IntArray
from lmd.core.files import read_text
from lmd.core.tables import COMMENT, in_order, read_table, time_of, write_table
from lmd.geometry.camera import PIXEL_CENTRE

# In OpenCV's pixels, clockwise from the top left of the tag as it was made.
CORNER_COLUMNS = tuple(f"{axis}{corner}" for corner in range(4) for axis in "xy")
TIMES, CAMERAS = ("time", "stamp", "timestamp", "image"), ("camera", "topic", "cam", "camera_id")
READ = (
    f"what is read is a CSV with a row for each tag and the columns {' or '.join(TIMES)}, id, x0, y0, ..., x3, y3, the "
    "corners clockwise from the tag's top left in OpenCV's pixels"
)
FROM_APRILTAG = [3, 2, 1, 0]
# Columns of a header that has others are named if it lacks so few; else the header is shown, characters at most.
MOST_LACKING, SHOWN = 4, 80
# A quadrilateral smaller than this, square pixels, has no corners to speak of.
LEAST_AREA = 1.0


@dataclass(frozen=True)
class DetectedTags:
    """N tags in the frames of C cameras.

    Args:
        times: of the F frames, or their names, as they were written, in ascending order, all different. What several
            cameras saw at the same time is one frame.
        cameras: what they are called, `(C,)`.
        frame: of each detection, `(N,)`, from 0.
        camera: likewise.
        ids: numbers of the tags, `(N,)`.
        corners: pixels from the border, top left, top right, bottom right, bottom left of the tag, `(N, 4, 2)`.
        blurred: frames whose detections were left out, with their blur, pixels, by their name.
        copies: images whose detections were left out, with the image that each is a copy of, by their name.
        in_order: whether corners are known to begin at the top left, because a detector of `lmd.detection` found them.
        taken: of which frames each camera has an image that counts, whether or not it shows a tag, `(F, C)`; None if
            it has one of all.
        left_out: frames whose detections were left out, as they add too little to the others.

    Raises:
        InputError: shapes do not match, or there is no detection.
    """

    times: tuple[str, ...]
    cameras: tuple[str, ...]
    frame: IntArray
    camera: IntArray
    ids: IntArray
    corners: FloatArray
    blurred: Mapping[str, float] = field(default_factory=dict)
    copies: Mapping[str, str] = field(default_factory=dict)
    in_order: bool = False
    taken: BoolArray | None = None
    left_out: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        count = len(self.ids)
        if not count:
            raise InputError("detections has no tag.", "detections")
        if self.corners.shape != (count, 4, 2) or self.frame.shape != (count,) or self.camera.shape != (count,):
            raise InputError(f"detections must be as many as their corners, got {self.corners.shape} for {count}.")

    def __len__(self) -> int:
        return len(self.ids)

    @property
    def images(self) -> BoolArray:
        """`taken`, whatever is known, `(F, C)`."""
        return np.ones((len(self.times), len(self.cameras)), dtype=bool) if self.taken is None else self.taken

    @classmethod
    def in_frames(cls, names: Sequence[str], ids: Sequence[IntArray], corners: Sequence[FloatArray]) -> "DetectedTags":
        """The tags that a detector found in frames of one camera.

        Args:
            names: of the frames, in ascending order.
            ids: of the tags in each frame, `(M,)`.
            corners: pixels from the border, as above, `(M, 4, 2)`.

        Raises:
            InputError: there is no tag in any frame.
        """
        frame = np.repeat(np.arange(len(ids)), [len(own) for own in ids])
        all_ids = np.concatenate([np.empty(0, dtype=np.int64), *ids])
        all_corners = np.concatenate([np.empty((0, 4, 2)), *corners])
        camera = np.zeros(len(all_ids), dtype=np.int64)
        return cls(tuple(names[: len(ids)]), ("",), frame, camera, all_ids, all_corners, in_order=True)

    @classmethod
    def together(cls, parts: Mapping[str, "DetectedTags"]) -> "DetectedTags":
        """What several cameras, by their names in ascending order, saw in frames that have equal names."""
        times = sorted({time for part in parts.values() for time in part.times})
        places = [np.searchsorted(times, part.times)[part.frame] for part in parts.values()]
        camera = np.repeat(np.arange(len(parts)), [len(part) for part in parts.values()])
        ids, corners = (np.concatenate([getattr(part, name) for part in parts.values()]) for name in ("ids", "corners"))
        blurs = {f"{name}/{time}": blur for name, part in parts.items() for time, blur in part.blurred.items()}
        in_order = all(part.in_order for part in parts.values())
        sharp = [sorted(set(part.times) - set(part.blurred)) for part in parts.values()]
        taken = np.stack([np.isin(times, names) for names in sharp], axis=1)
        cameras = tuple(parts)
        return cls(
            tuple(times), cameras, np.concatenate(places), camera, ids, corners, blurs, in_order=in_order, taken=taken
        )

    def of(self, chosen: IntArray) -> "DetectedTags":
        """Those that `chosen` selects, among the same frames and cameras."""
        names = ("frame", "camera", "ids", "corners")
        return replace(self, **{name: getattr(self, name)[chosen] for name in names})

    def renumbered(self, ids: IntArray, quarters: IntArray) -> "DetectedTags":
        """The same with the corners of tags with some `ids` `(K,)`, ascending, numbered from others.

        Args:
            quarters: by how many corners the first one moves back, `(K,)`.
        """
        place = np.minimum(np.searchsorted(ids, self.ids), len(ids) - 1)
        back = np.where(ids[place] == self.ids, quarters[place], 0)
        order = (np.arange(4) - back[:, None]) % 4
        return replace(self, corners=np.take_along_axis(self.corners, order[..., None], axis=1))

    def without(self, blurs: Mapping[str, float]) -> "DetectedTags":
        """Those of other frames than some that are blurred.

        Raises:
            InputError: there are none.
        """
        left_out = np.isin(self.times, list(blurs))
        return replace(self.of(np.flatnonzero(~left_out[self.frame])), blurred={**self.blurred, **blurs})


def signed_area(corners: FloatArray) -> FloatArray:
    """Of quadrilaterals `(..., 4, 2)`, positive where they go round clockwise as one looks at an image, `(...)`."""
    x, y = corners[..., 0], corners[..., 1]
    return np.asarray((x * np.roll(y, -1, axis=-1) - np.roll(x, -1, axis=-1) * y).sum(axis=-1) / 2.0)


def read_detections(path: Any) -> DetectedTags:
    """Read `id,x0,y0,...,x3,y3`, corners clockwise from the top left in OpenCV's pixels, with `time`.

    The time may be called `stamp` or `image`, and be any text, such as the name of a photograph.

    `camera` or `topic` says which camera saw a tag; without it there is one. Further columns are ignored. Where most
    corners go round counter-clockwise they are taken for those of the AprilTag library, which begins at the bottom
    left. Detections that go round the other way than most are left out.

    Raises:
        InputError: the file cannot be read, lacks a column, or a value is no number.
    """
    name = "detections"
    _check_header(path, name)
    table = read_table(path, name=name)
    time, camera = (next((known for known in known_as if known in table), "") for known_as in (TIMES, CAMERAS))
    values = table.numbers(("id", *CORNER_COLUMNS), None)
    ids = values[:, 0].astype(np.int64)
    if (wrong := np.flatnonzero((ids != values[:, 0]) | (ids < 0))).size:
        text = table.texts["id"][wrong[0]]
        raise InputError(f"{path} line {table.lines[wrong[0]]}: id is {text!r}, not a whole number from 0.", name)
    # Nanoseconds since 1970 have more digits than a float, so frames are told apart by what is written.
    moments = _as_first_written(table.texts[time])
    place = {text: index for index, text in enumerate(in_order(moments))}
    names = sorted(set(table.texts[camera])) if camera else [""]
    cameras = np.searchsorted(names, table.texts[camera]) if camera else np.zeros(len(ids), dtype=np.int64)
    corners = values[:, 1:9].reshape(-1, 4, 2) + PIXEL_CENTRE
    if 2 * (signed_area(corners) < 0.0).sum() > len(corners):
        corners = corners[:, FROM_APRILTAG]
    usable = signed_area(corners) >= LEAST_AREA
    if not usable.any():
        raise InputError(f"{path} has no detection with four corners around an area.", name)
    frames = np.array([place[text] for text in moments])
    found = DetectedTags(tuple(place), tuple(names), frames, np.asarray(cameras, dtype=np.int64), ids, corners)
    return found.of(np.flatnonzero(usable))


def _as_first_written(texts: Sequence[str]) -> list[str]:
    """Texts for times, equal numbers as the first of them was written: 9.5 and 9.50 are one time."""
    written: dict[Decimal | str, str] = {}
    return [written.setdefault(time_of(text), text) for text in texts]


def write_detections(path: Path, detected: DetectedTags) -> None:
    """Write what `read_detections` reads."""
    corners = (detected.corners - PIXEL_CENTRE).reshape(-1, 8)
    columns: dict[str, Any] = {TIMES[0]: [detected.times[frame] for frame in detected.frame.tolist()]}
    if len(detected.cameras) > 1:
        columns[CAMERAS[0]] = [detected.cameras[camera] for camera in detected.camera.tolist()]
    write_table(path, {**columns, "id": detected.ids, **dict(zip(CORNER_COLUMNS, corners.T, strict=True))})


def _check_header(path: Any, name: str) -> None:
    """Raise `InputError` if a file does not begin with the columns of detections, whatever else it is."""
    text = read_text(path, name)
    lines = [line for line in text.splitlines() if line.strip() and not line.lstrip().startswith(COMMENT)]
    header = [column.strip().strip('"') for column in lines[0].split(",")] if lines else []
    if len(header) == 1 and ";" in header[0]:
        return  # which `read_table` refuses
    lacks = [column for column in ("id", *CORNER_COLUMNS) if column not in header]
    lacks = [" or ".join(TIMES)] * (not set(TIMES) & set(header)) + lacks
    if not lacks:
        return
    if not lines:
        found = "is empty"
    elif lines[0].lstrip().startswith(("{", "[")):
        found = "is JSON or YAML, and no CSV"
    elif {"corner", "x", "y"} <= set(header):
        found = "has a row for each corner"
    elif len(lacks) > MOST_LACKING:
        found = f"has no such columns in its first line, {lines[0].strip()[:SHOWN]!r}"
    else:
        found = f"lacks the column{'s' * (len(lacks) > 1)} {', '.join(lacks)}"
    raise InputError(f"{name}: {str(path)!r} {found}; {READ}.", name)
