"""The files that a survey leaves."""

import os
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from omegaconf import DictConfig, OmegaConf

from .outputs import write_document
from .provenance import texts_in

if TYPE_CHECKING:
    from lmd.mapping.detections import DetectedTags
    from lmd.mapping.formats import Export
    from lmd.space.space import Space
    from lmd.survey.audit import Audit
    from lmd.survey.survey import Survey

DOCUMENT, MEASURED, DETECTED = "survey.json", "measured.csv", "detections.csv"
ALWAYS = ("map.csv", "frames.csv", DOCUMENT, "survey.png", "in_view.csv")
AUDIT = (
    *(f"audit_{name}.csv" for name in ("pitches", "incidences", "places", "tags")),
    *("audit.png", "audit_places.png"),
)


def check_folder(directory: Path, cfg: DictConfig, cameras: int, exports: "Export", *, has_plan: bool) -> None:
    """Refuse a folder that would hold files of an earlier survey beside those of this one, or where these cannot be.

    Args:
        directory: where the files go.
        cfg: of the survey.
        cameras: how many there are.
        exports: what is written besides.
        has_plan: whether there is one.

    Raises:
        InputError: it is such a folder.
    """
    from lmd.core.checks import InputError
    from lmd.mapping.formats import FORMATS

    own = set(ALWAYS) | {FORMATS[name].file for name in exports.formats}
    own |= {MEASURED} if has_plan else set()
    own |= {DETECTED} if cfg.detections is None else set()
    own |= set(camera_files(cameras))
    own |= set(AUDIT) if cfg.audit else set()
    for name in sorted(own):
        if (directory / name).is_dir():
            raise InputError(f"hydra.run.dir: {str(directory / name)!r} is a folder, where a file is to be written.")
    if not (directory / DOCUMENT).is_file():
        return
    known = {MEASURED, DETECTED, *AUDIT, *(form.file for form in FORMATS.values())}
    known |= {path.name for path in directory.glob("camera*.yaml")}
    read = {os.path.realpath(text) for text in texts_in(OmegaConf.to_container(cfg, resolve=True))}
    left = [name for name in sorted(known - own) if (directory / name).is_file()]
    if stale := [name for name in left if os.path.realpath(directory / name) not in read]:
        text = f"hydra.run.dir: {str(directory)!r} holds {', '.join(stale)} of an earlier survey, which this one does"
        raise InputError(
            f"{text} not write anew: remove {'it' if len(stale) == 1 else 'them'}, or name another folder."
        )


def camera_files(count: int) -> list[str]:
    """The names of the files for the calibrations of cameras."""
    return ["camera.yaml"] if count == 1 else [f"camera_{number}.yaml" for number in range(1, count + 1)]


def writers_of(
    found: "Survey", room: "Space | None", title: str, detected: "DetectedTags | None"
) -> dict[str, Callable[[Path], object]]:
    """Functions that write the files, by their names.

    Args:
        found: what is written.
        room: None where it is not known.
        title: of the picture.
        detected: what was detected in all frames; None where it is in a file already.
    """
    from lmd.core.tables import write_table
    from lmd.mapping.detections import write_detections
    from lmd.mapping.tag_map import write_yaml
    from lmd.plot.survey import save_survey_figure
    from lmd.survey.intrinsics import camera_info
    from lmd.survey.report import document, frame_columns, map_columns, measured_of

    writers: dict[str, Callable[[Path], object]] = {
        "map.csv": lambda path: write_table(path, map_columns(found)),
        "frames.csv": lambda path: write_table(path, frame_columns(found)),
        DOCUMENT: lambda path: write_document(path, document(found)),
        "survey.png": lambda path: save_survey_figure(path, found, room, title),
    }
    if (measured := measured_of(found)) is not None:
        writers[MEASURED] = lambda path: measured.to_csv(path, ups=True)
    for file, camera in zip(camera_files(len(found.calibrated)), found.calibrated, strict=True):
        writers[file] = partial(write_yaml, keys=camera_info(camera.found))
    if detected is not None:
        writers[DETECTED] = lambda path: write_detections(path, detected)
    return writers


def audit_writers(audit: "Audit", detector: str, title: str) -> dict[str, Callable[[Path], object]]:
    """Functions that write the files of an audit, by their names."""
    import pandas as pd

    from lmd.detection.report import figures
    from lmd.plot.detection import save_calibration_figure, save_places_figure

    named = {"deployment": "survey", "detector": detector}
    row = pd.DataFrame([{**named, **figures(audit.prediction, audit.seen)}])
    pitches = audit.tables["audit_pitches"].assign(**named)
    writers: dict[str, Callable[[Path], object]] = {
        f"{name}.csv": partial(table.to_csv, index=False) for name, table in audit.tables.items()
    }
    return {
        **writers,
        "audit.png": lambda path: save_calibration_figure(path, row, pitches, title),
        "audit_places.png": lambda path: save_places_figure(path, audit.tables["audit_places"], title),
    }
