"""Figures of a deployment as measured, compared with the figures of its plan."""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from lmd.core.checks import InputError, said_of
from lmd.detection.frames import draw_poses
from lmd.evaluation.losses import TAGS_LISTED
from lmd.evaluation.maps import MountedTags, error_quantiles, errors_text, figures_text, map_errors, named_figures
from lmd.evaluation.mounting import SAMPLE, off_grid_figures
from lmd.evaluation.validation import Sample
from lmd.formats.tag_maps import read_deployment
from lmd.problem import Problem
from lmd.scene.deployment import Deployment
from lmd.scene.footprints import as_they_are

RANDOM_VIEWS = 2000  # number of random poses
MEASURED_STREAM = 0x737572766579  # separates the random numbers of the noise from other uses of the seed


def read_measured(path: str | Path, problem: Problem, plan: Deployment, **table: Any) -> Deployment:
    """Read the measured places of the tags of a plan, in its order and with its labels.

    Measured places are not corrected: tags need not be flush, and papers may seem to overlap. Tags may be anywhere if
    the plan is free (`FileDeployment.free`).

    Args:
        path: CSV with the columns of a plan, or a tag map.
        problem: problem of the plan.
        plan: K landmarks.
        table: `axes` and `columns` of `lmd.formats.tag_maps.read_deployment`.

    Raises:
        InputError: the file is no deployment, does not have the ids of the plan, or a tag is outside the room and
            belongs to no surface.
    """
    measured = read_deployment(path, "measured", problem.scene.tag.own_family, **table)
    for name, ids in (
        ("lacks the", np.setdiff1d(plan.ids, measured.ids)),
        ("has a", np.setdiff1d(measured.ids, plan.ids)),
    ):
        if len(ids):
            other = "that is planned" if name == "lacks the" else "that is not planned"
            raise InputError(f"measured: {path} {name} landmark {ids[0]} {other} ({len(ids)} in all).", "measured")
    places = np.argsort(measured.ids)[np.searchsorted(np.sort(measured.ids), plan.ids)]
    with said_of(f"measured: {path}", "measured"):
        measured, scene = replace(measured[places], note=measured.note), problem.scene
        hung = measured.with_surfaces(scene.room, as_they_are(problem.start), scene.footprints.papers(measured))
    return replace(hung, labels=plan.labels, edges=np.where(np.isnan(hung.edges), plan.edges, hung.edges))


@dataclass(frozen=True)
class Measured:
    """Figures of a deployment as measured and as planned."""

    n: int
    """Number of tags that a view must show for a pose."""
    moved: pd.DataFrame
    """Columns `id,moved,dx,dy,dz,tilted`, metres and rad: differences from plan to measured place, the largest
    first.
    """
    figures: pd.DataFrame
    """Columns `planned` and `measured`, indexed by `figure`: figures on the grid, and off the grid as
    `grid_free_...`.
    """
    views: pd.DataFrame
    """Errors of the pose with the map as `planned` and as `measured`, see `map_errors`."""

    @property
    def tables(self) -> dict[str, pd.DataFrame]:
        """See `lmd.evaluation.Study.tables`."""
        return {"moved": self.moved, "survey": self.figures.reset_index()}

    def metrics(self) -> dict[str, float]:
        """Figures by names such as `fitness/planned`, `position_planned/50` (m) and `moved/greatest` (m)."""
        off = self.moved[["moved", "tilted"]].agg(["median", "max"]).T.rename(columns={"max": "greatest"})
        return named_figures(self.figures, error_quantiles(self.views), off)

    def to_text(self) -> str:
        """Text for a terminal."""
        far, most = self.moved.head(TAGS_LISTED), self.moved.tilted.max()
        listed = ", ".join(f"{i} ({1e3 * away:.1f})" for i, away in zip(far["id"], far.moved, strict=True))
        head = (
            f"as measured: tags hang {1e3 * self.moved.moved.median():.1f} mm off (median), at most "
            f"{1e3 * self.moved.moved.max():.1f} mm, and tilted by at most {1e3 * most:.1f} mrad\n"
            f"farthest off, mm: {listed}"
        )
        return f"{head}\n\nfigures\n{figures_text(self.figures.to_dict())}\n\n{errors_text(self.views, self.n)}"


def as_measured(
    problem: Problem,
    plan: Deployment,
    measured: Deployment,
    seed: int,
    sample: Sample = SAMPLE,
    views: int = RANDOM_VIEWS,
) -> Measured:
    """Score a deployment as measured and as planned. Results do not depend on the number of threads.

    Args:
        problem: problem with the scene and the objective.
        plan: K landmarks.
        measured: landmarks of the plan at their measured places.
        seed: seed of the random positions and the views.
        sample: random positions off the grid.
        views: number of random views.
    """
    both = {"planned": plan, "measured": measured}
    on_grid = pd.DataFrame([problem.metrics(each) for each in both.values()])
    figures = pd.concat([on_grid, off_grid_figures(problem, list(both.values()), seed, sample)], axis=1)
    maps, poses = {name: MountedTags.of(each) for name, each in both.items()}, draw_poses(problem.scene, views, seed)
    noise = np.random.default_rng([seed, MEASURED_STREAM])
    return Measured(
        problem.objective.n,
        _moved(plan, measured),
        figures.set_axis(list(both)).T.rename_axis("figure"),
        map_errors(problem, maps["measured"], maps, poses, noise),
    )


def _moved(plan: Deployment, measured: Deployment) -> pd.DataFrame:
    """Table `Measured.moved`."""
    way = measured.places - plan.places
    chord = np.linalg.norm(measured.normals - plan.normals, axis=1)  # more accurate than the cosine
    rows = {
        "id": plan.ids,
        "moved": np.linalg.norm(way, axis=1),
        **dict(zip(("dx", "dy", "dz"), way.T, strict=True)),
        "tilted": 2.0 * np.arcsin(np.clip(chord / 2.0, 0.0, 1.0)),
    }
    return pd.DataFrame(rows).sort_values("moved", ascending=False, kind="stable", ignore_index=True)
