"""Trees of keys and values, made from the content of files, and paths to the values in a tree.

The content may be YAML, JSON, XML, arrays, Python literals or other texts. A path is a text of keys with dots between
them, such as `pose.translation`; a key of a file may also contain dots. A number in a path is an index into a list, or
into the numbers in a text. A list of one entry stands for the entry, as XML does not distinguish one child from a list
of children. Alternative paths are separated by `|`; the first that leads to a value is taken.
"""

import ast
import io
import math
import re
import xml.etree.ElementTree as ElementTree
import zipfile
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any, Final

import numpy as np

from lmd.core.checks import InputError, bounded, real, vector
from lmd.core.files import parse_keys, read_bytes, read_text
from lmd.core.tables import COMMENT

Keys = Mapping[str, Any]
MISSING: Final = object()  # stands for a value that a tree lacks
NUMBER = re.compile(r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?[fF]?")
NESTED = 4  # maximum depth of lists and matrices around numbers
DEEPEST = 64  # maximum nesting of XML elements; searches of deeper nestings would take hours
LONGEST, LEVELS = 64, 4  # maximum length of a list or mapping, and maximum depth, of a search at any depth
LARGEST_ARRAY = 256  # maximum number of entries of an array of a calibration; files may also hold images and points
LARGEST_LITERAL = 1 << 20  # maximum number of characters of a Python literal; literals take more memory than JSON
ANYWHERE = "**"  # begins a path to the mappings, at any depth, that have the key that follows


def find(tree: Any, paths: str) -> Any:
    """Value at the first path that leads to a value other than null; `MISSING` if none does. `|` separates paths."""
    values = (_at(tree, path) for path in paths.split("|"))
    return next((value for value in values if value is not MISSING and value is not None), MISSING)


def _at(tree: Any, path: str) -> Any:
    if not path:
        return tree
    if isinstance(tree, Mapping):
        for end in (len(path), *(dot.start() for dot in re.finditer(r"\.", path))):
            if (key := path[:end]) in tree and (found := _at(tree[key], path[end + 1 :])) is not MISSING:
                return found
        return MISSING
    first, _, rest = path.partition(".")
    parts = numbers_of(tree) if isinstance(tree, str) else tree
    if not isinstance(parts, list | tuple):
        return MISSING
    if first.isdecimal() and int(first) < len(parts):
        return _at(parts[int(first)], rest)
    return _at(parts[0], path) if len(parts) == 1 and parts is tree else MISSING


def entries(tree: Any, path: str, around: Keys | None = None, key: str = "") -> Iterator[tuple[str, Keys]]:
    """Yield the key and the content (a mapping) of each entry at a path of a tree, such as a camera or a tag.

    A path consists of steps with dots between them. A step is a key; or `*`, which stands for each item of a list or a
    mapping; or `/PATTERN/`, for each key that matches a regular expression. The step `**KEY` stands for the mappings at
    any depth that have the key KEY.

    An entry also gets the keys and values of the mappings that contain it, unless it has these keys itself. An entry
    gets no keys from the entries beside it. A value that is not a mapping becomes a mapping with the one key `value`.
    """
    step, _, rest = path.partition(".")
    own, outer = dict(tree) if isinstance(tree, Mapping) else {}, around or {}
    if not path:
        yield key, {**outer, **(own if isinstance(tree, Mapping) else {"value": tree})}
    elif step.startswith(ANYWHERE):
        for name, found in _anywhere(tree, step.removeprefix(ANYWHERE)):
            yield from entries(found, rest, {**outer, **own}, name)
    elif step == "*" or step[0] == "/":
        every = own or dict(enumerate(tree if isinstance(tree, list | tuple) else ()))
        chosen = {name: value for name, value in every.items() if re.fullmatch(step.strip("/*") or ".*", str(name))}
        beside = {name: value for name, value in own.items() if name not in chosen}
        for name, value in chosen.items():
            yield from entries(value, rest, {**outer, **beside}, str(name))
    elif (child := find(tree, step)) is not MISSING:
        yield from entries(child, rest, {**outer, **own}, key)


def _anywhere(tree: Any, wanted: str, name: str = "", levels: int = LEVELS) -> Iterator[tuple[str, Keys]]:
    """Yield the mappings that have the key `wanted`, at most `levels` below `tree`, as pairs of name and mapping.

    The name consists of the keys above the mapping, joined by `/`. Long lists and mappings are not searched.
    """
    if isinstance(tree, Mapping) and wanted in tree:
        yield name, tree
    elif levels and isinstance(tree, Mapping | list) and len(tree) <= LONGEST:
        for key, value in tree.items() if isinstance(tree, Mapping) else enumerate(tree):
            yield from _anywhere(value, wanted, f"{name}/{key}" if name else str(key), levels - 1)


def plain(text: str) -> str:
    """Key or path in lower case and without `_`, for the comparison of keys that users may write in several ways."""
    return text.lower().replace("_", "")


def numbers_of(value: Any, nested: int = NESTED) -> list[Any]:
    """Flatten a value to a list of its numbers.

    A value is a number, a text of numbers, a mapping whose key `data` has the numbers, or a list of such values.
    Anything else becomes an item of the result without a change.
    """
    if isinstance(value, Mapping) and "data" in value and nested:
        return numbers_of(value["data"], nested - 1)
    if isinstance(value, list | tuple) and value and nested:
        return [number for part in value for number in numbers_of(part, nested - 1)]
    words = value.replace(",", " ").split() if isinstance(value, str) else []
    if words and all(map(NUMBER.fullmatch, words)):
        return [float(word.rstrip("fF")) for word in words]
    return [value]


def vector_at(tree: Keys, paths: str, size: int | None, called: str = "") -> tuple[float, ...]:
    """Numbers at a path, in the order of the file.

    Args:
        tree: tree of keys and values.
        paths: alternative paths, separated by `|`.
        size: required number of numbers; None for any.
        called: name of the value, for messages; the first path by default.

    Raises:
        InputError: the value is missing, or does not consist of `size` numbers.
    """
    name = called or paths.split("|")[0]
    if (value := find(tree, paths)) is MISSING:
        raise InputError(f"the key {name} is missing.")
    name, numbers = f"{name}.data" if isinstance(value, Mapping) and "data" in value else name, numbers_of(value)
    return (real(name, numbers[0]),) if size == len(numbers) == 1 else vector(name, numbers, size)


def number_at(tree: Keys, paths: str) -> float:
    """Number at a path.

    Raises:
        InputError: the value is missing, or is not a number.
    """
    return vector_at(tree, paths, 1)[0]


def matches(text: str, patterns: Mapping[str, str]) -> dict[str, Any]:
    """Matches of several regular expressions in a text, as a list for each expression, keyed by its name in `patterns`.

    A match is a mapping of the expression's named groups.
    """
    found = {name: re.finditer(pattern, text, re.MULTILINE) for name, pattern in patterns.items()}
    return {name: [match.groupdict() for match in each] for name, each in found.items()}


def xml_of(text: str) -> ElementTree.Element | None:
    """Root element of XML; None for a text that does not begin with `<`. Entities are refused, as they could expand to
    gigabytes.

    Raises:
        InputError: the text begins with `<`, but is not valid XML, or has a document type, entities, or too many
            levels.
    """
    if not text.lstrip().startswith("<"):
        return None
    if "<!DOCTYPE" in text or "<!ENTITY" in text:
        raise InputError("an XML file must not have a document type or entities.")
    try:
        root = ElementTree.fromstring(text)
    except (ElementTree.ParseError, ValueError) as error:
        raise InputError(f"it cannot be read as XML ({error}).") from None
    level, depth = [root], 0
    while level:
        bounded("nested elements", depth, DEEPEST, "it")
        level, depth = [child for element in level for child in element], depth + 1
    return root


def tree_of(element: ElementTree.Element) -> Any:
    """Tree of an XML element: a mapping of its attributes and, for each name of children, the list of these children. A
    single child that has only a text becomes this text. An element without attributes and children becomes its text.
    """
    if not element.attrib and not len(element):
        return (element.text or "").strip().strip('"')
    inner: dict[str, Any] = {}
    for child in element:
        inner.setdefault(child.tag, []).append(tree_of(child))
    texts = {name: parts[0] for name, parts in inner.items() if len(parts) == 1 and isinstance(parts[0], str)}
    return {**element.attrib, **inner, **texts}


def literal(text: str) -> Any:
    """Value of a Python literal.

    Raises:
        InputError: the text is not a literal, or is longer than `LARGEST_LITERAL`.
    """
    bounded("characters", len(text), LARGEST_LITERAL, "it")
    try:
        return ast.literal_eval(text.strip())
    except Exception as error:  # Python's parser raises many kinds of errors for a broken file
        reason = " ".join(str(error).partition(": <ast.")[0].split())  # without the address of a node in memory
        raise InputError(f"it is not a literal of Python ({reason or type(error).__name__}).") from None


def arrays_of(path: Any, name: str, largest: float, most: float = LARGEST_ARRAY) -> dict[str, Any] | None:
    """Arrays in a NumPy archive (`.npz`), keyed by name; None for a file of another kind.

    Args:
        path: path of the file.
        name: name of the argument that gave the path, for messages.
        largest: maximum size of the file, and of its expanded content, bytes.
        most: maximum number of entries of an array that is kept.

    Raises:
        InputError: the file cannot be read, is too large, or holds no array with at most `most` entries. Arrays of
            Python objects are ignored.
    """
    content = read_bytes(path, name, largest)
    if not content.startswith(b"PK\x03\x04"):
        return None
    found, where = dict[str, Any](), f"{name}: {str(path)!r}"
    try:
        with zipfile.ZipFile(io.BytesIO(content)) as archive:
            bounded("bytes when it is expanded", sum(part.file_size for part in archive.infolist()), largest, where)
        with np.load(io.BytesIO(content), allow_pickle=False) as arrays:
            for key in arrays.files:
                try:
                    if (array := arrays[key]).size <= most:
                        found[key] = array
                except ValueError as error:
                    if "pickle" not in str(error):  # Python objects are skipped
                        raise
    except InputError:
        raise
    except Exception as error:  # a broken file may raise any error
        reason = " ".join(str(error).split()) or type(error).__name__
        raise InputError(f"{where} cannot be read as arrays ({reason}).", name) from None
    if not found:
        raise InputError(
            f"{where} has no array of at most {most:g} numbers: use numpy.savez('lens.npz', mtx=mtx, dist=dist).", name
        )
    return found


@dataclass(frozen=True)
class File:
    """File whose format is not yet known, with the user's settings `asked`; read when the content is first needed."""

    path: Any
    """Path of the file."""
    argument: str = "path"
    """Name of the argument that gave the path, for messages."""
    asked: Mapping[str, Any] = field(default_factory=dict)
    """User's settings for the formats of the file's family, keyed by name."""
    largest: float = math.inf
    """Maximum size, bytes; a larger file is refused."""

    @cached_property
    def text(self) -> str:
        """Text of the file.

        Raises:
            InputError: the file cannot be read, or is not a text.
        """
        return read_text(self.path, self.argument, self.largest)

    @cached_property
    def data(self) -> Mapping[str, Any]:
        """Keys and values of YAML or JSON.

        Raises:
            InputError: the text is neither YAML nor JSON.
        """
        return parse_keys(self.path, self.text, self.argument)

    @cached_property
    def root(self) -> ElementTree.Element | None:
        """Root element of the file's XML; None for a text that does not begin with `<`, see `xml_of`.

        Raises:
            InputError: the text begins like XML but is broken, or has entities.
        """
        return xml_of(self.text)

    @cached_property
    def lines(self) -> list[str]:
        """Lines that are neither blank nor comments."""
        return [line for line in self.text.splitlines() if line.strip() and line.lstrip()[0] != COMMENT]

    @property
    def first(self) -> str:
        """First of `lines`; an empty text if there are no lines."""
        return self.lines[0] if self.lines else ""

    @property
    def suffix(self) -> str:
        """Suffix of the file's name, such as `.json`, in lower case."""
        return Path(self.path).suffix.lower()

    def refused(self, reason: str) -> InputError:
        """Make the error for a file that is refused; `reason` is its message, without the full stop."""
        return InputError(f"{reason}.")
