"""Fit the limits within which a detector finds a tag: `python -m pipelines.calibrate_detector detectors=[aruco]`."""

import sys
from functools import partial
from typing import Any

from omegaconf import DictConfig

from .command import Command
from .nodes import instantiate, keyed
from .sensed import in_batches, rendered
from .study import Report, Study

VIEWS_STREAM = 0x7669657773  # key that separates the random numbers of views from other uses of the seed


def calibrate(cfg: DictConfig) -> Study:
    """Check the settings, and return the study that fits the limits within which each detector finds a tag."""
    from lmd.core.checks import integer, real, seed_number
    from lmd.core.optional import optional
    from lmd.detection.tag_views import SurveyedViews

    optional("cv2", "detection")
    seed, count = seed_number(cfg.seed), integer("frames", cfg.frames, low=0)
    margin, key = real("margin", cfg.margin, low=0.0), "views" if cfg.survey is None else "survey"
    with keyed(key, **({"folder": "survey"} if key == "survey" else {})):
        source = SurveyedViews(str(cfg.survey)) if key == "survey" else instantiate(cfg[key])
    subject = rendered(cfg, max(count, 1))
    if count:
        subject.problem.scene.single_camera("judging a detector in frames")
    told = subject.prediction.parts[0]
    renderer, family = told.renderer, told.renderer.room.tag.family

    def run(_: object) -> Report:
        import numpy as np

        from lmd.detection.calibration import (
            DetectorCalibration,
            fit,
            frame_scores,
            limits_markdown,
            predicted_in_frames,
        )
        from lmd.evaluation.detected import sightings
        from lmd.plot.detection_figures import save_limits_figure

        seen = sightings({"room": subject}, seed, partial(in_batches, cfg.workers))["room"] if count else {}
        found, text = dict[str, DetectorCalibration](), ""
        for name, detector in subject.detectors.items():
            rng = np.random.default_rng([seed, VIEWS_STREAM])  # each detector gets equal views
            with keyed(key):
                views = source.views(subject.problem.scene.cameras, renderer.room.tag, detector, renderer.imaging, rng)
                limits = fit(views, rng, margin)
            if views.seen.all():
                told_all = f"{name} finds all of {len(views)} tags, so give images in which it misses some"
                print(f"warning: {key}: no limit can be fitted, as {told_all}", file=sys.stderr)
            rooms = frame_scores(predicted_in_frames(limits.limits, renderer, told.poses), seen[name]) if count else {}
            found[name] = DetectorCalibration(views, limits, rooms, source.photographs)
            text += limits.circles_text(name)
        about, figures = f"views of {key}, seed {seed}", {name: each.figures() for name, each in found.items()}
        files: dict[str, Any] = {
            **{f"{family}_{name}.yaml": each.preset(name, family, about) for name, each in found.items()},
            "calibration.md": (markdown := limits_markdown(figures)),
            "calibration.json": {"seed": seed, "figures": figures},
            "calibration.png": lambda path: save_limits_figure(path, found, f"{family}, views of {key}"),
        }
        named = {f"{key}/{name}": v for name, row in figures.items() for key, v in row.items() if np.isfinite(v)}
        return Report(files, named, text=text + markdown)

    return Study(f"calibrate_detector {family}", run)


main = Command("calibrate_detector", calibrate)

if __name__ == "__main__":
    main()
