"""Range of tags: where a camera reads a tag, how well that tag fixes the pose, and the smallest tag that is read."""

import math

from omegaconf import DictConfig, OmegaConf

from .building import camera_of, visibility_of
from .nodes import instantiate, keyed
from .study import Report, Study


def size(cfg: DictConfig) -> Study:
    """Study of the range of each size of the configured tag for the configured camera."""
    from lmd.core.checks import InputError
    from lmd.evaluation.reach import Reading, reach_text
    from lmd.export.paper import PAPERS, largest_whole
    from lmd.sight.models.fiducial import Fiducial
    from lmd.space.parts import made

    given = OmegaConf.to_container(cfg.size) if OmegaConf.is_config(cfg.size) else {}
    reading = made("size", given, Reading)
    (camera, *others), tag = camera_of(cfg.camera).cameras, instantiate(cfg.tag)
    criteria, _ = visibility_of(cfg.visibility)
    if others or not isinstance(criteria, Fiducial):
        lack = "one camera: leave camera.rig out" if others else "a detector: it needs visibility=fiducial"
        raise InputError(f"size is about what is read by {lack}.")
    tag.check_edge()
    papers = ((paper, largest_whole(tag.of_size(tag.sizes[0]), paper)) for paper in PAPERS)
    on_sheets = ", ".join(f"{math.floor(1e3 * edge) / 1e3:g} m ({paper})" for paper, edge in papers)
    with keyed("tag"):
        text = f"{reach_text(camera, tag, criteria, reading)}\n\nlargest {tag.square} on one sheet: {on_sheets}"
    return Study("size", lambda _: Report({"size.txt": f"{text}\n"}, text=text))
