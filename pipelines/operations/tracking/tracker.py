"""Experiment tracking: interface of trackers; the interface itself records nothing."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

PARENT_TAG = "mlflow.parentRunId"  # tag with the parent of a run

Entry = dict[str, Any]  # entry of a journal


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
    """Further tags, by which runs can be found."""
    ago: float = 0.0
    """Time since the run began, seconds."""
    dataset: tuple[str, str] | None = None
    """Name and digest of the problem, called a dataset by mlflow; None for a run without a problem."""


class NoTracker:
    """Tracker that records nothing (`tracking=none`)."""

    @property
    def run_id(self) -> str | None:
        """Id of the started run; None if nothing is recorded."""
        return None

    def start(self, run: RunStart, run_id: str | None = None) -> None:
        """Begin a run, or continue the run `run_id` if it was not deleted.

        Raises:
            InputError: the store cannot be used for a new run.
        """

    def goes_on(self, run_id: str, folder: Path, params: Mapping[str, Any]) -> bool:
        """True if the run `run_id` can be continued as one history: it has these params, is unfinished, was last in
        `folder`, and has not been continued by another run.

        Raises:
            InputError: the store cannot be used.
        """
        return False

    def discard(self) -> None:
        """Delete the started run."""

    def settle(self, run: RunStart, status: str, reason: str = "", files: Sequence[Path] = ()) -> None:
        """Settle the runs with the tags of `run`, whose processes have ended. Runs that are RUNNING, or that were ended
        because their process was gone, are ended with `status`. Only the newest run is kept, and gets the files. If
        there is no run, one is recorded unless the status is FINISHED.

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
        """Text that tells where the run is recorded, in one line."""
        return "not tracked (tracking=none)"

    def views(self, params: Sequence[str]) -> list[str]:
        """Links to the child runs of this run, grouped by params; empty if the store does not answer."""
        return []


Tracker = NoTracker
