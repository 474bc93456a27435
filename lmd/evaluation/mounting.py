"""Metrics of a deployment whose tags have random mounting errors, or whose tags were measured after mounting.

In every draw all tags have independent errors. The metrics of a draw are computed on the grid and at random positions.
Then camera poses are estimated from single images, once with the map of the planned tags and once with the map of the
mounted tags, which a survey would give.
"""

from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import pandas as pd

from lmd.core.checks import Checked, Count, FloatArray, InputError, NotNegative, real, said_of
from lmd.core.memory import check_memory
from lmd.detection.frames import draw_poses
from lmd.evaluation.losses import TAGS_LISTED
from lmd.evaluation.maps import (
    QUANTILES,
    MountedTags,
    error_quantiles,
    errors_text,
    figures_text,
    map_errors,
    named_figures,
)
from lmd.evaluation.validation import Sample, sampled_evaluators
from lmd.formats.tag_maps import read_deployment
from lmd.geometry.squares import upright
from lmd.objectives.base import SelfValidating
from lmd.problem import Problem
from lmd.scene.deployment import Deployment
from lmd.scene.footprints import as_they_are

SAMPLE = Sample(groups=8, positions=256, divisions=23)
VIEWS_PER_DRAW = 40  # number of random poses of a draw
POSE_BYTES = 4 * 4 * 8  # memory of a pose
MOUNTING_STREAM = 0x6D6F756E74  # separates the random numbers of the draws from other uses of the seed


QuarterTurn = Annotated[float, partial(real, low=0.0, high=np.pi / 2.0)]


@dataclass(frozen=True)
class MountingError(Checked):
    """Standard deviations of the independent normal errors with which tags are mounted.

    Raises:
        InputError: a value is negative, an angle is more than a quarter turn, or the number of draws is not positive.
    """

    position: NotNegative = 0.0
    """Standard deviation of the position along each of the two axes in the plane of the surface, metres."""
    turn: QuarterTurn = 0.0
    """Standard deviation of the rotation of the tag about its normal, rad."""
    tilt: QuarterTurn = 0.0
    """Standard deviation of the tilt of the tag's normal about each of the two axes in the surface's plane, rad."""
    draws: Count = 100
    """Number of draws, in each of which all tags are mounted again."""

    def _validate(self) -> None:
        what = f"draws = {self.draws} mountings, each in {VIEWS_PER_DRAW} views,"
        check_memory(POSE_BYTES * VIEWS_PER_DRAW * self.draws, what, "draws")

    @property
    def is_none(self) -> bool:
        """True if all errors are zero, so that all tags hang as planned."""
        return not (self.position or self.turn or self.tilt)

    def covariances(self, problem: Problem, plan: Deployment) -> FloatArray:
        """Covariance of each planned tag's mounting error in position (metres) and rotation (rad), world frame, `(K, 6,
        6)`; zeros for fixed tags.
        """
        right, up = upright(plan.normals)
        axes = np.stack([right, up, plan.normals], axis=-1)
        found = np.zeros((len(plan), 6, 6))
        for first, deviations in ((0, (self.position, self.position, 0.0)), (3, (self.tilt, self.tilt, self.turn))):
            block = axes * np.square(deviations) @ np.swapaxes(axes, 1, 2)
            found[:, first : first + 3, first : first + 3] = block
        found[: problem.fixed_count] = 0.0
        return found

    def draw(self, problem: Problem, plan: Deployment, rng: np.random.Generator) -> MountedTags:
        """Draw the poses of the tags of a plan after mounting.

        Tags stay on their surface, and footprints do not overlap: a tag that would reach beyond an edge of its surface,
        or overlap an earlier tag, moves to the nearest allowed place. Fixed tags (`Problem.fixed`) do not move.

        Args:
            problem: problem with the surfaces, the footprints, and the fixed tags.
            plan: K landmarks with their surfaces.
            rng: random generator that draws the errors.

        Raises:
            InputError: the surfaces have no room for all tags with their white margins.
        """
        from scipy.spatial.transform import Rotation

        free = (np.arange(len(plan)) >= problem.fixed_count)[:, None]
        shift = np.where(free, rng.normal(0.0, self.position, (len(plan), 2)), 0.0)
        turns = np.where(free, rng.normal(0.0, (self.tilt, self.tilt, self.turn), (len(plan), 3)), 0.0)
        along = np.stack(upright(plan.normals), axis=1)  # (K, 2, 3)
        moved = self._separated(problem, replace(plan, positions=plan.positions + (shift[:, None] @ along)[:, 0]))
        axes = np.stack([*upright(moved.normals), moved.normals], axis=-1)
        _, ups, normals = np.moveaxis(axes @ Rotation.from_rotvec(turns).as_matrix(), -1, 0)
        return MountedTags(replace(moved, normals=normals), ups)

    def _separated(self, problem: Problem, moved: Deployment) -> Deployment:
        """Copy of `moved` in which overlapping landmarks are moved apart on their surfaces; landmarks that belong to no
        surface stay.
        """
        on = np.flatnonzero(moved.surfaces >= 0)
        if not len(on):
            return moved
        apart = problem.scene.footprints.separated(moved[on], fixed=int((on < problem.fixed_count).sum()))
        if apart is None:
            raise InputError(f"position = {self.position:g} m moves tags too far: some find no free place.", "position")
        return moved.put(on, apart)


@dataclass(frozen=True)
class Mounted:
    """Metrics of a plan whose tags have random mounting errors."""

    error: MountingError
    """Distribution of the mounting errors."""
    seed: int
    """Seed of the draws."""
    n: int
    """Number of tags that a view must show before a pose is estimated."""
    planned: pd.Series
    """Metrics of the plan without mounting errors: on the grid, and off the grid (at random positions), where the names
    begin with `grid_free_`.
    """
    draws: pd.DataFrame
    """Metrics as in `planned`, with a row for each draw."""
    views: pd.DataFrame
    """Errors of the poses that are estimated with two maps: `planned` has the planned poses of the tags, `mounted` the
    poses after mounting. See `map_errors`; column `draw` has the number of the draw.
    """

    @property
    def table(self) -> pd.DataFrame:
        """Table of the metrics, indexed by `figure`: the value `planned`, and the `mean` and the quantiles `5 %`, `50
        %` and `95 %` over the draws.
        """
        quantiles = {f"{100 * q:g} %": self.draws.quantile(q) for q in QUANTILES}
        return pd.DataFrame({"planned": self.planned, "mean": self.draws.mean(), **quantiles}).rename_axis("figure")

    @property
    def tables(self) -> dict[str, pd.DataFrame]:
        """See `lmd.evaluation.Study.tables`."""
        return {
            "mounting": self.table.reset_index(),
            "mountings": self.draws.reset_index(),
            "mounting_views": self.views,
        }

    def metrics(self) -> dict[str, float]:
        """Metrics keyed by names such as `fitness/5` and `position_planned/50` (the number is the quantile in per
        cent); pose errors are in metres and rad.
        """
        return named_figures(self.table.drop(columns="planned"), error_quantiles(self.views))

    def to_text(self) -> str:
        """Text for a terminal: the mounting errors, the metrics, and the pose errors."""
        error = self.error
        head = (
            f"as mounted: tags off by {1e3 * error.position:g} mm along their surface, turned by "
            f"{1e3 * error.turn:g} and tilted by {1e3 * error.tilt:g} mrad (1 sigma); {error.draws} draws, seed "
            f"{self.seed}"
        )
        return f"{head}\n{figures_text(self.table.to_dict())}\n\n{errors_text(self.views, self.n)}"


def mounted(problem: Problem, plan: Deployment, error: MountingError, seed: int, sample: Sample = SAMPLE) -> Mounted:
    """Compute the metrics of a plan with random mounting errors. Results do not depend on the number of threads.

    Args:
        problem: problem with the scene and the objective.
        plan: K landmarks with their surfaces.
        error: distribution of the mounting errors.
        seed: seed of the mounting errors, of the random positions, and of the views.
        sample: random positions off the grid, shared by all draws.

    Raises:
        InputError: the surfaces have no room for all tags with their white margins.
    """
    plan = replace(plan, surveyed=None)  # tags are mounted at their places on the surfaces
    streams = np.random.default_rng([seed, MOUNTING_STREAM]).spawn(error.draws)
    hung = [error.draw(problem, plan, rng) for rng in streams]
    all_of_them = [plan, *(each.deployment for each in hung)]
    figures = _figures(problem, all_of_them, seed, sample)
    poses = draw_poses(problem.scene, error.draws * VIEWS_PER_DRAW, seed).reshape(error.draws, VIEWS_PER_DRAW, 4, 4)
    maps = [{"planned": MountedTags.of(plan), "mounted": each} for each in hung]
    views = [map_errors(problem, *drawn) for drawn in zip(hung, maps, poses, streams, strict=True)]
    numbered = pd.concat(views, keys=range(error.draws), names=["draw"]).reset_index("draw").reset_index(drop=True)
    draws = figures.iloc[1:].reset_index(drop=True).rename_axis("draw")
    return Mounted(error, seed, problem.objective.n, figures.iloc[0], draws, numbered)


def _figures(problem: Problem, deployments: list[Deployment], seed: int, sample: Sample) -> pd.DataFrame:
    """Table of the metrics on the grid, and off the grid (at random positions), with a row for each deployment."""
    on_grid = pd.DataFrame([problem.metrics(each) for each in deployments])
    return pd.concat([on_grid, off_grid_figures(problem, deployments, seed, sample)], axis=1)


def off_grid_figures(problem: Problem, deployments: list[Deployment], seed: int, sample: Sample) -> pd.DataFrame:
    """Table of the objective's shares (`Objective.shares`) off the grid, with a row for each deployment of K landmarks.

    A share is a metric that is a mean over positions. Here the means are over one sample of random positions. An
    objective with its own validation (`SelfValidating`) computes the shares by its own method.
    """
    objective = problem.objective
    if isinstance(objective, SelfValidating):
        return pd.DataFrame([objective.off_grid(problem.evaluator, each) for each in deployments])
    positions, normals = (np.stack([getattr(d, name) for d in deployments]) for name in ("positions", "normals"))
    groups: list[dict[str, FloatArray]] = []
    for evaluator in sampled_evaluators(problem.scene, problem.count, seed, sample, problem.evaluator.threads):
        shares = objective.shares(objective.values(evaluator, positions, normals))
        groups.append({f"grid_free_{key}": share.mean(axis=1) for key, share in shares.items()})
    return pd.DataFrame({key: np.mean([group[key] for group in groups], axis=0) for key in groups[0]})


RANDOM_VIEWS = 2000  # number of random poses
MEASURED_STREAM = 0x737572766579  # separates the random numbers of the noise from other uses of the seed


def read_measured(path: str | Path, problem: Problem, plan: Deployment, **table: Any) -> Deployment:
    """Read the measured poses of the tags of a plan; return the tags in the plan's order and with the plan's labels.

    Measured poses are not corrected: tags need not be flush, and footprints may seem to overlap. Tags need not be on a
    surface if the plan was read without this requirement (`FileDeployment.free`).

    Args:
        path: CSV with the columns of a plan, or a tag map.
        problem: problem of the plan.
        plan: K landmarks.
        table: `axes` and `columns`, which describe a file that does not define its axes or columns, see
            `lmd.formats.tag_maps.read_deployment`.

    Raises:
        InputError: the file is not a deployment or does not have the ids of the plan, or a tag is outside the room and
            belongs to no surface.
    """
    measured = read_deployment(path, "measured", problem.scene.tag.own_family, **table)
    lacking, further = np.setdiff1d(plan.ids, measured.ids), np.setdiff1d(measured.ids, plan.ids)
    for ids, wrong in ((lacking, "lacks the landmark {} that is"), (further, "has a landmark {} that is not")):
        if len(ids):
            message = f"measured: {path} {wrong.format(ids[0])} planned ({len(ids)} in all)."
            raise InputError(message, "measured")
    places = np.argsort(measured.ids)[np.searchsorted(np.sort(measured.ids), plan.ids)]
    with said_of(f"measured: {path}", "measured"):
        measured, scene = replace(measured[places], note=measured.note), problem.scene
        hung = measured.with_surfaces(scene.room, as_they_are(problem.start), scene.footprints.papers(measured))
    return replace(hung, labels=plan.labels, edges=np.where(np.isnan(hung.edges), plan.edges, hung.edges))


@dataclass(frozen=True)
class Measured:
    """Metrics of a deployment with the tags as planned and as measured."""

    n: int
    """Number of tags that a view must show before a pose is estimated."""
    moved: pd.DataFrame
    """Table with the columns `id,moved,dx,dy,dz,tilted`, metres and rad: differences between the planned and the
    measured pose of each tag. The tag with the largest `moved`, the distance between the two positions, is first.
    """
    figures: pd.DataFrame
    """Table with the columns `planned` and `measured`, indexed by `figure`: metrics on the grid, and metrics off the
    grid, whose names begin with `grid_free_`.
    """
    views: pd.DataFrame
    """Errors of the poses that are estimated with two maps: `planned` has the planned poses of the tags, `measured` the
    measured poses. See `map_errors`.
    """

    @property
    def tables(self) -> dict[str, pd.DataFrame]:
        """See `lmd.evaluation.Study.tables`."""
        return {"moved": self.moved, "survey": self.figures.reset_index()}

    def metrics(self) -> dict[str, float]:
        """Metrics keyed by names such as `fitness/planned`, `position_planned/50` (m) and `moved/greatest` (m)."""
        off = self.moved[["moved", "tilted"]].agg(["median", "max"]).T.rename(columns={"max": "greatest"})
        return named_figures(self.figures, error_quantiles(self.views), off)

    def to_text(self) -> str:
        """Text for a terminal: the distances between planned and measured tags, the metrics, and the pose errors."""
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
    """Compute the metrics of a deployment with the tags as measured and as planned.

    Results do not depend on the number of threads.

    Args:
        problem: problem with the scene and the objective.
        plan: K landmarks.
        measured: landmarks of the plan with their measured poses.
        seed: seed of the random positions and the views.
        sample: size of the sample of random positions, for the metrics off the grid.
        views: number of random views, for the errors of camera poses.
    """
    both = {"planned": plan, "measured": measured}
    figures = _figures(problem, list(both.values()), seed, sample).set_axis(list(both)).T.rename_axis("figure")
    maps, poses = {name: MountedTags.of(each) for name, each in both.items()}, draw_poses(problem.scene, views, seed)
    errors = map_errors(problem, maps["measured"], maps, poses, np.random.default_rng([seed, MEASURED_STREAM]))
    return Measured(problem.objective.n, _moved(plan, measured), figures, errors)


def _moved(plan: Deployment, measured: Deployment) -> pd.DataFrame:
    """Make the table `Measured.moved`, the differences between the planned and the measured poses."""
    way = measured.places - plan.places
    chord = np.linalg.norm(measured.normals - plan.normals, axis=1)  # more accurate than the cosine
    rows = {"id": plan.ids, "moved": np.linalg.norm(way, axis=1), "dx": way[:, 0], "dy": way[:, 1], "dz": way[:, 2]}
    table = pd.DataFrame({**rows, "tilted": 2.0 * np.arcsin(np.clip(chord / 2.0, 0.0, 1.0))})
    return table.sort_values("moved", ascending=False, kind="stable", ignore_index=True)
