"""Directory of a run and its files, each written whole or not at all."""

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
from typing import Any, TypeVar

from hydra.experimental.callback import Callback as HydraCallback
from omegaconf import DictConfig

from .app import LOCK, discard_empty

LEAST_FREE = 1 << 20  # least free disk space for a run to begin, bytes
JOB_VARIABLE = "LMD_JOB"  # environment variable with the folder of the job that a process of a sweep does
# Commands that search or score, each with a file that it writes last.
RESULTS = {
    **dict.fromkeys(("optimise", "evaluate"), "metrics.json"),
    "compare": "comparison.csv",
    "tradeoff": "tradeoff.json",
    "survey": "survey.json",
}
PARTIAL = ".partial_"  # prefix of folders whose files are moved once all files are written
RESERVED_BYTES = 1 << 16  # reserved disk space, bytes: more than landmarks and figures of a thousand tags

locks = ExitStack()
"""Locks of directories that this process holds until its command ends."""


class RunDirectory(HydraCallback):
    """Hydra callback that checks the disk before a run, locks the run's directory and the directory that it resumes,
    and removes the directory of a run without results.
    """

    def on_run_start(self, config: DictConfig, **kwargs: Any) -> None:
        """Check the disk, lock the directories, and register the removal of an empty directory."""
        directory = Path(config.hydra.run.dir).resolve()
        self._check(directory)
        self._check_earlier(directory, config)
        directory.mkdir(parents=True, exist_ok=True)
        self._lock("hydra.run.dir", directory)
        atexit.register(discard_empty, directory)
        resumed = Path(str(config.get("resume") or directory)).resolve()
        if resumed != directory:
            self._lock("resume", resumed)

    def _lock(self, key: str, directory: Path) -> None:
        """Lock a directory for this process, or exit if another process works there."""
        if JOB_VARIABLE in os.environ:  # the process that watches a job has locked its directory
            return
        lock: int | None = 0
        with suppress(ImportError, OSError):  # a system without locks, or the directory of another user
            lock = locks.enter_context(held(directory, wait=False))
        if lock is None:
            print(f"error: {key}: another process is at work in {str(directory)!r}.", file=sys.stderr)
            sys.exit(1)
        if lock:
            locks.callback((directory / LOCK).unlink, missing_ok=True)

    def on_multirun_start(self, config: DictConfig, **kwargs: Any) -> None:
        """Check the disk of the sweep's directory."""
        self._check(Path(config.hydra.sweep.dir))

    @staticmethod
    def _check_earlier(directory: Path, config: DictConfig) -> None:
        """Exit if the command would overwrite the results of an earlier run, unless it resumes that run."""
        result, resume = RESULTS.get(str(config.hydra.job.name)), config.get("resume")
        is_resumed = resume is not None and Path(str(resume)).resolve() == directory
        if result is None or not (directory / result).is_file() or is_resumed or JOB_VARIABLE in os.environ:
            return
        text = f"hydra.run.dir: {str(directory)!r} holds {result} of an earlier run"
        go_on = ", or go on with resume=DIR" if "resume" in config else ""
        print(f"error: {text}: name another folder, or delete this one{go_on}.", file=sys.stderr)
        sys.exit(1)

    @staticmethod
    def _check(directory: Path) -> None:
        there = directory.resolve()
        while not there.exists():
            there = there.parent
        usage = shutil.disk_usage(there)
        if not there.is_dir():
            problem = f"{there} is no folder"
        elif not os.access(there, os.W_OK | os.X_OK):
            problem = f"{there} cannot be written to"
        elif usage.free < LEAST_FREE:
            problem = f"no space is left there ({usage.free} bytes)"
        else:
            return
        print(f"error: {directory.resolve()}: {problem}", file=sys.stderr)
        sys.exit(1)


@contextmanager
def held(directory: Path, wait: bool = True) -> Iterator[int | None]:
    """Lock a directory for this process and all processes that inherit the descriptor; None if another process has
    locked it.

    Args:
        directory: the directory.
        wait: True to wait for the other process.

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
    """Call `write` with a folder, then move the files in the folder to `directory`; after an error, no file is left.

    Returns:
        the files in `directory`, sorted.

    Raises:
        OSError: a file cannot be written, or has the name of a folder in `directory`.
    """
    for left in directory.glob(f"{PARTIAL}*"):  # left by a process that was killed
        shutil.rmtree(left, ignore_errors=True)
    with tempfile.TemporaryDirectory(dir=directory, prefix=PARTIAL) as name:
        write(Path(name))
        written = sorted(path for path in Path(name).rglob("*") if path.is_file())
        moves = [(path, directory / path.relative_to(name)) for path in written]
        for _, target in moves:
            if target.is_dir():
                raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR), str(target))
            target.parent.mkdir(parents=True, exist_ok=True)
        return [path.replace(target) for path, target in moves]


def write_all(directory: Path, writers: Mapping[str, Callable[[Path], object]]) -> list[Path]:
    """Write the files of `writers`, functions by file name, all or none; see `all_or_none`."""
    from .progress import doing

    def fill(folder: Path) -> None:
        for name, write in writers.items():
            with doing(f"writing {name}"):
                (folder / name).parent.mkdir(parents=True, exist_ok=True)
                write(folder / name)

    return all_or_none(directory, fill)


@contextmanager
def space_reserved(directory: Path) -> Iterator[None]:
    """Context in which disk space for the results is reserved, in case that the disk fills up meanwhile.

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


Content = TypeVar("Content")


def read_document(path: Path, content_of: Callable[[dict[str, Any]], Content]) -> Content | None:
    """Content of a JSON document; None without a file. A damaged file is renamed, with a warning, and ignored.

    Args:
        content_of: function that converts the keys and values of the document; it raises ValueError, KeyError or
            TypeError if the document is damaged.
    """
    if not path.is_file():  # a pipe would block
        return None
    try:
        return content_of(dict(json.loads(path.read_text())))
    except (ValueError, KeyError, TypeError, RecursionError) as error:
        aside = path.with_name(f"{path.name}.damaged")
        os.replace(path, aside)
        reason = " ".join(f"{type(error).__name__}: {error}".split())
        kept = f"it is kept as {aside.name}, and what it held is done again"
        print(f"warning: {path} is damaged ({reason}); {kept}", file=sys.stderr)
        return None


def write_document(path: Path, document: Mapping[str, Any]) -> None:
    """Write a JSON document, whole or not at all, also if the process is killed or the power fails."""
    from lmd.core.files import write_whole

    write_whole(path, (json.dumps(document, indent=2) + "\n").encode())
