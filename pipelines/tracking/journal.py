"""What a run has to tell its store, on disk before it is sent: what cannot be sent now can be sent later."""

import json
import os
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any

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
    def of(cls, folder: Path) -> "Journal":
        """The journal in a run's folder, an empty one where there is none; a last line cut short is left out."""
        path, entries = folder / FILE, []
        for line in path.read_text().splitlines() if path.exists() else ():
            with suppress(json.JSONDecodeError):
                entries.append(json.loads(line))
        journal = cls(path, entries)
        journal.on_disk = len(entries)
        return journal

    @classmethod
    def below(cls, folder: Path) -> "Iterator[Journal]":
        """The journals in a folder and the folders below."""
        for path in sorted(folder.rglob(FILE)):
            yield cls.of(path.parent)

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
