"""The images that were taken, from a CSV: those without a tag, which detections do not tell from none, too."""

from dataclasses import replace
from typing import Any

import numpy as np

from lmd.core.checks import InputError
from lmd.core.tables import read_table, time_of
from lmd.formats.detections import CAMERAS, TIMES, DetectedTags

NAME = "images"


def with_images(detected: DetectedTags, path: Any) -> DetectedTags:
    """Detections that know which images there are, from a CSV with a row for each image.

    It has the columns of `lmd.formats.detections.read_detections` for time and camera; others are ignored, and so are
    images of times at which nothing was detected.

    Raises:
        InputError: the file cannot be read or lacks a column, or it lacks an image in which a tag was detected.
    """
    table = read_table(path, name=NAME)
    time, camera = (next((known for known in known_as if known in table), "") for known_as in (TIMES, CAMERAS))
    if not time:
        raise InputError(f"{NAME}: {str(path)!r} has no column {' or '.join(TIMES)}.", NAME)
    if not camera and len(detected.cameras) > 1:
        raise InputError(
            f"{NAME}: {str(path)!r} has no column {' or '.join(CAMERAS)}, and detections are of "
            f"{len(detected.cameras)} cameras.",
            NAME,
        )
    frame = {time_of(text): index for index, text in enumerate(detected.times)}
    number = {name: index for index, name in enumerate(detected.cameras)}
    cameras = table.texts[camera] if camera and len(number) > 1 else [detected.cameras[0]] * len(table.lines)
    taken = np.zeros((len(detected.times), len(detected.cameras)), dtype=bool)
    for text, name in zip(table.texts[time], cameras, strict=True):
        if (index := frame.get(time_of(text))) is not None and name in number:
            taken[index, number[name]] = True
    if (lacking := np.flatnonzero(~taken[detected.frame, detected.camera])).size:
        first = lacking[0]
        of = f" of {detected.cameras[detected.camera[first]]}" if len(number) > 1 else ""
        raise InputError(
            f"{NAME}: {str(path)!r} lacks the image{of} at {detected.times[detected.frame[first]]}, in which a tag was "
            "detected.",
            NAME,
        )
    return replace(detected, taken=taken)
