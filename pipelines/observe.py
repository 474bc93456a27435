"""Localise a flying camera: `python -m pipelines.observe deployment=greedy,uniform,random [overrides]`.

All deployments are compared over equal flights in one run, so `deployment=a,b,c` is no sweep: it is read as
`deployments=[a,b,c]`.
"""

from collections.abc import Callable, Iterator, Sequence
from functools import partial
from typing import TYPE_CHECKING, Any

from omegaconf import DictConfig

from .app import choices, run_directory
from .building import build_problem, seeds_of
from .crowd import refuse_crowd
from .deployments import any_deployment, composed_deployments, read_deployment_as_a_list
from .nodes import instantiate, keyed, note, settings_of
from .outputs import write_document
from .pipeline import Pipeline

if TYPE_CHECKING:
    import pandas as pd

    from .operations.tracking import Tracker


def observe(cfg: DictConfig) -> None:
    """Localise a camera over the configured deployments."""
    from lmd.estimation import pairs
    from lmd.estimation.study import Flights, conduct, to_markdown
    from lmd.plot.pose_errors import save_error_figure

    from .tracked_run import keep, title_of, tracked

    seeds = seeds_of(cfg)
    composed = composed_deployments(cfg, "observe")
    problems = {name: build_problem(any_deployment(own)) for name, own in composed.items()}
    for problem in problems.values():
        refuse_crowd(problem, "observe")
    problem = next(iter(problems.values()))
    trajectory, start, odometry = (instantiate(settings_of(cfg, key)) for key in ("trajectory", "start", "odometry"))
    estimators = {name: instantiate(settings_of(cfg, f"estimator.{name}")) for name in cfg.get("estimator") or {}}
    detectors = {name: instantiate(settings_of(own, "sensor")) for name, own in composed.items()}
    with keyed("trajectory", seeds="seeds"):
        flights = Flights.draw(problem, trajectory, start, seeds)
    if hasattr(trajectory, "note_of"):  # the trajectory is from a file
        note(trajectory.note_of("trajectory."))
    directory, n = run_directory(), problem.objective.n
    with tracked(cfg, "observe", problem=problem) as tracker:
        with keyed(estimators="estimator", family="tag.family"):
            each = partial(_each, cfg.workers)
            study = conduct(problems, flights, detectors, estimators, cfg.all_visible, odometry, each)
        figures, curves = study.figures(), study.curves()
        markdown, paired = to_markdown(figures, n), pairs.paired(figures)
        if len(paired):
            markdown += f"\n{pairs.to_markdown(paired)}"
            paired.to_csv(directory / "paired.csv", index=False)
        figures.to_csv(directory / "figures.csv", index=False)
        curves.to_csv(directory / "curves.csv", index=False)
        (directory / "observe.md").write_text(markdown)
        medians = _medians(figures)
        document = {"medians": medians, "seeds": list(seeds), "settings": problem.settings()}
        write_document(directory / "observe.json", document)
        counts = {name: outcome.counts[0] for name, outcome in study.outcomes.items()}
        title = title_of(problem, f"{len(seeds)} flights: median, band from 10 to 90 %;")
        save_error_figure(directory / "errors.png", curves, study.time, counts, n, title)
        _log_curves(tracker, curves)
        names = ["figures.csv", "curves.csv", "observe.md", "observe.json", "errors.png"]
        names += ["paired.csv"] if len(paired) else []
        keep(tracker, [directory / name for name in names], medians)
    made = " ".join(f"{group}={choices()[group]}" for group in ("trajectory", "sensor"))
    print(f"{markdown}\nflown with {made}\nfiles: {directory}\nmlflow: {tracker.describe()}")


def _each(workers: int | None, function: Callable[[Any], Any], jobs: Sequence[Any]) -> Iterator[Any]:
    """Results of a function for each job, in processes of their own; see `lmd.estimation.recording.Each`."""
    from .progress import bar
    from .workers import in_processes

    results = in_processes(
        partial(_on_one_thread, function), jobs, workers, lambda _: "a batch of frames", ordered=True
    )
    with bar(len(jobs), "batches of frames") as progress:
        for result in results:
            progress.update()
            yield result


def _on_one_thread(function: Callable[[Any], Any], job: Any) -> Any:
    """Do one job on one thread."""
    from lmd.core.optional import optional

    optional("cv2", "detection").setNumThreads(1)
    return function(job)


def _medians(figures: "pd.DataFrame") -> dict[str, float]:
    """Finite medians over the seeds by `<figure>/<deployment>/<estimator>`."""
    import math

    medians = {}
    for (name, estimator), runs in figures.groupby(["deployment", "estimator"], sort=False):
        for key, value in runs.drop(columns="seed").median(numeric_only=True).items():
            if math.isfinite(value):
                medians[f"{key}/{name}/{estimator}"] = float(value)
    return medians


def _log_curves(tracker: "Tracker", curves: "pd.DataFrame") -> None:
    """Log the median errors over time; mlflow's steps are milliseconds."""
    for (name, estimator), curve in curves.groupby(["deployment", "estimator"], sort=False):
        for quantity in ("error", "position", "attitude"):
            values = curve[["time", f"{quantity}_median"]].dropna().to_numpy()
            points = [(round(1000 * time), float(value), float(time)) for time, value in values]
            tracker.log_curve(f"{quantity}_over_time/{name}/{estimator}", points)


main = Pipeline("observe", observe, (read_deployment_as_a_list,))

if __name__ == "__main__":
    main()
