"""Interface of experiment tracking, and the tracker that records nothing."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Protocol

from typing_extensions import override

PARENT_TAG = "mlflow.parentRunId"  # tag with the parent of a run

Entry = dict[str, Any]  # entry of a journal


@dataclass(frozen=True)
class Dataset:
    """Problem of a run, which mlflow calls a dataset."""

    name: str
    """Name in mlflow's filter of datasets."""
    digest: str
    """Digest of everything that decides the fitness."""
    settings: Mapping[str, str]
    """Its parts, in words."""


@dataclass(frozen=True)
class RunStart:
    """Description of a run at its beginning."""

    name: str
    """Name in lists."""
    folder: Path
    """Folder of the run's files, and of its journal until all entries are sent."""
    params: Mapping[str, Any] = field(default_factory=dict)
    """Settings."""
    tags: Mapping[str, str] = field(default_factory=dict)
    """Further facts for finding runs."""
    ago: float = 0.0
    """Time since the run began, seconds."""
    dataset: Dataset | None = None
    """Its problem, if it has one."""


class Tracker(Protocol):
    """Records a run."""

    @property
    def run_id(self) -> str | None:
        """Id of the started run; None if nothing is recorded."""

    def start(self, run: RunStart, run_id: str | None = None) -> None:
        """Begin a run, or continue the run `run_id`.

        Raises:
            InputError: the store cannot be used for a new run.
        """

    def goes_on(self, run_id: str, folder: Path, params: Mapping[str, Any]) -> bool:
        """True if the run `run_id` can be continued as one history: it has these params, is unfinished, was last in
        `folder`, and was not continued by another run.

        Raises:
            InputError: the store cannot be used.
        """

    def has(self, run_id: str) -> bool:
        """True if the run `run_id` can be continued: the experiment has it, and it was not deleted.

        Raises:
            InputError: the store cannot be used.
        """

    def discard(self) -> None:
        """Delete the started run."""

    def end_lost(self, tags: Mapping[str, str], reason: str, status: str = "FAILED") -> bool:
        """End the runs with these tags that are RUNNING, or were ended because their process had ended.

        Returns:
            False if no run has these tags.

        Raises:
            InputError: the store cannot be used.
        """

    def keep_newest(self, tags: Mapping[str, str]) -> None:
        """Delete all runs with these tags but the one that began last.

        Raises:
            InputError: the store cannot be used.
        """

    def attach(self, tags: Mapping[str, str], path: Path) -> None:
        """Store a copy of a file with the runs that have these tags.

        Raises:
            InputError: the store cannot be used.
        """

    def log_curve(self, metric: str, points: Iterable[tuple[int, float, float]]) -> None:
        """Log a curve of points (step, value, seconds since the beginning of the run)."""

    def log_metrics(self, metrics: Mapping[str, float]) -> None:
        """Log final figures."""

    def log_artifacts(self, paths: Iterable[Path]) -> None:
        """Store copies of files."""

    def finish(self, status: str, reason: str = "") -> None:
        """End the run as FINISHED, KILLED or FAILED, with the reason as a tag."""

    def describe(self) -> str:
        """Text about the place of the run, in one line."""

    def views(self, params: Sequence[str]) -> list[str]:
        """Links to the runs below this one, grouped by params, and to this one; none if the store does not answer."""


class NoTracker(Tracker):
    """Records nothing (`tracking=none`)."""

    @property
    @override
    def run_id(self) -> None:
        """See `Tracker.run_id`: None, as nothing is recorded."""

    @override
    def goes_on(self, run_id: str, folder: Path, params: Mapping[str, Any]) -> bool:
        return False

    @override
    def has(self, run_id: str) -> bool:
        return True

    @override
    def end_lost(self, tags: Mapping[str, str], reason: str, status: str = "FAILED") -> bool:
        return True

    @override
    def describe(self) -> str:
        return "not tracked (tracking=none)"

    @override
    def views(self, params: Sequence[str]) -> list[str]:
        return []
