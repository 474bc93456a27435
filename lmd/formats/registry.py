"""Registry of the file formats that are read and written, including formats of other packages.

A package adds formats by an entry point of the group `lmd.formats`: a `Format`, or a list of formats. Added formats are
tried before the formats of `lmd`.
"""

import math
import re
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from functools import cache, cached_property
from importlib import import_module
from importlib.metadata import entry_points
from itertools import chain
from pathlib import Path
from typing import Any, NamedTuple

from lmd.core.checks import InputError
from lmd.core.files import parse_keys, read_text
from lmd.core.tables import COMMENT
from lmd.scene.families import FAMILIES as TAG_FAMILIES

GROUP = "lmd.formats"
# Module of each family. The module's `FORMATS` are tried in their order; the last format accepts every file.
FAMILIES = {
    "calibration": "lmd.formats.calibration_formats",
    "trajectory": "lmd.formats.pose_files",
    "tag map": "lmd.formats.tag_map_formats",
    "room": "lmd.formats.meshes",
    "floor plan": "lmd.formats.plans",
    "detections": "lmd.formats.detection_formats",
}
HEAD = 2000  # number of characters that `begins` searches


@dataclass(frozen=True)
class File:
    """File whose format is to be found; the file is read when its content is first used."""

    path: Any
    """Path of the file."""
    argument: str = "path"
    """Name of the argument with the path, for messages."""
    asked: Mapping[str, Any] = field(default_factory=dict)
    """User's settings that formats of the family need, by name."""
    largest: float = math.inf
    """Maximum size, bytes; a larger file is refused."""

    @cached_property
    def text(self) -> str:
        """Text of the file.

        Raises:
            InputError: the file cannot be read, or holds no text.
        """
        return read_text(self.path, self.argument, self.largest)

    @cached_property
    def keys(self) -> Mapping[str, Any]:
        """Keys and values of YAML or JSON.

        Raises:
            InputError: the text is neither YAML nor JSON.
        """
        return parse_keys(self.path, self.text, self.argument)

    @cached_property
    def lines(self) -> list[str]:
        """Lines that are neither blank nor comments."""
        return [line for line in self.text.splitlines() if line.strip() and line.lstrip()[0] != COMMENT]

    @property
    def first(self) -> str:
        """First of `lines`; empty if there is none."""
        return self.lines[0] if self.lines else ""

    @property
    def suffix(self) -> str:
        """Suffix of the file's name, such as `.json`, in small letters."""
        return Path(self.path).suffix.lower()

    def refused(self, reason: str) -> InputError:
        """Error about a file that is refused for a reason."""
        return InputError(f"{reason}.")


class Writer(NamedTuple):
    """Output of a format: a tag map, a plan or print sheets.

    Args:
        file: name of the file.
        write: function of the path, the map as `tags` and, for printed files, the size of the paper as `paper`; for the
            plan, also the direction of north as `north`.
        only_apriltag: True if readers of the format support only the families of AprilTag.
        only_opencv: True if readers of the format support only families that OpenCV has.
        on_paper: True if the file is to be printed.
        check: function that raises `InputError`, with the predicate of a sentence, if the format cannot hold the tags
            of a map; None if it can hold any tags.
        edges: tag sizes in the file: `OWN`, a size for each tag; `ONE`, one size for all tags; `NONE`, no size.
    """

    file: str
    write: Callable[..., None]
    only_apriltag: bool = False
    only_opencv: bool = False
    on_paper: bool = False
    check: Callable[[Any], None] | None = None
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
class Format:
    """Format that is read, written, or recognised and refused."""

    family: str
    """One of `FAMILIES`."""
    name: str
    """Name of the program or the standard; for a written format, its name in `formats`."""
    recognises: Callable[[Any], bool]
    """Function that returns True for a `File` of this format; called only for files that no earlier format
    recognises.
    """
    read: Callable[[Any], Any] | None = None
    """Function that reads a `File`; None for a refused format.

    | family | it returns |
    | --- | --- |
    | calibration | the cameras by name, each in the keys of ROS's `camera_info`, or a function that returns them |
    | trajectory | `lmd.formats.pose_files.Rows` |
    | tag map | `lmd.formats.placed_tag.Found` |
    | room | `lmd.formats.captured_rooms.Captured`, or meshes of trimesh by name, z up |
    | floor plan | `lmd.formats.plans.ReadPlan` |
    | detections | `lmd.formats.detections.DetectedTags` |
    """
    why_not: str | Callable[[Any], str] = ""
    """Reason for the refusal and advice on a supported format, without the full stop; may be a function of a `File`.
    """
    row: str = ""
    """Row of the table in the documentation, with ` | ` between cells; the row names arguments, as in `name=cam1`.

    Several kinds of file have a line each; empty for a format that shares the row of another format.
    """
    writer: Writer | None = None
    """Output of the format; None if the format is only read."""

    def __post_init__(self) -> None:
        if self.family not in FAMILIES:
            raise InputError(f"family must be one of {', '.join(FAMILIES)}, got {self.family!r}.", "family")


def has_keys(*names: str) -> Callable[[File], bool]:
    """Make a test for files that have all the given keys."""
    return lambda file: set(names) <= file.keys.keys()


def begins(mark: str) -> Callable[[File], bool]:
    """Make a test for files whose first characters match a regular expression, in which `^` matches at the beginning of
    each line.
    """
    return lambda file: re.search(mark, file.text[:HEAD], re.MULTILINE) is not None


def ends(*suffixes: str) -> Callable[[File], bool]:
    """Make a test for files whose names end in one of the given suffixes."""
    return lambda file: file.suffix in suffixes


def anything(_: File) -> bool:
    """Test that is True for every file, for the last format of a family."""
    return True


@cache
def outside() -> tuple[Format, ...]:
    """Formats of other packages.

    Raises:
        InputError: an entry point cannot be loaded, or is no format.
    """
    found: list[Format] = []
    for entry in entry_points(group=GROUP):
        try:
            loaded = entry.load()
        except (ImportError, AttributeError) as error:
            raise InputError(f"the entry point {entry.value} of {GROUP} cannot be loaded: {error}.") from None
        listed = list(loaded) if isinstance(loaded, Iterable) else [loaded]
        if not all(isinstance(form, Format) for form in listed):
            raise InputError(f"the entry point {entry.value} of {GROUP} must be a Format or a list of them.")
        found += listed
    return tuple(found)


def _takes(form: Format, file: File) -> bool:
    """True if a format of another package recognises a file; False if its test fails because the file is neither YAML
    nor JSON.
    """
    try:
        return form.recognises(file)
    except InputError:
        return False


def format_of(family: str, file: File) -> Format:
    """First format of a family that recognises a file."""
    theirs = (form for form in outside() if form.family == family and _takes(form, file))
    ours = (form for form in formats(family) if form.recognises(file))
    return next(chain(theirs, ours))


def read(family: str, file: File) -> Any:
    """Read a file by its format, see `Format.read`.

    Raises:
        InputError: the format is refused or unknown, or the file is damaged.
    """
    form = format_of(family, file)
    if form.read is None:
        raise file.refused(form.why_not if isinstance(form.why_not, str) else form.why_not(file))
    return form.read(file)


def formats(family: str) -> tuple[Format, ...]:
    """Formats of a family in `lmd`, in the order in which they are tried."""
    found: tuple[Format, ...] = import_module(FAMILIES[family]).FORMATS
    return found


def rows(family: str) -> list[str]:
    """Rows of the table of a family in the documentation, in alphabetical order."""
    found = (row for form in formats(family) for row in form.row.splitlines())
    return sorted(found, key=lambda row: row.strip("`").lower())
