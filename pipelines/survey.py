"""Map tags from photographs: `python -m pipelines.survey run=DIR photographs=DIR camera.path=FILE`."""

import sys
from collections.abc import Iterator
from contextlib import closing, contextmanager
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING, Any

from omegaconf import DictConfig

from .app import discard_empty, run_directory
from .building import camera_of, visibility_of
from .command import Command
from .composing import RIG
from .export import build_export
from .landmarks import fixed_of, table_in
from .nodes import instantiate, keyed, note, plain, settings_of
from .operations.signals import Stopped, stop
from .photographs import detected, odometry_of, reader_of, with_camera_of_bag
from .study import Report, Study

if TYPE_CHECKING:
    from lmd.evaluation.audit import Audit
    from lmd.formats.detections import DetectedTags
    from lmd.geometry.camera import Camera
    from lmd.scene.rig import Rig
    from lmd.scene.scene import Scene
    from lmd.scene.tag import Tag
    from lmd.space.space import Space
    from lmd.survey.knowledge import PriorKnowledge
    from lmd.survey.survey import Survey

    from .progress import Stages

NO_HANGING = ("calibrate", "every", "odometry")  # keys of `survey` that are not about the tags
KNOWN = ("origin", "points", "boards", "printed", "motion", "edges")


def survey(cfg: DictConfig) -> Study:
    """Estimate the map of the tags from photographs or detections; return a study that reports on the result."""
    from lmd.core.checks import InputError, boolean, integer, seed_number
    from lmd.evaluation.audit import audited, in_the_open
    from lmd.evaluation.verdicts import verdicts
    from lmd.survey.keyframes import select_keyframes
    from lmd.survey.results import map_of, metrics, to_text
    from lmd.survey.survey import SurveyStage
    from lmd.survey.survey import survey as find

    from .progress import Stages

    seed_number(cfg.seed)
    tag = instantiate(cfg.tag)
    with keyed():
        tag.check_edge()
    given = camera_of(with_camera_of_bag(cfg).camera)
    name, detector = reader_of(cfg)
    known, room = _known(cfg, tag), instantiate(cfg.room) if cfg.get("room") else None
    scene = _scene(cfg, room, given, tag) if boolean("audit", cfg.audit) else None
    exports = build_export(cfg, "export", tag)
    if exports.formats and room is None:
        raise InputError("export needs a room: give run=DIR, or room=... with its keys.")
    with keyed("survey"):
        calibrate = None if cfg.survey.calibrate == "auto" else boolean("calibrate", cfg.survey.calibrate)
        every = None if cfg.survey.every == "auto" else integer("every", cfg.survey.every, low=1)
    stages, audit = Stages(), None
    source = "photographs" if cfg.detections is None else "detections"
    with _map_or_nothing(stages):
        tags = detected(cfg, given.cameras, detector, tag)
        with closing(stages), stop.deferred(lambda: stages.has_map, "this step"):
            with keyed("survey", detections=source, cameras="camera", fixed="deployment.fixed"):
                frames = select_keyframes(tags, every)
                found = find(frames, given.cameras, tag, detector.corner_errors, known, calibrate, stages)
            if scene is not None and not stages(SurveyStage.AUDITING):
                audit = audited(*((found, scene) if room is not None else in_the_open(found, scene)), verdicts)
            found = replace(found, interrupted=stages.interrupted)
    about = f"survey of {found.placed.sum()} tags in {len(found.found.frames)} frames"

    files = _files(found, room, tag, about, tags if cfg.detections is None else None)
    if exports.formats and room is not None:
        files |= exports.writers(room, tag, map_of(found))
    figures, text = metrics(found), to_text(found)
    if audit is not None:
        files |= _audit_files(audit, name, about)
        figures, text = figures | audit.metrics(), f"{text}\n{audit.to_text()}"
    report = Report(files, figures, text=text, is_cut=found.interrupted is not None)
    return Study("survey", lambda _: report, about)


@contextmanager
def _map_or_nothing(stages: "Stages") -> Iterator[None]:
    """Context that removes the empty folder and prints a message if the survey is stopped before there is a map."""
    try:
        yield
    except Stopped:
        discard_empty(run_directory())
        print(f"told to stop while {stages.doing}: nothing is written.", file=sys.stderr)
        raise


def _scene(cfg: DictConfig, room: "Space | None", camera: "Camera | Rig", tag: "Tag") -> "Scene":
    """Scene for the audit, which compares the found tags with the tags that a visibility model predicts to be seen.

    If no room is given, the scene has a placeholder for the room.

    Raises:
        InputError: the visibility model is for points, not for tags.
    """
    from lmd.core.checks import InputError
    from lmd.scene.pdf import solid_angle
    from lmd.scene.scene import Scene
    from lmd.space.cuboid import Cuboid

    if "tag" not in cfg.visibility:
        raise InputError("audit needs a visibility model of tags: visibility=fiducial.")
    visibility, _ = visibility_of(cfg.visibility)  # the crowd of the plan is not in the photographs
    anywhere = Cuboid((1.0, 1.0, 1.0), reachable_size=(1.0, 1.0, 1.0), spacing=1.0) if room is None else room
    return Scene(anywhere, camera, solid_angle(1), visibility, tag)  # the audit takes orientations from the frames


def _known(cfg: DictConfig, tag: "Tag") -> "PriorKnowledge":
    """Read the prior knowledge about the tags' poses from the settings `survey` and `deployment`.

    Raises:
        InputError: a file cannot be read, or a number is out of range.
    """
    from lmd.adjust.prior import Hanging
    from lmd.core.checks import InputError, boolean, integer
    from lmd.formats.tag_maps import read_deployment
    from lmd.survey.knowledge import Boards, MeasuredPoints, PriorKnowledge

    settings = plain(settings_of(cfg, "survey"))
    odometry = odometry_of(settings.get("odometry"), "survey.odometry")
    origin, points, boards, printed, motion, sizes = map(settings.get, KNOWN)
    steady = None if motion == "auto" else boolean("survey.motion", motion)
    with keyed("survey"):
        hanging = Hanging(**{key: value for key, value in settings.items() if key not in (*NO_HANGING, *KNOWN)})
        origin = None if origin is None else integer("origin", origin, low=0)
        points = None if points is None else MeasuredPoints.from_csv(points)
        boards = None if boards is None else Boards.from_csv(boards, printed)
    node = settings_of(cfg, "deployment")
    if "path" not in node:
        raise InputError("deployment must be a file (deployment.path=plan.csv) or come from a run (run=DIR).")
    with keyed("deployment", family="tag.family"):
        plan = None if node.path is None else read_deployment(node.path, "path", tag.own_family, **table_in(node))
        fixed = fixed_of(node, tag.own_family)
    note("" if plan is None else plan.note)
    with keyed("survey"):
        told = points, boards, origin, odometry, sizes or {}, steady
        return PriorKnowledge(plan, hanging, fixed, *told)


def camera_files(count: int) -> list[str]:
    """Names of the calibration files that a survey writes, one for each of `count` cameras."""
    return ["camera.yaml"] if count == 1 else [f"camera_{number}.yaml" for number in range(1, count + 1)]


def _files(
    found: "Survey", room: "Space | None", tag: "Tag", title: str, detected: "DetectedTags | None"
) -> dict[str, Any]:
    """Contents of the files of a survey, keyed by file name.

    Args:
        found: result of the survey.
        room: the room; None if it is not given.
        tag: tag whose family and sizes the tags have.
        title: title of the picture.
        detected: detections in all frames; None if they were read from a file.
    """
    from lmd.adjust.tables import files_of_model
    from lmd.detection.tag_views import FILE as VIEWS
    from lmd.evaluation.audit import view_columns
    from lmd.formats.calibrations import camera_info
    from lmd.formats.detection_formats import write_detections
    from lmd.formats.rigs import write_rig
    from lmd.formats.tag_map import write_yaml
    from lmd.formats.tag_maps import FILE, write_map_covariance
    from lmd.plot.plans import save_survey_figure
    from lmd.scene.rig import Rig
    from lmd.survey.results import frame_columns, map_columns, map_covariance, measured_of, survey_document

    through, names = tuple(one.found for one in found.found.calibrated), camera_files(len(found.found.calibrated))
    files: dict[str, Any] = {
        "map.csv": map_columns(found),
        FILE: lambda path: write_map_covariance(path, *map_covariance(found)),
        "frames.csv": frame_columns(found),
        "survey.json": survey_document(found),
        "survey.png": lambda path: save_survey_figure(path, found, room, title),
        VIEWS: view_columns(found, through, tag, room),
    }
    if (measured := measured_of(found)) is not None:
        files["measured.csv"] = partial(measured.to_csv, ups=True)
    for file, camera in zip(names, through, strict=True):
        files[file] = partial(write_yaml, keys=camera_info(camera))
    if len(names) > 1:
        rig = Rig.of_poses(list(through), found.found.poses.mounts)
        files[RIG] = partial(write_rig, rig=rig, sources=dict(zip(rig.cameras, names, strict=True)))
    written, unable = files_of_model(found.found, found.detected, through)
    note(unable)
    files |= written
    if detected is not None:
        files["detections.csv"] = lambda path: write_detections(path, detected)
    return files


def _audit_files(audit: "Audit", detector: str, title: str) -> dict[str, Any]:
    """Contents of the files of a survey's audit, keyed by file name.

    Args:
        audit: comparison of the detections with the tags that the visibility model predicts to be seen.
        detector: name of the detector.
        title: title of the picture.
    """
    import pandas as pd

    from lmd.detection.predictions import figures
    from lmd.plot.detection_figures import save_calibration_figure

    named = {"deployment": "survey", "detector": detector}
    row, pitches = pd.DataFrame([named | figures(audit.prediction, audit.seen)]), audit.tables["audit_pitches"]
    return {
        **{f"{name}.csv": table for name, table in audit.tables.items()},
        "audit.png": lambda path: save_calibration_figure(path, row, pitches.assign(**named), title),
    }


main = Command("survey", survey)

if __name__ == "__main__":
    main()
