"""A tracked run: begun with its provenance, ended with its outputs and figures."""

import sys
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from hydra.core.hydra_config import HydraConfig
from omegaconf import DictConfig

from lmd.core.checks import InputError
from lmd.core.words import as_code, escaped, labelled
from lmd.evaluation.validation import Sample, describe_validation, headline_off_grid, validation_metrics
from lmd.evaluation.verdicts import causes
from lmd.objectives.base import labelled_figures
from lmd.optimisers.ledger import Record
from lmd.problem import Problem
from lmd.scene.deployment import Deployment

from .app import choices, flat_settings, run_directory
from .earlier_run import GROUPS
from .nodes import instantiate
from .operations.signals import Stopped, stop
from .operations.sweeps.folder import current_job, reason_of
from .operations.sweeps.names import override_tags, short_name
from .operations.tracking import Dataset, RunStart
from .outputs import write_figures, write_history, write_pictures, write_what_fits
from .overrides import key_and_value
from .progress import doing
from .provenance import command_line, digest, parameters, repeating, source_tags, write_sources

if TYPE_CHECKING:
    from lmd.export.exports import Export

    from .operations.tracking import Tracker

# Settings of `deployment` that decide the problem, beside the number of landmarks.
DECIDED = ("fixed", "measured")
DATASET_DIGITS = 16  # characters of the digest of a problem; mlflow takes 36
FEW_QUALIFIED = 0.1  # share of qualified positions; below it a run prints the criteria that exclude the others


class Earlier(NamedTuple):
    """A run that another run continues."""

    run_id: str | None
    """Its tracked run, if it has one."""
    folder: Path
    """The folder of its files."""


class Extras(NamedTuple):
    """Settings on the outputs of a run beside its landmarks, figures and history."""

    seed: int
    """Seed of the validation sample."""
    validate: bool
    """Score the deployment off its grid."""
    picture: bool
    """Draw the scene and the convergence."""

    @classmethod
    def of(cls, cfg: DictConfig) -> "Extras":
        """The settings of a configuration."""
        return cls(*(cfg[key] for key in cls._fields))


def title_of(problem: Problem, subject: str) -> str:
    """Title of the pictures of a run: its subject and the main settings."""
    return f"{subject} {problem.objective.name} K={problem.count}"


def dataset_of(cfg: DictConfig, problem: Problem) -> Dataset:
    """The problem of a configuration as mlflow's filter of datasets shows it.

    Equal problems have equal digests, whichever options they are composed of. A frozen problem of the suite has its own
    name and digest.
    """
    from lmd.suite import document

    suite = cfg.get("suite")
    if isinstance(suite, str) and (frozen := document(suite)).problem["deployment"].get("count") == problem.count:
        return Dataset(suite, frozen.hash, {"about": frozen.about})
    chosen = {group: choices().get(group, "") for group in (*GROUPS, "body") if group in cfg}
    placed = {key: cfg.deployment[key] for key in DECIDED if cfg.deployment.get(key) is not None}
    settings = flat_settings(cfg, *chosen, *(["cameras", "deployment"] if "cameras" in cfg else []))
    words = {**chosen, "objective": problem.objective.name, "K": str(problem.count)}
    called = " ".join(dict.fromkeys([chosen["room"], chosen["camera"]]))
    name = f"{called} {problem.objective.name} K={problem.count}"
    return Dataset(name, digest(settings, placed, problem.count)[:DATASET_DIGITS], words)


def in_words(problem: Problem, subject: str) -> str:
    """Title that says what was placed, objective, visibility and room in words."""
    scene, of = problem.scene, getattr(problem.scene.visibility, "detector", None)
    visibility = f"visibility {choices().get('visibility', '')}{f' ({of})' if of else ''}"
    return (
        f"{subject}, {problem.count} landmarks: {problem.objective.value_label}; {visibility}; {scene.room.describe()}"
    )


@contextmanager
def tracked(
    cfg: DictConfig, subject: str, about: str = "", earlier: Earlier | None = None, problem: Problem | None = None
) -> "Iterator[Tracker]":
    """A started run of the configured tracker; an exception marks it FAILED, Ctrl-C KILLED, bad input removes it.

    Args:
        cfg: configuration, logged as parameters.
        subject: subject of the run, in a word.
        about: description of the run; by default the title of its problem.
        earlier: the run that it continues. A new run is linked to it if its record differs from this configuration.
        problem: its problem, if it has one.
    """
    tracker: Tracker = instantiate(cfg.tracking)
    job, overrides = current_job(), list(HydraConfig.get().overrides.task)
    varied, given, tags = overrides, list[str](), {f"choice.{group}": option for group, option in choices().items()}
    if job is not None:
        folder, swept = job
        overrides, varied = list(swept.overrides), [f"{key}={value}" for key, value in swept.varied.items()]
        given = [override for override in overrides if key_and_value(override)[0] not in swept.varied]
        tags |= swept.tags(folder.name)
    pipeline = HydraConfig.get().job.name
    tags |= {"pipeline": pipeline} | override_tags(overrides) | source_tags(pipeline)
    about = about or (title_of(problem, subject) if problem else subject)
    dataset = dataset_of(cfg, problem) if problem else None
    told = f"{escaped(about)}\n\n{repeating(tags)}\n\nfiles: {as_code(run_directory())}"
    tags["mlflow.note.content"] = told
    params, run_id = parameters(cfg, choices()), None
    if earlier is not None and earlier.run_id is not None:
        if tracker.goes_on(earlier.run_id, earlier.folder, params):
            run_id = earlier.run_id
        else:
            tags["continues"] = earlier.run_id
    try:
        with stop.raising():
            write_sources(run_directory() / ".hydra")
            started = RunStart(short_name(subject, varied, given), run_directory(), params, tags, dataset=dataset)
            tracker.start(started, run_id)
            yield tracker
    except InputError as error:
        if run_id is None and job is None:
            tracker.discard()
        else:
            tracker.finish("FAILED", reason_of(error))
        raise
    except BaseException as error:
        tracker.finish("KILLED" if isinstance(error, KeyboardInterrupt) else "FAILED", reason_of(error))
        raise


def draw_room(cfg: DictConfig, problem: Problem, tracker: "Tracker") -> None:
    """Write room.png before anything is computed: the room as it was understood, and where people are in the way."""
    room, crowd = problem.scene.room, problem.scene.crowd
    path, people = getattr(getattr(room, "plan", None), "path", None), None if crowd is None else crowd.people
    if not cfg.picture:
        return
    from lmd.plot.plans import save_room_figure

    title = room.describe() if path is None else f"{Path(path).name}: {room.describe()}"
    picture = {"room.png": lambda file: save_room_figure(file, room, title, people)}
    files, failed = write_what_fits(run_directory(), picture)
    tracker.log_artifacts(files)
    print(f"room     {', '.join([*map(str, files), *failed])}", flush=True)


def log_child(
    tracking: DictConfig, run: RunStart, parent: str | None, metrics: Mapping[str, float], landmarks: Path,
    curve: Sequence[tuple[int, float, float]] = (),
) -> None:  # fmt: skip
    """Record a finished run below another one.

    Args:
        tracking: group `tracking`.
        parent: run that it is shown below, if any.
        landmarks: its deployment.
        curve: its best fitness, see `Tracker.log_curve`.
    """
    from .operations.tracking import PARENT_TAG

    tracker: Tracker = instantiate(tracking)
    tracker.start(replace(run, tags={**run.tags, **({} if parent is None else {PARENT_TAG: parent})}))
    if curve:
        tracker.log_curve("best_fitness", curve)
    tracker.log_metrics(metrics)
    tracker.log_artifacts([landmarks])
    tracker.finish("FINISHED")


def keep(tracker: "Tracker", files: Iterable[Path], metrics: Mapping[str, float], status: str = "FINISHED") -> None:
    """Log the final figures, the files and the configuration of a run, and end it."""
    if metrics:
        tracker.log_metrics(metrics)
    tracker.log_artifacts([*files, *sorted(path for path in (run_directory() / ".hydra").glob("*") if path.is_file())])
    tracker.finish(status)


def record(
    extras: Extras, problem: Problem, tracker: "Tracker", deployment: Deployment, history: Sequence[Record], *,
    subject: str, summary: Mapping[str, Any], further: Callable[[], Mapping[str, float]] = dict,
    export: "Export | None" = None, in_haste: bool = False,
) -> dict[str, float]:  # fmt: skip
    """Write the outputs, log them, end the run and print its figures.

    Landmarks, figures and history cannot be computed again: they are written before all else, and they stay.

    Args:
        tracker: tracker with the run started.
        history: best fitness over the run.
        subject: subject of the run, in a word.
        summary: more entries of metrics.json; with `stopped` = "interrupted" the run ends as KILLED.
        further: more entries that take seconds to compute.
        in_haste: leave out outputs that take seconds: validation, pictures, exports and `further` entries.

    Returns:
        the figures, among them `fitness` and, unless validation is left out, `off_grid` (`headline_off_grid`).
    """
    directory, status = run_directory(), "KILLED" if summary.get("stopped") == "interrupted" else "FINISHED"
    with stop.shielded():
        metrics = problem.metrics(deployment)
        document: dict[str, Any] = {**metrics, **summary, "seed": extras.seed}
        files = write_figures(directory, problem, deployment, document)
        curve, failed = write_history(directory, history)
    figures = {key: value for key, value in summary.items() if isinstance(value, int | float)}
    validation, why = {}, None
    if not in_haste:
        with doing("scoring off the grid", Sample.groups) as next_group:
            figures |= further()
            why = causes(problem.scene, deployment, extras.seed)
            if extras.validate:
                validation = validation_metrics(problem, deployment, extras.seed, between=next_group)
    if validation:
        figures["off_grid"] = validation[headline_off_grid(problem)]
    tracker.log_metrics(metrics | figures)
    document |= figures
    groups = {"validation": validation, "criteria": why.metrics() if why else {}}
    document |= {group: found for group, found in groups.items() if found}
    # Standard errors would only clutter the charts.
    charted = {key: value for key, value in validation.items() if not key.endswith("standard_error")}
    tracker.log_metrics({f"validation/{key}": value for key, value in charted.items()})
    pictures: list[Path] = []
    if not in_haste:
        try:
            write_figures(directory, problem, deployment, document)
        except OSError as error:
            failed.append(f"metrics.json has no validation ({error.strerror})")
        title = in_words(problem, subject)
        exports = export.writers(problem.scene.room, problem.scene.tag, deployment) if export else {}
        try:
            with stop.raising():
                pictures, lost = write_pictures(
                    directory, problem, deployment, history, title, picture=extras.picture, exports=exports,
                )  # fmt: skip
            failed += lost
        except Stopped:
            if status != "FINISHED":
                raise
            failed.append("told to stop, it has left out pictures")  # the search itself is complete
    files = sorted({*files, *curve, *pictures})
    keep(tracker, files, {}, status)
    off_grid = describe_validation(problem, validation) if validation else {}
    lines = labelled_figures({key: value for key, value in figures.items() if key != "off_grid"})
    if all(camera.is_pinhole for camera in problem.scene.cameras):
        lines["focus"] = "no criterion: the camera has no aperture"
    lines["files"] = f"{directory}: {', '.join(path.name for path in files)}"
    if directory / "scene.png" in files:
        lines["picture"] = str(directory / "scene.png")
    lines["mlflow"] = tracker.describe()
    fitness, headline, *others = problem.describe(metrics, problem.count).items()
    print(labelled(dict([fitness, headline, *off_grid.items(), *others, *lines.items()])))
    if failed:
        again = command_line("evaluate", [f"run={directory}"])
        print(f"warning: {'; '.join(failed)}; to draw and write again: {again}", file=sys.stderr)
    if why and problem.objective.qualified(problem.values(deployment)).mean() < FEW_QUALIFIED:
        print(f"\n{why.to_text()}")
    return metrics | figures
