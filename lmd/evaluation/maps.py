"""Pose errors of a camera or a rig due to an inaccurate map, in which the poses of tags differ from their true poses.

The pose of the camera is estimated from one image by PnP (`lmd.geometry.pose`); the pose of a rig is estimated from the
images of all its cameras. A map that is displaced as a whole by a rigid motion T displaces the pose by T; independent
errors of tags partly cancel out.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd

from lmd.core.checks import FloatArray
from lmd.evaluation.accuracy import TOLERANCES, as_localisation
from lmd.geometry.pose import body_from_corners, pose_error
from lmd.geometry.projection import project
from lmd.geometry.se3 import axis_and_right
from lmd.geometry.squares import corners
from lmd.objectives.base import figure_of, labelled_figures
from lmd.problem import Problem
from lmd.scene.deployment import Deployment
from lmd.scene.tag import Tag
from lmd.sight.views import visible_to_each

QUANTILES = (0.05, 0.5, 0.95)


@dataclass(frozen=True)
class MountedTags:
    """Tags, not necessarily upright, with the directions of their upper edges."""

    deployment: Deployment
    """K landmarks."""
    ups: FloatArray
    """Unit vectors in the planes of the tags that point towards their upper edges, `(K, 3)`, world frame."""

    @classmethod
    def of(cls, deployment: Deployment) -> "MountedTags":
        """Make the tags of a deployment, with the directions of their upper edges."""
        return cls(deployment, deployment.ups)

    def points(self, tag: Tag) -> FloatArray:
        """Points of the tags that are measured in images, world frame, metres, `(K, M, 3)`: the M = 4 corners of each
        tag, or the centre of each point landmark (M = 1).
        """
        places, edges = self.deployment.places, self.deployment.edges_of(tag)
        return places[:, None] if tag.is_point else corners(places, self.deployment.normals, self.ups, edges)


def map_errors(
    problem: Problem, truth: MountedTags, maps: Mapping[str, MountedTags], poses: FloatArray, rng: np.random.Generator
) -> pd.DataFrame:
    """Measure the errors of poses estimated from single images with inaccurate maps.

    Args:
        problem: problem with the scene, n, and the noise of a corner. For an objective other than `Localisation`, the
            noise of the default `Localisation` is used.
        truth: K tags with their true poses. The visibility model, which assumes upright tags, decides which tags are
            seen.
        maps: maps, keyed by name: the K tags with the poses from which the camera pose is estimated. All maps are
            tested with equal noise.
        poses: poses of the camera or the rig's body in the world, `(N, 4, 4)`.
        rng: random generator that draws the noise.

    Returns:
        table with a row for each pose from which at least n tags are seen; `tags` is the number of seen tags. For each
        map, `position_<name>` (m) and `attitude_<name>` (rad) are the errors of the pose estimated with this map; NaN
        where the points do not determine a pose.
    """
    scene, tag = problem.scene, problem.scene.tag
    points, body = truth.points(tag), (scene.cameras, scene.extrinsics)
    images = np.stack([
        project(camera, poses @ mounted, points.reshape(-1, 3)).reshape(len(poses), *points.shape[:2], 2)
        for camera, mounted in zip(*body, strict=True)
    ])  # fmt: skip
    images += rng.normal(0.0, as_localisation(problem.objective).pixel_noise, images.shape)
    seen = visible_to_each(problem.evaluator, truth.deployment, poses[:, :3, 3], axis_and_right(poses))
    seen &= np.isfinite(images).all(axis=(-2, -1))
    images[~seen] = np.nan
    counts = seen.any(axis=0).sum(axis=1)
    enough = np.flatnonzero(counts >= problem.objective.n)
    columns: dict[str, FloatArray] = {"tags": counts[enough]}
    for name, known in maps.items():
        found = [body_from_corners(*body, known.points(tag), list(images[:, v])) for v in enough]
        errors = pose_error(poses[enough], np.array(found).reshape(-1, 4, 4))
        columns |= {f"{part}_{name}": error for part, error in zip(("position", "attitude"), errors, strict=True)}
    return pd.DataFrame(columns)


def named_figures(*tables: pd.DataFrame) -> dict[str, float]:
    """Finite values in tables, keyed by names such as `fitness/5` for the row `fitness` and the column `5 %`."""
    return {
        f"{row}/{column}".replace(" %", ""): float(value)
        for table in tables
        for row, values in table.to_dict("index").items()
        for column, value in values.items()
        if np.isfinite(value)
    }


def percent_text(figures: pd.DataFrame) -> str:
    """Table of fractions as text for a terminal, in per cent; the names of metrics are replaced by their labels."""
    named = figures.rename(index=_label, columns=_label)
    return named.to_string(float_format=lambda value: f"{100.0 * value:.2f}", na_rep="-")


def _label(name: object) -> str:
    return figure_of(str(name)).label


def figures_text(columns: Mapping[Any, Mapping[Any, float]]) -> str:
    """Table of metrics as text for a terminal, with labels and units. `columns` are the table's columns, keyed by their
    headings; a column has its values keyed by the name of the metric.
    """
    return pd.DataFrame({name: labelled_figures(figures) for name, figures in columns.items()}).to_string(na_rep="-")


def error_quantiles(views: pd.DataFrame) -> pd.DataFrame:
    """Quantiles of the columns of `map_errors`; the rows are named `position_<name>` and `attitude_<name>`.

    The columns `5 %`, `50 %` and `95 %` are quantiles over the views that have a pose estimate. For positions there are
    also columns `within_<n>mm`, the fraction of all views with an error of at most n mm; a view without an estimate
    counts as outside every limit.
    """
    rows: dict[str, dict[str, float]] = {}
    for name in views.columns[views.columns.str.startswith(("position_", "attitude_"))]:
        errors = views[name]
        rows[name] = {f"{100 * q:g} %": float(errors.quantile(q)) for q in QUANTILES}
        if name.startswith("position_"):
            rows[name] |= {f"within_{1e3 * limit:g}mm": float((errors <= limit).mean()) for limit in TOLERANCES}
    return pd.DataFrame.from_dict(rows, orient="index")


def errors_text(views: pd.DataFrame, n: int) -> str:
    """Text for a terminal with the values of `error_quantiles`, in mm and mrad, for `views` that show at least `n`
    tags.
    """
    table = error_quantiles(views)
    parts = [f"{name.replace('_', ', map as ', 1)} [{'mm' if name[0] == 'p' else 'mrad'}]" for name in table.index]
    shares = table.columns[table.columns.str.startswith("within")]
    shown = {label: (1e3 * table[label]).map("{:.2f}".format) for label in table.columns.difference(shares, sort=False)}
    shown |= {label.replace("_", " "): table[label].map("{:.1%}".format, na_action="ignore") for label in shares}
    head = f"error of the pose from one image (PnP) in {len(views)} random views of {n} tags or more"
    return f"{head}\n{pd.DataFrame(shown).set_axis(parts).to_string(na_rep='')}"
