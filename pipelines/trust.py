"""Checks of the code that a configuration of other origin names, as Hydra imports and calls every `_target_`.

A configuration that is neither part of this project nor on the command line is read as plain data and checked before
any import: the configuration of `run=DIR`, configurations in a tracking store, and the overrides of a resumed run.
docs/trust.md lists the rights of each kind of file.
"""

import re
import sys
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml
from hydra._internal.utils import get_args_parser
from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra.errors import HydraException
from omegaconf._utils import get_yaml_loader

from .app import CONF

PAGE = "docs/trust.md"
TARGET = "_target_"
PACKAGED = "pkg://"  # prefix of a place of configuration in a package
NAMED = re.compile(rf"{TARGET}:\s*['\"]?([\w.]+)")  # target in a file of configuration
NESTED = re.compile(r"^[ \t]*- /(\w+)@", re.MULTILINE)  # group whose option a file puts below a key of its own
REFERENCE = re.compile(r"\$\{\.*\w+(\.\w+|\[\w+\])*\}")  # interpolation of another value, without a resolver
RESOLVER = re.compile(r"\$\{\s*([\w.]+)\s*:")
PLAIN = (str, int, float, bool, type(None))
SPECIAL = re.compile(r"_[a-z]+_")  # key that Hydra's instantiate reads
NAME = re.compile(r"\w+(\.\w+)+")
LARGEST = 1 << 17  # greatest size of a configuration, bytes; a larger file takes seconds to parse and is refused
# Greatest number of characters of a group with its interpolations replaced, where a run has 10,000.
MOST_CHARACTERS = 1_000_000
SHOWN = 100  # greatest number of characters of a value in a message; longer values are cut


@dataclass(frozen=True)
class Trust:
    """Names that are trusted in a configuration of other origin."""

    names: tuple[str, ...] = ()
    """Packages, single targets and resolvers that the user trusts."""
    folders: tuple[Path, ...] = (Path(CONF),)
    """Folders of configuration; a target in their files is trusted in the group of the file."""

    @classmethod
    def given(cls) -> "Trust":
        """Trust that the command line gives: `trust=[...]`, and the folders and packages of its search path.

        Raises:
            InputError: `trust` is no list of names.
        """
        options, more = get_args_parser().parse_known_args(sys.argv[1:])
        names: list[str] = []
        folders = [CONF] if options.config_dir is None else [CONF, options.config_dir]
        for argument in [*options.overrides, *more]:
            key = argument.partition("=")[0].lstrip("+")
            if key == "trust":
                names += listed(argument)
            elif key == "hydra.searchpath":
                for place in listed(argument):
                    if place.startswith(PACKAGED):
                        names.append(place.removeprefix(PACKAGED).partition(".")[0])
                    else:
                        folders.append(place.removeprefix("file://"))
        return cls(tuple(names), tuple(Path(folder).resolve() for folder in folders))

    def parts(self, found: Mapping[Any, Any], source: str, groups: Sequence[str]) -> dict[str, dict[str, Any]]:
        """Nodes of the `groups` in a configuration of other origin.

        Args:
            found: configuration as plain data.
            source: name of the source, for messages.

        Raises:
            InputError: a node names code that is not trusted, or is no node.
        """
        from lmd.core.checks import InputError, bounded

        parts = {group: found[group] for group in groups if found.get(group) is not None}
        for group, part in parts.items():
            if not isinstance(part, dict) or "defaults" in part:  # `defaults` would make Hydra read other files
                raise InputError(f"{source}: {group} is not written as Hydra writes it.")
            self.check(source, group, part)
            length = len(str(part))
            for where, leaf in _leaves(source, group, part, set()):
                for each in REFERENCE.finditer(str(leaf)):
                    there = str(_place(found, where, each[0][2:-1]))
                    if "${" in there:  # lengths could double with each step
                        raise InputError(f"{source}: {where} leads to a value that leads on ({PAGE}).")
                    length += len(there)
            bounded(f"characters in {group} after interpolation", length, MOST_CHARACTERS, source)
        return parts

    def check(self, source: str, key: str, value: Any) -> None:
        """Check a value of a configuration of other origin.

        Args:
            source: name of the source, for messages.
            key: key of the value in the configuration, which begins with its group.
            value: plain data, nested in any way.

        Raises:
            InputError: the value names code that is not trusted, or is no plain data.
        """
        from lmd.core.checks import InputError

        group = re.split(r"[./@]", key)[0]
        trusted, named = set(), self._named_in(group)
        known = {TARGET, *(word for text in self._texts_of(group) for word in SPECIAL.findall(text))}
        for where, leaf in _leaves(source, key, value, set()):
            if others := {word for word in where.split(".") if SPECIAL.fullmatch(word)} - known:
                raise InputError(f"{source}: {where} has {min(others)}, which no option of {group} has ({PAGE}).")
            if where.rpartition(".")[2] == TARGET:
                if not isinstance(leaf, str) or not NAME.fullmatch(leaf):
                    raise InputError(f"{source}: {where} is no name of a class or a function ({PAGE}).")
                if self._trusts(leaf):
                    trusted.add((where, leaf))
                    continue
                asked = None if leaf in named else leaf.partition(".")[0]
            else:
                asked = self._resolver_in(leaf) if isinstance(leaf, str) else None
            if asked is not None:
                raise InputError(
                    f"{source}: {where} = {leaf[:SHOWN]!r} would run code that neither this project's "
                    f"configuration nor your search path names; if you trust it, add trust=[{asked}] ({PAGE})."
                )
        for where, leaf in sorted(trusted):
            if not self._is_defined_there(leaf):
                place = f"{source}: {where} = {leaf[:SHOWN]!r}"
                raise InputError(f"{place} is not defined in what you trust, which only imports it ({PAGE}).")

    def _named_in(self, group: str) -> set[str]:
        """Targets in files of a group, and of groups whose options these files put below their own keys."""
        texts = self._texts_of(group)
        nested = {other for text in texts for other in NESTED.findall(text)}
        texts += [text for other in sorted(nested) for text in self._texts_of(other)]
        return {name for text in texts for name in NAMED.findall(text)}

    def _texts_of(self, group: str) -> list[str]:
        """Contents of the files of a group, and of commands, whose files have nodes that are no groups."""
        files = [
            file for folder in self.folders for file in (*(folder / group).rglob("*.yaml"), *folder.glob("*.yaml"))
        ]
        return [file.read_text(encoding="utf-8", errors="replace") for file in files]

    def _resolver_in(self, text: str) -> str | None:
        """Untrusted resolver in a text; None if there is none."""
        rest = REFERENCE.sub("", text)
        found = RESOLVER.findall(rest)
        for name in filter(self._trusts, set(found)):
            rest = re.sub(rf"\$\{{\s*{re.escape(name)}\s*:", "", rest)
        if "${" not in rest:
            return None
        return next((name for name in found if not self._trusts(name)), "${...}")

    def _trusts(self, name: str) -> bool:
        return any(name == trusted or name.startswith(f"{trusted}.") for trusted in self.names)

    def _is_defined_there(self, target: str) -> bool:
        """True if a trusted package defines a target itself, and has not only imported it."""
        from hydra.utils import get_object

        try:
            found = get_object(target)
        except Exception:  # any error of the package is reported when the object is built
            return True
        return self._trusts(f"{getattr(found, '__module__', '')}.{getattr(found, '__qualname__', '')}")


def read_yaml(file: Path, source: str) -> dict[Any, Any]:
    """Read a configuration file as plain data, with interpolations unresolved.

    Raises:
        InputError: the file cannot be read, or is no configuration.
    """
    from lmd.core.checks import InputError
    from lmd.core.files import check_aliases, read_text

    text = read_text(file, source, LARGEST)
    try:
        check_aliases(text)
        found = yaml.load(text, Loader=get_yaml_loader())
    except Exception as error:  # any error of the parser
        raise InputError(f"{source}: '{file}' cannot be read ({' '.join(str(error).split())}).") from None
    if not isinstance(found, dict):
        raise InputError(f"{source}: '{file}' is no configuration.")
    return found


def listed(argument: str) -> list[str]:
    """Names in an argument of the command line; empty if Hydra will refuse the argument."""
    from lmd.core.checks import InputError

    try:
        value = OverridesParser.create().parse_override(argument).value()
    except HydraException:
        return []
    names = value if isinstance(value, list) else [] if value is None else [value]
    if not all(isinstance(name, str) and name for name in names):
        raise InputError(f"{argument.partition('=')[0]} must be a list of names, got {argument.partition('=')[2]}.")
    return [str(name) for name in names]


def _place(found: Any, key: str, name: str) -> Any:
    """Value to which the interpolation `${name}` of the value at `key` leads; None if there is none."""
    plain = name.lstrip(".")
    up = len(name) - len(plain)
    for word in [*(key.split(".")[:-up] if up else []), *re.findall(r"\w+", plain)]:
        inside = found.get(word) if isinstance(found, Mapping) else None
        found = found[int(word)] if isinstance(found, list) and word.isdecimal() and int(word) < len(found) else inside
    return found


def _leaves(source: str, key: str, value: Any, seen: set[int]) -> Iterator[tuple[str, Any]]:
    """Values below a key that are no containers, and all values of `_target_`, with their keys.

    Raises:
        InputError: a container occurs twice, for example by an alias of YAML, or a key or a value is no plain data.
    """
    from lmd.core.checks import InputError

    is_target = key.rpartition(".")[2] == TARGET
    if isinstance(value, Mapping | list | tuple) and not is_target:
        if id(value) in seen:
            raise InputError(f"{source}: {key} is an alias, which Hydra writes none of.")
        seen.add(id(value))
        for name, inner in value.items() if isinstance(value, Mapping) else enumerate(value):
            if not isinstance(name, str | int | float):
                raise InputError(f"{source}: {key} has a key that is no text.")
            yield from _leaves(source, f"{key}.{name}", inner, seen)
    elif isinstance(value, PLAIN) or is_target:
        yield key, value
    else:
        raise InputError(f"{source}: {key} is no plain value.")
