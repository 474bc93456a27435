"""A survey as a picture: the room from above with the plan beside what hangs, and how far each tag is off."""

from pathlib import Path
from typing import Any

import numpy as np

from lmd.core.checks import FloatArray
from lmd.plot.common import LANDMARK, PARTS, literal, new_figure, shrink
from lmd.space.space import Space
from lmd.survey.results import tag_columns
from lmd.survey.survey import Survey

PLANNED, UNSEEN, PROPOSED = "#9e9e9e", "#ff7f0e", "#2ca02c"
ELLIPSE_SIGMAS = 2.0  # of the ellipses
ARROW_SHARE = 0.08  # of the room's length that the median arrow is long
WEDGE_SHARE = 0.05  # of the room's length that the view of a photograph to take is drawn long
ELLIPSE_POINTS = 40
MOST_NAMED = 12  # tags that the right panel names, those farthest off


def save_survey_figure(path: str | Path, survey: Survey, room: Space | None, title: str) -> None:
    """Write a PNG of 1500 x 700 pixels.

    Args:
        room: its outline is drawn; None where it is not known.
    """
    figure = new_figure((15.0, 7.0))
    left, right = figure.subplots(1, 2)
    _draw_above(left, survey, room)
    if survey.planned is None:
        _draw_sigmas(right, survey)
    else:
        _draw_offsets(right, survey)
    figure.suptitle(literal(title), fontsize=13)
    figure.savefig(path)
    shrink(path)


def _draw_above(axes: Any, survey: Survey, room: Space | None) -> None:
    """The room from above: the tags, arrows from their plan, ellipses, the unseen ones by name, photographs to take."""
    if room is not None:
        for part, lines in room.outline().items():
            colour, dashed = PARTS[part]
            for line in lines:
                axes.plot(*line[:, :2].T, color=colour, linestyle="--" if dashed else "-", linewidth=0.8, zorder=1)
    placed, planned = survey.placed, survey.planned
    tags = survey.found.poses.tags
    axes.plot(*_edges(tags[placed], survey.found.sightings.edges[placed]), color=LANDMARK, linewidth=2.0, zorder=3)
    size = np.ptp(tags[placed][:, :2, 3], axis=0).max(initial=1.0)
    covariances = survey.found.in_world(survey.found.gauge_free_covariances)
    sigma = 1e3 * np.nanmedian(np.sqrt(covariances[placed][:, 0, 0] + covariances[placed][:, 1, 1]))
    scale = ARROW_SHARE * size
    if planned is not None:
        both = placed & np.isfinite(planned[:, 0, 0])
        way = tags[both][:, :2, 3] - planned[both][:, :2, 3]
        scale /= max(float(np.median(np.linalg.norm(way, axis=1))), 1e-6)
        axes.quiver(
            *planned[both][:, :2, 3].T,
            *(scale * way).T,
            angles="xy",
            scale_units="xy",
            scale=1.0,
            width=0.003,
            zorder=4,
        )
        missing = np.isfinite(planned[:, 0, 0]) & ~placed
        axes.plot(*planned[missing][:, :2, 3].T, "x", color=UNSEEN, zorder=5)
        for number, (x, y) in zip(survey.ids[missing], planned[missing][:, :2, 3], strict=True):
            axes.annotate(f"{number}", (x, y), color=UNSEEN, fontsize=9)
        axes.set_title(f"from above; arrows from the plan, {scale:.0f} times as long", fontsize=11)
    else:
        scale /= 1e-3 * sigma
        axes.set_title(
            f"against the z axis; ellipses of {ELLIPSE_SIGMAS:g} sigma, {scale:.0f} times as large", fontsize=11
        )
    for pose, covariance in zip(tags[placed], covariances[placed][:, :2, :2], strict=True):
        axes.plot(*(pose[:2, 3, None] + scale * _ellipse(covariance)), color="black", linewidth=0.6, zorder=4)
    for number, photograph in enumerate(survey.proposed, 1):
        stand, right, ahead = (photograph.pose[:2, column] for column in (3, 0, 2))
        ends = WEDGE_SHARE * size * np.stack([ahead - 0.5 * right, np.zeros(2), ahead + 0.5 * right])
        axes.plot(*(stand + ends).T, color=PROPOSED, linewidth=1.2, zorder=5)
        axes.annotate(f"{number}", stand, color=PROPOSED, fontsize=10, ha="center", va="top")
    axes.set(xlabel="x [m]", ylabel="y [m]", aspect="equal")


def _edges(tags: FloatArray, edges: FloatArray) -> tuple[FloatArray, FloatArray]:
    """x and y of the lines along the middles of tags, a column each."""
    half = edges[:, None] / 2.0 * tags[:, :2, 0]
    ends = np.stack([tags[:, :2, 3] - half, tags[:, :2, 3] + half])
    return ends[..., 0], ends[..., 1]


def _ellipse(covariance: FloatArray) -> FloatArray:
    """The points of an ellipse around the origin, `(2, n)`, for a covariance `(2, 2)`."""
    values, axes = np.linalg.eigh(covariance)
    angle = np.linspace(0.0, 2.0 * np.pi, ELLIPSE_POINTS)
    circle = np.stack([np.cos(angle), np.sin(angle)])
    return np.asarray(ELLIPSE_SIGMAS * axes @ (np.sqrt(np.maximum(values, 0.0))[:, None] * circle))


def _draw_offsets(axes: Any, survey: Survey) -> None:
    """How far the tags are off in their planes, with ellipses, the farthest ones by name."""
    columns = tag_columns(survey)
    offset = 1e3 * np.stack([np.asarray(columns[name], dtype=np.float64) for name in ("right", "up", "out")], axis=1)
    there = np.flatnonzero(np.isfinite(offset[:, 0]))
    dots = axes.scatter(*offset[there, :2].T, c=offset[there, 2], cmap="coolwarm", s=28, zorder=3)
    for k in there:
        ellipse = 1e3 * _ellipse(survey.found.gauge_free_covariances[k, 3:5, 3:5])
        axes.plot(*(offset[k, :2, None] + ellipse), color="0.5", linewidth=0.6, zorder=2)
    for k in there[np.argsort(-np.linalg.norm(offset[there], axis=1))][:MOST_NAMED]:
        axes.annotate(f" {survey.ids[k]}", offset[k, :2], fontsize=9)
    axes.axhline(0.0, color=PLANNED, linewidth=0.8, zorder=1)
    axes.axvline(0.0, color=PLANNED, linewidth=0.8, zorder=1)
    axes.figure.colorbar(dots, ax=axes, label="off the wall [mm]")
    axes.set(xlabel="to the right of the plan [mm]", ylabel="above the plan [mm]", aspect="equal")
    axes.set_title(
        f"how far tags are off, each as one stands before it; ellipses of {ELLIPSE_SIGMAS:g} sigma", fontsize=11
    )


def _draw_sigmas(axes: Any, survey: Survey) -> None:
    """How well each tag is known, against how often it was seen."""
    columns = tag_columns(survey)
    sigma, seen = 1e3 * np.asarray(columns["sigma"]), survey.used
    axes.loglog(seen[survey.placed], sigma[survey.placed], "o", color=LANDMARK, markersize=5)
    for k in np.argsort(-np.where(survey.placed, sigma, -np.inf))[:MOST_NAMED]:
        axes.annotate(f" {survey.ids[k]}", (seen[k], sigma[k]), fontsize=9)
    axes.set(xlabel="sightings that place a tag", ylabel="standard deviation beside the others [mm]")
    axes.grid(alpha=0.3)
