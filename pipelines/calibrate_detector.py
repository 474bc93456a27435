"""Fit the limits within which a detector finds a tag: `python -m pipelines.calibrate_detector detectors=[aruco]`."""

import sys
from pathlib import Path

from hydra.core.config_store import ConfigStore
from omegaconf import DictConfig

from .app import run_directory
from .detect import read_number_of_poses, sightings, subject_of
from .earlier_run import parts_of, read_earlier_run
from .nodes import instantiate, keyed, settings_of
from .outputs import write_document
from .overrides import quoted
from .pipeline import Pipeline

SURVEY_KEY, OPTION = "survey=", "survey"
VIEWS_STREAM = 0x7669657773  # separates the random numbers of views from other uses of the seed


def calibrate(cfg: DictConfig) -> None:
    """Fit limits to each of the configured detectors."""
    import numpy as np

    from lmd.core.checks import integer, real, seed_number
    from lmd.core.optional import optional
    from lmd.detection.board import BoardImages
    from lmd.detection.calibration import DetectorCalibration, fit, frame_scores, intervals, predicted_in_frames
    from lmd.detection.tag_views import SurveyedViews
    from lmd.plot.detection_figures import save_limits_figure

    from .tracked_run import keep, tracked

    optional("cv2", "detection")
    seed, count = seed_number(cfg.seed), integer("poses", cfg.frames, low=0)
    margin, made_of = real("margin", cfg.margin, low=0.0), source_key(cfg)
    with keyed(made_of, **({"folder": "survey"} if made_of == "survey" else {})):
        source = SurveyedViews(str(cfg.survey)) if made_of == "survey" else instantiate(cfg[made_of])
    subject = subject_of(cfg, max(count, 1), seed)
    if count:
        subject.problem.scene.single_camera("judging a detector in frames")
    told, directory, written = subject.prediction.parts[0], run_directory(), []
    renderer, tag = told.renderer, told.renderer.room.tag
    with tracked(cfg, f"calibrate_detector {tag.family}") as tracker:
        fitted, spans = {}, {}
        for name, detector in subject.detectors.items():
            rng = np.random.default_rng([seed, VIEWS_STREAM])  # equal views for every detector
            with keyed(made_of):
                views = source.views(subject.problem.scene.cameras, tag, detector, renderer.imaging, rng)
                fitted[name] = views, fit(views, rng, margin)
            spans[name] = intervals(views, rng, margin) if source.photographs else {}
            if views.seen.all():
                text = f"warning: {made_of}: {name} finds all of {len(views)} tags, so they tell no limit of it"
                print(f"{text}; images are needed in which it misses some", file=sys.stderr)
        seen = sightings({"room": subject}, seed, cfg.workers)["room"] if count else {}
        calibrations: dict[str, DetectorCalibration] = {}
        if isinstance(source, BoardImages) and (copies := source.images.repeated):
            copy, first = next(iter(copies.items()))
            print(f"note: {len(copies)} images are copies and not counted, such as {copy} of {first}", file=sys.stderr)
        for name, (views, limits) in fitted.items():
            predicted = predicted_in_frames(limits.limits, renderer, told.poses)
            rooms = frame_scores(predicted, seen[name]) if count else {}
            calibrations[name] = DetectorCalibration(views, limits, rooms, source.photographs, spans[name])
        for name, calibration in calibrations.items():
            written.append(directory / f"{tag.family}_{name}.yaml")
            written[-1].write_text(calibration.preset(name, tag.family, f"views of {made_of}, seed {seed}"))
        figures = {name: calibration.figures() for name, calibration in calibrations.items()}
        markdown = limits_markdown(figures)
        (directory / "calibration.md").write_text(markdown)
        write_document(directory / "calibration.json", {"seed": seed, "figures": figures})
        save_limits_figure(directory / "calibration.png", calibrations, f"{tag.family}, views of {made_of}")
        written += [directory / f"calibration.{kind}" for kind in ("md", "json", "png")]
        named = {f"{key}/{name}": value for name, row in figures.items() for key, value in row.items()}
        keep(tracker, written, {key: value for key, value in named.items() if np.isfinite(value)})
    for name, (_, limits) in fitted.items():
        for number, diameter in limits.known_circles.items():
            print(f"{name} finds nothing beyond camera.image_circle={diameter:.0f}, pixels, of camera {number}")
    print(f"{markdown}\nfiles: {directory}\nmlflow: {tracker.describe()}")


def source_key(cfg: DictConfig) -> str:
    """Key of the views that are read: a survey, photographs of a board, or else rendered mosaics."""
    if cfg.survey is not None:
        return "survey"
    board = settings_of(cfg, "board")
    return "views" if board.get("folder") is None and board.get("tags") is None else "board"


def limits_markdown(figures: dict[str, dict[str, float]]) -> str:
    """Table of the limits of each detector, with the accuracy of the limits on held-out views."""
    from lmd.core.words import escaped, markdown_table

    head = ["detector", "views", "a", "k", "m [px]", "b [degrees]", "margin [px]"]
    head += ["held-out accuracy / precision / recall"]
    head += [f"rooms: P(>= {n}) predicted / detected" for n in range(1, 5)]
    head += ["rooms: precision / recall", "rooms: frames agree on >= 2"]
    rows = []
    for name, row in figures.items():
        cells = [escaped(name), f"{row['views']:.0f}", *(f"{row[key]:.2g}" for key in ("pitch", "blur"))]
        cells += [f"{row['edge']:.3g}", f"{row['incidence']:.0f}", f"{row['margin']:.3g}"]
        cells += [f"{row['accuracy']:.3f} / {row['precision']:.3f} / {row['recall']:.3f}"]
        if "room_frames" in row:
            cells += [f"{row[f'room_predicted_{n}']:.3f} / {row[f'room_detected_{n}']:.3f}" for n in range(1, 5)]
            cells += [f"{row['room_precision']:.3f} / {row['room_recall']:.3f}", f"{row['room_agreement_2']:.1%}"]
        else:
            cells += ["–"] * 6
        rows.append(cells)
    return markdown_table(head, rows) + "\n"


def read_survey() -> None:
    """Read `survey=DIR` on the command line as the views of that survey, with its run, cameras, tags and detector."""
    given = [argument.removeprefix(SURVEY_KEY) for argument in sys.argv[1:] if argument.startswith(SURVEY_KEY)]
    if not given or given[-1] == "null":
        return
    before, parts = parts_of(Path(given[-1]), "survey", ("camera", "tag"))
    for group, part in parts.items():
        ConfigStore.instance().store(OPTION, part, group)
    chosen = {
        "frames": "0",
        "margin": "0",
        **dict.fromkeys(parts, OPTION),
    }
    chosen["detectors"] = f"[{','.join(before.get('detectors') or {})}]"
    if before.get("run"):
        chosen["run"] = quoted(Path(before["run"]))
    named = {argument.partition("=")[0] for argument in sys.argv[1:]}
    sys.argv[1:] += [f"{key}={value}" for key, value in chosen.items() if key not in named]


main = Pipeline("calibrate_detector", calibrate, (read_number_of_poses, read_survey, read_earlier_run))

if __name__ == "__main__":
    main()
