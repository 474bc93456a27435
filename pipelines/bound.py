"""What no deployment can exceed: `python -m pipelines.bound deployment.count=90 [overrides]`."""

from typing import Any

from omegaconf import DictConfig

from .app import run_directory
from .building import build_problem, keyed, settings_of
from .documents import write_document
from .earlier_run import read_earlier_problem
from .pipeline import Pipeline


def bound(cfg: DictConfig) -> None:
    """Bound what the configured problem admits."""
    from lmd.core.checks import real
    from lmd.evaluation.bounds import Search, average_upper_bound, fewest_landmarks, fitness_upper_bound
    from lmd.evaluation.selection_bound import selection_upper_bound

    from .tracked_run import keep, title_of, tracked

    problem = build_problem(cfg)
    settings = settings_of(cfg, "bound")
    with keyed("bound"):
        search = Search(settings.spacing, settings.iterations, settings.tolerance)
        target = None if settings.target is None else real("target", settings.target, low=0.0, high=1.0)
    if target is not None:
        problem.scene.check_one_size("bound.target, a least number of landmarks,")
    directory, count, free = run_directory(), problem.count, problem.free_count
    beside = f" beside {problem.fixed_count} that hang already" if problem.fixed else ""
    document: dict[str, Any] = {}
    figures: dict[str, float] = {}
    with tracked(cfg, "bound", title_of(problem, "bound")) as tracker:
        with keyed("bound"):
            choice = selection_upper_bound(problem, count, search.spacing)
        document["selection"] = {"greedy": choice.greedy, "grid": choice.grid, "share": choice.share}
        figures |= {f"bound/selection/{kind}": value for kind, value in document["selection"].items()}
        _show("greedy choice", f">= {choice.share:.2%} of the best {free} poses of the grid{beside}, "
              f"by the {choice.label}: {choice.greedy:.4g} of at most {choice.grid:.4g}; "
              f"sure before was {choice.guarantee:.2%}")  # fmt: skip
        for label, key, method in (
            ("fitness", "fitness", fitness_upper_bound),
            ("average probability", "average_coverage_probability", average_upper_bound),
        ):
            result = method(problem, count, search)
            document[key] = {"walls": result.walls, "grid": result.grid, "fractional": result.fractional}
            figures |= {f"bound/{key}/{kind}": value for kind, value in document[key].items()}
            _show(label, f"<= {result.walls:.2%} for any {free} landmarks flush on the walls{beside}; on the grid of "
                  f"poses <= {result.grid:.2%}, "
                  f"where fractions of landmarks reach {result.fractional:.2%}")  # fmt: skip
        if target is not None:
            with keyed("bound"):
                fewest = fewest_landmarks(problem, target, search)
            document["target"] = {"fitness": target, "fewest_landmarks": fewest}
            figures["bound/fewest_landmarks"] = fewest
            _show("landmarks", f">= {fewest} for a fitness of {target:.2%}")
        document["settings"] = problem.settings()
        file = directory / "bound.json"
        write_document(file, document)
        keep(tracker, [file], figures)
    _show("files", str(file))
    _show("mlflow", tracker.describe())


def _show(label: str, text: str) -> None:
    print(f"{label:<20} {text}", flush=True)


main = Pipeline("bound", bound, (read_earlier_problem,))

if __name__ == "__main__":
    main()
