"""Files that a survey writes."""

from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from .composing import RIG
from .outputs import write_document

if TYPE_CHECKING:
    from lmd.evaluation.audit import Audit
    from lmd.formats.detections import DetectedTags
    from lmd.space.space import Space
    from lmd.survey.survey import Survey

DOCUMENT, MEASURED, DETECTED = "survey.json", "measured.csv", "detections.csv"


def camera_files(count: int) -> list[str]:
    """Names of the calibration files of cameras."""
    return ["camera.yaml"] if count == 1 else [f"camera_{number}.yaml" for number in range(1, count + 1)]


def writers_of(
    found: "Survey", room: "Space | None", title: str, detected: "DetectedTags | None"
) -> dict[str, Callable[[Path], object]]:
    """Functions that write the files, by the names of the files.

    Args:
        found: the survey.
        room: the room; None if unknown.
        title: title of the picture.
        detected: detections in all frames; None if they were read from a file.
    """
    from lmd.adjust.intrinsics import camera_info
    from lmd.core.tables import write_table
    from lmd.formats.detection_formats import write_detections
    from lmd.formats.rigs import write_rig
    from lmd.formats.tag_map import write_yaml
    from lmd.formats.tag_maps import FILE, write_map_covariance
    from lmd.plot.plans import save_survey_figure
    from lmd.scene.rig import Rig
    from lmd.survey.results import frame_columns, map_columns, map_covariance, measured_of, survey_document

    writers: dict[str, Callable[[Path], object]] = {
        "map.csv": lambda path: write_table(path, map_columns(found)),
        FILE: lambda path: write_map_covariance(path, *map_covariance(found)),
        "frames.csv": lambda path: write_table(path, frame_columns(found)),
        DOCUMENT: lambda path: write_document(path, survey_document(found)),
        "survey.png": lambda path: save_survey_figure(path, found, room, title),
    }
    if (measured := measured_of(found)) is not None:
        writers[MEASURED] = lambda path: measured.to_csv(path, ups=True)
    for file, camera in zip(camera_files(len(found.calibrated)), found.calibrated, strict=True):
        writers[file] = partial(write_yaml, keys=camera_info(camera.found))
    if len(found.calibrated) > 1:
        rig = Rig.of_poses([camera.found for camera in found.calibrated], found.found.poses.mounts)
        sources = dict(zip(rig.cameras, camera_files(len(rig.cameras)), strict=True))
        writers[RIG] = partial(write_rig, rig=rig, sources=sources)
    if detected is not None:
        writers[DETECTED] = lambda path: write_detections(path, detected)
    return writers


def audit_writers(audit: "Audit", detector: str, title: str) -> dict[str, Callable[[Path], object]]:
    """Functions that write the files of an audit, by the names of the files."""
    import pandas as pd

    from lmd.detection.predictions import figures
    from lmd.plot.detection_figures import save_calibration_figure, save_places_figure

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
