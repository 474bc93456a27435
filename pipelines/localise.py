"""Localise photographs in a map: `python -m pipelines.localise map=FILE photographs=DIR camera.path=FILE`."""

from pathlib import Path
from typing import TYPE_CHECKING, Any

from omegaconf import DictConfig

from .app import doing
from .building import camera_of
from .command import Command
from .composing import RIG
from .landmarks import table_in
from .nodes import instantiate, keyed, note, settings_of
from .photographs import detected, odometry_of, reader_of, with_camera_of_bag
from .study import LANDMARKS, Report, Study
from .survey import camera_files

if TYPE_CHECKING:
    from lmd.geometry.camera import Camera
    from lmd.localise.fixed_map import FixedMap
    from lmd.scene.rig import Rig
    from lmd.scene.tag import Tag


def localise(cfg: DictConfig) -> Study:
    """Localise the configured photographs or detections; return a study that reports on the result."""
    from lmd.adjust.motion import seconds_of
    from lmd.adjust.tables import files_of_model
    from lmd.core.checks import InputError, boolean, seed_number
    from lmd.formats.detection_formats import write_detections
    from lmd.formats.pose_files import tum_text
    from lmd.formats.reconstructions import read_model
    from lmd.localise import results
    from lmd.localise.alignment import align
    from lmd.localise.localise import Drive
    from lmd.localise.localise import localise as find
    from lmd.plot.plans import save_localised_figure
    from lmd.scene.rig import Rig

    seed_number(cfg.seed)
    tag, given = instantiate(cfg.tag), _cameras(cfg)
    _, detector = reader_of(cfg)
    known, room = _map(cfg, tag), instantiate(cfg.room) if cfg.get("room") else None
    settings = settings_of(cfg, "localise")
    odometry = odometry_of(settings.odometry, "localise.odometry")
    with keyed("localise"):
        steady = None if settings.motion == "auto" else boolean("motion", settings.motion)
        calibrate = boolean("calibrate", settings.calibrate)
    if steady and odometry is not None:
        raise InputError("localise.motion = true and localise.odometry exclude each other: leave one of them out.")
    model = None if cfg.align is None else read_model(cfg.align)
    seen = detected(cfg, given.cameras, detector, tag)
    source = "photographs" if cfg.detections is None else "detections"
    drive = Drive(given.mounted if isinstance(given, Rig) else None, odometry, steady)
    with keyed("localise", detections=source, cameras="camera", map="map"), doing("localising"):
        found = find(seen, given.cameras, tag, detector.corner_errors, known, drive, calibrate)
    about = f"localisation of {found.found.poses.known_frames.sum()} of {len(seen.times)} frames"
    files: dict[str, Any] = {
        "changes.csv": results.change_columns(found),
        "localise.json": results.localise_document(found),
    }
    for name, estimate in (("poses", found.found), ("smoothed", found.smoothed)):
        if estimate is not None:
            files[f"{name}.csv"] = results.frame_columns(found, estimate)
            files[f"{name}.tum"] = tum_text(seconds_of(seen.times), estimate.poses.frames)
    if cfg.picture:
        title = f"{about} in {cfg.map or 'the map'}"
        files["localise.png"] = lambda path: save_localised_figure(path, found, room, title)
    if cfg.detections is None:
        files["detections.csv"] = lambda path: write_detections(path, seen)
    written, unable = files_of_model(found.smoothed or found.found, found.detected, given.cameras)
    note(unable)
    aligned, more, told = ({}, {}, "") if model is None else align(model, found)
    text = f"{results.to_text(found)}\n{told}".rstrip()
    report = Report({**files, **written, **aligned}, results.metrics(found) | more, text=text)
    return Study("localisation", lambda _: report, about)


def _cameras(cfg: DictConfig) -> "Camera | Rig":
    """Cameras of the configuration, or of a survey.

    If the configuration gives no camera and the map is the folder of a survey, the cameras of this survey are used.
    """
    from lmd.formats.calibrations import calibrated_camera
    from lmd.formats.rigs import read_mounts, rig_of

    cfg = with_camera_of_bag(cfg)
    folder = Path(str(cfg.map))
    if cfg.map is not None and cfg.camera.get("path", "") is None and cfg.camera.get("rig") is None:
        with keyed("localise"):
            if (folder / RIG).is_file():
                return rig_of(read_mounts(folder / RIG))
            if (one := folder / camera_files(1)[0]).is_file():
                return calibrated_camera(str(one))
    return camera_of(cfg.camera)


def _map(cfg: DictConfig, tag: "Tag") -> "FixedMap":
    """Read the map of the tags from `map` or `deployment.path`.

    Raises:
        InputError: no map or two maps are given, or the file is not a valid map.
    """
    from lmd.adjust.prior import Hanging
    from lmd.core.checks import InputError
    from lmd.localise.fixed_map import FixedMap

    node, settings = settings_of(cfg, "deployment"), settings_of(cfg, "localise")
    if "path" not in node:
        raise InputError("deployment must be a file (deployment.path=tags.csv) or come from a run (run=DIR).")
    if cfg.map is None and node.path is None:
        raise InputError("a tag map (map=FILE) or a run (run=DIR) must be given.")
    if cfg.map is not None and node.path is not None and cfg.run is None:
        raise InputError("map and deployment.path both name a map: leave one of the two out.")
    key, path = ("deployment.path", node.path) if cfg.map is None else ("map", cfg.map)
    if (folder := Path(str(path))).is_dir():
        path = str(folder / ("map.csv" if (folder / "map.csv").exists() else LANDMARKS))
    names = {"axes": "deployment.axes", "columns": "deployment.columns", "edge": "tag.edge", "family": "tag.family"}
    with keyed("localise", map=key, **names):
        errors = Hanging(*2 * (settings.place, settings.turn))
        found = FixedMap.read(path, tag, errors, **table_in(node))
    note(found.note)
    return found


main = Command("localise", localise)

if __name__ == "__main__":
    main()
