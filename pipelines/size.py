"""Range of tags: where a camera reads a tag, how well that tag fixes the pose, and the smallest tag that is read."""

import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from omegaconf import DictConfig, OmegaConf

from .building import camera_of, visibility_of
from .nodes import instantiate, keyed
from .study import Report, Study

if TYPE_CHECKING:
    from collections.abc import Sequence

    from lmd.geometry.camera import Camera
    from lmd.scene.tag import Tag
    from lmd.sight.models.fiducial import Fiducial


MOST_ATTITUDE_RAD = 0.35  # greatest attitude error, rad (20 degrees), for which the linear prediction is valid


@dataclass(frozen=True)
class Reading:
    """Where a tag is looked at.

    Raises:
        InputError: a value is out of range.
    """

    incidence: "Sequence[float]" = (0.0, 30.0, 45.0, 60.0)
    """Angles between the tag's normal and the line of sight, degrees."""
    distance: "Sequence[float]" = (0.5, 1.0, 2.0, 4.0, 8.0)
    """Distances from the camera, metres."""
    pixel_noise: float = 0.5
    """Standard deviation of a corner, pixels."""

    def __post_init__(self) -> None:
        from lmd.core.checks import real, vector

        vector("incidence", self.incidence, len(self.incidence), low=0.0, high=90.0)
        vector("distance", self.distance, len(self.distance), above=0.0)
        real("pixel_noise", self.pixel_noise, above=0.0)


def size(cfg: DictConfig) -> Study:
    """Study of the range of each size of the configured tag for the configured camera."""
    from lmd.core.checks import InputError
    from lmd.export.layout import largest_whole
    from lmd.export.paper import PAPERS
    from lmd.sight.models.fiducial import Fiducial
    from lmd.space.parts import made

    given = OmegaConf.to_container(cfg.size) if OmegaConf.is_config(cfg.size) else {}
    reading = made("size", Reading, given)
    (camera, *others), tag, (criteria, _) = (
        camera_of(cfg.camera).cameras,
        instantiate(cfg.tag),
        visibility_of(cfg.visibility),
    )
    if others:
        raise InputError("size is about one camera: leave camera.rig out.")
    if not isinstance(criteria, Fiducial):
        raise InputError("size is about what a detector reads: it needs visibility=fiducial.")
    tag.check_edge()
    tags = [tag.of_size(edge) for edge in tag.sizes]
    lines = [
        *(f"tag      {t.family}, {t.square} {t.size:g} m, with its quiet zone {t.paper_edge:.4g} m" for t in tags),
        f"camera   {camera.image_width:g} x {camera.image_height:g} pixels",
        f"detector {criteria.detector}\n",
    ]
    with keyed("tag"):
        for one in tags:
            lines += [f"{one.square} of {one.size:g} m"] * (len(tags) > 1)
            lines += [*_columns(_reads(camera, one, replace(criteria, tag=one), reading)), ""]
        lines += [f"smallest {tag.square} that is read, metres", *_columns(_edges(camera, tags[0], criteria, reading))]
    on_sheets = ", ".join(f"{math.floor(1e3 * largest_whole(tags[0], paper)) / 1e3:g} m ({paper})" for paper in PAPERS)
    text = "\n".join([*lines, f"\nlargest {tag.square} on one sheet: {on_sheets}"])
    return Study("size", lambda _: Report({"size.txt": f"{text}\n"}, text=text))


def _reads(
    camera: "Camera",
    tag: "Tag",
    criteria: "Fiducial",
    reading: Reading,
) -> list[list[str]]:
    """Table of the range of a tag at each angle, and of the pose error at each distance within the range."""
    from lmd.evaluation.reach import pose_bounds, reach

    rows = [["incidence", "read from", "to", *(f"alone at {distance:g} m" for distance in reading.distance)]]
    for angle in reading.incidence:
        found = reach(criteria, camera, math.radians(angle))
        bounds = ["never", ""] if math.isnan(found.farthest) else [f"{found.nearest:.3g} m", f"{found.farthest:.3g} m"]
        errors = zip(*pose_bounds(camera, tag, reading.distance, math.radians(angle), reading.pixel_noise), strict=True)
        fixed = [
            _error(*error) if found.nearest <= distance <= found.farthest else "-"
            for distance, error in zip(reading.distance, errors, strict=True)
        ]
        rows.append([f"{angle:g} deg", *bounds, *fixed])
    return rows


def _error(position: float, attitude: float) -> str:
    """Text of two standard deviations; "not fixed" beyond `MOST_ATTITUDE_RAD`."""
    return f"{1e3 * position:.3g} mm, {math.degrees(attitude):.2g} deg" if attitude < MOST_ATTITUDE_RAD else "not fixed"


def _edges(camera: "Camera", tag: "Tag", criteria: "Fiducial", reading: Reading) -> list[list[str]]:
    """Table of the smallest tag that is read at each angle and distance."""
    from lmd.evaluation.reach import smallest_edge

    def of(edge: float) -> "Fiducial":
        return replace(criteria, tag=replace(tag, edge=edge))

    rows = [["incidence", *(f"at {distance:g} m" for distance in reading.distance)]]
    for angle in reading.incidence:
        edges = [smallest_edge(of, camera, distance, math.radians(angle)) for distance in reading.distance]
        rows.append([f"{angle:g} deg", *("none" if math.isnan(edge) else f"{edge:.3g}" for edge in edges)])
    return rows


def _columns(rows: list[list[str]]) -> list[str]:
    """Lines of a table in columns."""
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    return ["   ".join(f"{text:<{width}}" for text, width in zip(row, widths, strict=True)).rstrip() for row in rows]
