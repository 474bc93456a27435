"""Uncertainty of the pose from one image: `python -m pipelines.uncertainty run=DIR [overrides]`."""

from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from omegaconf import DictConfig

from .app import run_directory
from .building import build_problem
from .crowd import refuse_crowd
from .earlier_run import read_earlier_run
from .evaluate import MOUNTING, read_mounting_error
from .nodes import instantiate, keyed, settings_of
from .outputs import write_all, write_document
from .pipeline import Pipeline

if TYPE_CHECKING:
    from lmd.evaluation.mounting import MountingError
    from lmd.evaluation.uncertainty import Uncertainty, UncertaintyStudy
    from lmd.evaluation.uncertainty_law import UncertaintyLaw
    from lmd.problem import Problem
    from lmd.scene.deployment import Deployment


def uncertainty(cfg: DictConfig) -> None:
    """Write tables, laws, code and pictures of the uncertainty of the configured deployment."""
    import numpy as np

    from lmd.core.checks import seed_number
    from lmd.core.words import labelled
    from lmd.evaluation.uncertainty import uncertainty as find
    from lmd.evaluation.uncertainty_law import uncertainty_law
    from lmd.localise.fixed_map import surveyed_covariance

    from .tracked_run import keep, tracked

    problem, seed = build_problem(cfg), seed_number(cfg.seed)
    refuse_crowd(problem, "uncertainty")
    study: UncertaintyStudy = instantiate(cfg.uncertainty)
    error: MountingError = instantiate(settings_of(cfg, MOUNTING))
    deployment = problem.draw(np.random.default_rng(seed))
    with tracked(cfg, "uncertainty", problem=problem) as tracker:
        places = error.covariances(problem, deployment)
        with keyed("uncertainty", map="deployment.path"):
            path = settings_of(cfg, "deployment").get("path")
            joint = None if path is None else surveyed_covariance(path, deployment)
            found = find(problem, deployment, study, seed, places, joint)
        with keyed("uncertainty"):
            law = uncertainty_law(found)
        files = write_all(run_directory(), _writers(problem, deployment, found, law, cfg.picture))
        keep(tracker, files, found.metrics())
    written = {"files": f"{run_directory()}: {', '.join(path.name for path in files)}", "mlflow": tracker.describe()}
    print(labelled(_lines(found, law) | written))


def _writers(
    problem: "Problem",
    deployment: "Deployment",
    found: "Uncertainty",
    law: "UncertaintyLaw",
    picture: bool,
) -> dict[str, Callable[[Path], object]]:
    """Functions that write the files, by the names of the files."""
    from lmd.export.filter_code import CLASS, FilterLaws, java, python, robot_localization
    from lmd.plot.uncertainty import save_uncertainty_figure

    from .tracked_run import title_of

    distance = found.views.distance[found.views.pose == "one"]
    tag, room = problem.scene.tag, problem.scene.room.describe()
    of = f"{len(deployment)} tags of {tag.size:g} m ({tag.family}, {tag.square})"
    about = f"{of}, {room}; errors of corners {found.corners}."
    code = FilterLaws(law.laws, law.rules, law.reach, float(distance.min()), float(distance.max()), about)
    document = {"about": about, "views": found.metrics(), "misleading": found.misleading, **law.document()}
    writers: dict[str, Callable[[Path], object]] = {
        "uncertainty.csv": partial(found.views.to_csv, index=False),
        "uncertainty_law.csv": partial(law.table.to_csv, index=False),
        "uncertainty_law.json": partial(write_document, document=document),
        "uncertainty_tags.csv": partial(found.tags.to_csv, index=False),
        f"{CLASS}.java": lambda path: path.write_text(java(code), encoding="utf-8"),
        "vision_uncertainty.py": lambda path: path.write_text(python(code), encoding="utf-8"),
        "robot_localization.yaml": lambda path: path.write_text(robot_localization(code), encoding="utf-8"),
    }
    if picture:
        title = title_of(problem, "uncertainty of the pose from one image,")
        writers["uncertainty.png"] = partial(
            save_uncertainty_figure, problem=problem, deployment=deployment, found=found, law=law, title=title
        )
    return writers


def _lines(found: "Uncertainty", law: "UncertaintyLaw") -> dict[str, str]:
    """Labelled lines for the terminal."""
    figures = found.metrics()
    errors = law.errors.set_index(["quantity", "rule"])

    def said(name: str, factor: float, unit: str) -> str:
        one, several = law.laws[name].one, law.laws[name].several
        return (
            f"one tag {factor * one.scale:.3g} {unit} d^{one.distance:.2f}; several {factor * several.scale:.3g} "
            f"{unit} d^{several.distance:.2f} / n^{several.tags:.2f}; 90 % within a factor "
            f"{errors.factor_90[name, 'law']:.2f}, d^2 / n {errors.factor_90[name, 'squared']:.2f}, constant "
            f"{errors.factor_90[name, 'constant']:.2f}"
        )

    return {
        "views": f"{len(found.views)}: {figures['share_one']:.1%} with one pose, {figures['share_two']:.1%} with two "
        f"(a single tag), {figures['share_none']:.1%} with none",
        "corners": f"errors {found.corners}",
        "position": said("position", 1e3, "mm"),
        "rotation": said("rotation", 1e3, "mrad"),
        "single tags": "have one pose" if law.reach == float("inf") else f"have one pose up to {law.reach:g} m",
        "misleading": ", ".join(map(str, found.misleading)) or "no tag",
    }  # fmt: skip


main = Pipeline("uncertainty", uncertainty, (read_mounting_error, read_earlier_run))

if __name__ == "__main__":
    main()
