"""`deployment.fixed` and `deployment.count`: what hangs already, and how many landmarks there are beside it."""

import re
from copy import deepcopy
from typing import TYPE_CHECKING, Any

from omegaconf import DictConfig, OmegaConf, open_dict

from .notes import note

if TYPE_CHECKING:
    from lmd.scene.deployment import Deployment

COUNT = "deployment.count="
PATH = "deployment.path"
# Keys of the group that say nothing of where landmarks come from.
NO_SOURCE = ("fixed", "marked", "measured", "mounting_error")
TABLES = "axes"  # the key for all tables of tags, of which those of a source are one
MORE = re.compile(r"\+(\d+)")


def quoted(override: str) -> str:
    """An override as it is to be read by Hydra, to which `+5` and `5` are the same number: `+5` becomes `'+5'`."""
    return re.sub(rf"(?<=[=,]){MORE.pattern}(?=,|$)", r"'+\1'", override) if override.startswith(COUNT) else override


def fixed_of(node: DictConfig, family: str | None) -> "Deployment | None":
    """The landmarks that a configured deployment keeps where they are; None for none.

    Of a file that holds the others too, as that of a run does, they are those it marks, if `marked` is true.

    Args:
        node: the group `deployment`.
        family: of the tags; None for points.

    Raises:
        InputError: the file cannot be read, or what it holds is no deployment of that family.
    """
    import numpy as np

    from lmd.formats.tag_maps import read_deployment
    from lmd.scene.fixed import COLUMN

    path = node.get("fixed")  # runs of old have none
    if path is None:
        return None
    found = read_deployment(path, "fixed", family, axes_in(node))
    note(found.note)
    marks = found.labels.columns.get(COLUMN) if found.labels and node.get("marked") else None
    return found if marks is None else found[np.array(marks) == "1"]


def axes_in(node: DictConfig) -> Any:
    """Directions of the axes of a tag in the tables that a group `deployment` names; None for our own."""
    axes = node.get(TABLES)  # runs of old have none
    return OmegaConf.to_container(axes) if OmegaConf.is_config(axes) else axes


def total_of(node: DictConfig, fixed: "Deployment | None") -> int | None:
    """How many landmarks there are in all, the fixed ones among them; None if none is fixed or nothing says how many.

    Raises:
        InputError: the count goes on from fixed landmarks, of which there are none, or leaves none to place.
    """
    from lmd.core.checks import InputError, integer

    count = node.get("count")
    more = MORE.fullmatch(count) if isinstance(count, str) else None
    if fixed is None:
        if more:
            raise InputError(f"count = {count} adds to the landmarks of fixed, which is not given.", "count")
        return None
    if count is None:
        return None
    total = len(fixed) + int(more[1]) if more else integer("count", count, low=1)
    if total <= len(fixed):
        raise InputError(f"count = {count} leaves none to place: {node.fixed} has {len(fixed)} landmarks.", "count")
    return total


def others_of(node: DictConfig, fixed: "Deployment | None", total: int | None) -> DictConfig:
    """The source of all landmarks but the fixed ones, of `total` in all.

    A file may have the fixed ones among its landmarks: how many it adds shows when they are put beside each other.
    """
    source = deepcopy(node)
    with open_dict(source):
        for key in NO_SOURCE:
            source.pop(key, None)
        if source.get(TABLES) is None or "path" not in source:
            source.pop(TABLES, None)
    if fixed is not None and total is not None:
        source.count = None if "path" in source else total - len(fixed)
    return source
