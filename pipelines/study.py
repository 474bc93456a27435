"""Spine of the commands: here a study is tracked, written whole or not at all, kept, printed, stopped and resumed."""

import sys
from collections.abc import Callable, Generator, Iterable, Mapping
from contextlib import closing, suppress
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from omegaconf import DictConfig

from .app import run_directory, say
from .operations.signals import Stopped, stop
from .outputs import write_all, write_document

if TYPE_CHECKING:
    from lmd.problem import Problem

    from .operations.tracking import Tracker

Curve = Iterable[tuple[int, float, float]]


@dataclass(frozen=True)
class Report:
    """Part of the results of a study, which is written and printed as soon as the study gives it."""

    files: Mapping[str, Any] = field(default_factory=dict)
    """Contents by the names of files: a table, columns of a table, keys of a JSON document, text, or a function that
    writes to a path."""
    figures: Mapping[str, float] = field(default_factory=dict)
    """Figures for the tracked run."""
    curves: Mapping[str, Curve] = field(default_factory=dict)
    """Curves for the tracked run, see `Tracker.log_curve`."""
    text: str = ""
    """Text for the terminal."""
    lines: Mapping[str, str] = field(default_factory=dict)
    """Labelled lines for the end of the terminal's text."""
    is_whole: bool = False
    """The results are complete: a signal from here on only leaves out further reports."""
    is_extra: bool = False
    """Files that do not fit on the disk are left out, and a signal interrupts their writing."""
    is_cut: bool = False
    """A signal has ended the study early; the process exits with the signal's code."""

    def below(self, folder: str) -> "Report":
        """The report with its files in a folder."""
        return replace(self, files={f"{folder}/{name}": content for name, content in self.files.items()})


class Earlier(NamedTuple):
    """A run that another run continues."""

    run_id: str | None
    """Its tracked run, if it has one."""
    folder: Path
    """The folder of its files."""


@dataclass(frozen=True)
class Study:
    """A study whose settings are checked and whose subjects are built."""

    subject: str
    """Subject of the run, in a word."""
    run: "Callable[[Tracker], Report | Iterable[Report]]"
    """Function that conducts it, and returns its report or gives one after the other."""
    about: str = ""
    """Description of the run; by default the title of its problem."""
    problem: "Problem | None" = None
    """Its problem, if it has one."""
    earlier: Earlier | None = None
    """The run that it continues."""
    hint: Callable[[], str] = str
    """Function that returns how to go on after an interruption."""
    returned: str = ""
    """Figure that a sweep gets; empty for none."""


def conduct(cfg: DictConfig, study: Study) -> float | None:
    """Conduct a study as a tracked run, and return the figure for sweepers.

    Args:
        cfg: configuration of the run.
        study: the study.

    Raises:
        InputError: the study refuses its input.
        OSError: the results cannot be written.
    """
    from lmd.core.words import labelled

    from .tracked_run import again, tracked

    directory, files, lacking = run_directory(), dict[Path, None](), list[str]()
    figures, lines, is_cut = dict[str, float](), dict[str, str](), False
    try:
        with tracked(cfg, study) as tracker:
            is_whole = False
            try:
                with stop.raising(), closing(_reports(study, tracker)) as reports:
                    report = next(reports, None)
                    while report is not None:
                        try:
                            written, failed = _written(directory, report)
                            files |= dict.fromkeys(written)
                            lacking += failed
                            figures |= report.figures
                            lines |= report.lines
                            is_whole, is_cut = is_whole or report.is_whole, is_cut or report.is_cut
                            _log(tracker, report)
                            if report.text:
                                say(report.text)
                            report = next(reports, None)
                        except Stopped as told:  # the study may have a last report
                            report = reports.throw(told)
            except Stopped:
                if not is_whole:
                    raise
                lacking.append("told to stop, it has left out the rest")
            records = sorted(path for path in (directory / ".hydra").glob("*") if path.is_file())
            tracker.log_artifacts([*files, *records])
            tracker.finish("KILLED" if is_cut else "FINISHED")
    except (Stopped, OSError):
        _print_hint(study)
        raise
    names = ", ".join(str(path.relative_to(directory)) for path in files)
    say(labelled({**lines, "files": f"{directory}: {names}", "mlflow": tracker.describe()}))
    if lacking:
        print(f"warning: {'; '.join(lacking)}{again(directory)}", file=sys.stderr)
    if is_cut:
        _print_hint(study)
        sys.exit(stop.code)
    return figures.get(study.returned)


def _reports(study: Study, tracker: "Tracker") -> Generator[Report, None, None]:
    found = study.run(tracker)
    yield from (found,) if isinstance(found, Report) else found


def _written(directory: Path, report: Report) -> tuple[list[Path], list[str]]:
    """Write the files of a report; returns the files, and a text for each one that does not fit on the disk."""
    writers = {name: _writer(name, content) for name, content in report.files.items()}
    if not report.is_extra:
        with stop.shielded():
            return write_all(directory, writers), []
    files, failed = list[Path](), list[str]()
    for name, write in writers.items():
        try:
            files += write_all(directory, {name: write})
        except OSError as error:
            failed.append(f"{name} could not be written ({error.strerror or error})")
    return files, failed


def _writer(name: str, content: Any) -> Callable[[Path], object]:
    """Function that writes a content to a path."""
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


def _log(tracker: "Tracker", report: Report) -> None:
    """Record the figures and curves of a report."""
    if report.figures:
        tracker.log_metrics(report.figures)
    for name, points in report.curves.items():
        tracker.log_curve(name, points)


def _print_hint(study: Study) -> None:
    with suppress(OSError):
        if hint := study.hint():
            print(f"interrupted; {hint}", file=sys.stderr)
