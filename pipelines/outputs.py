"""Directory of a run and its files; each file is written completely or not at all."""

import atexit
import errno
import json
import os
import shutil
import sys
import tempfile
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

from hydra.experimental.callback import Callback as HydraCallback
from omegaconf import DictConfig

from .app import LOCK, discard_empty, doing

if TYPE_CHECKING:
    from lmd.optimisers.ledger import Record

LEAST_FREE = 1 << 20  # minimum free disk space at the beginning of a run, bytes
JOB_VARIABLE = "LMD_JOB"  # environment variable with the folder of the job, in a process of a sweep
# Commands that search or score, each with the file that it writes last.
RESULTS = {
    **dict.fromkeys(("optimise", "evaluate"), "metrics.json"),
    "compare": "comparison.csv",
    "tradeoff": "tradeoff.json",
    "survey": "survey.json",
}
PARTIAL = ".partial_"  # prefix of folders from which files are moved once all are written
HISTORY_FILE = "history.csv"
RESERVED_BYTES = 1 << 16  # reserved disk space, bytes: enough for landmarks and figures of a thousand tags

Content = TypeVar("Content")
locks = ExitStack()
"""Locks on directories, which this process holds until its command ends."""


class RunDirectory(HydraCallback):
    """Hydra callback for the directory of a run.

    Before the run, it checks the disk and locks this directory and the directory of an earlier run that is resumed.
    After the run, it removes the directory if there are no results.
    """

    def on_run_start(self, config: DictConfig, **kwargs: Any) -> None:
        """Check the disk, and lock the run's directory and the directory of the run that is resumed.

        The run's directory is removed at exit if it has no results.
        """
        directory, resume = Path(config.hydra.run.dir).resolve(), config.get("resume")
        resumed = directory if resume is None else Path(str(resume)).resolve()
        self._check(directory)
        result, is_job = directory / RESULTS.get(str(config.hydra.job.name), ""), JOB_VARIABLE in os.environ
        if not is_job and result.is_file() and (resume is None or resumed != directory):
            text = f"hydra.run.dir: {str(directory)!r} holds {result.name} of an earlier run"
            go_on = ", or go on with resume=DIR" if "resume" in config else ""
            sys.exit(f"error: {text}: name another folder, or delete this one{go_on}.")
        directory.mkdir(parents=True, exist_ok=True)
        atexit.register(discard_empty, directory)
        # The process that supervises a job has already locked the job's directory.
        for place, key in () if is_job else {resumed: "resume", directory: "hydra.run.dir"}.items():
            with suppress(ImportError, OSError):  # a system without locks, or a directory of another user
                if locks.enter_context(held(place, wait=False)) is None:
                    sys.exit(f"error: {key}: another process is at work in {str(place)!r}.")
                locks.callback((place / LOCK).unlink, missing_ok=True)

    def on_multirun_start(self, config: DictConfig, **kwargs: Any) -> None:
        """Check that files can be written to the sweep's directory."""
        self._check(Path(config.hydra.sweep.dir))

    @staticmethod
    def _check(directory: Path) -> None:
        """Exit the process with a message if no files can be written to `directory`.

        If the directory does not exist yet, the nearest existing folder above it is checked.
        """
        directory = directory.resolve()
        there = next(place for place in (directory, *directory.parents) if place.exists())
        usage = shutil.disk_usage(there)
        for is_so, problem in (
            (not there.is_dir(), f"{there} is no folder"),
            (not os.access(there, os.W_OK | os.X_OK), f"{there} cannot be written to"),
            (usage.free < LEAST_FREE, f"no space is left there ({usage.free} bytes)"),
        ):
            if is_so:
                sys.exit(f"error: {directory}: {problem}")


@contextmanager
def held(directory: Path, wait: bool = True) -> Iterator[int | None]:
    """Context that locks a directory for this process and for processes that inherit the yielded file descriptor.

    Args:
        directory: the directory.
        wait: True to wait until another process that holds the lock releases it.

    Yields:
        file descriptor of the lock; None if another process holds the lock and `wait` is False.

    Raises:
        OSError: the file of the lock cannot be written.
    """
    import fcntl

    with (directory / LOCK).open("w") as lock:
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            if not wait:
                yield None
                return
            print(f"{directory} is still being worked on by another process; waiting for it", flush=True)
            fcntl.flock(lock, fcntl.LOCK_EX)
        yield lock.fileno()


def all_or_none(directory: Path, write: Callable[[Path], object]) -> list[Path]:
    """Call `write` with a temporary folder, then move the written files to `directory`; after an error, leave none.

    Returns:
        paths of the moved files in `directory`, sorted.

    Raises:
        OSError: a file cannot be written, or has the name of a folder in `directory`.
    """
    for left in directory.glob(f"{PARTIAL}*"):  # left by a killed process
        shutil.rmtree(left, ignore_errors=True)
    with tempfile.TemporaryDirectory(dir=directory, prefix=PARTIAL) as name:
        write(Path(name))
        moves = {path: directory / path.relative_to(name) for path in sorted(Path(name).rglob("*")) if path.is_file()}
        for target in moves.values():
            if target.is_dir():
                raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR), str(target))
            target.parent.mkdir(parents=True, exist_ok=True)
        return [path.replace(target) for path, target in moves.items()]


def write_all(directory: Path, writers: Mapping[str, Callable[[Path], object]]) -> list[Path]:
    """Write several files to a directory, either all of them or none, and return their paths.

    Args:
        directory: the directory.
        writers: for each file name, the function that writes the file to a given path.
    """

    def fill(folder: Path) -> None:
        for name, write in writers.items():
            with doing(f"writing {name}"):
                (folder / name).parent.mkdir(parents=True, exist_ok=True)
                write(folder / name)

    return all_or_none(directory, fill)


@contextmanager
def space_reserved(directory: Path) -> Iterator[None]:
    """Context that reserves disk space for the results, in case other files fill the disk during the run.

    Raises:
        OSError: the disk is already full.
    """
    reserve = directory / ".reserve"
    reserve.write_bytes(bytes(RESERVED_BYTES))
    try:
        yield
    finally:
        with suppress(OSError):
            reserve.unlink()


def read_history(path: Path) -> "list[Record]":
    """Read the history of a run from a file: the best fitness against evaluations and time."""
    from lmd.core.tables import read_numbers
    from lmd.optimisers.ledger import Record, columns_of

    return [Record(*row) for row in read_numbers(path, [*columns_of([])], name=HISTORY_FILE).tolist()]


def read_document(path: Path, content_of: Callable[[dict[str, Any]], Content]) -> Content | None:
    """Read a JSON document, and return its converted content; None if there is no file.

    A damaged file is renamed with a warning, and counts as missing.

    Args:
        path: path of the file.
        content_of: function that converts the keys and values of the document; it raises ValueError, KeyError or
            TypeError if the document is damaged.
    """
    if not path.is_file():  # a pipe would block
        return None
    try:
        return content_of(dict(json.loads(path.read_text())))
    except (ValueError, KeyError, TypeError, RecursionError) as error:
        aside = path.replace(path.with_name(f"{path.name}.damaged"))
        reason = " ".join(f"{type(error).__name__}: {error}".split())
        kept = f"it is kept as {aside.name}, and its content is computed again"
        print(f"warning: {path} is damaged ({reason}); {kept}", file=sys.stderr)
        return None


def write_document(path: Path, document: Mapping[str, Any]) -> None:
    """Write a JSON document completely or not at all, even if the process is killed or the power fails."""
    from lmd.core.files import write_whole

    write_whole(path, (json.dumps(document, indent=2) + "\n").encode())
