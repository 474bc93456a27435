"""`deployment.count=[20,10,3]`, `tag.paper`, `tag.budget`: how many tags of each of the sizes `tag.edges` there are.

And these sizes, where a map has them.
"""

from dataclasses import replace
from typing import TYPE_CHECKING

from omegaconf import DictConfig, ListConfig, open_dict

from .fixed import axes_in

if TYPE_CHECKING:
    from lmd.objectives.base import Objective
    from lmd.scene.deployment import Deployment
    from lmd.scene.scene import Scene


def take_sizes(cfg: DictConfig) -> None:
    """Take the sizes that the files of all tags say for `tag.edges`, if the user gives none.

    Raises:
        InputError: a file cannot be read.
    """
    import numpy as np

    from lmd.scene.tag_map_files import read_deployment

    node, tag = cfg.deployment, cfg.get("tag")  # runs of old have none
    if not tag or tag.get("edge") is not None or tag.get("edges") is not None or node.get("path") is None:
        return
    files = [(name, node[name]) for name in ("path", "fixed") if node.get(name) is not None]
    known = np.concatenate([read_deployment(path, name, axes=axes_in(node)).edges for name, path in files])
    if np.isfinite(known).all():
        with open_dict(cfg):
            cfg.tag.edges = np.unique(known).tolist()


def spell_counts(cfg: DictConfig) -> None:
    """Take a list `deployment.count` as the counts of the sizes that are placed, and their sum as the count.

    Fixed landmarks come on top of it.

    Raises:
        InputError: there are no sizes, or it has more or fewer numbers.
    """
    from lmd.core.checks import InputError, integer

    count = cfg.deployment.get("count")
    if not isinstance(count, ListConfig):
        return
    edges, counts = (cfg.get("tag") or {}).get("edges"), [integer("deployment.count", n, low=0) for n in count]
    if edges is None or len(edges) != len(counts):
        sizes = "is not given" if edges is None else f"has {len(edges)}"
        raise InputError(f"deployment.count = {counts} says how many tags have each of tag.edges, which {sizes}.")
    with open_dict(cfg):
        cfg.tag.counts = counts
        cfg.deployment.count = f"+{sum(counts)}" if cfg.deployment.get("fixed") else sum(counts)


def divide_paper(
    cfg: DictConfig, scene: "Scene", objective: "Objective", threads: int | None, fixed: "Deployment | None"
) -> "tuple[Scene, str]":
    """The scene with the counts of sizes found for `tag.paper` or `tag.budget`, if they are not given.

    Also what to say of it. The counts are recorded.

    Raises:
        InputError: that is too little, or the objective cannot say which tags are worth it.
    """
    from lmd.optimisers.composition import composition

    tag = scene.tag
    if tag.limit is None or tag.counts is not None or "count" not in cfg.deployment or "path" in cfg.deployment:
        return scene, ""
    counts = composition(scene, objective, threads, fixed)
    with open_dict(cfg):
        cfg.tag.counts = list(counts)
        cfg.deployment.count = sum(counts) + (0 if fixed is None else len(fixed))
    tag, visibility = replace(tag, counts=counts), scene.visibility
    if hasattr(visibility, "tag"):
        visibility = replace(visibility, tag=tag)  # type: ignore[type-var]
    sizes = ", ".join(f"{count} of {edge:g} m" for edge, count in zip(tag.sizes, counts, strict=True))
    limit = f"tag.budget = {tag.budget:g}" if tag.paper is None else f"tag.paper = {tag.paper:g} square metres"
    return replace(scene, tag=tag, visibility=visibility), f"{limit} make {sizes}"
