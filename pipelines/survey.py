"""Map tags from photographs: `python -m pipelines.survey run=DIR photographs=DIR camera.path=FILE`."""

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from typing import TYPE_CHECKING

from omegaconf import DictConfig, OmegaConf

from .app import discard_empty, run_directory
from .building import camera_of, visibility_of
from .command import Command
from .export import build_export
from .landmarks import fixed_of, table_in
from .nodes import instantiate, keyed, note, settings_of
from .operations.signals import Stopped, stop
from .photographs import detected, odometry_of, reader_of, with_camera_of_bag
from .study import Report, Study
from .survey_files import audit_writers, writers_of

if TYPE_CHECKING:
    from lmd.geometry.camera import Camera
    from lmd.scene.rig import Rig
    from lmd.scene.scene import Scene
    from lmd.scene.tag import Tag
    from lmd.space.space import Space
    from lmd.survey.knowledge import PriorKnowledge

    from .progress import Stages


def survey(cfg: DictConfig) -> Study:
    """Estimate the map of the tags in the configured photographs or detections."""
    from lmd.core.checks import InputError, boolean, integer, seed_number
    from lmd.core.tables import write_table
    from lmd.detection.tag_views import FILE as VIEWS
    from lmd.evaluation.audit import audited, in_the_open, view_columns
    from lmd.evaluation.verdicts import verdicts
    from lmd.survey.keyframes import select_keyframes
    from lmd.survey.results import map_of, metrics
    from lmd.survey.survey import SurveyStage
    from lmd.survey.survey import survey as find
    from lmd.survey.terminal import to_text

    from .progress import Stages

    seed_number(cfg.seed)
    tag = instantiate(cfg.tag)
    with keyed():
        tag.check_edge()
    given = camera_of(with_camera_of_bag(cfg).camera)
    cameras = given.cameras
    name, detector = reader_of(cfg)
    known, room = _known(cfg, tag, given), instantiate(cfg.room) if cfg.get("room") else None
    scene = _scene(cfg, room, given, tag) if boolean("audit", cfg.audit) else None
    exports = build_export(cfg, "export", tag)
    if exports.formats and room is None:
        raise InputError("export needs the room that the tags hang in: run=DIR, or room=... with its keys.")
    with keyed("survey"):
        calibrate = None if cfg.survey.calibrate == "auto" else boolean("calibrate", cfg.survey.calibrate)
        every = None if cfg.survey.every == "auto" else integer("every", cfg.survey.every, low=1)
    stages, audit = Stages(), None
    with _map_or_nothing(stages):
        found_tags = detected(cfg, cameras, detector, tag)
        with stages, stop.deferred(lambda: stages.has_map, "this step"):
            with keyed(
                "survey",
                detections="detections" if cfg.detections is not None else "photographs",
                cameras="camera",
                fixed="deployment.fixed",
            ):
                found = find(
                    select_keyframes(found_tags, every), cameras, tag, detector.corner_errors, known, calibrate, stages
                )
            through = tuple(one.found for one in found.calibrated)
            if scene is not None and not stages(SurveyStage.AUDITING):
                audit = audited(*((found, scene) if room is not None else in_the_open(found, scene)), verdicts)
            found = replace(found, interrupted=stages.interrupted)
    about = f"survey of {found.placed.sum()} tags in {len(found.found.frames)} frames"

    def run(_: object) -> Report:
        files = writers_of(found, room, about, found_tags if cfg.detections is None else None)
        files[VIEWS] = lambda path: write_table(path, view_columns(found, through, tag, room))
        if exports.formats and room is not None:
            files |= exports.writers(room, tag, map_of(found))
        if audit is not None:
            files |= audit_writers(audit, name, about)
        figures = metrics(found) | (audit.metrics() if audit else {})
        text = "\n".join([to_text(found), *([audit.to_text()] if audit else [])])
        return Report(files, figures, text=text, is_cut=found.interrupted is not None)

    return Study("survey", run, about)


@contextmanager
def _map_or_nothing(stages: "Stages") -> Iterator[None]:
    """Context that reports a stop before there is a map, and removes the empty folder."""
    try:
        yield
    except Stopped:
        discard_empty(run_directory())
        print(f"told to stop while {stages.doing}: nothing is written.", file=sys.stderr)
        raise


def _scene(cfg: DictConfig, room: "Space | None", camera: "Camera | Rig", tag: "Tag") -> "Scene":
    """Scene of the audit; an unknown room is replaced by a placeholder.

    Raises:
        InputError: the visibility model is for points, not for tags.
    """
    from lmd.core.checks import InputError, check_members
    from lmd.scene.criteria import Criteria
    from lmd.scene.pdf import solid_angle
    from lmd.scene.scene import Scene
    from lmd.space.cuboid import Cuboid

    if "tag" not in cfg.visibility:
        raise InputError("audit needs a visibility model of tags: visibility=fiducial.")
    visibility, _ = visibility_of(cfg.visibility)  # a crowd of the plan is not that of the photographs
    metre = (1.0, 1.0, 1.0)
    check_members("visibility", visibility, Criteria, "docs/extend.md")
    anywhere = Cuboid(metre, reachable_size=metre, spacing=1.0) if room is None else room
    return Scene(anywhere, camera, solid_angle(1), visibility, tag)  # the audit uses the orientations of the frames


def _known(cfg: DictConfig, tag: "Tag", given: "Camera | Rig") -> "PriorKnowledge":
    """Prior knowledge of the tags.

    Raises:
        InputError: a file cannot be read, or a number is refused.
    """
    from lmd.core.checks import InputError, boolean, integer
    from lmd.formats.tag_maps import read_deployment
    from lmd.scene.rig import Rig
    from lmd.survey.knowledge import Boards, Hanging, MeasuredPoints, PriorKnowledge

    settings = OmegaConf.to_container(settings_of(cfg, "survey"), resolve=True)
    assert isinstance(settings, dict)
    for key in ("calibrate", "every"):  # these do not describe the tags
        settings.pop(key)
    names = ("origin", "points", "floor", "boards", "printed", "mounted", "odometry", "motion", "edges")
    origin, points, floor, boards, printed, mounted, path, motion, sizes = (settings.pop(key, None) for key in names)
    odometry = odometry_of(path, "survey.odometry")
    steady = None if motion == "auto" else boolean("survey.motion", motion)
    with keyed("survey"):
        hanging = Hanging(**{str(key): value for key, value in settings.items()})
        origin = None if origin is None else integer("origin", origin, low=0)
        points = None if points is None else MeasuredPoints.from_csv(points)
        mounts = given.mounted if boolean("mounted", mounted) and isinstance(given, Rig) else None
        boards = None if boards is None else Boards.from_csv(boards, printed)
        if not isinstance(floor, list):
            raise InputError(f"floor must list the ids of tags, got {floor!r}.", "floor")
        floor = tuple(integer("floor", number, low=0) for number in floor)
    node = settings_of(cfg, "deployment")
    if "path" not in node:
        raise InputError("deployment must be a file, deployment.path=plan.csv, or that of a run, run=DIR.")
    with keyed("deployment", family="tag.family"):
        plan = None if node.path is None else read_deployment(node.path, "path", tag.own_family, **table_in(node))
        fixed = fixed_of(node, tag.own_family)
    note("" if plan is None else plan.note)
    with keyed("survey"):
        return PriorKnowledge(
            plan, hanging, fixed, points, boards, mounts, origin, floor, odometry, sizes or {}, steady
        )


main = Command("survey", survey)

if __name__ == "__main__":
    main()
