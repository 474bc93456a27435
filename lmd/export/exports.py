"""Output formats by name, and the settings of an export."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Annotated, Any

from lmd.core.checks import Checked, InputError, choice
from lmd.core.optional import optional
from lmd.export.paper import PAPERS
from lmd.export.plan import write_plan
from lmd.export.sheets import write_sheets
from lmd.formats.registry import NONE, ONE, Writer, writers
from lmd.formats.tag_map import TagMap
from lmd.scene.deployment import Deployment
from lmd.scene.tag import Tag
from lmd.space.space import Space


def all_formats() -> dict[str, Writer]:
    """Writers of all output formats, keyed by the format's name; plugins of other packages may add formats."""
    printed = {
        "plan": Writer("plan.pdf", write_plan, on_paper=True),
        "sheets": Writer("sheets.pdf", write_sheets, on_paper=True),
    }
    return writers() | printed


def formats_of(tag: Tag) -> tuple[str, ...]:
    """Names of the formats whose readers support the family of a tag."""
    return tuple(name for name, form in all_formats().items() if tag.family in form.families)


def check_printing(name: str) -> None:
    """Raise `InputError` if a package that the printed format `name` needs is missing."""
    optional("reportlab", "export")
    if name == "sheets":
        optional("cv2", "export")


def not_printed() -> dict[str, str]:
    """Reasons why printed formats cannot be written, keyed by the format's name: each names a missing package."""
    reasons = {}
    for name, form in all_formats().items():
        if form.on_paper:
            try:
                check_printing(name)
            except InputError as error:
                reasons[name] = str(error)
    return reasons


def one_edge(edges: Sequence[float]) -> str:
    """Text, a clause without a full stop, that says why a format with one edge length cannot hold the tags.

    `edges` are the edge lengths of the tags, metres.
    """
    return f"it holds one edge length, but the tags have {', '.join(f'{edge:g}' for edge in sorted(edges))} m"


@dataclass(frozen=True)
class Export(Checked):
    """Settings of the export of a deployment.

    Args:
        formats: names in `all_formats`.
        paper: paper size of printed files, one of `lmd.export.paper.PAPERS`.
        fitting: True to leave out formats that cannot hold the tags, False to raise an error.

    Raises:
        InputError: a format or the paper is unknown.
    """

    formats: tuple[str, ...]
    paper: Annotated[str, partial(choice, options=tuple(PAPERS))]
    fitting: bool = False

    def _validate(self) -> None:
        if not isinstance(self.formats, list | tuple):
            raise InputError(f"formats must be a list of {', '.join(all_formats())}, got {self.formats!r}.", "formats")
        for name in self.formats:
            choice("formats", name, tuple(all_formats()))
        object.__setattr__(self, "formats", tuple(self.formats))

    def check(self, tag: Tag) -> None:
        """Check that `formats` can hold tags of the family and size of `tag`.

        Raises:
            InputError: a format cannot hold the tags, the tag is a point, or a package that a printed format needs is
                missing.
        """
        if self.formats:
            tag.check_edge()
        for name in self.formats:
            if name not in formats_of(tag):
                known = ", ".join(all_formats()[name].families)
                raise InputError(f"formats has {name}, which supports families {known}, not {tag.family}.", "formats")
            if all_formats()[name].on_paper:
                check_printing(name)
            if all_formats()[name].edges == ONE and len(tag.sizes) > 1 and not self.fitting:
                raise InputError(f"formats has {name}: {one_edge(tag.sizes)}.", "formats")

    def unfit(self, tags: TagMap) -> dict[str, str]:
        """Reasons why some of `formats` cannot hold the tags, keyed by the format's name."""
        several = [tag.size for tag, _ in tags.by_size]
        return {
            name: one_edge(several) for name in self.formats if len(several) > 1 and all_formats()[name].edges == ONE
        }

    def silent(self, tags: TagMap) -> tuple[str, ...]:
        """Names of the formats in `formats` whose files do not contain the sizes of tags.

        Empty if all tags have one size.
        """
        several = len(tags.by_size) > 1
        return tuple(name for name in self.formats if several and all_formats()[name].edges == NONE)

    def writers(self, room: Space, tag: Tag, deployment: Deployment) -> dict[str, Callable[[Path], None]]:
        """Functions that write the tags to a given path, one for each format, keyed by the name of the file.

        Raises:
            InputError: `formats` is not empty, but the tag is a point, the family lacks an id, or a format cannot hold
                the tags.
        """
        if not self.formats:
            return {}
        tags = TagMap(room, tag, deployment)
        unfit = self.unfit(tags)
        for name, reason in unfit.items():
            if not self.fitting:
                raise InputError(f"formats has {name}: {reason}.", "formats")
        writers: dict[str, Callable[[Path], None]] = {}
        for name in self.formats:
            if name in unfit:
                continue
            form = all_formats()[name]
            options: dict[str, Any] = {"paper": self.paper} if form.on_paper else {}
            writers[form.file] = partial(form.write, tags=tags, **options)
        return writers
