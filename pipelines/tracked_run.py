"""A tracked run: begun with its provenance, and ended however the run ends."""

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from hydra.core.hydra_config import HydraConfig
from omegaconf import DictConfig

from lmd.core.checks import InputError
from lmd.core.words import as_code, escaped

from .app import choices, flat_settings, run_directory
from .composing import GROUPS
from .nodes import instantiate
from .operations.signals import stop
from .operations.sweeps.folder import current_job, reason_of
from .operations.sweeps.names import override_tags, short_name
from .operations.tracking import PARENT_TAG, Dataset, RunStart
from .overrides import key_and_value
from .provenance import command_line, digest, parameters, repeating, source_tags, write_sources

if TYPE_CHECKING:
    from lmd.problem import Problem

    from .operations.tracking import Tracker
    from .study import Curve, Study

# Settings of `deployment` that decide the problem, beside the number of landmarks.
DECIDED = ("fixed", "measured")
DATASET_DIGITS = 16  # characters of the digest of a problem; mlflow takes 36


def title_of(problem: "Problem", subject: str) -> str:
    """Title of the pictures of a run: its subject and the main settings."""
    return f"{subject} {problem.objective.name} K={problem.count}"


def dataset_of(cfg: DictConfig, problem: "Problem") -> Dataset:
    """The problem of a configuration as mlflow's filter of datasets shows it.

    Equal problems have equal digests, whichever options they are composed of. A frozen problem of the suite has its own
    name and digest.
    """
    if isinstance(suite := cfg.get("suite"), str):
        from lmd.suite import document

        if (frozen := document(suite)).problem["deployment"].get("count") == problem.count:
            return Dataset(suite, frozen.hash, {"about": frozen.about})
    chosen = {group: choices().get(group, "") for group in GROUPS if group in cfg}
    placed = {key: cfg.deployment[key] for key in DECIDED if cfg.deployment.get(key) is not None}
    settings = flat_settings(cfg, *chosen, *(["cameras", "body", "deployment"] if "cameras" in cfg else []))
    words = {**chosen, "objective": problem.objective.name, "K": str(problem.count)}
    called = " ".join(dict.fromkeys([chosen["room"], chosen["camera"]]))
    name = f"{called} {problem.objective.name} K={problem.count}"
    return Dataset(name, digest(settings, placed, problem.count)[:DATASET_DIGITS], words)


def derived(problem: "Problem") -> dict[str, Any]:
    """Parameters of a run that its configuration leaves to be found: the counts of landmarks."""
    counts = problem.scene.tag.counts
    return {"deployment.count": problem.count, **({} if counts is None else {"tag.counts": list(counts)})}


@contextmanager
def tracked(cfg: DictConfig, study: "Study") -> "Iterator[Tracker]":
    """A started run of the configured tracker; an exception marks it FAILED, Ctrl-C KILLED, bad input removes it.

    Args:
        cfg: configuration, logged as parameters.
        study: study of the run. A new run is linked to the one that it continues if their records differ.
    """
    tracker: Tracker = instantiate(cfg.tracking)
    subject, problem, earlier = study.subject, study.problem, study.earlier
    job, overrides = current_job(), list(HydraConfig.get().overrides.task)
    varied, given, tags = overrides, list[str](), {f"choice.{group}": option for group, option in choices().items()}
    if job is not None:
        folder, swept = job
        overrides, varied = list(swept.overrides), [f"{key}={value}" for key, value in swept.varied.items()]
        given = [override for override in overrides if key_and_value(override)[0] not in swept.varied]
        tags |= swept.tags(folder.name)
    pipeline = HydraConfig.get().job.name
    tags |= {"pipeline": pipeline} | override_tags(overrides) | source_tags(pipeline)
    dataset = dataset_of(cfg, problem) if problem else None
    about = study.about or (title_of(problem, subject) if problem else subject)
    tags["mlflow.note.content"] = f"{escaped(about)}\n\n{repeating(tags)}\n\nfiles: {as_code(run_directory())}"
    params, run_id = parameters(cfg, choices()) | (derived(problem) if problem else {}), None
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


def log_child(
    tracking: DictConfig, run: RunStart, parent: str | None, metrics: Mapping[str, float], landmarks: Path,
    curve: "Curve" = (),
) -> None:  # fmt: skip
    """Record a finished run below another one.

    Args:
        tracking: group `tracking`.
        run: the run.
        parent: run that it is shown below, if any.
        metrics: its figures.
        landmarks: its deployment.
        curve: its best fitness, see `Tracker.log_curve`.
    """
    tracker: Tracker = instantiate(tracking)
    tracker.start(replace(run, tags={**run.tags, **({} if parent is None else {PARENT_TAG: parent})}))
    tracker.log_curve("best_fitness", curve)
    tracker.log_metrics(metrics)
    tracker.log_artifacts([landmarks])
    tracker.finish("FINISHED")


def again(directory: Path) -> str:
    """Hint on computing the files again that a run has left out; empty without landmarks."""
    has_landmarks = (directory / "landmarks.csv").is_file()
    return f"; to draw and write again: {command_line('evaluate', [f'run={directory}'])}" if has_landmarks else ""
