"""Registry of file formats for reading and writing, including formats of other packages and of the user.

A format is a `Format`, or a row of YAML from which `described` makes one. The formats of one kind of files, such as tag
maps, are a *family*. A package adds formats with an entry point of the group `lmd.formats`: a `Format`, a row, or a
list of these. A user adds YAML files with rows, in folders that the environment variable `LMD_FORMATS` lists; commands
add the folder `file_formats` of each folder on `hydra.searchpath`. Added formats are tried before the formats of `lmd`.
"""

import os
import re
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from functools import cache, partial
from importlib import import_module
from importlib.metadata import entry_points
from itertools import chain
from pathlib import Path
from typing import Annotated, Any, NamedTuple

import yaml

from lmd.core.checks import Checked, InputError, choice
from lmd.core.files import LARGEST_YAML, read_text
from lmd.formats.trees import MISSING, File, entries, find, matches, plain
from lmd.scene.families import FAMILIES as TAG_FAMILIES

GROUP = "lmd.formats"
ADDED = "LMD_FORMATS"  # environment variable that lists the user's folders of rows
# Families, each with a table of formats that are tried in the table's order; the last format accepts every file.
FAMILIES = ("calibration", "trajectory", "tag map", "room", "floor plan", "detections")
# For each family with keyed files, class whose fields describe how such a file is read, see `described`.
KEYED = {
    "calibration": "lmd.formats.keyed_cameras.KeyedCameras",
    "tag map": "lmd.formats.keyed_tags.KeyedTags",
    "detections": "lmd.formats.detection_formats.KeyedDetections",
}
HEAD = 2000  # number of characters at the beginning of a file that `begins` searches
CALL = re.compile(r"(?P<module>[\w.]+)\.(?P<name>\w+)\((?P<arguments>[\w, ]*)\)")


class Writer(NamedTuple):
    """Writer of one format: its function, which writes a tag map, a plan or print sheets, and facts about the format.

    Args:
        file: name of the file.
        write: function that writes the file. The arguments are the path, the tag map `tags` and, for printed files, the
            paper size `paper`.
        only_apriltag: True if readers of the format support only the families of AprilTag.
        only_opencv: True if readers of the format support only families that OpenCV has.
        on_paper: True if the file is to be printed.
        edges: tag sizes that the file holds: `OWN`, a size for each tag; `ONE`, one size for all tags; `NONE`, no size.
    """

    file: str
    write: Callable[..., None]
    only_apriltag: bool = False
    only_opencv: bool = False
    on_paper: bool = False
    edges: str = "own"

    @property
    def families(self) -> tuple[str, ...]:
        """Families of tags that readers of the format support."""
        return tuple(
            name
            for name, family in TAG_FAMILIES.items()
            if (family.apriltag or not self.only_apriltag) and (family.dictionary or not self.only_opencv)
        )


OWN, ONE, NONE = "own", "one", "none"  # values of `Writer.edges`


@dataclass(frozen=True)
class Format(Checked):
    """Format of files: a test that recognises a file; and a reader, a writer, or the reason why a file is refused."""

    family: Annotated[str, partial(choice, options=FAMILIES)]
    """Kind of the files in this format, one of `FAMILIES`."""
    name: str
    """Name of the program or the standard; for a format that `lmd` can write, also its name in the option `formats`,
    unless `written` has another name.
    """
    recognises: Callable[[Any], bool]
    """Function that returns True for a `File` of this format; called only for files that no earlier format
    recognises.
    """
    read: Callable[[Any], Any] | None = None
    """Function that reads a `File`; None for a format that is only written or refused.

    | family | it returns |
    | --- | --- |
    | calibration | mapping of names to `lmd.formats.calibrations.ReadCamera` |
    | trajectory | `lmd.formats.pose_files.Rows` |
    | tag map | `lmd.formats.placed_tag.Found` |
    | room | mapping of names to meshes of trimesh, z up |
    | floor plan | `lmd.space.wall_lines.ReadPlan` |
    | detections | `lmd.formats.detections.DetectedTags` |
    """
    why_not: str | Callable[[Any], str] = ""
    """Reason for the refusal, with advice on a supported format, without the full stop; may be a function of a `File`.
    """
    row: str = ""
    """Rows of the documentation's table of formats, as a text: one line for each kind of file in this format, with
    ` | ` between the cells. A row also names arguments of the reader, as in `name=cam1`.

    The text is empty if the row of another format also stands for this format.
    """
    writer: Writer | None = None
    """Writer of the format; None if the format is only read."""
    written: str = ""
    """Name of the writer in the option `formats`; empty if it equals `name`."""


def begins(mark: str) -> Callable[[File], bool]:
    """Make a test for files whose first `HEAD` characters contain a match of a regular expression.

    In the expression, `^` matches at the beginning of each line.
    """
    return lambda file: re.search(mark, file.text[:HEAD], re.MULTILINE) is not None


def ends(*suffixes: str) -> Callable[[File], bool]:
    """Make a test for files whose names end in one of the given suffixes."""
    return lambda file: file.suffix in suffixes


def anything(_: File) -> bool:
    """Return True for every file. This is the test of a format that is tried after all others of its family."""
    return True


def function_of(text: str) -> Callable[[File], Any]:
    """Make a function of a `File` from the text of a call, such as `module.function(a, b)`.

    The result imports the module and calls its function. An argument in the text is the name of a setting in
    `File.asked`, or of an attribute of the file; `file` is the file itself.

    Raises:
        InputError: the text is not such a call. If the function does not exist, the result raises the error.
    """
    if not isinstance(text, str) or (parts := CALL.fullmatch(text)) is None:
        raise InputError(f"a function call in a format must be module.function(argument), got {text!r}.")

    def call(file: File) -> Any:
        try:
            function = getattr(import_module(parts["module"]), parts["name"])
        except (ImportError, AttributeError) as error:
            raise InputError(f"{text}, which a format calls, cannot be imported: {error}.") from None
        names = parts["arguments"].replace(",", " ").split()
        return function(
            *(file if n == "file" else file.asked[n] if n in file.asked else getattr(file, n) for n in names)
        )

    return call


@dataclass(frozen=True, kw_only=True)
class Keyed:
    """Description of a format of keys and values, such as YAML or JSON, by paths.

    The paths lead to the entries of a file, such as cameras or tags, and to the values of an entry; see
    `lmd.formats.trees`.
    """

    at: Mapping[str, str]
    """Paths in an entry to the values of quantities, keyed by quantity. In a path, `{key}` stands for the key of the
    entry. The value at a path with `?` at the end may be missing.
    """
    each: str = ""
    """Paths to the entries, separated by `|`; the first that leads to entries is taken. Empty for a file that is itself
    the only entry.
    """
    patterns: Mapping[str, str] = field(default_factory=dict)
    """Regular expressions whose matches in the file's text form the tree of keys and values, see
    `lmd.formats.trees.matches`.
    """
    source: str = ""
    """Function call, as a text, that returns the tree of keys and values; empty for the tree of the file itself."""

    def entries(self, file: File) -> tuple[Any, list[tuple[str, Mapping[str, Any]]]]:
        """The tree of keys and values in a file; and the entries of the tree, such as its cameras or tags.

        An entry is a pair: its key, and the mapping of its keys and values.
        """
        tree: Any = function_of(self.source)(file) if self.source else {}
        if not self.source:
            tree = matches(file.text, self.patterns) if self.patterns else file.data
        listed = (list(entries(tree, path)) for path in self.each.split("|"))
        return tree, next((some for some in listed if some), [])


def described(row: Mapping[str, Any], family: str, advice: str = "") -> Format:
    """Make a format from a row of a table of formats.

    A row has these keys:

    - `name`; and `row`, the format's row in the documentation.
    - tests `text`, `head`, `ends`, `when`, `any` and `marks`. A file is of the format if it passes all tests of the
      row. `text` is a regular expression that matches in the text, `head` one that matches in its beginning. `ends`
      lists suffixes of the file's name; `when` is a call that returns True; `any` accepts all files. Each of `marks` is
      a path that must lead to a value; a regular expression after a `=` must match this value. A path after a `!` must
      lead to no value.
    - `refuse`, the reason for a refusal. In it `{keys}` stands for the keys of the file, `{known}` for the names of the
      formats that are read, and `{advice}` for the argument `advice`.
    - `writes`, the fields of a `Writer` and the name of the writer in the option `formats`.
    - `read`, a call that reads a file. Without `read`, the other keys are the fields of the family's class in `KEYED`.

    A row without tests describes a format that is only written.

    Raises:
        InputError: the row lacks its name, or has an unknown key or value.
    """
    rest = {key: value for key, value in row.items() if key != "family"}
    name, why_not, read, written = (rest.pop(key, "") for key in ("name", "refuse", "read", "writes"))
    if not isinstance(name, str) or not name:
        raise InputError(f"a format must have a name, but its keys are {', '.join(map(str, row))[:200]}.")
    try:
        tests, cells = _tests(rest), rest.pop("row", "")
        called, writer = _writer(**written) if written else ("", None)
        reading = function_of(read) if read else None
        if tests and not (why_not or read):
            module, _, keyed = KEYED[family].rpartition(".")
            reading = getattr(import_module(module), keyed)(**rest).read
    except (AttributeError, TypeError, KeyError, re.error) as error:
        raise InputError(f"the format {name!r} of a {family} cannot be made ({error}).") from None
    if writer is not None and cells.count(" | ") == 2:
        program, content, is_read = cells.split(" | ")
        star = " *" if writer.only_apriltag else ""
        cells = f"{program} | `{called}`{star} | `{writer.file}`{content} | {is_read}"

    def recognises(file: Any) -> bool:
        return bool(tests) and all(test(file) for test in tests)

    def reason(file: Any) -> str:
        text = str(why_not).replace("{advice}", advice)
        if "{keys}" in text:
            text = text.replace("{keys}", ", ".join(file.data)[:200] or "no keys")
        known = dict.fromkeys(form.name for form in formats(family) if form.read) if "{known}" in text else ()
        return text.replace("{known}", ", ".join(known))

    return Format(family, name, recognises, reading, reason if why_not else "", cells, writer, called)


def _tests(row: dict[str, Any]) -> list[Callable[[Any], bool]]:
    """Make the tests that recognise files of a format; each test is a function that returns True or False for a `File`.

    `row` is the description of the format: the keys and values that `described` explains. The keys of the tests, such
    as `head` and `ends`, are removed from `row`.
    """
    tests: list[Callable[[Any], bool]] = [anything] if row.pop("any", False) else []
    if call := row.pop("when", None):
        tests.append(function_of(call))
    if endings := row.pop("ends", None):
        tests.append(ends(*endings.split()))
    if pattern := row.pop("head", None):
        tests.append(begins(pattern))
    if pattern := row.pop("text", None):
        whole = re.compile(pattern, re.MULTILINE)
        tests.append(lambda file: whole.search(file.text) is not None)
    if marks := row.pop("marks", None):
        loose = row.get("loose", False)
        tests.append(lambda file: all(_has(file.data, mark, loose) for mark in marks))
    return tests


def _has(keys: Mapping[str, Any], mark: str, loose: bool) -> bool:
    if mark.startswith("!"):
        return not _has(keys, mark[1:], loose)
    path, _, pattern = mark.partition("=")
    if "*" in path or path.startswith("/"):
        return any(True for _ in entries(keys, path))
    compared = {plain(key): value for key, value in keys.items()} if loose else keys
    value = find(compared, plain(path) if loose else path)
    return value is not MISSING and (not pattern or re.fullmatch(pattern, str(value)) is not None)


def _writer(name: str, write: str, **options: Any) -> tuple[str, Writer]:
    """Name and writer of a row's format. `write` is the name of a function, `module.function`, which is imported only
    when a file is written.
    """
    module, _, function = write.rpartition(".")
    return name, Writer(write=lambda *args, **tags: getattr(import_module(module), function)(*args, **tags), **options)


def _table(text: str, family: str | None, source: str) -> tuple[Format, ...]:
    """Formats of a table in YAML: a mapping with `rows` and `advice`, or a list of rows.

    Args:
        text: the YAML.
        family: family of all rows; None if each row names its family.
        source: the table, for messages.
    """
    try:
        table = yaml.load(text, getattr(yaml, "CSafeLoader", yaml.SafeLoader))  # the user's file, or lmd's own
        advice, listed = (table["advice"], table["rows"]) if isinstance(table, dict) else ("", table)
        rows = [dict(row) for row in listed]
    except (yaml.YAMLError, KeyError, TypeError, ValueError) as error:
        raise InputError(f"{source} is not a list of formats ({' '.join(str(error).split())}).") from None
    return tuple(described(row, family or row.get("family", ""), advice) for row in rows)


@cache
def outside() -> tuple[Format, ...]:
    """Formats of the user, and of other packages.

    Raises:
        InputError: an entry point cannot be loaded, or is not a format; or a file of the user is not a list of formats.
    """
    found: list[Format] = []
    for folder in filter(None, os.environ.get(ADDED, "").split(os.pathsep)):
        for path in sorted(Path(folder).glob("*.yaml")):
            found += _table(read_text(path, ADDED, LARGEST_YAML), None, f"{ADDED}: {str(path)!r}")
    for entry in entry_points(group=GROUP):
        try:
            loaded = entry.load()
        except (ImportError, AttributeError) as error:
            raise InputError(f"the entry point {entry.value} of {GROUP} cannot be loaded: {error}.") from None
        for form in [loaded] if isinstance(loaded, Mapping) or not isinstance(loaded, Iterable) else loaded:
            if not isinstance(form, Format | Mapping):
                raise InputError(
                    f"the entry point {entry.value} of {GROUP} must be a Format, a row (a mapping), or a list of these."
                )
            found.append(form if isinstance(form, Format) else described(form, form.get("family", "")))
    return tuple(found)


def _takes(form: Format, file: File) -> bool:
    """True if a format of the user or of another package recognises a file.

    False also if its test raises an `InputError`, for example because the test expects YAML and the file has another
    format.
    """
    try:
        return form.recognises(file)
    except InputError:
        return False


def format_of(family: str, file: File) -> Format:
    """First format of a family that recognises a file.

    Formats of the user and of other packages are tried before those of `lmd`.
    """
    theirs = (form for form in outside() if form.family == family and _takes(form, file))
    ours = (form for form in formats(family) if form.recognises(file))
    return next(chain(theirs, ours))


def read(family: str, file: File) -> Any:
    """Read a file with the first format that recognises it, see `Format.read`.

    Raises:
        InputError: the format is refused or unknown, or the file is damaged.
    """
    form = format_of(family, file)
    if form.read is None:
        raise file.refused(form.why_not if isinstance(form.why_not, str) else form.why_not(file))
    return form.read(file)


@cache
def formats(family: str) -> tuple[Format, ...]:
    """Formats of a family that are part of `lmd`, in the order in which they are tried."""
    path = Path(__file__).with_name("tables") / f"{family.replace(' ', '_')}.yaml"
    return _table(path.read_text(encoding="utf-8"), family, str(path))


def writers() -> dict[str, Writer]:
    """Writers of tag maps, plans and print sheets, keyed by their names in the option `formats`."""
    forms = chain(formats("tag map"), outside())
    return {form.written or form.name: form.writer for form in forms if form.writer is not None}


def rows(family: str) -> list[str]:
    """Rows of the documentation's table of the formats of a family, in alphabetical order."""
    found = (row for form in formats(family) for row in form.row.splitlines())
    return sorted(found, key=lambda row: row.strip("`").lower())
