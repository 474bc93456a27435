"""Execution of studies, common to all commands.

Runs are tracked, stopped and resumed. Reports are printed and written to files, each file completely or not at all.
"""

import sys
from collections.abc import Callable, Generator, Iterable, Iterator, Mapping
from contextlib import closing, contextmanager, suppress
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from hydra.core.hydra_config import HydraConfig
from omegaconf import DictConfig

from lmd.core.checks import InputError
from lmd.core.words import as_code, escaped, labelled

from .app import choices, flat_settings, key_and_value, run_directory, say
from .composing import GROUPS
from .nodes import instantiate
from .operations.signals import Stopped, stop
from .operations.sweeps.folder import current_job, reason_of
from .operations.sweeps.names import override_tags, short_name
from .operations.tracking import PARENT_TAG, RunStart, Tracker
from .outputs import write_all, write_document
from .provenance import command_line, digest, parameters, repeating, source_tags, write_sources

if TYPE_CHECKING:
    from lmd.problem import Problem

LANDMARKS = "landmarks.csv"
DECIDED = ("fixed", "measured")  # settings of `deployment` that decide the problem, beside the number of landmarks
DATASET_DIGITS = 16  # number of characters of the digest of a problem; mlflow accepts 36
Curve = Iterable[tuple[int, float, float]]


@dataclass(frozen=True)
class Report:
    """Part of a study's results; it is written and printed as soon as the study yields it."""

    files: Mapping[str, Any] = field(default_factory=dict)
    """Contents of the files to write, keyed by file name: a table, columns of a table, keys of a JSON document, text,
    or a function that writes to a path.
    """
    figures: Mapping[str, float] = field(default_factory=dict)
    """Metrics for the tracked run, keyed by name."""
    curves: Mapping[str, Curve] = field(default_factory=dict)
    """Curves for the tracked run, keyed by name, see `Tracker.log_curve`."""
    text: str = ""
    """Text for the terminal."""
    lines: Mapping[str, str] = field(default_factory=dict)
    """Lines, keyed by label, that are printed at the end of the terminal's text."""
    is_whole: bool = False
    """True if the results are complete with this report.

    A signal that comes later does not make the run incomplete; it only leaves out further reports.
    """
    is_extra: bool = False
    """True for a report that may be lost.

    Files of such a report that do not fit on the disk are left out, and a signal may interrupt the writing.
    """
    is_cut: bool = False
    """True if a signal has ended the study early; the process exits with the signal's code."""

    def below(self, folder: str) -> "Report":
        """Copy of this report whose files are written to the subfolder `folder`."""
        return replace(self, files={f"{folder}/{name}": content for name, content in self.files.items()})


@dataclass(frozen=True)
class Study:
    """Study that is ready to be conducted: its settings are checked, and its objects are built."""

    subject: str
    """Subject of the run, one word."""
    run: Callable[[Tracker], Report | Iterable[Report]]
    """Function that conducts the study; it returns one report or yields several, see `reports`."""
    about: str = ""
    """Description of the run; by default the title of its problem."""
    problem: "Problem | None" = None
    """Problem that is studied; None for a study without a problem."""
    earlier: tuple[str | None, Path] = (None, Path())
    """The tracked run that this study continues: its id (None if there is no such run), and its folder."""
    hint: Callable[[], str] = str
    """Function that returns a text about how to continue after an interruption."""
    returned: str = ""
    """Name of the metric whose value is returned to Hydra's sweeper; empty for none."""

    def reports(self, tracker: Tracker) -> Generator[Report, None, None]:
        """Conduct the study; yield its reports."""
        found = self.run(tracker)
        yield from (found,) if isinstance(found, Report) else found


def conduct(cfg: DictConfig, study: Study) -> float | None:
    """Conduct a study as a tracked run; return the metric `Study.returned` for Hydra's sweeper; None without it.

    Args:
        cfg: configuration of the run.
        study: the study.

    Raises:
        InputError: the study refuses its input.
        OSError: the results cannot be written.
    """
    directory, files, lacking = run_directory(), dict[Path, None](), list[str]()
    figures, lines, is_cut, is_whole = dict[str, float](), dict[str, str](), False, False
    try:
        with tracked(cfg, study) as tracker:
            try:
                with stop.raising(), closing(study.reports(tracker)) as reports:
                    report = next(reports, None)
                    while report is not None:
                        try:
                            written, failed = _written(directory, report)
                            files |= dict.fromkeys(written)
                            lacking += failed
                            figures |= report.figures
                            lines |= report.lines
                            is_whole, is_cut = is_whole or report.is_whole, is_cut or report.is_cut
                            if report.figures:
                                tracker.log_metrics(report.figures)
                            for name, points in report.curves.items():
                                tracker.log_curve(name, points)
                            say(report.text)
                            report = next(reports, None)
                        except Stopped as told:  # the study may yield a last report
                            report = reports.throw(told)
            except Stopped:
                if not is_whole:
                    raise
                lacking.append("it was told to stop and has left out the rest")
            records = sorted(path for path in (directory / ".hydra").glob("*") if path.is_file())
            tracker.log_artifacts([*files, *records])
            tracker.finish("KILLED" if is_cut else "FINISHED")
    except (Stopped, OSError):
        _print_hint(study)
        raise
    names = ", ".join(str(path.relative_to(directory)) for path in files)
    say(labelled({**lines, "files": f"{directory}: {names}", "mlflow": tracker.describe()}))
    if lacking:
        again = command_line("evaluate", [f"run={directory}"])
        hint = f"; to write the files again: {again}" if (directory / LANDMARKS).is_file() else ""
        print(f"warning: {'; '.join(lacking)}{hint}", file=sys.stderr)
    if is_cut:
        _print_hint(study)
        sys.exit(stop.code)
    return figures.get(study.returned)


def _written(directory: Path, report: Report) -> tuple[list[Path], list[str]]:
    """Write the files of a report.

    Returns:
        paths of the written files, and texts about the files of an extra report (`Report.is_extra`) that could not be
            written.

    Raises:
        OSError: a file of a report that is not extra cannot be written.
    """
    writers = {name: _writer(name, content) for name, content in report.files.items()}
    files, failed = list[Path](), list[str]()
    if not report.is_extra:
        with stop.shielded():
            return write_all(directory, writers), failed
    for name, write in writers.items():
        try:
            files += write_all(directory, {name: write})
        except OSError as error:
            failed.append(f"{name} could not be written ({error.strerror or error})")
    return files, failed


def _writer(name: str, content: Any) -> Callable[[Path], object]:
    """Make a function that writes `content` to a path; the ending of the file name `name` determines the format."""
    if callable(content):
        return content  # type: ignore[no-any-return]
    if isinstance(content, str):
        return lambda path: path.write_text(content, encoding="utf-8")
    if name.endswith(".json"):
        return lambda path: write_document(path, content)
    if not isinstance(content, Mapping):  # a table of pandas
        return lambda path: content.to_csv(path, index=content.index.name is not None)
    from lmd.core.tables import write_table

    return lambda path: write_table(path, content)


def _print_hint(study: Study) -> None:
    with suppress(OSError):
        if hint := study.hint():
            print(f"interrupted; {hint}", file=sys.stderr)


@contextmanager
def tracked(cfg: DictConfig, study: Study) -> Iterator[Tracker]:
    """Context with a started run of the configured tracker.

    An exception marks the run as FAILED, and Ctrl-C as KILLED. If the input is refused, the record of the run is
    removed, except for a job of a sweep and for a run that was recorded earlier.

    Args:
        cfg: configuration, whose settings are recorded as parameters.
        study: study of the run. If it continues an earlier run (`Study.earlier`), the record of that run is extended;
            where this is not possible, a new record is made that names the earlier run.
    """
    tracker: Tracker = instantiate(cfg.tracking)
    directory, pipeline, job = run_directory(), HydraConfig.get().job.name, current_job()
    overrides, given = list(HydraConfig.get().overrides.task), list[str]()
    varied, tags = overrides, {f"choice.{group}": option for group, option in choices().items()}
    if job is not None:
        folder, swept = job
        overrides, varied = list(swept.overrides), [f"{key}={value}" for key, value in swept.varied.items()]
        given = [override for override in overrides if key_and_value(override)[0] not in swept.varied]
        tags |= swept.tags(folder.name)
    tags |= {"pipeline": pipeline} | override_tags(overrides) | source_tags(pipeline)
    about, dataset, params = study.about or study.subject, None, parameters(cfg, choices())
    if (problem := study.problem) is not None:
        about, dataset = study.about or title_of(problem, study.subject), dataset_of(cfg, problem)
        params |= derived(problem)
    tags["mlflow.note.content"] = f"{escaped(about)}\n\n{repeating(tags)}\n\nfiles: {as_code(directory)}"
    run_id, before = study.earlier
    if run_id is not None and not tracker.goes_on(run_id, before, params):
        tags["continues"], run_id = run_id, None
    try:
        with stop.raising():
            write_sources(directory / ".hydra")
            name = short_name(study.subject, varied, given)
            tracker.start(RunStart(name, directory, params, tags, dataset=dataset), run_id)
            yield tracker
    except BaseException as error:
        if isinstance(error, InputError) and run_id is None and job is None:
            tracker.discard()
        else:
            tracker.finish("KILLED" if isinstance(error, KeyboardInterrupt) else "FAILED", reason_of(error))
        raise


def title_of(problem: "Problem", subject: str) -> str:
    """Title for the pictures of a run: `subject`, the objective and the number of landmarks K."""
    return f"{subject} {problem.objective.name} K={problem.count}"


def dataset_of(cfg: DictConfig, problem: "Problem") -> tuple[str, str]:
    """Name and digest of a problem; mlflow calls this pair a dataset, and can list the runs on one dataset.

    Equal problems have equal digests, whichever options compose them. A frozen problem of the suite has its own name
    and digest.
    """
    if isinstance(suite := cfg.get("suite"), str):
        from lmd.suite import document

        if (frozen := document(suite)).problem["deployment"].get("count") == problem.count:
            return suite, frozen.hash
    placed = {key: cfg.deployment[key] for key in DECIDED if cfg.deployment.get(key) is not None}
    cameras = ("cameras", "body", "deployment") if "cameras" in cfg else ()
    settings = flat_settings(cfg, *(group for group in GROUPS if group in cfg), *cameras)
    called = " ".join(dict.fromkeys([choices().get("room", ""), choices().get("camera", "")]))
    return title_of(problem, called), digest(settings, placed, problem.count)[:DATASET_DIGITS]


def derived(problem: "Problem") -> dict[str, Any]:
    """Parameters of a run that follow from its problem: the number of landmarks, and the number for each tag size."""
    counts = problem.scene.tag.counts
    return {"deployment.count": problem.count, **({} if counts is None else {"tag.counts": list(counts)})}


def log_child(
    tracking: DictConfig, run: RunStart, parent: str | None, metrics: Mapping[str, float], curve: Curve = ()
) -> None:
    """Record a finished run as the child of another run, with the file of landmarks in its folder.

    Args:
        tracking: config group `tracking`.
        run: description of the finished run.
        parent: id of the parent run; None for none.
        metrics: metrics of the finished run, keyed by name.
        curve: curve of the best fitness in the finished run, see `Tracker.log_curve`.
    """
    tracker: Tracker = instantiate(tracking)
    tracker.start(run if parent is None else replace(run, tags={**run.tags, PARENT_TAG: parent}))
    tracker.log_curve("best_fitness", curve)
    tracker.log_metrics(metrics)
    tracker.log_artifacts([run.folder / LANDMARKS])
    tracker.finish("FINISHED")
