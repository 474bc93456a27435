"""Documents: JSON files that are there whole or not at all, and whose damage costs no more than what they held."""

import json
import os
import sys
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, TypeVar

Content = TypeVar("Content")


def read_document(path: Path, content_of: Callable[[dict[str, Any]], Content]) -> Content | None:
    """What a document holds, or None if there is none. A damaged one counts as none, is named, and is set aside.

    Args:
        content_of: makes of the file's keys and values what they stand for; raises ValueError, KeyError or TypeError
            where they stand for nothing.
    """
    if not path.is_file():  # nor a pipe, which would be waited for
        return None
    try:
        return content_of(dict(json.loads(path.read_text())))
    except (ValueError, KeyError, TypeError, RecursionError) as error:
        aside = path.with_name(f"{path.name}.damaged")
        os.replace(path, aside)
        reason = " ".join(f"{type(error).__name__}: {error}".split())
        what = f"warning: {path} is damaged ({reason}); it is kept as {aside.name}, and what it held is done again"
        print(what, file=sys.stderr)
        return None


def write_document(path: Path, document: Mapping[str, Any]) -> None:
    """Write a document, whole or not at all, whatever ends the process or the machine meanwhile."""
    from lmd.core.files import write_whole

    write_whole(path, (json.dumps(document, indent=2) + "\n").encode())
