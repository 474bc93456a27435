"""What a run has to tell its store, on disk before it is sent: what cannot be sent now can be sent later."""

import json
import os
from contextlib import suppress
from pathlib import Path
from typing import Any

from lmd.core.checks import InputError

from ...trust import PAGE

FILE = "tracking.jsonl"  # in the run's folder, until all of it is sent

Entry = dict[str, Any]


class Journal:
    """The entries of one run, a line of JSON each.

    Args:
        path: of the file.
        entries: that it has already.
    """

    def __init__(self, path: Path, entries: list[Entry]) -> None:
        self.path, self.entries = path, entries
        self.on_disk = 0  # how many of them

    @classmethod
    def of(cls, folder: Path, elsewhere: bool = False) -> "Journal":
        """The journal in a run's folder, an empty one where there is none; a last line cut short is left out.

        Args:
            folder: of the run.
            elsewhere: whether it may name files that are not in the folder, which whoever wrote it wants to be sent.

        Raises:
            InputError: it names such a file, or is no journal.
        """
        path, entries = folder / FILE, []
        for line in path.read_text(errors="replace").splitlines() if path.is_file() else ():
            with suppress(ValueError, RecursionError):
                entries.append(json.loads(line))
        if not all(map(_is_entry, entries)):
            raise InputError(f"the journal in {folder} is none that a run has written.")
        for file in (file for entry in entries for file in entry.get("files", ())):
            if os.path.isfile(file) and not elsewhere and not Path(file).resolve().is_relative_to(folder.resolve()):
                told = f"the journal in {folder} would send {file!r}, which is not in that folder"
                raise InputError(f"{told}; `sync --yes` sends it all the same ({PAGE}).")
        journal = cls(path, entries)
        journal.on_disk = len(entries)
        return journal

    @property
    def store(self) -> str | None:
        """The address of the store that the run was given; None if it had none yet."""
        return next((str(entry["uri"]) for entry in reversed(self.entries) if {"run_id", "uri"} <= entry.keys()), None)

    def add(self, entry: Entry) -> None:
        """Add an entry, also where the disk is full: then it is written with the next that fits."""
        self.entries.append(entry)
        with suppress(OSError):
            self.write()

    def write(self) -> None:
        """Write what is not on disk yet.

        Raises:
            OSError: it cannot be written.
        """
        self.path.parent.mkdir(parents=True, exist_ok=True)
        size = self.path.stat().st_size if self.path.exists() else 0
        try:
            with self.path.open("a") as file:
                file.write("".join(f"{json.dumps(entry)}\n" for entry in self.entries[self.on_disk :]))
        except OSError:
            with suppress(OSError):
                os.truncate(self.path, size)  # what fitted of it
            raise
        self.on_disk = len(self.entries)

    def remove(self) -> None:
        """Forget it: all is sent."""
        with suppress(OSError):
            self.path.unlink(missing_ok=True)


def _is_entry(entry: Any) -> bool:
    """Whether an entry is a mapping, and its files, if it has any, are a list of paths."""
    files = entry.get("files", []) if isinstance(entry, dict) else None
    return isinstance(files, list) and all(isinstance(file, str) for file in files)
