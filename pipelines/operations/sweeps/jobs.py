"""A sweep and its jobs, as their records on disk describe them."""

from collections.abc import Mapping
from dataclasses import dataclass


@dataclass(frozen=True)
class Sweep:
    """A sweep.

    Args:
        name: the experiment it runs, or what it varies.
        varied: the config keys that differ between its jobs, those of earlier commands first.
        run_id: its tracked run, the parent of its jobs' runs; None where nothing is recorded.
        round: how many commands have grown it before the last one.
    """

    name: str
    varied: tuple[str, ...]
    run_id: str | None
    round: int = 0


@dataclass(frozen=True)
class Job:
    """A job of a sweep.

    Args:
        sweep: the name of its sweep.
        parent: the tracked run of its sweep, if any.
        number: its place in the sweep, from 0.
        overrides: its overrides, as on the command line.
        varied: those among them that differ from job to job, as `{"objective.n": "2"}`.
        status: `running`, `finished`, `interrupted`, `failed` by its own doing, or `killed`.
        value: what the finished job returned.
        reason: why it did not finish.
        seconds: wall time it took.
        round: of the sweep, when it was last asked for.
    """

    sweep: str
    parent: str | None
    number: int
    overrides: tuple[str, ...]
    varied: Mapping[str, str]
    status: str = "running"
    value: float | None = None
    reason: str = ""
    seconds: float = 0.0
    round: int = 0

    @property
    def label(self) -> str:
        """What tells it from the other jobs."""
        return " ".join(f"{key}={value}" for key, value in self.varied.items()) or " ".join(self.overrides)

    def tags(self, name: str) -> dict[str, str]:
        """The tags of its tracked run that lead to the sweep, and to its folder of that `name`."""
        from ..tracking import PARENT_TAG

        return {"sweep": self.sweep, "job": name} | ({PARENT_TAG: self.parent} if self.parent else {})


def reason_of(error: BaseException) -> str:
    """What ended a run, in one line."""
    from lmd.core.checks import InputError

    if isinstance(error, SystemExit) and not isinstance(error.code, str):
        return f"exited with code {error.code or 0} before it had finished"
    text = " ".join(str(error).split())
    return text if isinstance(error, InputError | SystemExit) else f"{type(error).__name__}: {text}".rstrip(": ")
