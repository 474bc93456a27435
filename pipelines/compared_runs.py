"""The runs of a comparison: what each is to do, and what it leaves in a folder of its own, from which one goes on."""

import shutil
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

from omegaconf import DictConfig

from .app import flat_settings
from .documents import read_document, write_document
from .operations.sweeps.names import digest
from .optimise import SAME_WHEN_RESUMED
from .outputs import columns_of

if TYPE_CHECKING:
    from lmd.evaluation.comparison import OptimiserRun

LANDMARKS, HISTORY, RECORD = FILES = "landmarks.csv", "history.csv", "run.json"


@dataclass(frozen=True, eq=False)
class Job:
    """A run that is to be compared.

    Args:
        optimiser: its entry of `optimisers`.
        cfg: of `optimise`, for this entry.
        seed: of the run.
    """

    optimiser: str
    cfg: DictConfig
    seed: int

    @property
    def name(self) -> str:
        """What the run is called."""
        return f"{self.optimiser} seed={self.seed}"

    @cached_property
    def digest(self) -> str:
        """A digest that is equal for runs that must find the same."""
        return digest(flat_settings(self.cfg, *SAME_WHEN_RESUMED, "budget", "validate"), self.seed)

    def folder(self, comparison: Path) -> Path:
        """The folder of the run below that of its comparison."""
        return comparison / "runs" / self.name.replace("/", "_")

    def save(self, comparison: Path, run: "OptimiserRun", parent: str | None, ups: bool) -> None:
        """Write what the run has found.

        Args:
            comparison: the folder of the comparison.
            parent: the tracked run of the comparison, if any.
            ups: as for `Deployment.to_csv`.
        """
        from lmd.core.tables import write_table

        folder = self.folder(comparison)
        folder.mkdir(parents=True, exist_ok=True)  # a sweep may do a lost job again
        run.deployment.to_csv(folder / LANDMARKS, ups)
        write_table(folder / HISTORY, columns_of(run.history))
        write_document(folder / RECORD, {"digest": self.digest, "parent": parent, "metrics": dict(run.metrics)})

    def saved(self, comparison: Path) -> "tuple[OptimiserRun, str | None] | None":
        """What the run has found in a comparison, and the tracked run of that; None if it is not there.

        Raises:
            InputError: its tables are damaged, or one of its files is a link that leads out of the comparison.
        """
        from lmd.core.checks import InputError
        from lmd.core.tables import read_numbers
        from lmd.evaluation.comparison import OptimiserRun
        from lmd.optimisers.ledger import Record
        from lmd.scene.deployment import Deployment

        folder = self.folder(comparison)
        for name in FILES:
            if not (folder / name).resolve().is_relative_to(comparison.resolve()):
                raise InputError(f"resume: {str(folder / name)!r} is a link that leads out of the folder.", "resume")
        record: dict[str, Any] = read_document(folder / RECORD, lambda values: {**values}) or {}
        if record.get("digest") != self.digest:
            return None
        rows = read_numbers(folder / HISTORY, [*columns_of([])], name="resume").tolist()
        history, landmarks = [Record(*row) for row in rows], Deployment.from_csv(folder / LANDMARKS)
        return OptimiserRun(self.optimiser, self.seed, record["metrics"], history, landmarks), record["parent"]


@dataclass(frozen=True)
class Kept:
    """What an earlier comparison has left.

    Args:
        runs: the finished ones.
        parent: the tracked run of that comparison, if any.
    """

    runs: "Mapping[Job, OptimiserRun]"
    parent: str | None


def kept_of(resume: Any, jobs: Iterable[Job], directory: Path) -> Kept:
    """The finished runs in the folder of an earlier comparison, which are copied to `directory`.

    Raises:
        InputError: there is no such folder, or what is there is damaged.
    """
    from lmd.core.checks import InputError, file_path

    earlier = file_path("resume", resume)
    if not earlier.is_dir():
        raise InputError(f"resume = {str(resume)!r} is no folder of a comparison.", "resume")
    found = {job: saved for job in jobs if (saved := job.saved(earlier)) is not None}
    if earlier.resolve() != directory.resolve():
        for job in found:
            _copy(job, earlier, directory)
    parent = next((parent for _, parent in found.values()), None)
    return Kept({job: run for job, (run, _) in found.items()}, parent)


def _copy(job: Job, earlier: Path, directory: Path) -> None:
    """Copy the files of a run that was read from the folder of a comparison to that of another."""
    folder = job.folder(directory)
    folder.mkdir(parents=True, exist_ok=True)
    for name in FILES:
        shutil.copyfile(job.folder(earlier) / name, folder / name)
