"""Bound the results of all deployments: `python -m pipelines.bound deployment.count=90 [overrides]`."""

import sys
from dataclasses import replace
from math import inf
from time import monotonic
from typing import TYPE_CHECKING, Any

from omegaconf import DictConfig

from .app import run_directory
from .building import build_problem
from .earlier_run import read_earlier_problem
from .nodes import keyed, note, settings_of
from .outputs import write_document
from .pipeline import Pipeline

if TYPE_CHECKING:
    from lmd.evaluation.time_limit import TimeLimit

EVERY = 10.0  # least time between two lines of progress, seconds


def bound(cfg: DictConfig) -> None:
    """Compute upper bounds of the configured problem, and the share of the bounds that a greedy choice reaches."""
    from lmd.core.checks import real
    from lmd.evaluation.bounds import Search, affordable, average_upper_bound, fewest_landmarks, fitness_upper_bound
    from lmd.evaluation.selection_bound import selection_upper_bound
    from lmd.evaluation.time_limit import TimeLimit

    from .tracked_run import keep, tracked

    problem = build_problem(cfg)
    settings = settings_of(cfg, "bound")
    with keyed("bound"):
        seconds = inf if settings.seconds is None else real("seconds", settings.seconds, above=0.0)
        limit = TimeLimit(seconds, _Progress())
        search = Search(settings.spacing, settings.iterations, settings.tolerance, limit)
        target = None if settings.target is None else real("target", settings.target, low=0.0, high=1.0)
    if target is not None:
        problem.scene.check_one_size("bound.target, a least number of landmarks,")
    with keyed("bound"):
        search = affordable(problem, problem.count, search)
    if search.spacing > settings.spacing:
        note(f"bound.seconds = {seconds:g} is too little for bound.spacing: poses are {search.spacing:.3g} m apart")
    directory, count, free = run_directory(), problem.count, problem.free_count
    beside = f" beside {problem.fixed_count} that hang already" if problem.fixed else ""
    document: dict[str, Any] = {"spacing": search.spacing}
    figures: dict[str, float] = {}
    with tracked(cfg, "bound", problem=problem) as tracker:
        with keyed("bound"):
            stage = limit.part(1 / 3)
            choice = selection_upper_bound(problem, count, search.spacing, stage)
        document["selection"] = {"greedy": choice.greedy, "grid": choice.grid, "share": choice.share}
        figures |= {f"bound/selection/{kind}": value for kind, value in document["selection"].items()}
        _show("greedy choice", f">= {choice.share:.2%} of the best {free} poses of the grid{beside}, "
              f"by the {choice.label}: {choice.greedy:.4g} of at most {choice.grid:.4g}; "
              f"sure before was {choice.guarantee:.2%}")  # fmt: skip
        early = _stopped_early("greedy choice", stage)
        for label, key, method, share in (
            ("fitness", "fitness", fitness_upper_bound, 1 / 2),
            ("average probability", "average_coverage_probability", average_upper_bound, 1),
        ):
            stage = limit.part(share if target is None else share / 2)
            result = method(problem, count, replace(search, limit=stage))
            document[key] = {"walls": result.walls, "grid": result.grid, "fractional": result.fractional}
            figures |= {f"bound/{key}/{kind}": value for kind, value in document[key].items()}
            _show(label, f"<= {result.walls:.2%} for any {free} landmarks flush on the walls{beside}; on the grid of "
                  f"poses <= {result.grid:.2%}, "
                  f"where fractions of landmarks reach {result.fractional:.2%}")  # fmt: skip
            early |= _stopped_early(label, stage)
        if target is not None:
            stage = limit.part(1)
            with keyed("bound"):
                fewest = fewest_landmarks(problem, target, replace(search, limit=stage))
            document["target"] = {"fitness": target, "fewest_landmarks": fewest}
            figures["bound/fewest_landmarks"] = fewest
            _show("landmarks", f">= {fewest} for a fitness of {target:.2%}")
            early |= _stopped_early("landmarks", stage)
        if early:
            document["stopped_early"] = early
        document["settings"] = problem.settings()
        file = directory / "bound.json"
        write_document(file, document)
        keep(tracker, [file], figures)
    _show("files", str(file))
    _show("mlflow", tracker.describe())


class _Progress:
    """Printer of the progress of a bound, at most every `EVERY` seconds."""

    def __init__(self) -> None:
        self._last = monotonic()

    def __call__(self, text: str) -> None:
        if monotonic() - self._last >= EVERY:
            print(text, file=sys.stderr, flush=True)
            self._last = monotonic()


def _stopped_early(label: str, stage: "TimeLimit") -> dict[str, list[str]]:
    """Print and return the parts of a bound that were stopped early; the bound holds without these parts."""
    if not stage.cut:
        return {}
    _show("", f"stopped early: {', '.join(stage.cut)}")
    return {label: stage.cut}


def _show(label: str, text: str) -> None:
    print(f"{label:<20} {text}", flush=True)


main = Pipeline("bound", bound, (read_earlier_problem,))

if __name__ == "__main__":
    main()
