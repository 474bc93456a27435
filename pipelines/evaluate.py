"""Score a deployment: `python -m pipelines.evaluate deployment=uniform|random|greedy|file [overrides]`."""

import re
import sys
from typing import TYPE_CHECKING, Any

from omegaconf import DictConfig

from .app import application, choices, run_directory
from .building import build_problem, instantiate, keyed, settings_of
from .earlier_run import read_earlier_run
from .operations.sweeps.supervisor import run

if TYPE_CHECKING:
    from lmd.evaluation.losses import Losses
    from lmd.evaluation.mounting import Mounted, MountingError
    from lmd.evaluation.sensitivity import Sensitivity
    from lmd.evaluation.survey import Survey
    from lmd.problem import Problem
    from lmd.scene.deployment import Deployment

    from .operations.tracking import Tracker

MEASURED, MOUNTING = "deployment.measured", "deployment.mounting_error"


def main() -> None:
    """Read `run=DIR` and a mounting error that is one number, then hand over to Hydra."""
    read_mounting_error()
    read_earlier_run()
    _main()


def read_mounting_error() -> None:
    """Take a mounting error of the command line that is no mapping as its position."""
    sys.argv[1:] = [re.sub(rf"^{MOUNTING}=(?!\{{)", f"{MOUNTING}.position=", argument) for argument in sys.argv[1:]]


@application("evaluate")
def _main(cfg: DictConfig) -> float | None:
    """Score, record and show; returns the fitness."""
    return run(cfg, evaluate)


def evaluate(cfg: DictConfig) -> float:
    """Score the configured deployment."""
    import numpy as np

    from lmd.core.checks import seed_number
    from lmd.core.compiled import clock
    from lmd.optimisers.base import Record
    from lmd.scene.rig import Rig

    from .tracked_run import record, title_of, tracked

    began = clock()
    problem = build_problem(cfg)
    seed = seed_number(cfg.seed)
    deployment = plan = problem.draw(np.random.default_rng(seed))
    with keyed("deployment", path=MEASURED):
        if cfg.deployment.measured is not None:
            from lmd.evaluation.survey import read_measured  # slow to load

            deployment = read_measured(cfg.deployment.measured, problem, plan)
        error: MountingError = instantiate(settings_of(cfg, MOUNTING))
    asked = {"sensitivity": cfg.sensitivity, MEASURED: deployment is not plan, MOUNTING: not error.is_none}
    for key, is_asked in asked.items():
        if is_asked:
            problem.scene.single_camera(key)
    history = [Record(1, problem.metrics(deployment)["fitness"], clock() - began)]
    subject = choices()["deployment"]
    with tracked(cfg, subject, title_of(problem, subject)) as tracker:
        alone = not isinstance(problem.scene.camera, Rig)
        summary: dict[str, Any] = localise(problem, deployment, seed, tracker) if cfg.localisation and alone else {}
        if cfg.localisation and not alone:
            print("localisation: left out, a single frame of a rig of several cameras is not bounded yet")
        fallen = lose(problem, deployment, tracker) if cfg.losses else None
        summary |= fallen.metrics() if fallen else {}
        studies: dict[str, Sensitivity | Survey | Mounted | None] = {
            "sensitivity": vary(problem, deployment, seed, tracker) if cfg.sensitivity else None,
            "survey": compare_measured(problem, plan, deployment, seed, tracker) if deployment is not plan else None,
            "mounting": mount(problem, deployment, error, seed, tracker) if not error.is_none else None,
        }
        found = {name: study for name, study in studies.items() if study is not None}
        for name, study in found.items():
            summary[name] = figures = study.metrics()
            tracker.log_metrics({f"{name}/{key}": value for key, value in figures.items()})
        fitness = record(cfg, problem, tracker, deployment, history, subject=subject, summary=summary)
        texts = [study.to_text() for study in (fallen, *found.values()) if study is not None]
        print("".join(f"\n{text}\n" for text in texts), end="")
        return fitness


def localise(problem: "Problem", deployment: "Deployment", seed: int, tracker: "Tracker") -> dict[str, float]:
    """Write and log the maps of how well a single frame is localised; returns the figures."""
    from lmd.estimation.cramer_rao import cramer_rao_map
    from lmd.evaluation.accuracy import accuracy_metrics, save_accuracy_map
    from lmd.plot.localisation import save_cramer_rao_map

    from .tracked_run import title_of

    bounds = cramer_rao_map(problem.scene, problem.evaluator, deployment)
    table, picture = (run_directory() / f"localisation.{kind}" for kind in ("csv", "png"))
    bounds.to_csv(table)
    save_cramer_rao_map(picture, problem.scene.room, bounds, title_of(problem, "Cramer-Rao bound of one frame,"))
    accuracy = run_directory() / "accuracy.csv"
    save_accuracy_map(accuracy, problem, deployment)
    tracker.log_artifacts([table, picture, accuracy])
    return bounds.metrics() | accuracy_metrics(problem, deployment, seed)


def lose(problem: "Problem", deployment: "Deployment", tracker: "Tracker") -> "Losses | None":
    """Write and log what is lost without each landmark; None, and a line that says why, where that cannot be told."""
    from lmd.core.checks import InputError
    from lmd.core.tables import write_table
    from lmd.evaluation.losses import losses

    try:
        found = losses(problem, deployment)
    except InputError as error:
        print(f"no losses: {error}")
        return None
    file = run_directory() / "losses.csv"
    write_table(file, found.table)
    tracker.log_artifacts([file])
    return found


def vary(problem: "Problem", deployment: "Deployment", seed: int, tracker: "Tracker") -> "Sensitivity":
    """Write and log how much the figures hang on what was assumed."""
    from lmd.evaluation.sensitivity import sensitivity
    from lmd.plot.sensitivity import save_sensitivity_figure

    from .tracked_run import title_of

    found, directory = sensitivity(problem, deployment, seed), run_directory()
    for name, table in found.tables.items():
        table.to_csv(directory / f"{name}.csv", index=False)
    picture = directory / "sensitivity.png"
    save_sensitivity_figure(picture, found, title_of(problem, "sensitivity,"))
    tracker.log_artifacts([*(directory / f"{name}.csv" for name in found.tables), picture])
    return found


def compare_measured(
    problem: "Problem", plan: "Deployment", measured: "Deployment", seed: int, tracker: "Tracker"
) -> "Survey":
    """Write and log how far tags hang from where they were planned, and what that changes."""
    from lmd.evaluation.survey import survey
    from lmd.plot.mounting import save_map_figure

    from .tracked_run import title_of

    found, directory = survey(problem, plan, measured, seed), run_directory()
    files = [directory / name for name in ("moved.csv", "survey.csv", "survey.png")]
    found.moved.to_csv(files[0], index=False)
    found.figures.to_csv(files[1])
    save_map_figure(files[2], found.views, title_of(problem, "maps as planned and as measured,"))
    tracker.log_artifacts(files)
    return found


def mount(
    problem: "Problem", deployment: "Deployment", error: "MountingError", seed: int, tracker: "Tracker"
) -> "Mounted":
    """Write and log what becomes of the figures if tags do not hang quite where they should."""
    from lmd.evaluation.mounting import mounted
    from lmd.plot.mounting import save_map_figure

    from .tracked_run import title_of

    with keyed(MOUNTING):
        found = mounted(problem, deployment, error, seed)
    directory = run_directory()
    files = [directory / name for name in ("mounting.csv", "mountings.csv", "mounting_views.csv", "mounting.png")]
    found.table.to_csv(files[0])
    found.draws.to_csv(files[1])
    found.views.to_csv(files[2], index=False)
    save_map_figure(files[3], found.views, title_of(problem, f"{error.draws} mountings,"))
    tracker.log_artifacts(files)
    return found


if __name__ == "__main__":
    main()
