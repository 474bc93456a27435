"""Write tag maps, mounting plans and print sheets: `python -m pipelines.export run=DIR formats=[wpilib,plan]`."""

from dataclasses import replace
from typing import TYPE_CHECKING

from omegaconf import DictConfig

from .building import build_parts
from .command import Command
from .composing import editable
from .landmarks import take_sizes
from .nodes import keyed, note, plain, settings_of
from .study import Report, Study

if TYPE_CHECKING:
    from lmd.export.exports import Export
    from lmd.scene.tag import Tag


def build_export(cfg: DictConfig, key: str, tag: "Tag") -> "Export":
    """Build the export of the landmarks in all formats that the configuration lists at `key`.

    The value null at `key` means all formats. Printed formats whose Python packages are missing are then left out, and
    named in a note.

    Args:
        cfg: configuration.
        key: config key of the list of formats.
        tag: tag of the landmarks.

    Raises:
        InputError: a format is unknown, or cannot hold the tags.
    """
    from lmd.export.exports import Export, all_formats, formats_of, not_printed

    with keyed(formats=key, paper="paper_size", edge="tag.edge"):
        paper, names = cfg.paper_size, plain(cfg[key])
        chosen = Export(formats_of(tag) if names is None else names, paper, names is None)
        if names is None and not tag.is_point:
            left_out = not_printed()
            chosen = replace(chosen, formats=tuple(name for name in chosen.formats if name not in left_out))
            for name, reason in left_out.items():
                note(f"{all_formats()[name].file} is not written: {reason}")
        chosen.check(tag)
    return chosen


def export(cfg: DictConfig) -> Study:
    """Return the study that writes the configured deployment in the formats listed in `formats`."""
    from lmd.core.checks import InputError
    from lmd.export.exports import all_formats
    from lmd.export.sheets import describe_sheets
    from lmd.formats.tag_map import TagMap

    settings_of(cfg, "deployment")
    cfg = editable(cfg)
    with keyed("deployment"):
        take_sizes(cfg.deployment, cfg.tag)
    parts = build_parts(cfg)
    scene = parts.scene
    chosen = build_export(cfg, "formats", scene.tag)
    if not chosen.formats:
        raise InputError("formats must list at least one format (docs/mounting.md), got [].")
    deployment = parts.draw(cfg.seed)
    writers = chosen.writers(scene.room, scene.tag, deployment)
    tags = TagMap(scene.room, scene.tag, deployment)
    for name, reason in chosen.unfit(tags).items():
        note(f"{all_formats()[name].file} is not written: {reason}")
    for name in chosen.silent(tags):
        note(f"{all_formats()[name].file} does not have the edges of the tags, {tags.edges_in_words}")
    lines = {"tags": f"{len(deployment)} of {scene.tag.family}, {tags.edges_in_words}"}
    if "sheets" in chosen.formats:
        lines["sheets"] = describe_sheets(tags, chosen.paper)
    about = f"export {parts.objective.name} K={len(deployment)}"
    return Study("export", lambda _: Report(writers, lines=lines), about)


main = Command("export", export)

if __name__ == "__main__":
    main()
