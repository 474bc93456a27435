"""What deployments do to localisation: `python -m pipelines.observe deployment=greedy,uniform,random [overrides]`.

All deployments share one run, because they are to be compared over the same flights. So `deployment=a,b,c` does not
start a sweep here: it is read as `deployments=[a,b,c]`.
"""

import json
from typing import TYPE_CHECKING

import hydra
from omegaconf import DictConfig

from .app import CONF, build_problem, instantiate, keyed, run_directory
from .deployments import composed_deployments, read_deployment_as_a_list
from .sweeps.supervisor import run

if TYPE_CHECKING:
    import pandas as pd

    from .tracking import Tracker


def main() -> None:
    """Read `deployment=...` as the list of deployments, then hand over to Hydra."""
    read_deployment_as_a_list()
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
    problems = {name: build_problem(composed) for name, composed in composed_deployments(cfg, "observe").items()}
    problem = next(iter(problems.values()))
    estimators = {name: instantiate(node) for name, node in (cfg.get("estimator") or {}).items()}
    trajectory, start = instantiate(cfg.trajectory), instantiate(cfg.start)
    with keyed("trajectory"):
        flights = Flights.draw(problem, trajectory, start, seeds)
    directory, n = run_directory(), problem.objective.n
    with tracked_run(cfg, problem, "observe") as tracker:
        detector = instantiate(cfg.detector)
        with keyed(estimators="estimator", family="detector.tag.family"):
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
