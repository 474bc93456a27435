"""What a run records, whatever keeps it."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Protocol

from typing_extensions import override

PARENT_TAG = "mlflow.parentRunId"  # tag with the run that this one is shown below

Entry = dict[str, Any]  # of a journal


@dataclass(frozen=True)
class RunStart:
    """What is known of a run when it begins.

    Args:
        name: shown in lists.
        folder: where its files are; a record that cannot be handed in waits there.
        params: its settings.
        tags: further facts, by which runs can be found.
        ago: seconds since it began.
    """

    name: str
    folder: Path
    params: Mapping[str, Any] = field(default_factory=dict)
    tags: Mapping[str, str] = field(default_factory=dict)
    ago: float = 0.0


class Tracker(Protocol):
    """Where a run is recorded."""

    @property
    def run_id(self) -> str | None:
        """Identifies the started run; None where nothing is recorded."""

    def start(self, run: RunStart, run_id: str | None = None) -> None:
        """Begin a run, or continue the one called `run_id`.

        Raises:
            InputError: the store cannot be used for a new run.
        """

    def goes_on(self, run_id: str, folder: Path, params: Mapping[str, Any]) -> bool:
        """Whether the run called `run_id`, continued, is still one history: with these params, unfinished, last in
        `folder` and continued by nobody since.

        Raises:
            InputError: the store cannot be used.
        """

    def discard(self) -> None:
        """Forget the run: it should not have been started."""

    def end_lost(self, tags: Mapping[str, str], reason: str) -> bool:
        """End as FAILED the runs with these tags that are still RUNNING, or ended because their process had gone.

        Returns:
            False if no run at all has these tags.

        Raises:
            InputError: the store cannot be used.
        """

    def log_curve(self, metric: str, points: Iterable[tuple[int, float, float]]) -> None:
        """Log a curve of (step, value, seconds since the run began)."""

    def log_metrics(self, metrics: Mapping[str, float]) -> None:
        """Log final figures."""

    def log_artifacts(self, paths: Iterable[Path]) -> None:
        """Keep copies of files."""

    def finish(self, status: str, reason: str = "") -> None:
        """End the run as FINISHED, KILLED or FAILED, with the reason as a tag."""

    def describe(self) -> str:
        """One line that tells the user where the run is."""

    def views(self, params: Sequence[str]) -> list[str]:
        """Lines that tell where the runs below this one are seen, grouped by params; none if the store is lost."""


class NoTracker(Tracker):
    """Records nothing (`tracking=none`): what it is told leads to nothing."""

    @property
    @override
    def run_id(self) -> None:
        """There is none."""

    @override
    def goes_on(self, run_id: str, folder: Path, params: Mapping[str, Any]) -> bool:
        return False

    @override
    def end_lost(self, tags: Mapping[str, str], reason: str) -> bool:
        return True

    @override
    def describe(self) -> str:
        return "not tracked (tracking=none)"

    @override
    def views(self, params: Sequence[str]) -> list[str]:
        return []
