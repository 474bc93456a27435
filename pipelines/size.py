"""Print the range of a tag: `python -m pipelines.size camera=calibration camera.path=FILE tag.edge=0.15`.

The command prints the distances at which a tag is read at several incidence angles, the error of the pose from this tag
alone, and the smallest tag that is read at several distances.
"""

import math
from dataclasses import replace
from typing import TYPE_CHECKING

from omegaconf import DictConfig

from .nodes import instantiate, keyed, settings_of
from .pipeline import Pipeline, alone

if TYPE_CHECKING:
    from lmd.geometry.camera import Camera
    from lmd.scene.tag import Tag
    from lmd.sight.models.fiducial import Fiducial


MOST_ATTITUDE_RAD = 0.35  # greatest attitude error, rad (20 degrees), for which the linear prediction is valid


def size(cfg: DictConfig) -> None:
    """Print the range of each size of the configured tag for the configured camera."""
    from lmd.core.checks import InputError, real, vector
    from lmd.export.layout import largest_whole
    from lmd.export.paper import PAPERS
    from lmd.sight.models.fiducial import Fiducial

    camera, tag, criteria = (instantiate(settings_of(cfg, group)) for group in ("camera", "tag", "visibility"))
    if not isinstance(criteria, Fiducial):
        raise InputError("size is about what a detector reads: it needs visibility=fiducial.")
    tag.check_edge()
    angles = vector("incidence", cfg.incidence, len(cfg.incidence), low=0.0, high=90.0)
    distances = vector("distance", cfg.distance, len(cfg.distance), above=0.0)
    noise = real("pixel_noise", cfg.pixel_noise, above=0.0)
    tags = [tag.of_size(edge) for edge in tag.sizes]
    for one in tags:
        print(f"tag      {one.family}, {one.square} {one.size:g} m, with its quiet zone {one.paper_edge:.4g} m")
    print(f"camera   {camera.image_width:g} x {camera.image_height:g} pixels")
    print(f"detector {criteria.detector}\n")
    with keyed("tag"):
        for one in tags:
            if len(tags) > 1:
                print(f"{one.square} of {one.size:g} m")
            _print(_reads(camera, one, replace(criteria, tag=one), angles, distances, noise))
            print()
        print(f"smallest {tag.square} that is read, metres")
        _print(_edges(camera, tags[0], criteria, angles, distances))
    on_sheets = ", ".join(f"{math.floor(1e3 * largest_whole(tags[0], paper)) / 1e3:g} m ({paper})" for paper in PAPERS)
    print(f"\nlargest {tag.square} on one sheet: {on_sheets}")


def _reads(
    camera: "Camera",
    tag: "Tag",
    criteria: "Fiducial",
    angles: tuple[float, ...],
    distances: tuple[float, ...],
    noise: float,
) -> list[list[str]]:
    """Table of the range of a tag at each angle, and of the pose error at each distance within the range."""
    from lmd.evaluation.reach import pose_bounds, reach

    rows = [["incidence", "read from", "to", *(f"alone at {distance:g} m" for distance in distances)]]
    for angle in angles:
        found = reach(criteria, camera, math.radians(angle))
        bounds = ["never", ""] if math.isnan(found.farthest) else [f"{found.nearest:.3g} m", f"{found.farthest:.3g} m"]
        errors = zip(*pose_bounds(camera, tag, distances, math.radians(angle), noise), strict=True)
        fixed = [
            _error(*error) if found.nearest <= distance <= found.farthest else "-"
            for distance, error in zip(distances, errors, strict=True)
        ]
        rows.append([f"{angle:g} deg", *bounds, *fixed])
    return rows


def _error(position: float, attitude: float) -> str:
    """Text of two standard deviations; "not fixed" beyond `MOST_ATTITUDE_RAD`."""
    return f"{1e3 * position:.3g} mm, {math.degrees(attitude):.2g} deg" if attitude < MOST_ATTITUDE_RAD else "not fixed"


def _edges(
    camera: "Camera", tag: "Tag", criteria: "Fiducial", angles: tuple[float, ...], distances: tuple[float, ...]
) -> list[list[str]]:
    """Table of the smallest tag that is read at each angle and distance."""
    from lmd.evaluation.reach import smallest_edge

    def of(edge: float) -> "Fiducial":
        return replace(criteria, tag=replace(tag, edge=edge))

    rows = [["incidence", *(f"at {distance:g} m" for distance in distances)]]
    for angle in angles:
        edges = [smallest_edge(of, camera, distance, math.radians(angle)) for distance in distances]
        rows.append([f"{angle:g} deg", *("none" if math.isnan(edge) else f"{edge:.3g}" for edge in edges)])
    return rows


def _print(rows: list[list[str]]) -> None:
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    for row in rows:
        print("   ".join(f"{text:<{width}}" for text, width in zip(row, widths, strict=True)).rstrip())


main = Pipeline("size", size, runner=alone)

if __name__ == "__main__":
    main()
