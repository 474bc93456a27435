"""Where tags hang, from photographs of them: `python -m pipelines.survey run=DIR photographs=DIR camera.path=FILE`."""

import sys
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from omegaconf import DictConfig, OmegaConf

from .app import run_directory
from .building import build_problem, camera_of, instantiate, keyed, settings_of
from .deployments import any_deployment
from .documents import write_document
from .earlier_run import read_earlier_run
from .export import build_export
from .fixed import axes_in, fixed_of
from .notes import note
from .outputs import write_all
from .pipeline import Pipeline

if TYPE_CHECKING:
    from collections.abc import Sequence

    from lmd.detection.detectors import Detections, Detector
    from lmd.detection.images import Images, Photographs
    from lmd.mapping.detections import DetectedTags
    from lmd.scene.camera import Camera
    from lmd.scene.rig import Rig
    from lmd.scene.scene import Scene
    from lmd.scene.tag import Tag
    from lmd.space.space import Space
    from lmd.survey.audit import Audit
    from lmd.survey.survey import Known, Survey

CHUNK = 8  # images that a worker reads at a time


def survey(cfg: DictConfig) -> None:
    """Find where the tags of the configured photographs or detections hang."""
    from lmd.core.checks import InputError, boolean, seed_number
    from lmd.core.tables import write_table
    from lmd.detection.corner_errors import CORNER_ERRORS
    from lmd.detection.surveyed import FILE as VIEWS
    from lmd.evaluation.verdicts import verdicts
    from lmd.scene.rig import Rig
    from lmd.survey.audit import audited
    from lmd.survey.next_photographs import next_photographs
    from lmd.survey.report import again, map_of, metrics, to_text
    from lmd.survey.survey import survey as find
    from lmd.survey.views import view_columns

    from .tracked_run import keep, tracked

    seed_number(cfg.seed)
    tag = instantiate(cfg.tag)
    with keyed():
        tag.check_edge()
    given = camera_of(cfg.camera)
    cameras = given.cameras if isinstance(given, Rig) else (given,)
    name, detector = _detector(cfg)
    known, room = _known(cfg, tag, given), instantiate(cfg.room) if cfg.get("room") else None
    scene = _scene(cfg) if boolean("audit", cfg.audit) else None
    exports = build_export(cfg, "export", tag)
    if exports.formats and room is None:
        raise InputError("export needs the room that the tags hang in: run=DIR, or room=... with its keys.")
    detected, source = (
        _detected(cfg, cameras, detector, tag.modules),
        "photographs" if cfg.detections is None else "detections",
    )
    errors = CORNER_ERRORS[name.removesuffix("_fine")]
    with keyed("survey", detections=source, cameras="camera", fixed="deployment.fixed"):
        found = find(detected, cameras, tag, errors, known, boolean("calibrate", cfg.survey.calibrate))
    through = tuple(one.found for one in found.calibrated) or cameras
    found = replace(found, proposed=next_photographs(found, through[0], tag.modules, errors, again(found), room))
    audit = None if scene is None else audited(found, scene, verdicts)
    about = f"survey of {found.placed.sum()} tags in {len(found.found.frames)} frames"
    with tracked(cfg, "survey", about) as tracker:
        writers = _writers(found, room, about, is_new=cfg.detections is None)
        writers[VIEWS] = lambda path: write_table(path, view_columns(found, through, tag, room))
        if exports.formats and room is not None:
            writers |= exports.writers(room, tag, map_of(found))
        if audit is not None:
            writers |= _audit_writers(audit, name, about)
        files = write_all(run_directory(), writers)
        keep(tracker, files, metrics(found) | (audit.metrics() if audit else {}))
    text = "\n".join([to_text(found), *([audit.to_text()] if audit else [])])
    print(f"{text}\nfiles: {run_directory()}: {', '.join(file.name for file in files)}")
    print(f"mlflow: {tracker.describe()}")


def _detector(cfg: DictConfig) -> "tuple[str, Detector]":
    """The detector and its name.

    Raises:
        InputError: there is not just one.
    """
    from lmd.core.checks import InputError

    named = list(cfg.get("detectors") or {})
    if len(named) != 1:
        raise InputError(f"detectors must name one detector, got {named}.")
    return named[0], instantiate(settings_of(cfg, f"detectors.{named[0]}"))


def _scene(cfg: DictConfig) -> "Scene":
    """What the frames are audited by.

    Raises:
        InputError: there is no room.
    """
    from lmd.core.checks import InputError

    if not cfg.get("room"):
        raise InputError("audit needs the room and the visibility model of a run: run=DIR.")
    return build_problem(any_deployment(cfg)).scene


def _known(cfg: DictConfig, tag: "Tag", given: "Camera | Rig") -> "Known":
    """What is known of the tags.

    Raises:
        InputError: a file cannot be read, or a number is refused.
    """
    from lmd.core.checks import InputError, boolean, integer
    from lmd.scene.rig import Rig
    from lmd.scene.tag_map_files import read_deployment
    from lmd.survey.boards import Boards
    from lmd.survey.known import Hanging, Points
    from lmd.survey.survey import Known

    settings = OmegaConf.to_container(settings_of(cfg, "survey"), resolve=True)
    assert isinstance(settings, dict)
    settings.pop("calibrate")  # says nothing of the tags
    names = ("origin", "points", "floor", "boards", "printed", "mounted")
    origin, points, floor, boards, printed, mounted = (settings.pop(key, None) for key in names)
    with keyed("survey"):
        hanging = Hanging(**{str(key): value for key, value in settings.items()})
        origin = None if origin is None else integer("origin", origin, low=0)
        points = None if points is None else Points.from_csv(points)
        mounts = given.mounted if boolean("mounted", mounted) and isinstance(given, Rig) else None
        boards = None if boards is None else Boards.from_csv(boards, printed)
        if not isinstance(floor, list):
            raise InputError(f"floor must list the ids of tags, got {floor!r}.", "floor")
        floor = tuple(integer("floor", number, low=0) for number in floor)
    node = settings_of(cfg, "deployment")
    if "path" not in node:
        raise InputError("deployment must be a file, deployment.path=plan.csv, or that of a run, run=DIR.")
    with keyed("deployment", family="tag.family"):
        plan = None if node.path is None else read_deployment(node.path, "path", tag.own_family, axes_in(node))
        fixed = fixed_of(node, tag.own_family)
    note("" if plan is None else plan.note)
    with keyed("survey"):
        return Known(plan, hanging, fixed, points, boards, mounts, origin, floor)


def _detected(cfg: DictConfig, cameras: "Sequence[Camera]", detector: "Detector", modules: int) -> "DetectedTags":
    """What was detected, by others or now.

    Raises:
        InputError: nothing, or both, is given, or a file cannot be read.
    """
    from lmd.core.checks import InputError
    from lmd.detection.images import Video
    from lmd.mapping.detections import DetectedTags, read_detections

    if (cfg.photographs is None) == (cfg.detections is None):
        raise InputError("photographs=DIR, a folder or a video, or detections=FILE.csv must be given, and not both.")
    if cfg.detections is not None:
        return read_detections(cfg.detections)
    given = Path(str(cfg.photographs))
    if not given.exists():
        raise InputError(f"photographs: there is no folder or video {str(given)!r}.")
    with keyed():
        if len(cameras) > 1:
            folders = sorted(folder for folder in given.glob("*") if folder.is_dir())
            if len(folders) != len(cameras):
                text = f"photographs must be a folder with one folder for each of {len(cameras)} cameras"
                raise InputError(f"{text}, {str(given)!r} has {len(folders)}.")
            views = {folder.name: _photographs(folder) for folder in folders}
            pairs = zip(views.items(), cameras, strict=True)
            return DetectedTags.together(
                {name: detected_in(images, camera, detector, modules, cfg.workers) for (name, images), camera in pairs}
            )
        images: Images = _photographs(given) if given.is_dir() else Video(given, cfg.rate, "photographs")
    return detected_in(images, cameras[0], detector, modules, cfg.workers)


def _photographs(folder: Path) -> "Photographs":
    """The images of a folder; says which it leaves out."""
    from lmd.detection.images import Photographs

    images = Photographs(folder, "photographs")
    if left := images.unread:
        print(f"warning: photographs: {len(left)} images of {folder} are not read, such as {left[0]}", file=sys.stderr)
    return images


class Job(NamedTuple):
    """Some images, for a process of its own."""

    images: "Images"
    camera: "Camera"
    detector: "Detector"
    modules: int
    first: int
    last: int


def detected_in(
    images: "Images", camera: "Camera", detector: "Detector", modules: int, workers: int | None
) -> "DetectedTags":
    """The tags that a detector finds in images, but for those in frames that are blurred beside the others.

    Args:
        images: all of one camera.
        camera: has the size of the images.
        detector: reads them.
        modules: N of the tags' family.
        workers: processes, None for every processor; the result is the same.

    Raises:
        InputError: an image cannot be read, or none shows a tag.
    """
    import numpy as np

    from lmd.core.checks import InputError
    from lmd.detection.sharpness import blurred
    from lmd.mapping.detections import DetectedTags

    from .progress import bar
    from .workers import in_processes

    count = len(images.names)
    next(images.read(0, 1, camera), None)  # what is wrong with all of them is said before anything is shown
    jobs = [
        Job(images, camera, detector, modules, first, min(first + CHUNK, count)) for first in range(0, count, CHUNK)
    ]
    found: list[Detections] = []
    blurs: list[float] = []
    with bar(count, "images") as progress:
        for part in in_processes(_read, jobs, workers, lambda job: job.images.names[job.first], ordered=True):
            found += [detections for detections, _ in part]
            blurs += [blur for _, blur in part]
            progress.update(len(part))
    if not any(len(one) for one in found):
        raise InputError(f"photographs: no tag is found in any of {count} images; tag.family says which to look for.")
    smeared = np.flatnonzero(blurred(np.array(blurs)))
    return DetectedTags.in_frames(images.names, found).without({images.names[k]: blurs[k] for k in smeared})


def _read(job: Job) -> "list[tuple[Detections, float]]":
    """One job, on one thread: what was detected in each image, and its blur."""
    from lmd.core.optional import optional
    from lmd.detection.sharpness import blur_of

    optional("cv2", "detection").setNumThreads(1)
    found = []
    for image in job.images.read(job.first, job.last, job.camera):
        detections = job.detector.detect(image)
        found.append((detections, blur_of(image, detections, job.modules)))
    return found


def _writers(found: "Survey", room: "Space | None", title: str, is_new: bool) -> dict[str, Callable[[Path], object]]:
    """What writes each file, by its name."""
    from lmd.core.tables import write_table
    from lmd.mapping.detections import write_detections
    from lmd.mapping.tag_map import write_yaml
    from lmd.plot.survey import save_survey_figure
    from lmd.survey.intrinsics import camera_info
    from lmd.survey.report import document, frame_columns, map_columns, measured_of

    writers: dict[str, Callable[[Path], object]] = {
        "map.csv": lambda path: write_table(path, map_columns(found)),
        "frames.csv": lambda path: write_table(path, frame_columns(found)),
        "survey.json": lambda path: write_document(path, document(found)),
        "survey.png": lambda path: save_survey_figure(path, found, room, title),
    }
    if (measured := measured_of(found)) is not None:
        writers["measured.csv"] = lambda path: measured.to_csv(path, ups=True)
    for number, camera in enumerate(found.calibrated, 1):
        file = f"camera_{number}.yaml" if len(found.calibrated) > 1 else "camera.yaml"
        writers[file] = partial(write_yaml, keys=camera_info(camera.found))
    if is_new:
        writers["detections.csv"] = lambda path: write_detections(path, found.detected)
    return writers


def _audit_writers(audit: "Audit", detector: str, title: str) -> dict[str, Callable[[Path], object]]:
    """What writes each file of an audit, by its name."""
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


main = Pipeline("survey", survey, (read_earlier_run,))

if __name__ == "__main__":
    main()
