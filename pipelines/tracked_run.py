"""Starting a tracked run, and recording what came out of it."""

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

from hydra.core.hydra_config import HydraConfig
from omegaconf import DictConfig

from lmd.checks import InputError
from lmd.deployment import Deployment
from lmd.optimisers.base import Record
from lmd.problem import Problem
from lmd.validation import validation_metrics
from lmd.verdicts import causes

from .app import choices, flat_settings, instantiate, run_directory
from .outputs import write_outputs
from .sweeps.folder import current_job
from .sweeps.jobs import reason_of
from .sweeps.names import override_tags

if TYPE_CHECKING:
    from .tracking import Tracker

# What the name of a run says anyway.
IN_THE_NAME = ("optimiser", "deployment", "deployment.count", "objective.n", "objective.thold_p", "seed")

LITTLE = 0.1  # share of qualified positions below which a run says what takes the others


def title_of(problem: Problem, subject: str) -> str:
    """A short name for a run: what it is about and the settings that matter most."""
    return f"{subject} {problem.objective.name} K={problem.count}"


@contextmanager
def tracked_run(cfg: DictConfig, problem: Problem, subject: str, run_id: str | None = None) -> "Iterator[Tracker]":
    """`tracked` with the name of a run on a coverage problem.

    Args:
        cfg: logged as parameters.
        problem: named in the run's name.
        subject: what the run is about.
        run_id: continue this run.
    """
    with tracked(cfg, title_of(problem, subject), run_id) as tracker:
        yield tracker


@contextmanager
def tracked(cfg: DictConfig, title: str, run_id: str | None = None) -> "Iterator[Tracker]":
    """A started run of the configured tracker; an exception marks it FAILED, Ctrl-C KILLED, bad input leaves none.

    Args:
        cfg: logged as parameters.
        title: the run's name, to which the seed is added.
        run_id: continue this run.
    """
    tracker: Tracker = instantiate(cfg.tracking)
    name, working_for = f"{title} seed={cfg.seed}", current_job()
    overrides: Sequence[str] = HydraConfig.get().overrides.task
    tags = {f"choice.{group}": option for group, option in choices().items()}
    if working_for is not None:
        folder, job = working_for
        name = " ".join([name, *(f"{key}={value}" for key, value in job.varied.items() if key not in IN_THE_NAME)])
        overrides = job.overrides
        tags |= job.tags(folder.name)
    tags |= {"pipeline": HydraConfig.get().job.name} | override_tags(overrides)
    tracker.start(name, choices() | flat_settings(cfg), tags, run_id)
    try:
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


def record(
    cfg: DictConfig,
    problem: Problem,
    tracker: "Tracker",
    deployment: Deployment,
    history: Sequence[Record],
    *,
    subject: str,
    summary: Mapping[str, Any],
    status: str = "FINISHED",
) -> float:
    """Write the outputs, log them, end the run with `status` and print a report; returns the fitness."""
    directory = run_directory()
    why = causes(problem.scene, deployment, cfg.seed)
    criteria = why.metrics() if why else {}
    summary = {**summary, **({"criteria": criteria} if criteria else {})}
    validation = validation_metrics(problem, deployment, cfg.seed) if cfg.validate else {}
    metrics, files = write_outputs(
        directory,
        problem,
        deployment,
        history,
        title=f"{title_of(problem, subject)}, {choices()['room']}",
        page=cfg.page,
        summary={**summary, "seed": cfg.seed, **({"validation": validation} if validation else {})},
    )
    figures = {key: value for key, value in summary.items() if isinstance(value, int | float)}
    tracker.log_metrics(metrics | figures)
    for group, values in (("validation", validation), ("criteria", criteria)):
        tracker.log_metrics({f"{group}/{key}": value for key, value in values.items()})
    tracker.log_artifacts([*files, *sorted((directory / ".hydra").glob("*.yaml"))])
    tracker.finish(status)
    described = problem.objective.describe_validation(validation) if validation else {}
    lines = described | {key.replace("_", " "): f"{value:g}" for key, value in figures.items()}
    lines["files"] = f"{directory}: {', '.join(path.name for path in files)}"
    lines["picture"] = str(directory / "scene.png")
    lines["mlflow"] = tracker.describe()
    print(report(problem, metrics, lines))
    if why and problem.objective.qualified(problem.values(deployment)).mean() < LITTLE:
        print(f"\n{why.to_text()}")
    return metrics["fitness"]


def report(problem: Problem, metrics: Mapping[str, float], lines: Mapping[str, str]) -> str:
    """The figures of a run as text for the terminal, followed by labelled `lines`."""
    described = problem.objective.describe(metrics, len(problem.relevance), problem.count)
    rows = {**described, **lines}
    return "\n".join(f"{label:<20} {text}" for label, text in rows.items())
