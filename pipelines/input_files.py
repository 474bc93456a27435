"""The files that a configuration reads, by what they hold: the same name with other contents is another input."""

import hashlib
import os
import re
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

# What stands around a path in an override, such as `deployments=['mine: file deployment.path=a.csv',uniform]`; a path
# with a space in it needs the first.
SEPARATORS = (r"[,=\[\]{}'\"]+", r"[\s,=\[\]{}'\"]+")

# Of a larger file, which hardly any memory would hold, the number of bytes has to do.
LARGEST_READ = 1 << 32


def contents_of(settings: Any) -> dict[str, str]:
    """The digest of every file that `settings` name, `{"contents of flight.csv": "9f86d081884c7d65"}`.

    Any text that is the path of a file counts, or of a folder with files in it, whatever its key: so a new key needs no
    entry in a list. A word that happens to be one does no harm, it is only looked at in vain.

    Args:
        settings: resolved, nested in any way; overrides as they were written will do.
    """
    from lmd.core.checks import printable

    texts = list(_texts(settings))
    files = {Path(word) for text in texts for word in _words(text) if os.path.isfile(word)}
    folders = [Path(text) for text in texts if os.path.isdir(text) and os.access(text, os.R_OK)]
    files |= {file for folder in folders for file in folder.iterdir() if os.path.isfile(file)}
    return {printable(f"contents of {file}"): _digest(file) for file in sorted(files) if os.access(file, os.R_OK)}


def _texts(settings: Any) -> Iterator[str]:
    if isinstance(settings, str):
        yield settings
    elif isinstance(settings, Mapping):
        yield from _texts(list(settings.values()))
    elif isinstance(settings, list | tuple):
        for entry in settings:
            yield from _texts(entry)


def _words(text: str) -> set[str]:
    return {text, *(word for around in SEPARATORS for word in re.split(around, text))}


def _digest(file: Path) -> str:
    if (size := file.stat().st_size) > LARGEST_READ:
        return f"{size} bytes"
    with file.open("rb") as content:
        return hashlib.file_digest(content, "sha256").hexdigest()[:16]
