"""Studies of `evaluate` that simulate cameras.

In one study a camera is localised during flights, in the other study detectors read rendered images.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from omegaconf import DictConfig, OmegaConf

from .app import choices
from .building import build_problem, refuse_crowd, seeds_of
from .nodes import detectors_of, instantiate, keyed, note, settings_of
from .study import Report, Study, title_of

if TYPE_CHECKING:
    from lmd.evaluation.detected import DetectionStudy, Rendered

Own = Mapping[str, DictConfig]


def observe(cfg: DictConfig, own: Own) -> Study:
    """Study of flights: a flying camera is localised by the landmarks of each deployment.

    The flights are equal for all deployments.
    """
    from lmd.estimation.study import Flights

    seeds = seeds_of(cfg)
    problems = {name: build_problem(_any_tag(each)) for name, each in own.items()}
    for problem in problems.values():
        refuse_crowd(problem, "observe")
    problem = next(iter(problems.values()))
    trajectory, start, odometry = (instantiate(settings_of(cfg, key)) for key in ("trajectory", "start", "odometry"))
    estimators = {name: instantiate(settings_of(cfg, f"estimator.{name}")) for name in cfg.get("estimator") or {}}
    detectors = {name: instantiate(settings_of(each, "sensor")) for name, each in own.items()}
    with keyed("trajectory", seeds="seeds"):
        flights = Flights.draw(problem, trajectory, start, seeds)
    if hasattr(trajectory, "note_of"):  # the trajectory is from a file
        note(trajectory.note_of("trajectory."))

    def run(_: object) -> Report:
        from lmd.estimation import pairs
        from lmd.estimation.study import conduct, to_markdown
        from lmd.plot.pose_errors import save_error_figure

        with keyed(estimators="estimator", family="tag.family"):
            each = partial(in_batches, cfg.workers)
            study = conduct(problems, flights, detectors, estimators, cfg.all_visible, odometry, each)
        figures, curves, n = study.figures(), study.curves(), problem.objective.n
        markdown, paired, medians = to_markdown(figures, n), pairs.paired(figures), study.medians(figures)
        files = {"figures.csv": figures, "curves.csv": curves}
        if len(paired):
            markdown += f"\n{pairs.to_markdown(paired)}"
            files["paired.csv"] = paired
        counts = {name: outcome.counts[0] for name, outcome in study.outcomes.items()}
        title = title_of(problem, f"{len(seeds)} flights: median, band from 10 to 90 %;")
        more = {
            "observe.md": markdown,
            "observe.json": {"medians": medians, "seeds": list(seeds), "settings": problem.settings()},
            "errors.png": lambda path: save_error_figure(path, curves, study.time, counts, n, title),
        }
        made = " ".join(f"{group}={choices()[group]}" for group in ("trajectory", "sensor"))
        return Report(files | more, medians, study.over_time(curves), f"{markdown}\nsimulated with {made}")

    return Study("observe", run, problem=problem)


def _any_tag(cfg: DictConfig) -> DictConfig:
    """Copy of the configuration in which landmarks are points, if the visibility model is for points.

    Points cannot overlap, so tags whose white margins overlap are then accepted. If the model is for tags, the
    configuration is returned unchanged.
    """
    return cfg if "tag" in cfg.visibility else OmegaConf.merge(cfg, {"tag": {"edge": None}})  # type: ignore[return-value]


def in_batches(workers: int | None, function: Callable[[Any], Any], jobs: Sequence[Any]) -> Iterator[Any]:
    """Apply `function` to each job in several processes; yield the results in the order of the jobs.

    `workers` is the number of processes; None for every processor. With `workers` fixed, this is a function of the type
    `lmd.estimation.recording.Each`.
    """
    from lmd.core.workers import in_processes

    from .progress import bar

    results = in_processes(partial(_on_one_thread, function), jobs, workers, lambda _: "a batch", ordered=True)
    with bar(len(jobs), "batches of frames") as progress:
        for result in results:
            progress.update()
            yield result


def _on_one_thread(function: Callable[[Any], Any], job: Any) -> Any:
    """Apply `function` to a job on a single thread, because several jobs run in parallel."""
    from lmd.core.optional import optional

    optional("cv2", "detection").setNumThreads(1)
    return function(job)


def detect(cfg: DictConfig, own: Own) -> Study:
    """Study of detection: real detectors read rendered images of the deployments.

    The images are taken at random poses, which are equal for all deployments.
    """
    from lmd.core.checks import integer
    from lmd.core.optional import optional

    optional("cv2", "detection")
    count, seed = integer("frames", cfg.frames, low=1), cfg.seed
    pictures = min(integer("pictures", cfg.pictures, low=0), count)
    subjects = {name: rendered(each, count) for name, each in own.items()}
    problem = next(iter(subjects.values())).problem

    def run(_: object) -> Report:
        from lmd.detection.predictions import to_markdown
        from lmd.evaluation.detected import DetectionStudy, sightings
        from lmd.plot.detection_figures import save_calibration_figure

        study = DetectionStudy(subjects, sightings(subjects, seed, partial(in_batches, cfg.workers)))
        tables, metrics = study.tables, study.metrics()
        markdown, title = to_markdown(tables["figures"]), title_of(problem, f"{count} poses,")
        files = {
            "detect.md": markdown,
            **{f"{name}.csv": table for name, table in tables.items()},
            "detect.json": {"figures": metrics, "poses": count, "seed": seed, "settings": problem.settings()},
            "calibration.png": lambda path: save_calibration_figure(path, tables["figures"], tables["pitches"], title),
        }
        return Report(files | _frames(study, pictures, seed), metrics, text=markdown)

    return Study("detect", run, problem=problem)


def rendered(cfg: DictConfig, count: int) -> "Rendered":
    """Return the test of detectors on rendered images of the configured deployment, ready to be conducted.

    The returned test has `count` random poses. For each pose, it holds the tags that the visibility model predicts to
    be seen, and can render the image that the detectors read.

    Raises:
        InputError: the deployment, the tag or a detector cannot be used.
    """
    from lmd.core.checks import InputError
    from lmd.evaluation.detected import Rendered

    tag, imaging, problem = instantiate(cfg.tag), instantiate(cfg.imaging), build_problem(_any_tag(cfg))
    with keyed():
        tag.check_edge()
    if not (detectors := detectors_of(cfg)):
        raise InputError("detectors must name at least one detector.")
    with keyed("tag", crowd="visibility.crowd", frames="frames"):
        return Rendered.of(problem, tag, imaging, detectors, count, cfg.seed)


def _frames(study: "DetectionStudy", count: int, seed: int) -> dict[str, Callable[[Path], object]]:
    """Functions that draw rendered images into files, keyed by file name.

    Each function renders one image, and marks the tags that the first detector has found. There is a function for each
    of the first `count` images of each deployment and camera.
    """
    import numpy as np

    from lmd.detection.frames import rendered_frame
    from lmd.plot.detection_figures import save_frame

    files: dict[str, Callable[[Path], object]] = {}
    for name, subject in study.subjects.items():
        found, parts = next(iter(study.seen[name].values())), subject.prediction.parts
        for c, told in enumerate(parts):
            its = np.split(found.corners, len(parts), axis=1)[c]
            for i in range(count):

                def draw(path: Path, told: Any = told, i: int = i, c: int = c, its: Any = its) -> None:
                    among, people = told.renderer, told.people
                    among = among if people is None else replace(among, room=among.room.among(people[i]))
                    image = rendered_frame(among, told.poses[i], c * len(told.poses) + i, seed)
                    save_frame(path, image, told.corners[i], told.visible[i], its[i])

                files[f"frames/{name}_{i}_{c}.png" if len(parts) > 1 else f"frames/{name}_{i}.png"] = draw
    return files
