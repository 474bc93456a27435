"""Words of a command line: spelling for Hydra, what Hydra was told, and suggestions for unknown keys."""

import re
import sys
from collections.abc import Iterable, Iterator, Mapping
from functools import cache
from pathlib import Path
from typing import Any

from hydra.core.hydra_config import HydraConfig
from hydra.core.override_parser.overrides_parser import OverridesParser

from .app import CONF

COUNT = "deployment.count="
# Keys that change no result of a run: its place, its speed, its record and its further outputs.
WITHOUT_EFFECT = (
    "tracking", "trust", "resume", "threads", "workers", "checkpoint_seconds", "picture", "pictures",
    "export", "paper_size", "north", "save_as", "kept",
)  # fmt: skip
LIKENESS = 0.8  # least similarity, by `difflib`, of a suggested key, such as a missing letter in a word


def spelled(override: str) -> str:
    """Override with `deployment.count=+5` in quotes, as Hydra reads `+5` as the number 5."""
    return re.sub(r"(?<=[=,])\+(\d+)(?=,|$)", r"'+\1'", override) if override.startswith(COUNT) else override


def at(key: str, path: Path) -> str:
    """Override with a path as its value, in quotes if Hydra needs them."""
    return f"{key}={path}" if re.fullmatch(r"[\w./-]+", str(path)) else f"{key}={quoted(path)}"


def quoted(path: str | Path) -> str:
    """Path as the value of an override, in quotes."""
    escaped = str(path).replace("\\", "\\\\").replace("'", "\\'")
    return f"'{escaped}'"


def key_and_value(override: str) -> tuple[str, str]:
    """Split an override, such as `+objective.n=2`, into key and value (`objective.n`, `2`)."""
    key, _, value = override.partition("=")
    return key.lstrip("+~"), value


def changes_results(key: str) -> bool:
    """False for a key, or group, that changes no result of a run."""
    return re.split("[./@]", key)[0] not in WITHOUT_EFFECT


def search_path() -> list[str]:
    """Overrides that add folders of configuration, on which other overrides depend."""
    own = HydraConfig.get().overrides.hydra if HydraConfig.initialized() else []
    return [override for override in own if override.startswith("hydra.searchpath=")]


def config_dir() -> list[str]:
    """Option `--config-dir` of this application, for another process; empty without such an option."""
    sources = HydraConfig.get().runtime.config_sources
    return [word for source in sources if source.provider == "command-line" for word in ("--config-dir", source.path)]


def task_overrides() -> list[tuple[str, str]]:
    """Overrides of this job, as pairs of key (or group) and override."""
    return keyed_overrides(HydraConfig.get().overrides.task)


def keyed_overrides(overrides: Iterable[str]) -> list[tuple[str, str]]:
    """Overrides as pairs of key (or group) and override."""
    parsed = OverridesParser.create().parse_overrides(list(overrides))
    return [(str(override.key_or_group), str(override.input_line)) for override in parsed]


def meant(key: str) -> str:
    """Question that suggests the known key most similar to an unknown key; empty for a known key, or if no known key is
    similar.

    Args:
        key: key with its groups, such as `room.keepout`.
    """
    import difflib

    known = known_keys(CONF)
    close = [] if key in known else difflib.get_close_matches(key, sorted(known), 1, LIKENESS)
    return f"did you mean {close[0]}?" if close else ""


def ask_what_was_meant() -> None:
    """Suggest on stderr a known key for each unknown key of the command line, which Hydra has refused."""
    for argument in sys.argv[1:]:
        key = argument.partition("=")[0]
        if key.replace(".", "_").isidentifier() and "." in key and (question := meant(key)):
            print(f"{key}: {question}", file=sys.stderr)


@cache
def known_keys(folder: str) -> frozenset[str]:
    """Keys of the configuration in a folder, with their groups."""
    import yaml

    loader = getattr(yaml, "CSafeLoader", yaml.SafeLoader)  # ten times as fast, if PyYAML was built with it
    files = list(Path(folder).rglob("*.yaml"))
    nodes = [
        (list(f.parent.relative_to(folder).parts), yaml.load(f.read_text(encoding="utf-8"), loader)) for f in files
    ]
    return frozenset(name for groups, node in nodes for name in _keys_within(node, groups))


def _keys_within(node: Any, above: list[str]) -> Iterator[str]:
    if isinstance(node, Mapping):
        for key, inner in node.items():
            if key == "defaults":  # Hydra's own key
                continue
            yield ".".join([*above, str(key)])
            yield from _keys_within(inner, [*above, str(key)])
