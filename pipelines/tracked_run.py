"""Starting a tracked run, and recording what came out of it."""

import sys
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from hydra.core.hydra_config import HydraConfig
from omegaconf import DictConfig

from lmd.core.checks import InputError
from lmd.evaluation.validation import describe_validation, headline_off_grid, validation_metrics
from lmd.evaluation.verdicts import causes
from lmd.optimisers.ledger import Record
from lmd.problem import Problem
from lmd.scene.deployment import Deployment

from .app import choices, run_directory
from .nodes import instantiate
from .operations.signals import Stopped, stop
from .operations.sweeps.folder import current_job, reason_of
from .operations.sweeps.names import override_tags, short_name
from .operations.tracking import RunStart
from .outputs import write_figures, write_history, write_pictures
from .provenance import command_line, parameters, source_tags

if TYPE_CHECKING:
    from lmd.mapping.formats import Export

    from .operations.tracking import Tracker

FEW_QUALIFIED = 0.1  # share of qualified positions below which a run says what takes the others


@dataclass(frozen=True)
class Earlier:
    """A run that another one goes on with.

    Args:
        run_id: its tracked run, if it has one.
        folder: where its files are.
    """

    run_id: str | None
    folder: Path


def title_of(problem: Problem, subject: str) -> str:
    """What heads the pictures of a run: what it is about and the settings that matter most."""
    return f"{subject} {problem.objective.name} K={problem.count}"


@contextmanager
def tracked(cfg: DictConfig, subject: str, about: str = "", earlier: Earlier | None = None) -> "Iterator[Tracker]":
    """A started run of the configured tracker; an exception marks it FAILED, Ctrl-C KILLED, bad input leaves none.

    Args:
        cfg: logged as parameters.
        subject: what the run is about, in a word.
        about: the same in a sentence.
        earlier: the run it goes on with. If what is recorded there is no longer true, a new one is linked to it.
    """
    tracker: Tracker = instantiate(cfg.tracking)
    working_for, overrides = current_job(), list(HydraConfig.get().overrides.task)
    varied, tags = overrides, {f"choice.{group}": option for group, option in choices().items()}
    if working_for is not None:
        folder, job = working_for
        overrides, varied = list(job.overrides), [f"{key}={value}" for key, value in job.varied.items()]
        tags |= job.tags(folder.name)
    pipeline = HydraConfig.get().job.name
    tags |= {"pipeline": pipeline} | override_tags(overrides) | source_tags(pipeline)
    tags["mlflow.note.content"] = f"{about or subject}\n\n`{tags['command']}`\n\nfiles: {run_directory()}"
    params, run_id = parameters(cfg, choices()), None
    if earlier is not None and earlier.run_id is not None:
        if tracker.goes_on(earlier.run_id, earlier.folder, params):
            run_id = earlier.run_id
        else:
            tags["continues"] = earlier.run_id
    try:
        with stop.raising():
            tracker.start(RunStart(short_name(subject, varied), run_directory(), params, tags), run_id)
            yield tracker
    except InputError as error:
        if run_id is None and working_for is None:
            tracker.discard()
        else:
            tracker.finish("FAILED", reason_of(error))
        raise
    except BaseException as error:
        tracker.finish("KILLED" if isinstance(error, KeyboardInterrupt) else "FAILED", reason_of(error))
        raise


def keep(tracker: "Tracker", files: Iterable[Path], metrics: Mapping[str, float], status: str = "FINISHED") -> None:
    """Log the final figures, the files and the configuration of a run, and end it."""
    if metrics:
        tracker.log_metrics(metrics)
    tracker.log_artifacts([*files, *sorted((run_directory() / ".hydra").glob("*.yaml"))])
    tracker.finish(status)


def record(
    cfg: DictConfig,
    problem: Problem,
    tracker: "Tracker",
    deployment: Deployment,
    history: Sequence[Record],
    *,
    subject: str,
    summary: Mapping[str, Any],
    further: Callable[[], Mapping[str, float]] = dict,
    export: "Export | None" = None,
    status: str = "FINISHED",
    in_haste: bool = False,
) -> dict[str, float]:
    """Write the outputs, log them, end the run with `status` and print a report; returns the figures.

    Among the figures are the `fitness`, and as `off_grid` the one that says how good the deployment is where it was not
    made (`headline_off_grid`), unless validation is left out.

    What cannot be had again comes first: landmarks, figures and history are written before anything else is computed,
    and whatever happens then they stay.

    Args:
        tracker: with the run started.
        history: best fitness over the run.
        subject: what the run is about, in a word.
        summary: more entries of metrics.json.
        further: yet more, that take seconds to compute.
        status: the run ends with.
        in_haste: leave out what takes seconds: validation, pictures, exports and `further` entries.
    """
    directory = run_directory()
    with stop.shielded():
        metrics = problem.metrics(deployment)
        document: dict[str, Any] = {**metrics, **summary, "seed": cfg.seed}
        files = write_figures(directory, problem, deployment, document)
        curve, failed = write_history(directory, history)
    figures = {key: value for key, value in summary.items() if isinstance(value, int | float)}
    validation, why = {}, None
    if not in_haste:
        figures |= further()
        why = causes(problem.scene, deployment, cfg.seed)
        validation = validation_metrics(problem, deployment, cfg.seed) if cfg.validate else {}
    if validation:
        figures["off_grid"] = validation[headline_off_grid(problem)]
    tracker.log_metrics(metrics | figures)
    document |= figures
    groups = {"validation": validation, "criteria": why.metrics() if why else {}}
    document |= {group: found for group, found in groups.items() if found}
    # A standard error says how well a figure is known; as a chart of its own it would only be in the way.
    told = {key: value for key, value in validation.items() if not key.endswith("standard_error")}
    tracker.log_metrics({f"validation/{key}": value for key, value in told.items()})
    pictures: list[Path] = []
    if not in_haste:
        try:
            write_figures(directory, problem, deployment, document)
        except OSError as error:
            failed.append(f"metrics.json has no validation ({error.strerror})")
        title = f"{title_of(problem, subject)}, {problem.scene.room.describe()}"
        exports = export.writers(problem.scene.room, problem.scene.tag, deployment) if export else {}
        try:
            with stop.raising():
                pictures, lost = write_pictures(
                    directory, problem, deployment, history, title, picture=cfg.picture, page=cfg.page, exports=exports
                )
            failed += lost
        except Stopped:
            if status != "FINISHED":
                raise
            failed.append("told to stop, it has left out pictures")  # all that was looked for has been found
    files = sorted({*files, *curve, *pictures})
    keep(tracker, [file for file in files if file.suffix != ".html"], {}, status)
    off_grid = describe_validation(problem, validation) if validation else {}
    lines = {key.replace("_", " "): f"{value:g}" for key, value in figures.items() if key != "off_grid"}
    if all(camera.is_pinhole for camera in problem.scene.cameras):
        lines["focus"] = "no criterion: the camera has no aperture"
    lines["files"] = f"{directory}: {', '.join(path.name for path in files)}"
    if directory / "scene.png" in files:
        lines["picture"] = str(directory / "scene.png")
    lines["mlflow"] = tracker.describe()
    print(report(problem, metrics, off_grid, lines))
    if failed:
        again = command_line("evaluate", [f"run={directory}", f"page={cfg.page}".lower()])
        print(f"warning: {'; '.join(failed)}; to draw and write again: {again}", file=sys.stderr)
    if why and problem.objective.qualified(problem.values(deployment)).mean() < FEW_QUALIFIED:
        print(f"\n{why.to_text()}")
    return metrics | figures


def report(
    problem: Problem, metrics: Mapping[str, float], off_grid: Mapping[str, str], lines: Mapping[str, str]
) -> str:
    """The figures of a run for the terminal, the one on the grid beside those off it, followed by labelled `lines`."""
    (label, headline), *others = problem.objective.describe(metrics, len(problem.relevance), problem.count).items()
    rows = {label: headline, **off_grid, **dict(others), **lines}
    width = max(map(len, rows))
    return "\n".join(f"{label:<{width}} {text}" for label, text in rows.items())
