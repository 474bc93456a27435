"""Overrides of the command line: spelling for Hydra, repeated composition, and suggestions for unknown keys."""

import os
import re
import sys
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from functools import cache
from pathlib import Path
from typing import Any

from hydra.core.hydra_config import HydraConfig
from hydra.types import RunMode
from omegaconf import DictConfig, open_dict

from .app import CONF
from .hyperparameters import GROUPS
from .trust import Trust

OPTIONAL = ("experiment",)  # groups without a default option, which a `+` may come before
PLAIN = re.compile(r"(?!hydra\.|tracking\.)[\w-]+(\.[\w-]+)+=")  # begin of an override of a key below a group
_as_given = dict[str, str]()  # overrides of this sweep by their forced spelling
COUNT, PATH = "deployment.count=", "deployment.path"
# Keys that change no result of a run: its place, its speed, its record and its further outputs.
WITHOUT_EFFECT = (
    "tracking", "trust", "resume", "threads", "workers", "checkpoint_seconds", "picture", "pictures",
    "export", "paper_size", "north", "save_as", "kept",
)  # fmt: skip
LIKENESS = 0.8  # least similarity, by `difflib`, of a suggested key, such as a missing letter in a word


def as_hydra_reads(override: str) -> str:
    """Translate spellings of this project to Hydra's: `deployment.count=+5`, `+experiment=lab`, and no `+` before a
    default of a class.

    Hydra reads `+5` as the number 5, and refuses `+experiment=lab` because the group already has a default, none.
    """
    if override.startswith(tuple(f"+{group}=" for group in OPTIONAL)):
        return override[1:]
    if override.startswith(COUNT):
        return re.sub(r"(?<=[=,])\+(\d+)(?=,|$)", r"'+\1'", override)
    return f"+{override}" if override.startswith(tuple(f"+{group}." for group in GROUPS)) else override


def forced(arguments: list[str]) -> list[str]:
    """Command line of a sweep whose plain overrides add keys (`++`); unchanged without a sweep.

    Before a sweep, Hydra checks overrides with the default option of a group, which may lack a key of the options that
    the sweep chooses. Jobs get the overrides `as_given`.
    """
    if not _is_sweep(arguments):
        return arguments
    _as_given.update({f"++{argument}": argument for argument in arguments if PLAIN.match(argument)})
    return [f"++{argument}" if PLAIN.match(argument) else argument for argument in arguments]


def as_given(overrides: Iterable[str]) -> list[str]:
    """Overrides without the marks of `forced`."""
    return [_as_given.get(override, override) for override in overrides]


def _is_sweep(arguments: list[str]) -> bool:
    """True if a command line asks for a sweep, or chooses a stored one."""
    if "hydra.mode=RUN" in arguments or {"-m", "--multirun", "hydra.mode=MULTIRUN"}.intersection(arguments):
        return "hydra.mode=RUN" not in arguments
    stored = [argument.replace("=", "/") for argument in arguments if argument.startswith("experiment=")]
    with suppress(ValueError):  # trust=... is refused later
        files = [folder / f"{option}.yaml" for option in stored for folder in Trust.given().folders]
        return any("mode: MULTIRUN" in file.read_text(encoding="utf-8") for file in files if file.is_file())
    return False


def at(key: str, path: Path) -> str:
    """Override with a path as its value, in quotes if Hydra needs them."""
    return f"{key}={path}" if re.fullmatch(r"[\w./-]+", str(path)) else f"{key}={quoted(path)}"


def quoted(path: Path) -> str:
    """Path as the value of an override, in quotes if Hydra needs them."""
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
    return [o for o in HydraConfig.get().overrides.hydra if o.startswith("hydra.searchpath=")]


def config_dir() -> list[str]:
    """Option `--config-dir` of this application, for another process; empty without such an option."""
    sources = HydraConfig.get().runtime.config_sources
    return [word for source in sources if source.provider == "command-line" for word in ("--config-dir", source.path)]


def offer_file_formats() -> None:
    """Name the folders `file_formats` on the search path to `lmd.formats.registry`, here and in processes to come."""
    sources = HydraConfig.get().runtime.config_sources
    folders = [os.path.join(source.path, "file_formats") for source in sources if source.schema == "file"]
    known = filter(None, os.environ.get("LMD_FORMATS", "").split(os.pathsep))
    os.environ["LMD_FORMATS"] = os.pathsep.join(dict.fromkeys([*known, *filter(os.path.isdir, folders)]))


def task_overrides() -> list[tuple[str, str]]:
    """Overrides of this job, as pairs of key (or group) and override."""
    from hydra.core.override_parser.overrides_parser import OverridesParser

    parsed = OverridesParser.create().parse_overrides(list(HydraConfig.get().overrides.task))
    return [(str(override.key_or_group), str(override.input_line)) for override in parsed]


def recompose(config_name: str, overrides: Sequence[str], setting: str, entry: str) -> DictConfig:
    """Compose another configuration of the running application, without Hydra's own part.

    Args:
        config_name: name of the configuration, such as `optimise`.
        overrides: overrides, as on a command line.
        setting, entry: key and value that caused the composition, for messages.

    Raises:
        InputError: Hydra refuses the overrides.
    """
    from hydra.core.global_hydra import GlobalHydra
    from hydra.errors import HydraException

    from lmd.core.checks import InputError

    try:
        loader = GlobalHydra.instance().config_loader()
        composed = loader.load_configuration(
            config_name, list(map(as_hydra_reads, overrides)), RunMode.RUN, validate_sweep_overrides=False
        )
    except (HydraException, ValueError) as error:  # Hydra raises ValueError for an option that is a number
        raise InputError(f"{setting}: {entry!r} is refused: {str(error).splitlines()[0]}") from error
    with open_dict(composed):
        composed.pop("hydra")
    return composed


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
