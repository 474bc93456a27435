"""Checks of configurations from outside, which may name only trusted code.

The checks are needed because Hydra imports and calls every `_target_`. A configuration is from outside if it is neither
part of this project nor on the command line. Examples are the configuration of `run=DIR`, configurations in a
tracking store, and the overrides of a resumed run. Such a configuration is read as plain data, and checked before any
import. docs/trust.md lists the rights of each kind of file.
"""

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml
from omegaconf import DictConfig, ListConfig
from omegaconf._utils import get_yaml_loader

from .app import CONF

PAGE = "docs/trust.md"
TARGET = "_target_"
NAMED = re.compile(rf"{TARGET}:\s*['\"]?([\w.]+)")  # target in a file of configuration
NESTED = re.compile(r"^[ \t]*- /(\w+)@", re.MULTILINE)  # group from which a file takes an option for a key of its own
REFERENCE = re.compile(r"\$\{\.*\w+(\.\w+|\[\w+\])*\}")  # interpolation of another value that uses no resolver
SPECIAL = re.compile(r"_[a-z]+_")  # key that Hydra's instantiate reads
NAME = re.compile(r"\w+(\.\w+)+")
LARGEST = 1 << 17  # maximum size of a configuration, bytes; larger files would take seconds to parse and are refused
# Maximum number of characters of a group with its interpolations replaced; a run has 10,000.
MOST_CHARACTERS = 1_000_000


@dataclass(frozen=True)
class Trust:
    """Code that the user trusts in configurations from outside, such as the configuration of an earlier run."""

    names: tuple[str, ...] = ()
    """Names of packages and of single functions or classes that the user trusts."""
    folders: tuple[Path, ...] = (Path(CONF),)
    """Folders with configuration files.

    A `_target_` in one of these files is trusted, but only in nodes of the config group to which the file belongs.
    """

    @classmethod
    def of(cls, cfg: DictConfig, runtime: Any) -> "Trust":
        """Trust that follows from the user's settings: the list `trust=[...]`, and the search path of configurations.

        Args:
            cfg: configuration of the command.
            runtime: Hydra's record of the run, which lists the folders and packages where Hydra has looked for
                configurations.

        Raises:
            InputError: `trust` is not a list of names.
        """
        from lmd.core.checks import InputError

        names = cfg.get("trust", [])
        if not isinstance(names, list | ListConfig) or not all(isinstance(name, str) and name for name in names):
            raise InputError(f"trust must be a list of names, got {names}.")
        places = [(place.schema, place.path) for place in runtime.config_sources if place.provider != "hydra"]
        packages = (path.partition(".")[0] for schema, path in places if schema == "pkg")
        return cls((*names, *packages), tuple(Path(path).resolve() for schema, path in places if schema == "file"))

    def parts(self, found: Mapping[Any, Any], source: str, groups: Sequence[str]) -> dict[str, dict[str, Any]]:
        """Check the nodes of config groups in a configuration from outside; return the nodes, keyed by group.

        A configuration is from outside if it is neither part of this project nor on the command line.

        Args:
            found: configuration as plain data.
            source: name of the configuration's source, for error messages.
            groups: names of the groups; a group that the configuration lacks is left out.

        Raises:
            InputError: a node names code that is not trusted, is not a mapping, or has a key or a reference that is not
                allowed.
        """
        from lmd.core.checks import InputError, bounded

        parts = {group: found[group] for group in groups if found.get(group) is not None}
        for group, part in parts.items():
            if not isinstance(part, dict) or "defaults" in part:  # `defaults` would make Hydra read other files
                raise InputError(f"{source}: {group} must be a mapping without a key 'defaults'.")
            self.check(source, group, part)
            length = len(str(part))
            for where, leaf in _leaves(source, group, part, set()):
                for each in REFERENCE.finditer(str(leaf)):
                    there = str(_place(found, where, each[0][2:-1]))
                    if "${" in there:  # lengths could double with each replacement
                        raise InputError(f"{source}: {where} refers to a value that is itself a reference ({PAGE}).")
                    length += len(there)
            bounded(f"characters in {group} after interpolation", length, MOST_CHARACTERS, source)
        return parts

    def check(self, source: str, key: str, value: Any) -> None:
        """Check that a value of a configuration from outside is plain data and names only trusted code.

        A configuration is from outside if it is neither part of this project nor on the command line.

        Args:
            source: name of the configuration's source, for error messages.
            key: key of the value in the configuration, which begins with its group.
            value: plain data, nested in any way.

        Raises:
            InputError: the value names code that is not trusted, or is not plain data.
        """
        from hydra.utils import get_object

        from lmd.core.checks import InputError

        group, trusted = re.split(r"[./@]", key)[0], list[tuple[str, str]]()
        texts = self._texts_of(group)
        known = {TARGET, *(word for text in texts for word in SPECIAL.findall(text))}
        nested = {other for text in texts for other in NESTED.findall(text)}
        texts += [text for other in nested for text in self._texts_of(other)]
        named = {name for text in texts for name in NAMED.findall(text)}
        for where, leaf in _leaves(source, key, value, set()):
            place, is_target = f"{source}: {where}", where.rpartition(".")[2] == TARGET
            shown = f"{place} = {str(leaf)[:100]!r}"
            if others := {word for word in where.split(".") if SPECIAL.fullmatch(word)} - known:
                raise InputError(f"{place}: remove the key {min(others)}, which no option of {group} has ({PAGE}).")
            if is_target and not (isinstance(leaf, str) and NAME.fullmatch(leaf)):
                raise InputError(f"{place} must name a class or a function ({PAGE}).")
            if is_target and self._trusts(leaf):
                trusted.append((shown, leaf))
            elif is_target and leaf not in named:
                told = f"{shown} would run code that neither this project's configuration nor your search path names"
                raise InputError(f"{told}; if you trust it, add trust=[{leaf.partition('.')[0]}] ({PAGE}).")
            elif isinstance(leaf, str) and "${" in REFERENCE.sub("", leaf):
                raise InputError(f"{shown} would call a resolver, which is not allowed ({PAGE}).")
        for place, leaf in trusted:  # all values are checked before the first import
            try:
                target = get_object(leaf)
            except Exception:  # an error of the package is reported when the object is built
                continue
            if not self._trusts(f"{getattr(target, '__module__', '')}.{getattr(target, '__qualname__', '')}"):
                raise InputError(f"{place} is only imported by code that you trust: trust its own module too ({PAGE}).")

    def _texts_of(self, group: str) -> list[str]:
        """Texts of the configuration files with nodes of a group: the files of the group, and the files of commands."""
        files = (file for at in self.folders for file in (*(at / group).rglob("*.yaml"), *at.glob("*.yaml")))
        return [file.read_text(encoding="utf-8", errors="replace") for file in files]

    def _trusts(self, name: str) -> bool:
        return any(name == trusted or name.startswith(f"{trusted}.") for trusted in self.names)


def read_yaml(file: Path, source: str) -> dict[Any, Any]:
    """Read a configuration file as plain data, with interpolations unresolved.

    Raises:
        InputError: the file cannot be read, or is not a configuration.
    """
    from lmd.core.checks import InputError
    from lmd.core.files import check_aliases, read_text

    text = read_text(file, source, LARGEST)
    try:
        check_aliases(text)
        found = yaml.load(text, Loader=get_yaml_loader())
    except Exception as error:  # the parser may raise any error
        raise InputError(f"{source}: '{file}' cannot be read ({' '.join(str(error).split())}).") from None
    if not isinstance(found, dict):
        raise InputError(f"{source}: '{file}' is not a configuration.")
    return found


def _place(found: Any, key: str, name: str) -> Any:
    """Value in the configuration `found` to which the interpolation `${name}` refers; None without such a value.

    The text `${name}` stands at the key `key`. Leading dots of `name` are relative to this key.
    """
    up = len(name) - len(name.lstrip("."))
    for word in [*(key.split(".")[:-up] if up else []), *re.findall(r"\w+", name)]:
        entries = dict(enumerate(found)) if isinstance(found, list) else found if isinstance(found, Mapping) else {}
        found = entries.get(int(word) if isinstance(found, list) and word.isdecimal() else word)
    return found


def _leaves(source: str, key: str, value: Any, seen: set[int]) -> Iterator[tuple[str, Any]]:
    """Yield the values below a key that are not containers, and the value of every `_target_`, as pairs (key, value).

    Args:
        source: name of the configuration's source, for error messages.
        key: key of `value`.
        value: plain data, nested in any way.
        seen: ids of the containers that have been visited; updated.

    Raises:
        InputError: a container occurs twice, for example by an alias of YAML, or a key or a value is not plain data.
    """
    from lmd.core.checks import InputError

    is_target = key.rpartition(".")[2] == TARGET
    if isinstance(value, Mapping | list | tuple) and not is_target:
        if id(value) in seen:
            raise InputError(f"{source}: {key} is a YAML alias, which Hydra never writes.")
        seen.add(id(value))
        for name, inner in value.items() if isinstance(value, Mapping) else enumerate(value):
            if not isinstance(name, str | int | float):
                raise InputError(f"{source}: {key} has a key that is not a text.")
            yield from _leaves(source, f"{key}.{name}", inner, seen)
    elif isinstance(value, str | int | float | None) or is_target:
        yield key, value
    else:
        raise InputError(f"{source}: {key} must be a number, a text, true, false or null.")
