"""Interface of trackers, which record runs; the base class records nothing."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

PARENT_TAG = "mlflow.parentRunId"  # tag with the parent of a run

Entry = dict[str, Any]  # entry of a journal


@dataclass(frozen=True)
class RunStart:
    """Description of a run that is about to be recorded."""

    name: str
    """Name of the run in lists."""
    folder: Path
    """Folder that holds the run's files, and its journal until all entries are sent."""
    params: Mapping[str, Any] = field(default_factory=dict)
    """Settings of the run, keyed by config key."""
    tags: Mapping[str, str] = field(default_factory=dict)
    """Further labels by which the run can be found (tags of mlflow)."""
    ago: float = 0.0
    """Time since the run began, seconds."""
    dataset: tuple[str, str] | None = None
    """Name and digest of the problem, which mlflow calls a dataset; None for a run without a problem."""


class NoTracker:
    """Tracker that records nothing (`tracking=none`)."""

    @property
    def run_id(self) -> str | None:
        """Id of the run that was started; None if nothing is recorded."""
        return None

    def start(self, run: RunStart, run_id: str | None = None) -> None:
        """Begin to record a run, or continue the record of the run `run_id` unless that run was deleted.

        Raises:
            InputError: a new run cannot be recorded in the store.
        """

    def goes_on(self, run_id: str, folder: Path, params: Mapping[str, Any]) -> bool:
        """True if the record of the run `run_id` can be continued.

        The run must be unfinished and have the parameters `params`. The newest process that recorded this run must have
        written its files to `folder`; otherwise the run was already continued in another folder.

        Raises:
            InputError: the store cannot be used.
        """
        return False

    def discard(self) -> None:
        """Delete the record of the run that was started."""

    def settle(self, run: RunStart, status: str, reason: str = "", files: Sequence[Path] = ()) -> None:
        """End the recorded attempts of one job, after the job's process has ended, and keep only the newest attempt.

        The attempts are the runs that have the `tags` of `run`. The `status` and the `reason` are given to two kinds of
        attempts: those whose status is still RUNNING, and those marked as failed because their process had ended. Then
        all attempts except the newest are deleted, and the newest gets the `files`. If there is no attempt, `run`
        itself is recorded unless the status is FINISHED.

        Raises:
            InputError: the store cannot be used.
        """

    def log_curve(self, metric: str, points: Iterable[tuple[int, float, float]]) -> None:
        """Record a curve of the metric `metric` over the run.

        `points` are triples (step, value, seconds since the beginning of the run).
        """

    def log_metrics(self, metrics: Mapping[str, float]) -> None:
        """Record the final metrics of the run."""

    def log_artifacts(self, paths: Iterable[Path]) -> None:
        """Record copies of the files `paths` with the run."""

    def finish(self, status: str, reason: str = "") -> None:
        """End the run with the status FINISHED, KILLED or FAILED, and record the reason as a label (tag of mlflow)."""

    def describe(self) -> str:
        """One-line text that names the place where the run is recorded."""
        return "not tracked (tracking=none)"

    def views(self, params: Sequence[str]) -> list[str]:
        """Links to pages that show the child runs of the started run, grouped by the parameters `params`.

        The list is empty if the store does not answer.
        """
        return []


Tracker = NoTracker
