"""Journal of a run: entries are written to disk before they are sent to the store.

If the store does not answer, the entries can be sent later. The labels of `this_process` tell a run whose process has
ended from a run that is still going on.
"""

import itertools
import json
import os
import re
import socket
import sys
from contextlib import suppress
from pathlib import Path

from lmd.core.checks import InputError, printable

from ...trust import PAGE
from .store import Store, now
from .tracker import Entry

FILE = "tracking.jsonl"  # file in the folder of the run until all entries are sent
GONE = "its process is gone: it was killed, or the machine was switched off"
BOOT = Path("/proc/sys/kernel/random/boot_id")
IDENTITY = re.compile(r"\d{1,9} \d{1,19} [0-9a-f-]{36}" if BOOT.is_file() else r"\d{1,9}")


class Journal:
    """Entries for the record of one run; each entry is a line of JSON in a file.

    Args:
        path: file of the journal.
        entries: entries that are already in the file.
    """

    def __init__(self, path: Path, entries: list[Entry]) -> None:
        self.path, self.entries, self.on_disk = path, entries, len(entries)  # number of entries in the file

    @classmethod
    def of(cls, folder: Path) -> "Journal":
        """Read the journal in the folder of a run; the journal is empty if there is no file.

        An incomplete last line is ignored.

        Args:
            folder: folder of the run.

        Raises:
            InputError: the file is not a journal, or names a file outside the folder.
        """
        path, entries = folder / FILE, []
        for line in path.read_text(errors="replace").splitlines() if path.is_file() else ():
            with suppress(ValueError, RecursionError):
                entries.append(json.loads(line))
        listed = [entry.get("files", []) if isinstance(entry, dict) else None for entry in entries]
        if not all(isinstance(files, list) and all(isinstance(file, str) for file in files) for files in listed):
            raise InputError(f"the journal in {folder} was not written by a run.")
        for file in itertools.chain.from_iterable(filter(None, listed)):
            if os.path.isfile(file) and not Path(file).resolve().is_relative_to(folder.resolve()):
                raise InputError(f"the journal in {folder} would send {file!r}, which is not in that folder ({PAGE}).")
        return cls(path, entries)

    @property
    def store(self) -> str | None:
        """Address of the store to which the run belongs; None if no store has accepted the run yet."""
        return next((str(entry["uri"]) for entry in reversed(self.entries) if {"run_id", "uri"} <= entry.keys()), None)

    def add(self, entry: Entry) -> None:
        """Add an entry to the journal.

        If the disk is full, the entry is kept in memory, and is written together with a later entry.
        """
        self.entries.append(entry)
        with suppress(OSError):
            self.write()

    def write(self) -> None:
        """Write the entries that are not on disk yet.

        Raises:
            OSError: the entries cannot be written.
        """
        self.path.parent.mkdir(parents=True, exist_ok=True)
        size = self.path.stat().st_size if self.path.exists() else 0
        try:
            with self.path.open("a") as file:
                file.write("".join(f"{json.dumps(entry)}\n" for entry in self.entries[self.on_disk :]))
        except OSError:
            with suppress(OSError):
                os.truncate(self.path, size)  # remove the part of the entry that fitted
            raise
        self.on_disk = len(self.entries)

    def remove(self) -> None:
        """Remove the journal's file; called when all entries have been sent."""
        with suppress(OSError):
            self.path.unlink(missing_ok=True)


def hand_in(journal: Journal, uri: str) -> str:
    """Send the journal of an ended run to the store `uri`, and remove the journal's file.

    Entries that are in the store already are not duplicated. If the run has not ended, nothing is sent or removed.

    Returns:
        text of one line about the outcome.

    Raises:
        InputError: the store cannot be used, or no run has written the journal.
    """
    entries = journal.entries
    last = next((entry for entry in reversed(entries) if "run_id" in entry), None)
    if last is None:  # the process was killed before a run was started
        journal.remove()
        return f"{journal.path} held nothing"
    try:
        ended = "end" in entries[-1]
        if not ended and not is_gone(last):
            return f"{journal.path} is left: its process still runs, or ran on another host ({last['host']})"
        store, run_id = Store(uri, last["experiment"]), last["run_id"]
        with store.errors_reported():
            run = store.client.get_run(run_id)
            if not ended and run.info.status == "RUNNING":
                entries = [*entries, {"end": "FAILED", "reason": GONE, "at": now()}]
            # If a run was continued in another folder, the journal there has the run's status.
            went_on = run.data.tags.get("folder") != last["folder"]
            for entry in entries:
                if not (went_on and {"end", "reopen"} & set(entry)):
                    store.send(run_id, entry)
    except InputError:
        raise
    except (KeyError, TypeError, ValueError, ArithmeticError, AttributeError) as error:
        told = f"the journal in {journal.path.parent} was not written by a run"
        raise InputError(f"{told} ({type(error).__name__}: {error}).") from error
    journal.remove()
    return f"{journal.path} is handed in: run {run.info.run_name} in {store.uri}"


def end_those_gone(store: Store) -> None:
    """Mark unfinished runs as FAILED if their process was on this host and has ended.

    The names of these runs are printed on stderr.
    """
    for run in store.matching("attributes.status = 'RUNNING'"):
        if is_gone(run.data.tags):
            store.send(run.info.run_id, {"end": "FAILED", "reason": GONE, "at": now()})
            print(f"{printable(run.info.run_name)} is ended as FAILED: {GONE}", file=sys.stderr)


def this_process() -> dict[str, str]:
    """Labels (tags of mlflow) that identify this process in the record of a run: host, process number, start time."""
    return {"host": socket.gethostname(), "process": _identity(os.getpid())}


def is_gone(tags: dict[str, str]) -> bool:
    """True if the process that the labels `tags` identify has ended.

    The result is False if the process was on another host, or if the labels identify no process.
    """
    process = tags.get("process", "")
    if tags.get("host") != socket.gethostname() or not IDENTITY.fullmatch(process):
        return False
    try:
        return _identity(int(process.partition(" ")[0])) != process
    except (FileNotFoundError, ProcessLookupError):
        return True


def _identity(number: int) -> str:
    """Text that identifies a process: its number and its start time; without /proc only the number.

    The start time is counted from the boot, because the clock may be changed.

    Raises:
        FileNotFoundError, ProcessLookupError: there is no such process.
    """
    if not BOOT.is_file():
        os.kill(number, 0)
        return f"{number}"
    began = Path(f"/proc/{number}/stat").read_text().rpartition(")")[2].split()[19]  # ticks; field 22 of proc(5)
    return f"{number} {began} {BOOT.read_text().strip()}"
