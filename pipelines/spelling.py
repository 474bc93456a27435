"""What a key that is not known was meant to be."""

import sys
from collections.abc import Iterator, Mapping
from functools import cache
from pathlib import Path
from typing import Any

LIKENESS = 0.8  # as `difflib` counts likeness: a letter or an underscore that is missing in a word


def meant(key: str, folder: str) -> str:
    """Ask after the known key that is most like an unknown one; empty if the key is known, or no known one is like it.

    Args:
        key: with the names of its groups, such as `room.keepout`.
        folder: of the configuration.
    """
    import difflib

    known = _known(folder)
    close = [] if key in known else difflib.get_close_matches(key, sorted(known), 1, LIKENESS)
    return f"did you mean {close[0]}?" if close else ""


def ask_what_was_meant(folder: str) -> None:
    """Ask on stderr after the keys of the command line that are not known, which Hydra has refused."""
    for argument in sys.argv[1:]:
        key = argument.partition("=")[0]
        if key.replace(".", "_").isidentifier() and "." in key and (question := meant(key, folder)):
            print(f"{key}: {question}", file=sys.stderr)


@cache
def _known(folder: str) -> frozenset[str]:
    """All keys of the configuration in a folder."""
    return frozenset(name for file in Path(folder).rglob("*.yaml") for name in _keys(file, Path(folder)))


def _keys(file: Path, folder: Path) -> Iterator[str]:
    """All keys of a file of the configuration, with the names of their groups."""
    import yaml

    groups = list(file.parent.relative_to(folder).parts)
    loader = getattr(yaml, "CSafeLoader", yaml.SafeLoader)  # ten times as fast, where PyYAML was built with it
    yield from _within(yaml.load(file.read_text(encoding="utf-8"), loader), groups)


def _within(node: Any, above: list[str]) -> Iterator[str]:
    if isinstance(node, Mapping):
        for key, inner in node.items():
            if key == "defaults":  # Hydra's
                continue
            yield ".".join([*above, str(key)])
            yield from _within(inner, [*above, str(key)])
