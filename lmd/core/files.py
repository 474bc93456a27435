"""Files that users name, read in one place.

A file may come from a stranger: it may be a pipe or a device, larger than the memory, or a few hundred bytes that stand
for gigabytes. Each of these is refused in one sentence before it is read.
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

# Greatest memory per byte of a file while it is parsed, bytes: the texts of a table.
MEMORY_PER_BYTE = 20.0
# Greatest size of a YAML file, bytes: a calibration has a few kilobytes; half a megabyte takes some seconds to parse.
LARGEST_YAML = 1 << 19

# Files that are no text, by their first bytes, and the way to a text.
_BINARIES = {
    b"PK\x03\x04": "an archive, such as NumPy's .npz: write what it holds as text",
    b"\x93NUMPY": "an array of NumPy: write what it holds as text",
    b"MATLAB 5.0": "a file of MATLAB: write what it holds as text",
    b"SQLite format 3": "a database, such as a bag of ROS 2: play it, and ros2 topic echo --csv TOPIC > drive.csv",
    b"\x89MCAP0": "a bag of ROS 2: play it, and ros2 topic echo --csv TOPIC > drive.csv",
    b"#ROSBAG": "a bag of ROS: rostopic echo -b FILE -p TOPIC > drive.csv",
    b"ULog": "a log of PX4: ulog2csv FILE writes tables",
    b"\xff\xfe": "in UTF-16: save it as UTF-8",
    b"\xfe\xff": "in UTF-16: save it as UTF-8",
}
_KINDS = {stat.S_IFDIR: "a directory", stat.S_IFIFO: "a pipe", stat.S_IFCHR: "a device", stat.S_IFBLK: "a device"}


def read_bytes(path: Any, name: str, largest: float = math.inf, first: int | None = None) -> bytes:
    """The contents of a file.

    Args:
        name: the argument the path came from, for messages.
        largest: bytes that it may have.
        first: bytes that are read; None for all.

    Raises:
        InputError: it is missing, no regular file, larger than is allowed or than fits into memory, or not readable.
    """
    source = file_path(name, path)
    refused = f"{name}: {str(path)!r} cannot be read"
    try:
        descriptor = os.open(source, os.O_RDONLY | os.O_NONBLOCK)  # does not wait for who writes into a pipe
        try:
            status = os.fstat(descriptor)
            if not stat.S_ISREG(status.st_mode):
                kind = _KINDS.get(stat.S_IFMT(status.st_mode), "no file")
                raise InputError(f"{refused}: it is {kind}.", name)
            size = status.st_size if first is None else min(first, status.st_size)
            if size > largest:
                raise InputError(f"{refused}: it has {size:.4g} bytes, and at most {largest:.4g} are taken.", name)
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
    """Write a file, whole or not at all, even if the process or the machine ends meanwhile."""
    partial = path.with_name(f"{path.name}.partial")  # the next one takes the place of what a kill leaves
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
    """The text of a file in UTF-8, see `read_bytes`.

    Raises:
        InputError: as there, or it is no such text.
    """
    content = read_bytes(path, name, largest)
    if kind := next((kind for start, kind in _BINARIES.items() if content.startswith(start)), ""):
        raise InputError(f"{name}: {str(path)!r} cannot be read as text: it is {kind}.", name)
    try:
        return content.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise InputError(f"{name}: {str(path)!r} cannot be read as text ({error}).", name) from None


# A comment of JSON as many programs write it, or a comma after the last entry; texts are left as they are.
_TEXT, _COMMENT, _LAST_COMMA = r'"(?:\\.|[^"\\])*"', r"//[^\n]*|/\*.*?\*/", r",(?=\s*[}\]])"


def read_keys(path: Any, name: str) -> dict[str, Any]:
    """The keys and values of a file in YAML or JSON, see `read_bytes` and `parse_keys`."""
    return parse_keys(path, read_text(path, name, LARGEST_YAML), name)


def parse_keys(path: Any, text: str, name: str) -> dict[str, Any]:
    """The keys and values of a text in YAML or JSON; there may be matrices of OpenCV, and comments.

    Args:
        path: where the text is from, for messages.
        text: at most `LARGEST_YAML` characters of YAML, which takes long to read.
        name: the argument the path came from.

    Raises:
        InputError: it is neither, or has no keys.
    """
    # YAML takes most of JSON, but no tabs.
    plain = _without(_COMMENT, text) if text.lstrip()[:1] in ("{", "/") else text
    is_json = plain.lstrip().startswith("{")
    try:
        if not is_json and len(text) > LARGEST_YAML:
            raise ValueError(f"it has {len(text):.4g} characters, and at most {LARGEST_YAML:.4g} are taken")
        keys = json.loads(_without(_LAST_COMMA, plain)) if is_json else _yaml(_from_opencv(text))
    except Exception as error:  # a parser of a broken file may raise anything
        reason = " ".join(str(error).split())
        raise InputError(f"{name}: {str(path)!r} cannot be read as YAML or JSON ({reason}).", name) from None
    if not isinstance(keys, dict):
        raise InputError(f"{name}: {str(path)!r} has no keys.", name)
    return {str(key): value for key, value in keys.items()}


def flat(values: Iterable[Any]) -> list[Any]:
    """The values of a list, and those of the lists within it."""
    return [value for row in values for value in (row if isinstance(row, list) else [row])]


def _from_opencv(text: str) -> str:
    """YAML of OpenCV as others read it: it may begin with %YAML:1.0, and then has no space in `{ id:9 }` or `id:9`."""
    plain = re.sub(r"\A%YAML.*\n", "", text)
    return plain if plain == text else re.sub(r"([{,]\s*\w+|^\s*[\w.]+):(?=\S)", r"\1: ", plain, flags=re.MULTILINE)


def _without(pattern: str, text: str) -> str:
    """A text of JSON without what matches outside of its texts."""
    return re.sub(f"({_TEXT})|{pattern}", lambda found: found[1] or "", text, flags=re.DOTALL)


class _Loader(yaml.SafeLoader):  # type: ignore[misc] # yaml has no types
    """Takes OpenCV's matrices for mappings, and 1e-5 for a number, which to YAML 1.1 is a text.

    Not libyaml's, which is faster: where values are nested deeply, it overflows the stack of the process.
    """


_Loader.add_constructor("tag:yaml.org,2002:opencv-matrix", _Loader.construct_yaml_map)
_Loader.add_implicit_resolver(
    "tag:yaml.org,2002:float", re.compile(r"[-+]?(\d+(\.\d*)?|\.\d+)[eE][-+]?\d+$"), list("-+.0123456789")
)


def _integer(loader: Any, node: Any) -> int:
    """An integer that can be printed: in other bases than ten, Python reads longer ones. None of YAML's base 60."""
    if ":" in node.value:
        raise ValueError(f"{node.value[:20]!r} is no number")
    value = loader.construct_yaml_int(node)
    str(value)
    return int(value)


_Loader.add_constructor("tag:yaml.org,2002:int", _integer)


def _yaml(text: str) -> Any:
    text = re.sub(r"\n---\s*\Z", "\n", text)  # with which ROS's tools end a message
    check_aliases(text)
    return yaml.load(text, _Loader)


def check_aliases(text: str) -> None:
    """Raise `ValueError` if the aliases of a text in YAML stand for more values than it has characters."""
    root = yaml.compose(text, _Loader)
    if root is not None and (values := _values(root, {})) > len(text):
        raise ValueError(f"its aliases stand for {values:.4g} values")


def _values(node: Any, known: dict[int, float]) -> float:
    """Number of values of a node with every alias written out; infinite for a node that holds itself."""
    if id(node) not in known:
        known[id(node)] = math.inf
        pairs = isinstance(node, yaml.MappingNode)
        parts = [part for pair in node.value for part in pair] if pairs else node.value
        known[id(node)] = 1.0 + (0.0 if isinstance(node, yaml.ScalarNode) else sum(_values(p, known) for p in parts))
    return known[id(node)]
