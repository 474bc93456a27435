"""The formats of files that are read, in one register, with those of other packages.

A package adds formats by an entry point of the group `lmd.formats`: a `Format`, or a list of them. They are tried
before those of `lmd`.
"""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from functools import cache, cached_property
from importlib import import_module
from importlib.metadata import entry_points
from itertools import chain
from typing import Any

from lmd.core.checks import InputError
from lmd.core.files import parse_keys

GROUP = "lmd.formats"
# The module of each family, whose `FORMATS` are tried in their order.
FAMILIES = {"calibration": "lmd.formats.calibration_formats"}


@dataclass(frozen=True)
class File:
    """A file whose format is asked for."""

    path: Any
    """For messages, and for readers of other packages."""
    text: str
    """Its text."""
    asked: Mapping[str, Any] = field(default_factory=dict)
    """Settings of the user that some formats of the family need, by name."""
    parse: Callable[[str], Mapping[str, Any]] | None = None
    """Function that reads the keys of `text`; None for YAML or JSON."""

    @cached_property
    def keys(self) -> Mapping[str, Any]:
        """The keys and values of YAML or JSON.

        Raises:
            InputError: the text is neither.
        """
        return parse_keys(self.path, self.text, "path") if self.parse is None else self.parse(self.text)

    @cached_property
    def first(self) -> str:
        """The first line that is neither blank nor a comment; empty if there is none."""
        lines = (line for line in self.text.splitlines() if line.strip() and not line.lstrip().startswith("#"))
        return next(lines, "")


@dataclass(frozen=True)
class Format:
    """A format that is read, or recognised and refused."""

    family: str
    """One of `FAMILIES`."""
    name: str
    """Name of the program or the standard."""
    recognises: Callable[[Any], bool]
    """Function that is true for a `File` of this format, of those that no earlier format recognises."""
    read: Callable[[Any], Any] | None = None
    """Function that reads a `File`, None for a format that is refused.

    That of a calibration returns the cameras by name, each in the keys of ROS's `camera_info`.
    """
    why_not: str = ""
    """Reason for the refusal and a way to a format that is read, without the full stop."""
    row: tuple[str, ...] = ()
    """Cells of the table in the documentation, which name arguments, as in `name=cam1`.

    Empty for a format that shares the row of another.
    """

    def __post_init__(self) -> None:
        if self.family not in FAMILIES:
            raise InputError(f"family must be one of {', '.join(FAMILIES)}, got {self.family!r}.", "family")


def has_keys(*names: str) -> Callable[[File], bool]:
    """A test for files that have all these keys."""
    return lambda file: set(names) <= file.keys.keys()


@cache
def outside() -> tuple[Format, ...]:
    """The formats of other packages.

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
    """True if a format of another package recognises a file; one that is neither YAML nor JSON may be one of ours."""
    try:
        return form.recognises(file)
    except InputError:
        return False


def format_of(family: str, file: File) -> Format | None:
    """The format of a file; None if it is not known.

    Raises:
        InputError: the format is known and refused.
    """
    theirs = (form for form in outside() if form.family == family and _takes(form, file))
    ours = (form for form in _own(family) if form.recognises(file))
    found = next(chain(theirs, ours), None)
    if found is not None and found.read is None:
        raise InputError(f"{found.why_not}.")
    return found


def _own(family: str) -> tuple[Format, ...]:
    formats: tuple[Format, ...] = import_module(FAMILIES[family]).FORMATS
    return formats


def rows(family: str) -> list[tuple[str, ...]]:
    """The rows of the table of a family in the documentation, by the alphabet."""
    return sorted((form.row for form in _own(family) if form.row), key=lambda row: row[0].lower())
