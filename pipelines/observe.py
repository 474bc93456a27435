"""What deployments do to localisation: `python -m pipelines.observe deployment=greedy,uniform,random [overrides]`.

All deployments share one run, because they are to be compared over the same flights. So `deployment=a,b,c` does not
start a sweep here: it is read as `deployments=[a,b,c]`.
"""

import json
import re
import sys
from typing import TYPE_CHECKING

import hydra
from omegaconf import DictConfig, OmegaConf

from .app import (
    CONF,
    build_problem,
    instantiate,
    keyed,
    recompose,
    run_directory,
    search_path,
    task_overrides,
)
from .sweeps.supervisor import run

if TYPE_CHECKING:
    import pandas as pd

    from .tracking import Tracker

NAME = re.compile(r"[\w.-]+")  # what mlflow takes in the name of a metric


def main() -> None:
    """Read `deployment=...` as the list of deployments, then hand over to Hydra."""
    sys.argv[1:] = [re.sub(r"^deployment=(.*)$", r"deployments=[\1]", argument) for argument in sys.argv[1:]]
    _main()


@hydra.main(version_base="1.3", config_path=CONF, config_name="observe")
def _main(cfg: DictConfig) -> None:
    """Fly, record and show."""
    run(cfg, observe)


def observe(cfg: DictConfig) -> None:
    """Localise a camera over the configured deployments."""
    from lmd.checks import integer
    from lmd.localisation.study import Flights, conduct, to_markdown
    from lmd.plot.localisation import save_error_figure

    from .tracked_run import title_of, tracked_run

    seeds = range(integer("seed", cfg.seed, low=0), cfg.seed + integer("seeds", cfg.seeds, low=1))
    problems = {name: build_problem(composed) for name, composed in _deployments(cfg).items()}
    problem = next(iter(problems.values()))
    estimators = {name: instantiate(node) for name, node in (cfg.get("estimator") or {}).items()}
    trajectory, start = instantiate(cfg.trajectory), instantiate(cfg.start)
    with keyed("trajectory"):
        flights = Flights.draw(problem, trajectory, start, seeds)
    directory, n = run_directory(), problem.objective.n
    with tracked_run(cfg, problem, "observe") as tracker:
        detector = instantiate(cfg.detector)
        with keyed(estimators="estimator"):
            study = conduct(problems, flights, detector, estimators, cfg.all_visible)
        figures, curves = study.figures(), study.curves()
        markdown = to_markdown(figures, n)
        figures.to_csv(directory / "figures.csv", index=False)
        curves.to_csv(directory / "curves.csv", index=False)
        (directory / "observe.md").write_text(markdown)
        medians = _medians(figures)
        document = {"medians": medians, "seeds": list(seeds), "settings": problem.settings()}
        (directory / "observe.json").write_text(json.dumps(document, indent=2) + "\n")
        counts = {name: outcome.counts[0] for name, outcome in study.outcomes.items()}
        title = title_of(problem, f"{len(seeds)} flights: median, band from 10 to 90 %;")
        save_error_figure(directory / "errors.png", curves, study.time, counts, n, title)
        tracker.log_metrics(medians)
        _log_curves(tracker, curves)
        names = ("figures.csv", "curves.csv", "observe.md", "observe.json", "errors.png")
        tracker.log_artifacts([*(directory / name for name in names), *sorted((directory / ".hydra").glob("*.yaml"))])
        tracker.finish("FINISHED")
    print(f"{markdown}\nfiles: {directory}\nmlflow: {tracker.describe()}")


def _deployments(cfg: DictConfig) -> dict[str, DictConfig]:
    """The configuration for each entry of `deployments`, under its name."""
    from lmd.checks import InputError

    entries = OmegaConf.to_container(cfg.deployments) if OmegaConf.is_list(cfg.deployments) else []
    if not entries or not all(str(entry).split() for entry in entries):
        raise InputError(f"deployments must list at least one option of conf/deployment, got {cfg.deployments!r}.")
    composed: dict[str, DictConfig] = {}
    used: set[str] = set()
    for entry in map(str, entries):
        first, *rest = entry.split()
        name, option, own = (first[:-1], rest[0], rest[1:]) if first.endswith(":") and rest else (first, first, rest)
        if name in composed:
            raise InputError(f"deployments has {name!r} twice: give them names, e.g. 'mine: {entry}'.")
        if not NAME.fullmatch(name):
            raise InputError(f"deployments: the name {name!r} must be of letters, digits, _, - and dots.")
        composed[name] = _compose(entry, option, own, used)
    unused = [override for key, override in task_overrides() if key.startswith("deployment.") and key not in used]
    if unused:
        raise InputError(f"{unused[0]} is for none of the deployments {', '.join(composed)}.")
    return composed


def _compose(entry: str, option: str, own: list[str], used: set[str]) -> DictConfig:
    """The configuration for one deployment, without overrides of keys it lacks; the keys it has go to `used`."""
    keys = recompose("observe", [*search_path(), f"deployment={option}"], "deployments", entry).deployment
    shared = []
    for key, override in task_overrides():
        group, _, rest = key.partition(".")
        if group == "deployments" or (group == "deployment" and rest.split(".")[0] not in keys):
            continue
        used.add(key)
        shared.append(override)
    return recompose("observe", [*shared, *search_path(), f"deployment={option}", *own], "deployments", entry)


def _medians(figures: "pd.DataFrame") -> dict[str, float]:
    """The finite medians over the seeds as `<figure>/<deployment>/<estimator>`."""
    import math

    medians = {}
    for (name, estimator), runs in figures.groupby(["deployment", "estimator"], sort=False):
        for key, value in runs.drop(columns="seed").median(numeric_only=True).items():
            if math.isfinite(value):
                medians[f"{key}/{name}/{estimator}"] = float(value)
    return medians


def _log_curves(tracker: "Tracker", curves: "pd.DataFrame") -> None:
    """Log the median errors over time; a step is a millisecond."""
    for (name, estimator), curve in curves.groupby(["deployment", "estimator"], sort=False):
        for quantity in ("error", "position", "attitude"):
            values = curve[["time", f"{quantity}_median"]].dropna().to_numpy()
            points = [(round(1000 * time), float(value), float(time)) for time, value in values]
            tracker.log_curve(f"{quantity}_over_time/{name}/{estimator}", points)


if __name__ == "__main__":
    main()
