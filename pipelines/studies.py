"""Studies of one or several deployments that the command `evaluate` conducts in addition to the score.

For each study there is a function that checks the settings and returns the study. The arguments are the configuration
of the command, and the configurations of the deployments, keyed by name.
"""

import sys
from collections.abc import Iterator, Mapping
from dataclasses import replace
from math import inf
from typing import TYPE_CHECKING, Any

from omegaconf import DictConfig

from .building import build_problem, refuse_crowd
from .nodes import instantiate, keyed, note, settings_of
from .score import mounting_of
from .study import Report, Study, title_of

if TYPE_CHECKING:
    from lmd.core.checks import FloatArray
    from lmd.evaluation.relaxation import TimeLimit
    from lmd.problem import Problem
    from lmd.scene.deployment import Deployment

Own = Mapping[str, DictConfig]


def accuracy(cfg: DictConfig, own: Own) -> Study:
    """Study of accuracy: predict how accurately single images localise the camera."""
    import numpy as np

    problems = {name: build_problem(each) for name, each in own.items()}
    drawn = {name: (problem, problem.draw(np.random.default_rng(cfg.seed))) for name, problem in problems.items()}
    problem = next(iter(problems.values()))

    def run(_: object) -> Report:
        import pandas as pd

        from lmd.evaluation.accuracy import accuracy_metrics, plan_of_errors
        from lmd.evaluation.maps import figures_text
        from lmd.plot.plans import save_accuracy_figure

        figures = {name: accuracy_metrics(*subject, cfg.seed) for name, subject in drawn.items()}
        table = pd.DataFrame(figures).T.rename_axis("deployment")
        plans = {name: plan_of_errors(*subject) for name, subject in drawn.items()}
        headed = {f"{key}: {table.localised_share_20mm[key]:.1%} to 20 mm": (*drawn[key], plans[key]) for key in plans}
        title = title_of(problem, "median predicted error of one image,")
        files = {"figures.csv": table, "accuracy.png": lambda path: save_accuracy_figure(path, headed, title)}
        files |= {f"{name}.csv": plan for name, plan in plans.items() if "time" in plan}  # of a recording
        named = {f"{key}/{name}": value for name, row in figures.items() for key, value in row.items()}
        return Report(files, named, text=figures_text(figures))

    return Study("accuracy", run, problem=problem)


def bound(cfg: DictConfig, own: Own) -> Study:
    """Study of bounds: compute upper bounds on the fitness that any deployment can have in a problem.

    The study also computes the fraction of such a bound that a greedy choice reaches.
    """
    from lmd.core.checks import real
    from lmd.evaluation.bounds import (
        Search,
        affordable,
        average_upper_bound,
        fewest_landmarks,
        fitness_upper_bound,
        selection_upper_bound,
    )
    from lmd.evaluation.relaxation import TimeLimit

    problem, settings = build_problem(next(iter(own.values()))), settings_of(cfg, "bound")

    with keyed("bound"):
        seconds = inf if settings.seconds is None else real("seconds", settings.seconds, above=0.0)
        limit = TimeLimit(seconds, lambda text: print(text, file=sys.stderr, flush=True))
        search = Search(settings.spacing, settings.iterations, settings.tolerance, limit)
        target = None if settings.target is None else real("target", settings.target, low=0.0, high=1.0)
        if target is not None:
            problem.scene.check_one_size("bound.target, a least number of landmarks,")
        search = affordable(problem, problem.count, search)
    if search.spacing > settings.spacing:
        note(f"bound.seconds = {seconds:g} is too little for bound.spacing: poses are {search.spacing:.3g} m apart")
    count, free = problem.count, problem.free_count
    beside = f" beside {problem.fixed_count} fixed landmarks" if problem.fixed else ""

    def run(_: object) -> Iterator[Report]:
        document, early = dict[str, Any](spacing=search.spacing), dict[str, list[str]]()

        def told(label: str, text: str, stage: "TimeLimit") -> Report:
            if stage.cut:  # a bound holds without the parts that were stopped early
                early[label], text = stage.cut, f"{text}\n{'':<20} stopped early: {', '.join(stage.cut)}"
            return Report(text=f"{label:<20} {text}")

        stage = limit.part(1 / 3)
        with keyed("bound"):
            choice = selection_upper_bound(problem, count, search.spacing, stage)
        document["selection"] = {"greedy": choice.greedy, "grid": choice.grid, "share": choice.share}
        yield told("greedy choice", f">= {choice.share:.2%} of the best {free} poses of the grid{beside}, by the "
                   f"{choice.label}: {choice.greedy:.4g} of at most {choice.grid:.4g}; guaranteed in any room: "
                   f"{choice.guarantee:.2%}", stage)  # fmt: skip
        for label, key, method, share in (
            ("fitness", "fitness", fitness_upper_bound, 1 / 2),
            ("average probability", "average_coverage_probability", average_upper_bound, 1),
        ):
            stage = limit.part(share if target is None else share / 2)
            result = method(problem, count, replace(search, limit=stage))
            document[key] = {"walls": result.walls, "grid": result.grid, "fractional": result.fractional}
            yield told(label, f"<= {result.walls:.2%} for any {free} landmarks flush on the walls{beside}; on the grid "
                       f"of poses <= {result.grid:.2%}, where fractions of landmarks reach {result.fractional:.2%}",
                       stage)  # fmt: skip
        kinds = [(part, found) for part, found in document.items() if part != "spacing"]
        figures = {f"bound/{part}/{kind}": value for part, found in kinds for kind, value in found.items()}
        if target is not None:
            stage = limit.part(1)
            with keyed("bound"):
                fewest = fewest_landmarks(problem, target, replace(search, limit=stage))
            document["target"] = {"fitness": target, "fewest_landmarks": fewest}
            figures["bound/fewest_landmarks"] = fewest
            yield told("landmarks", f">= {fewest} for a fitness of {target:.2%}", stage)
        document |= ({"stopped_early": early} if early else {}) | {"settings": problem.settings()}
        yield Report({"bound.json": document}, figures)

    return Study("bound", run, problem=problem)


def uncertainty(cfg: DictConfig, own: Own) -> Study:
    """Study of uncertainty: standard deviations of the camera's pose when it is estimated from one image.

    The results are tables, formulas ("laws"), and Java code of these formulas. A formula gives a standard deviation as
    a function of distance and number of tags, and is fitted to random images.
    """
    from lmd.evaluation.uncertainty import UncertaintyStudy
    from lmd.evaluation.uncertainty import uncertainty as find
    from lmd.evaluation.uncertainty_law import uncertainty_law

    problem, deployment, places, joint = _hung(cfg, own, "uncertainty")
    study: UncertaintyStudy = instantiate(settings_of(cfg, "uncertainty"))

    def run(_: object) -> Report:
        from lmd.export.filter_code import CLASS, FilterLaws, java
        from lmd.plot.pose_errors import save_uncertainty_figure

        with keyed("uncertainty"):
            found = find(problem, deployment, study, cfg.seed, places, joint)
            law = uncertainty_law(found)
        distance, tag = found.views.distance[found.views.pose == "one"], problem.scene.tag
        of = f"{len(deployment)} tags of {tag.size:g} m ({tag.family}, {tag.square}), {problem.scene.room.describe()}"
        about = f"{of}; errors of corners {found.corners}."
        code = FilterLaws(law.laws, law.rules, law.reach, float(distance.min()), float(distance.max()), about)
        document = {"about": about, "views": found.metrics(), **law.document()}
        files: dict[str, Any] = {
            "uncertainty.csv": found.views,
            "uncertainty_law.csv": law.table,
            "uncertainty_law.json": document,
            f"{CLASS}.java": java(code),
        }
        title = title_of(problem, "uncertainty of the pose from one image,")
        if cfg.picture:
            drawn = problem, deployment, found, law, title
            files["uncertainty.png"] = lambda path: save_uncertainty_figure(path, *drawn)
        return Report(files, found.metrics(), lines=law.lines(found))

    return Study("uncertainty", run, problem=problem)


def acceptance(cfg: DictConfig, own: Own) -> Study:
    """Study of acceptance, which checks that tags hang as planned.

    The study chooses stations, poses of the camera at which a measurement would show a tag that hangs wrongly. If
    measurements from stations are given, the study decides from them if the tags are accepted.
    """
    from scipy.linalg import block_diag

    from lmd.evaluation.acceptance import Acceptance, HungMap
    from lmd.evaluation.uncertainty import UncertaintyStudy

    problem, deployment, places, joint = _hung(cfg, own, "acceptance")
    settings: Acceptance = instantiate(settings_of(cfg, "acceptance"))

    def run(_: object) -> Report:
        errors, _ = UncertaintyStudy().errors(problem, deployment, cfg.seed)
        hung = HungMap(problem, deployment, errors, block_diag(*places) if joint is None else joint, settings)
        with keyed("acceptance"):
            files, figures, text = hung.report(cfg.seed)
        return Report(files, figures, text=text)

    return Study("acceptance", run, problem=problem)


def _hung(cfg: DictConfig, own: Own, study: str) -> "tuple[Problem, Deployment, FloatArray, FloatArray | None]":
    """Build the problem of a study of one deployment; return it with the K tags and their mounting covariances.

    Args:
        cfg: configuration of the command.
        own: configuration of the deployment, by its name.
        study: name of the study, for error messages.

    Returns:
        problem; deployment; covariance of the mounting error of each tag, `(K, 6, 6)`; joint covariance of all tags,
            `(6 K, 6 K)`, if the deployment is a surveyed map, else None. A tag has three coordinates of position
            (metres), then three of rotation (rad).

    Raises:
        InputError: there are several deployments, or the problem has a crowd.
    """
    import numpy as np

    from lmd.core.checks import InputError
    from lmd.localise.fixed_map import surveyed_covariance

    if len(own) > 1:
        raise InputError(f"studies=[{study}] needs a single deployment: leave out the key deployments.")
    (alone,) = own.values()
    problem, path = build_problem(alone), alone.deployment.get("path")
    refuse_crowd(problem, study)
    deployment = problem.draw(np.random.default_rng(cfg.seed))
    with keyed(map="deployment.path"):
        joint = None if path is None else surveyed_covariance(path, deployment)
    return problem, deployment, mounting_of(alone).covariances(problem, deployment), joint
