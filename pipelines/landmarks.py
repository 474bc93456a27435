"""Landmarks described by the config groups `deployment` and `tag`: fixed landmarks, number of landmarks, tag sizes."""

import re
from copy import deepcopy
from dataclasses import replace
from typing import TYPE_CHECKING, Any

from omegaconf import DictConfig, ListConfig

from .nodes import note, plain

if TYPE_CHECKING:
    from lmd.objectives.base import Objective
    from lmd.scene.deployment import Deployment
    from lmd.scene.scene import Scene

NO_SOURCE = ("fixed", "marked", "measured", "mounting_error")  # keys of `deployment` that are not arguments of a source
TABLE = ("axes", "columns")  # keys of `deployment` that apply to every table of tags, including that of a source
MORE = re.compile(r"\+(\d+)")  # a count of landmarks in addition to the fixed ones


def fixed_of(node: DictConfig, family: str | None) -> "Deployment | None":
    """Read the landmarks that keep their poses; None if no landmark is fixed.

    With the key `marked`, only the landmarks that the file marks as fixed are returned, because the file of a run also
    holds movable landmarks.

    Args:
        node: group `deployment`.
        family: name of the tag family; None for landmarks that are points.

    Raises:
        InputError: the file cannot be read, or holds no deployment of that family.
    """
    if (path := node.get("fixed")) is None:
        return None
    import numpy as np

    from lmd.formats.tag_maps import read_deployment
    from lmd.scene.footprints import COLUMN

    found = read_deployment(path, "fixed", family, **table_in(node))
    note(found.note)
    marks = found.labels.columns.get(COLUMN) if found.labels and node.get("marked") else None
    return found if marks is None else found[np.array(marks) == "1"]


def table_in(node: DictConfig) -> dict[str, Any]:
    """Arguments of `read_deployment` that describe a table of landmarks, from the config group `deployment`."""
    return {key: plain(node[key]) for key in TABLE if node.get(key) is not None}


def others_of(node: DictConfig, fixed: "Deployment | None") -> tuple[int | None, DictConfig]:
    """Return the total number of landmarks, and the config node of the source of the landmarks that are not fixed.

    Args:
        node: group `deployment`.
        fixed: fixed landmarks; None without such landmarks.

    Returns:
        total number of landmarks, fixed ones included; None if no landmark is fixed or no count is given.
        config node of the source. The key `count` is the number of landmarks that the source places, or None if the
            source is a file, which may also contain the fixed landmarks.

    Raises:
        InputError: the count has a plus sign, such as +5, which adds landmarks to fixed landmarks, but no landmark is
            fixed; or the count leaves no landmark to place.
    """
    from lmd.core.checks import InputError, integer

    count = node.get("count")
    more = MORE.fullmatch(count) if isinstance(count, str) else None
    if fixed is None and more:
        raise InputError(f"count = {count} needs deployment.fixed; otherwise write the number without a sign.", "count")
    source = deepcopy(node)
    for key in (*NO_SOURCE, *(key for key in TABLE if node.get(key) is None or "path" not in node)):
        source.pop(key, None)
    if fixed is None or count is None:
        return None, source
    total = len(fixed) + int(more[1]) if more else integer("count", count, low=1)
    if total <= len(fixed):
        raise InputError(f"count = {count} leaves no landmark to place: {node.fixed} has {len(fixed)}.", "count")
    source.count = None if "path" in source else total - len(fixed)
    return total, source


def take_sizes(node: DictConfig, tag: DictConfig) -> None:
    """Set `tag.edges` to the distinct edge lengths in the landmark files, unless the user gives an edge length.

    Nothing is set if `deployment.path` is not given, or if a landmark in the files has no edge length.

    Args:
        node: group `deployment`.
        tag: group `tag`, which is changed.

    Raises:
        InputError: a file cannot be read.
    """
    import numpy as np

    from lmd.formats.tag_maps import read_deployment

    if tag.get("edge") is None and tag.get("edges") is None and node.get("path") is not None:
        files = [name for name in ("path", "fixed") if node.get(name) is not None]
        known = np.concatenate([read_deployment(node[name], name, **table_in(node)).edges for name in files])
        if np.isfinite(known).all():
            tag.edges = np.unique(known).tolist()


def spell_counts(node: DictConfig, tag: DictConfig) -> None:
    """Move a list in `deployment.count` to `tag.counts`, and set `deployment.count` to the sum of the list.

    The list has the number of placed tags of each size. Fixed landmarks are not counted; if there are any, the sum has
    a plus sign, as it adds landmarks to them.

    Args:
        node: group `deployment`, which is changed.
        tag: group `tag`, which is changed.

    Raises:
        InputError: the list has another length than `tag.edges`.
    """
    from lmd.core.checks import InputError, integer

    if not isinstance(count := node.get("count"), ListConfig):
        return
    edges, counts = tag.get("edges"), [integer("deployment.count", n, low=0) for n in count]
    if edges is None or len(edges) != len(counts):
        sizes = "is not given" if edges is None else f"has {len(edges)}"
        raise InputError(f"deployment.count = {counts} must have one number for each of tag.edges, which {sizes}.")
    tag.counts = counts
    node.count = f"+{sum(counts)}" if node.get("fixed") else sum(counts)


def divide_paper(
    cfg: DictConfig, scene: "Scene", objective: "Objective", threads: int | None, fixed: "Deployment | None"
) -> "Scene":
    """Choose by greedy selection how many tags of each size to place, within the user's limit on paper or cost.

    The limit is `tag.paper`, the total area of paper, or `tag.budget`, the total cost. The chosen numbers are written
    to the groups `deployment` and `tag`, and are printed. Nothing is chosen if the configuration has no limit, already
    gives the numbers, or takes the landmarks from a file.

    Args:
        cfg: configuration, which is changed.
        scene: scene with the tag that the group `tag` describes.
        objective: objective of the landmarks.
        threads: number of threads; None for every processor.
        fixed: fixed landmarks.

    Returns:
        scene whose tag has the chosen numbers as its `counts`; `scene` itself if nothing is chosen.

    Raises:
        InputError: the limit is too small, or the objective cannot compare sizes.
    """
    from lmd.optimisers.selection import composition

    made, node = scene.tag, cfg.deployment
    if made.limit is None or made.counts is not None or "count" not in node or "path" in node:
        return scene
    cfg.tag.counts = list(counts := composition(scene, objective, threads, fixed))
    node.count = sum(counts) + (0 if fixed is None else len(fixed))
    made, sight = replace(made, counts=counts), scene.visibility
    visibility = replace(sight, tag=made) if hasattr(sight, "tag") else sight  # type: ignore[type-var]
    sizes = ", ".join(f"{count} of {edge:g} m" for edge, count in zip(made.sizes, counts, strict=True))
    limit = f"tag.budget = {made.budget:g}" if made.paper is None else f"tag.paper = {made.paper:g} square metres"
    note(f"{limit} make {sizes}")
    return replace(scene, tag=made, visibility=visibility)
