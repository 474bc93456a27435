"""Predict the accuracy of single images: `python -m pipelines.accuracy deployment=uniform,random [overrides]`.

The deployments share one picture for comparison, so `deployment=a,b,c` is no sweep: it is read as
`deployments=[a,b,c]`.
"""

from omegaconf import DictConfig

from .app import run_directory
from .building import build_problem
from .deployments import composed_deployments, read_deployment_as_a_list
from .pipeline import Pipeline

HEADLINE = "localised_share_20mm"  # figure in the headings of panels


def accuracy(cfg: DictConfig) -> None:
    """Predict the accuracy of the configured deployments."""
    import numpy as np
    import pandas as pd

    from lmd.core.checks import seed_number
    from lmd.evaluation.accuracy import accuracy_metrics
    from lmd.evaluation.maps import figures_text
    from lmd.plot.plans import save_accuracy_figure

    from .tracked_run import keep, title_of, tracked

    seed, directory = seed_number(cfg.seed), run_directory()
    problems = {name: build_problem(own) for name, own in composed_deployments(cfg, "accuracy").items()}
    drawn = {name: (problem, problem.draw(np.random.default_rng(seed))) for name, problem in problems.items()}
    problem = next(iter(problems.values()))
    with tracked(cfg, "accuracy", problem=problem) as tracker:
        figures = {name: accuracy_metrics(*subject, seed) for name, subject in drawn.items()}
        table = pd.DataFrame(figures).T.rename_axis("deployment")
        table.to_csv(directory / "figures.csv")
        headed = {f"{name}: {table[HEADLINE][name]:.1%} to 20 mm off the grid": drawn[name] for name in drawn}
        title = title_of(problem, "median predicted error of one image,")
        save_accuracy_figure(directory / "accuracy.png", headed, title)
        files = [directory / "figures.csv", directory / "accuracy.png"]
        metrics = {f"{key}/{name}": value for name, row in figures.items() for key, value in row.items()}
        keep(tracker, files, metrics)
    print(f"{figures_text(figures)}\nfiles: {directory}\nmlflow: {tracker.describe()}")


main = Pipeline("accuracy", accuracy, (read_deployment_as_a_list,))

if __name__ == "__main__":
    main()
