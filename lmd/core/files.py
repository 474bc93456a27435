"""Readers of files that users name: contents as bytes, as text, or as keys and values in YAML or JSON.

Files are not trusted. Pipes, devices, files larger than the memory, and small files that expand to gigabytes are
refused with one sentence before they are read.
"""

import json
import math
import os
import re
import stat
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import yaml

from lmd.core.checks import InputError, file_path
from lmd.core.memory import check_memory

# Greatest memory for parsing one byte of a file, bytes; tables of short texts need most.
MEMORY_PER_BYTE = 20.0
# Greatest size of a YAML file, bytes; larger files are refused, as half a megabyte takes seconds to parse.
LARGEST_YAML = 1 << 19

# Binary formats by their first bytes, with advice on converting them to text.
_BINARIES = {
    b"PK\x03\x04": "an archive, such as NumPy's .npz: write its contents as text",
    b"\x93NUMPY": "a NumPy array: write its contents as text",
    b"MATLAB": "a file of MATLAB: for a calibration run writelines(jsonencode(toStruct(cameraParams)), 'lens.json')",
    b"\x80\x04": "a pickle of Python, which may run code: write it by numpy.savez('lens.npz', mtx=mtx, dist=dist)",
    b"SQLite format 3": "a database, such as a bag of ROS 2: play it, and run ros2 topic echo --csv TOPIC > drive.csv",
    b"\x89MCAP0": "a bag of ROS 2: play it, and run ros2 topic echo --csv TOPIC > drive.csv",
    b"#ROSBAG": "a bag of ROS: run rostopic echo -b FILE -p TOPIC > drive.csv",
    b"ULog": "a log of PX4: ulog2csv FILE writes tables",
    b"\xff\xfe": "in UTF-16: save it as UTF-8",
    b"\xfe\xff": "in UTF-16: save it as UTF-8",
}
_KINDS = {stat.S_IFDIR: "a directory", stat.S_IFIFO: "a pipe", stat.S_IFCHR: "a device", stat.S_IFBLK: "a device"}


def read_bytes(path: Any, name: str, largest: float = math.inf, first: int | None = None) -> bytes:
    """Contents of a file.

    Args:
        path: path of the file.
        name: argument that gave the path, for messages.
        largest: greatest size of the file, bytes.
        first: number of bytes to read; None for all.

    Raises:
        InputError: the file is missing, not regular, not readable, larger than `largest`, or does not fit into memory.
    """
    source = file_path(name, path)
    refused = f"{name}: {str(path)!r} cannot be read"
    try:
        descriptor = os.open(source, os.O_RDONLY | os.O_NONBLOCK)  # so that opening a pipe does not wait for a writer
        try:
            status = os.fstat(descriptor)
            if not stat.S_ISREG(status.st_mode):
                kind = _KINDS.get(stat.S_IFMT(status.st_mode), "no file")
                raise InputError(f"{refused}: it is {kind}.", name)
            size = status.st_size if first is None else min(first, status.st_size)
            if size > largest:
                raise InputError(f"{refused}: it has {size:.4g} bytes; at most {largest:.4g} are allowed.", name)
            check_memory(MEMORY_PER_BYTE * size, f"{name}: {str(path)!r}, of {size:.4g} bytes,", name)
            with os.fdopen(descriptor, "rb", closefd=False) as file:
                return file.read(size)
        finally:
            os.close(descriptor)
    except FileNotFoundError:
        raise InputError(f"{name}: there is no file {str(path)!r}.", name) from None
    except OSError as error:
        raise InputError(f"{refused} ({error.strerror}).", name) from None
    except ValueError as error:
        if isinstance(error, InputError):
            raise
        raise InputError(f"{refused} ({error}).", name) from None


def write_whole(path: Path, content: bytes) -> None:
    """Write a file atomically: after a crash the file has either the old or the new content."""
    partial = path.with_name(f"{path.name}.partial")  # overwrites a file that a killed process left
    try:
        with partial.open("wb") as file:
            file.write(content)
            file.flush()
            os.fsync(file.fileno())
        os.replace(partial, path)
    except OSError:
        partial.unlink(missing_ok=True)
        raise


def read_text(path: Any, name: str, largest: float = math.inf) -> str:
    """Text of a file in UTF-8 of at most `largest` bytes; `name` is the argument that gave the path, for messages.

    Raises:
        InputError: the file cannot be read, is too large (see `read_bytes`), or is not UTF-8.
    """
    content = read_bytes(path, name, largest)
    if kind := next((kind for start, kind in _BINARIES.items() if content.startswith(start)), ""):
        raise InputError(f"{name}: {str(path)!r} cannot be read as text: it is {kind}.", name)
    try:
        return content.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise InputError(f"{name}: {str(path)!r} cannot be read as text ({error}).", name) from None


# Patterns of a JSON string, of a comment, and of a comma after the last entry; the latter two are removed.
_TEXT, _COMMENT, _LAST_COMMA = r'"(?:\\.|[^"\\])*+(?:"|\Z)', r"//[^\n]*|/\*.*?\*/", r",(?=\s*[}\]])"


def read_keys(path: Any, name: str) -> dict[str, Any]:
    """Keys and values of a file in YAML or JSON; `name` is the argument that gave the path, for messages.

    Raises:
        InputError: the file cannot be read (see `read_bytes`), is neither YAML nor JSON, or has no keys.
    """
    return parse_keys(path, read_text(path, name, LARGEST_YAML), name)


def parse_keys(path: Any, text: str, name: str) -> dict[str, Any]:
    """Keys and values of a text in YAML or JSON; OpenCV matrices and comments are allowed.

    Args:
        path: file of the text, for messages.
        text: the text; at most `LARGEST_YAML` characters of YAML.
        name: argument that gave the path, for messages.

    Raises:
        InputError: the text is neither YAML nor JSON, or has no keys.
    """
    # A YAML parser reads most of JSON, but refuses tabs.
    plain = _without(_COMMENT, text) if text.lstrip()[:1] in ("{", "/") else text
    is_json = plain.lstrip().startswith("{")
    try:
        if not is_json and len(text) > LARGEST_YAML:
            raise ValueError(f"it has {len(text):.4g} characters; at most {LARGEST_YAML:.4g} are allowed")
        keys = json.loads(_without(_LAST_COMMA, plain)) if is_json else _yaml(_from_opencv(text))
    except Exception as error:  # a parser of a broken file may raise anything
        reason = " ".join(str(error).split())
        raise InputError(f"{name}: {str(path)!r} cannot be read as YAML or JSON ({reason}).", name) from None
    if not isinstance(keys, dict):
        raise InputError(f"{name}: {str(path)!r} has no keys.", name)
    return {str(key): value for key, value in keys.items()}


def flat(values: Iterable[Any]) -> list[Any]:
    """Flatten a list by one level: entries that are lists are replaced by their entries."""
    return [value for row in values for value in (row if isinstance(row, list) else [row])]


def _from_opencv(text: str) -> str:
    """Convert OpenCV's YAML to standard YAML: drop a first line `%YAML:1.0`, and write `id: 9` for `id:9`."""
    plain = re.sub(r"\A%YAML.*\n", "", text)
    return plain if plain == text else re.sub(r"([{,]\s*\w+|^[ \t]*[\w.]+):(?=\S)", r"\1: ", plain, flags=re.MULTILINE)


def _without(pattern: str, text: str) -> str:
    """Remove matches of `pattern` from JSON, except within strings."""
    return re.sub(rf"({_TEXT})|{pattern}|(/\*.*)", lambda found: found[1] or found[2] or "", text, flags=re.DOTALL)


class _Loader(yaml.SafeLoader):  # type: ignore[misc] # yaml has no types
    """YAML loader that reads OpenCV matrices as mappings, and 1e-5 as a number (YAML 1.1 reads a text).

    libyaml's faster loader is not used, as deeply nested values overflow the stack of the process.
    """


_Loader.add_constructor("tag:yaml.org,2002:opencv-matrix", _Loader.construct_yaml_map)
_Loader.add_implicit_resolver(
    "tag:yaml.org,2002:float", re.compile(r"[-+]?(\d+(\.\d*)?|\.\d+)[eE][-+]?\d+$"), list("-+.0123456789")
)


def _integer(loader: Any, node: Any) -> int:
    """Read an integer; YAML's base-60 integers and integers too long to print are refused."""
    if ":" in node.value:
        raise ValueError(f"{node.value[:20]!r} is not a number")
    value = loader.construct_yaml_int(node)
    str(value)
    return int(value)


_Loader.add_constructor("tag:yaml.org,2002:int", _integer)


def _yaml(text: str) -> Any:
    text = re.sub(r"\n---\s*\Z", "\n", text)  # ROS tools end a message with ---
    check_aliases(text)
    return yaml.load(text, _Loader)


def check_aliases(text: str) -> None:
    """Raise `ValueError` if a YAML text, after its aliases are expanded, has more values than characters."""
    root = yaml.compose(text, _Loader)
    if root is not None and (values := _values(root, {})) > len(text):
        raise ValueError(f"its YAML aliases expand to {values:.4g} values, more than its {len(text)} characters")


def _values(node: Any, known: dict[int, float]) -> float:
    """Number of values in a YAML node after its aliases are expanded; infinite for a node that contains itself.

    `known` collects the results for all visited nodes, keyed by the node's `id()`; it is empty at first.
    """
    if id(node) not in known:
        known[id(node)] = math.inf
        pairs = isinstance(node, yaml.MappingNode)
        parts = [part for pair in node.value for part in pair] if pairs else node.value
        known[id(node)] = 1.0 + (0.0 if isinstance(node, yaml.ScalarNode) else sum(_values(p, known) for p in parts))
    return known[id(node)]
