"""Score of a deployment.

Landmarks and metrics are written first, and then all outputs that can be computed again from these.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from omegaconf import DictConfig

from .app import choices, doing
from .building import build_problem
from .landmarks import table_in
from .nodes import keyed, note, plain
from .operations.signals import stop
from .outputs import HISTORY_FILE
from .study import Report, Study, title_of

if TYPE_CHECKING:
    from lmd import evaluation
    from lmd.evaluation.mounting import MountingError
    from lmd.export.exports import Export
    from lmd.optimisers.ledger import Record
    from lmd.problem import Problem
    from lmd.scene.deployment import Deployment

# Figures of deployments that the terminal shows side by side.
COMPARED = ("fitness", "off_grid", "qualified_ratio", "average_coverage_probability", "localised_share_20mm")


def room_report(cfg: DictConfig, problem: "Problem") -> Report:
    """Report with a picture of the room as read from its file, and of the people who may hide landmarks.

    The report is made before anything is computed, and is empty if `picture` is switched off.
    """
    if not cfg.picture:
        return Report()
    room, crowd = problem.scene.room, problem.scene.crowd
    path, people = getattr(getattr(room, "plan", None), "path", None), None if crowd is None else crowd.people
    from lmd.plot.plans import save_room_figure

    title = room.describe() if path is None else f"{Path(path).name}: {room.describe()}"
    return Report({"room.png": partial(save_room_figure, room=room, title=title, people=people)}, is_extra=True)


def scored(
    cfg: DictConfig,
    problem: "Problem",
    deployment: "Deployment",
    history: "Sequence[Record]",
    subject: str,
    summary: Mapping[str, Any],
    further: Callable[[], Mapping[str, float]] = dict,
    export: "Export | None" = None,
    in_haste: bool = False,
) -> Iterator[Report]:
    """Yield reports on a deployment.

    Landmarks, metrics and history cannot be computed again, so they are written first, and stay if a later step fails.

    Args:
        cfg: configuration of the run.
        problem: problem of the deployment.
        deployment: the deployment.
        history: records of the best fitness during the run; no curve is drawn for a single evaluation.
        subject: subject of the run, one word.
        summary: more entries of metrics.json; `stopped` = "interrupted" means that the run was cut short.
        further: function that computes more entries of metrics.json; the computation takes seconds.
        export: tag maps, plans and sheets to write; None for none.
        in_haste: True to leave out outputs that take seconds: validation, pictures, exports and `further` entries.

    Yields:
        reports with the metrics, among them `fitness` and, unless validation is left out, `off_grid`.
    """
    from lmd.evaluation.validation import describe_validation, headline_off_grid, validation_metrics
    from lmd.evaluation.verdicts import causes
    from lmd.objectives.base import labelled_figures
    from lmd.optimisers.ledger import columns_of
    from lmd.plot.charts import save_convergence_figure
    from lmd.plot.scenes import save_scene_figure

    is_cut, settings = summary.get("stopped") == "interrupted", {"settings": problem.settings()}
    with stop.shielded():
        metrics = problem.metrics(deployment)
        document: dict[str, Any] = {**metrics, **summary, "seed": cfg.seed}
        write = partial(deployment.to_csv, ups=not problem.scene.tag.is_point)
        yield Report({"landmarks.csv": write, "metrics.json": document | settings}, is_whole=not is_cut, is_cut=is_cut)
        yield Report({HISTORY_FILE: columns_of(history)}, is_extra=True)
    figures = {key: value for key, value in summary.items() if isinstance(value, int | float)}
    validation, why = dict[str, float](), None
    if not in_haste:
        with doing("scoring off the grid"):
            figures |= further()
            why = causes(problem.scene, deployment, cfg.seed)
            if cfg.validate:
                validation = validation_metrics(problem, deployment, cfg.seed)
                figures["off_grid"] = validation[headline_off_grid(problem)]
    groups = {"validation": validation, "criteria": why.metrics() if why else {}}
    document |= figures | {group: found for group, found in groups.items() if found} | settings
    # standard errors would clutter the charts
    charted = {f"validation/{key}": v for key, v in validation.items() if not key.endswith("standard_error")}
    lines = labelled_figures({key: value for key, value in figures.items() if key != "off_grid"})
    fitness, headline, *others = problem.describe(metrics, problem.count).items()
    off_grid = describe_validation(problem, validation) if validation else {}
    few = problem.objective.qualified(problem.values(deployment)).mean() < 0.1  # then the criteria are printed
    yield Report(
        {} if in_haste else {"metrics.json": document},
        metrics | figures | charted,
        text=why.to_text() if why and few else "",
        lines=dict([fitness, headline, *off_grid.items(), *others, *lines.items()]),
        is_extra=True,
    )
    if in_haste:
        return
    room, of = problem.scene.room, getattr(problem.scene.visibility, "detector", None)
    visibility = f"visibility {choices().get('visibility', '')}{f' ({of})' if of else ''}"
    placed = f"{subject}, {problem.count} landmarks: {problem.objective.value_label}"
    title, files = f"{placed}; {visibility}; {room.describe()}", dict[str, Any]()
    if cfg.picture:
        files["scene.png"] = lambda path: save_scene_figure(path, problem, deployment, title)
    if cfg.picture and len(history) > 1:
        files["convergence.png"] = lambda path: save_convergence_figure(path, columns_of(history), title)
    yield Report(files | (export.writers(room, problem.scene.tag, deployment) if export else {}), is_extra=True)


def score(cfg: DictConfig, own: Mapping[str, DictConfig]) -> Study:
    """Return the study that computes the metrics of each deployment, and does the analyses that are configured.

    The analyses are the accuracy of single images, the loss of tags, the sensitivity, the measured poses of tags, and
    mounting errors.

    Args:
        cfg: configuration of the command.
        own: configuration of each deployment, by the name of the deployment.
    """
    subjects = {name: _Subject.of(each) for name, each in own.items()}
    (first, *_), is_alone = subjects.values(), len(subjects) == 1

    def run(_: object) -> Iterator[Report]:
        yield room_report(cfg, first.problem)
        if is_alone:
            yield from _studied(cfg, first, choices()["deployment"])
            return
        rows = {}
        for name, subject in subjects.items():
            figures: dict[str, float] = {}
            for report in _studied(cfg, subject, name):
                figures |= report.figures
                lines = {f"{label}, {name}": text for label, text in report.lines.items()}
                named = {f"{key}/{name}": value for key, value in report.figures.items()}
                yield replace(report.below(name), figures=named, lines=lines, is_whole=False)
            rows[name] = figures
        import pandas as pd

        from lmd.evaluation.maps import figures_text

        # The terminal shows the figures that all deployments have.
        shown = {name: {key: row[key] for key in COMPARED if key in row} for name, row in rows.items()}
        table = pd.DataFrame(rows).T.rename_axis("deployment")
        yield Report({"scores.csv": table}, text=figures_text(shown), is_whole=True)

    problem, subject = first.problem, choices()["deployment"] if is_alone else " ".join(subjects)
    return Study(subject, run, title_of(problem, subject), problem, returned="fitness" if is_alone else "")


class _Subject(NamedTuple):
    """Deployment to be scored, with the planned and with the measured poses of its tags."""

    problem: "Problem"
    plan: "Deployment"
    """Planned poses of the tags."""
    deployment: "Deployment"
    """Measured poses of the tags; equal to `plan` if nothing was measured."""
    error: "MountingError | None"
    history: "Sequence[Record]"

    @classmethod
    def of(cls, cfg: DictConfig) -> "_Subject":
        import numpy as np

        from lmd.core.compiled import clock
        from lmd.optimisers.ledger import Record

        began, problem = clock(), build_problem(cfg)
        with doing("placing the landmarks"):
            deployment = plan = problem.draw(np.random.default_rng(cfg.seed))
        if cfg.deployment.measured is not None:
            from lmd.evaluation.mounting import read_measured  # slow to load

            with keyed("deployment", path="deployment.measured", family="tag.family"):
                deployment = read_measured(cfg.deployment.measured, problem, plan, **table_in(cfg.deployment))
            note(deployment.note)
        history = [Record(1, problem.metrics(deployment)["fitness"], clock() - began)]
        error = mounting_of(cfg) if cfg.deployment.mounting_error else None  # slow to load
        return cls(problem, plan, deployment, error, history)


def mounting_of(cfg: DictConfig) -> "MountingError":
    """Build the mounting error of a configuration; a single number is the standard deviation of the position.

    Raises:
        InputError: a value is out of range.
    """
    from lmd.evaluation.mounting import MountingError
    from lmd.space.parts import made

    given = plain(cfg.deployment.mounting_error)
    return made("deployment.mounting_error", given if isinstance(given, dict) else {"position": given}, MountingError)


def _studied(cfg: DictConfig, subject: _Subject, name: str) -> Iterator[Report]:
    """Yield the reports on the studies and on the score of a deployment."""
    texts, summary = "", dict[str, Any]()
    with doing("studying the deployment"):
        for key, files, figures, text in _studies(cfg, subject):
            summary |= {key: figures} if key else figures
            yield Report(files, {f"{key}/{figure}": value for figure, value in figures.items()} if key else {})
            texts += f"{text}\n\n" if text else ""
    yield from scored(cfg, subject.problem, subject.deployment, subject.history, name, summary)
    yield Report(text=texts.removesuffix("\n"), is_extra=True)


Studied = tuple[str, Mapping[str, Any], Mapping[str, float], str]


def _studies(cfg: DictConfig, subject: _Subject) -> Iterator[Studied]:
    """Conduct the configured studies of a deployment, one after the other.

    Yields:
        name, files, metrics and text of a study. The name is the prefix of the metrics; it is empty if the metrics
            describe the deployment itself.
    """
    from lmd.core.checks import InputError

    problem, plan, deployment, error, seed = *subject[:4], cfg.seed

    def told(key: str, study: "evaluation.Study", draw: Callable[..., None] | None = None, about: str = "") -> Studied:
        tables = {stem: {str(c): values for c, values in table.items()} for stem, table in study.tables.items()}
        files: dict[str, Any] = {f"{stem}.csv": columns for stem, columns in tables.items()}
        if draw is not None and cfg.picture:
            files[f"{key}.png"] = partial(draw, title=title_of(problem, about))
        return key, files, study.metrics(), study.to_text()

    if cfg.localisation:
        from lmd.estimation.cramer_rao import cramer_rao_map
        from lmd.evaluation.accuracy import accuracy_metrics, save_accuracy_map

        bounds = cramer_rao_map(problem.scene, problem.evaluator, deployment)
        save_accuracy = partial(save_accuracy_map, problem=problem, deployment=deployment)
        files: dict[str, Any] = {"localisation.csv": bounds.to_csv, "accuracy.csv": save_accuracy}
        yield "", files, bounds.metrics() | accuracy_metrics(problem, deployment, seed), ""
    if cfg.losses:
        from lmd.evaluation.losses import losses

        try:
            yield told("", losses(problem, deployment))
        except InputError as refused:
            print(f"no losses: {refused}")
    if cfg.sensitivity:
        from lmd.evaluation.sensitivity import sensitivity
        from lmd.plot.charts import save_sensitivity_figure

        varied = sensitivity(problem, deployment, seed)
        yield told("sensitivity", varied, partial(save_sensitivity_figure, found=varied), "sensitivity,")
    if deployment is not plan:
        from lmd.evaluation.mounting import as_measured
        from lmd.plot.pose_errors import save_map_figure

        surveyed = as_measured(problem, plan, deployment, seed)
        draw = partial(save_map_figure, views=surveyed.views)
        yield told("survey", surveyed, draw, "maps as planned and as measured,")
    if error is not None and not error.is_none:
        from lmd.evaluation.mounting import mounted
        from lmd.plot.pose_errors import save_map_figure

        with keyed("deployment.mounting_error"):
            hung = mounted(problem, deployment, error, seed)
        yield told("mounting", hung, partial(save_map_figure, views=hung.views), f"{error.draws} mountings,")
