"""Score a deployment: `python -m pipelines.evaluate deployment=uniform|random|greedy|file [overrides]`."""

import re
import sys
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from omegaconf import DictConfig

from .app import choices, run_directory
from .building import build_problem
from .earlier_run import read_earlier_run
from .landmarks import table_in
from .nodes import instantiate, keyed, note, settings_of
from .pipeline import Pipeline

if TYPE_CHECKING:
    from lmd.evaluation import Study
    from lmd.evaluation.losses import Losses
    from lmd.evaluation.mounting import MountingError
    from lmd.problem import Problem
    from lmd.scene.deployment import Deployment

    from .operations.tracking import Tracker

MEASURED, MOUNTING = "deployment.measured", "deployment.mounting_error"


def read_mounting_error() -> None:
    """Read a mounting error on the command line that is a number as the error of position."""
    sys.argv[1:] = [re.sub(rf"^{MOUNTING}=(?!\{{)", f"{MOUNTING}.position=", argument) for argument in sys.argv[1:]]


def evaluate(cfg: DictConfig) -> float:
    """Score the configured deployment."""
    import numpy as np

    from lmd.core.checks import seed_number
    from lmd.core.compiled import clock
    from lmd.optimisers.ledger import Record

    from .progress import doing
    from .tracked_run import Extras, draw_room, record, title_of, tracked

    began = clock()
    problem = build_problem(cfg)
    seed = seed_number(cfg.seed)
    with doing("placing the landmarks"):
        deployment = plan = problem.draw(np.random.default_rng(seed))
    with keyed("deployment", path=MEASURED, family="tag.family"):
        if cfg.deployment.measured is not None:
            from lmd.evaluation.measured import read_measured  # slow to load

            deployment = read_measured(cfg.deployment.measured, problem, plan, **table_in(cfg.deployment))
            note(deployment.note)
        error: MountingError = instantiate(settings_of(cfg, MOUNTING))
    history = [Record(1, problem.metrics(deployment)["fitness"], clock() - began)]
    subject = choices()["deployment"]
    with tracked(cfg, subject, problem=problem) as tracker:
        draw_room(cfg, problem, tracker)
        drawn, asked = bool(cfg.picture), [name for name in ("losses", "sensitivity") if cfg[name]]
        texts = []
        with doing("studying the deployment"):
            summary: dict[str, Any] = localise(problem, deployment, seed, tracker, drawn) if cfg.localisation else {}
            for name, study, draw, about in studies(asked, problem, plan, deployment, error, seed):
                tracker.log_artifacts(
                    write_study(run_directory(), name, study, draw if drawn else None, title_of(problem, about))
                )
                figures = study.metrics()
                if name == "losses":  # figures of the deployment, like its fitness
                    summary |= figures
                else:
                    summary[name] = figures
                    tracker.log_metrics({f"{name}/{key}": value for key, value in figures.items()})
                texts.append(f"\n{study.to_text()}\n")
        figures = record(Extras.of(cfg), problem, tracker, deployment, history, subject=subject, summary=summary)
        print("".join(texts), end="")
        return figures["fitness"]


def localise(
    problem: "Problem", deployment: "Deployment", seed: int, tracker: "Tracker", drawn: bool
) -> dict[str, float]:
    """Write and log maps of the accuracy of one frame, and return the figures.

    Args:
        drawn: True to draw the map of the bounds, too.
    """
    from lmd.estimation.cramer_rao import cramer_rao_map
    from lmd.evaluation.accuracy import accuracy_metrics, save_accuracy_map
    from lmd.plot.pose_errors import save_cramer_rao_map

    from .tracked_run import title_of

    bounds = cramer_rao_map(problem.scene, problem.evaluator, deployment)
    table, accuracy, picture = (run_directory() / f for f in ("localisation.csv", "accuracy.csv", "localisation.png"))
    bounds.to_csv(table)
    save_accuracy_map(accuracy, problem, deployment)
    if drawn:
        save_cramer_rao_map(picture, problem.scene.room, bounds, title_of(problem, "Cramer-Rao bound of one frame,"))
    tracker.log_artifacts([table, accuracy, *([picture] if drawn else [])])
    return bounds.metrics() | accuracy_metrics(problem, deployment, seed)


def studies(
    asked: Sequence[str],
    problem: "Problem",
    plan: "Deployment",
    deployment: "Deployment",
    error: "MountingError",
    seed: int,
) -> "Iterator[tuple[str, Study, Callable[..., None] | None, str]]":
    """Conduct studies of a deployment, one after the other.

    Args:
        asked: `losses` or `sensitivity`, or both; the other studies depend on `plan` and `error`.
        plan: planned places of the tags.
        deployment: measured places of the tags; `plan` if nothing was measured.
        error: error of mounting the tags.

    Yields:
        name of a study, the study, the function that draws it (None for none), and the subject of its picture.
    """
    if "losses" in asked and (lost := lose(problem, deployment)):
        yield "losses", lost, None, ""
    if "sensitivity" in asked:
        from lmd.evaluation.sensitivity import sensitivity
        from lmd.plot.charts import save_sensitivity_figure

        varied = sensitivity(problem, deployment, seed)
        yield "sensitivity", varied, partial(save_sensitivity_figure, found=varied), "sensitivity,"
    if deployment is not plan:
        from lmd.evaluation.measured import as_measured
        from lmd.plot.pose_errors import save_map_figure

        surveyed = as_measured(problem, plan, deployment, seed)
        draw = partial(save_map_figure, views=surveyed.views)
        yield "survey", surveyed, draw, "maps as planned and as measured,"
    if not error.is_none:
        from lmd.evaluation.mounting import mounted
        from lmd.plot.pose_errors import save_map_figure

        with keyed(MOUNTING):
            hung = mounted(problem, deployment, error, seed)
        yield "mounting", hung, partial(save_map_figure, views=hung.views), f"{error.draws} mountings,"


def lose(problem: "Problem", deployment: "Deployment") -> "Losses | None":
    """Losses of fitness without each landmark; None, with a line in the terminal, if losses are not defined."""
    from lmd.core.checks import InputError
    from lmd.evaluation.losses import losses

    try:
        return losses(problem, deployment)
    except InputError as error:
        print(f"no losses: {error}")
        return None


def write_study(
    directory: Path, name: str, study: "Study", draw: "Callable[..., None] | None", title: str
) -> list[Path]:
    """Write the tables and the picture of a study, and return the files."""
    from lmd.core.tables import write_table

    files = []
    for stem, table in study.tables.items():
        files.append(directory / f"{stem}.csv")
        write_table(files[-1], {str(column): values for column, values in table.items()})
    if draw is not None:
        files.append(directory / f"{name}.png")
        draw(files[-1], title=title)
    return files


main = Pipeline("evaluate", evaluate, (read_mounting_error, read_earlier_run))

if __name__ == "__main__":
    main()
