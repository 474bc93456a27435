"""Picture of a localisation: the way from above, with the tags that changed, and how well poses are known, as a PNG."""

from pathlib import Path
from typing import Any

import numpy as np

from lmd.adjust.gauge import in_world
from lmd.adjust.motion import seconds_of
from lmd.core.checks import FloatArray
from lmd.localise.localise import Localisation
from lmd.plot.common import LANDMARK, draw_plan, literal, new_figure, shrink
from lmd.plot.plans import ELLIPSE_SIGMAS, edge_lines, ellipse
from lmd.space.space import Space

SINGLE, SMOOTHED = "#9e9e9e", "#1f77b4"
CHANGED = {"moved": "#9467bd", "vanished": "#ff7f0e", "new": "#2ca02c"}
MARKERS = {"moved": "D", "vanished": "x", "new": "P"}
MOST_ELLIPSES = 40  # largest number of ellipses along the way
LARGE_SHARE = 0.02  # radius of the median ellipse over the extent of the picture
MOST_NAMED = 12  # largest number of changed tags that are named


def save_localised_figure(path: str | Path, result: Localisation, room: Space | None, title: str) -> None:
    """Write a PNG of 1500 x 700 pixels.

    Args:
        path: path of the PNG.
        result: localisation that is drawn.
        room: room whose outline is drawn; None if unknown.
        title: title of the figure.
    """
    figure = new_figure((15.0, 7.0))
    left, right = figure.subplots(1, 2)
    _draw_way(left, result, room)
    _draw_deviations(right, result)
    figure.suptitle(literal(title), fontsize=13)
    figure.savefig(path)
    shrink(path)


def _ways(result: Localisation) -> list[tuple[str, str, FloatArray, FloatArray]]:
    """Name, colour, poses and covariances, of single images and of the smoothed drive."""
    every = ("single images", SINGLE, result.found), ("smoothed", SMOOTHED, result.smoothed)
    return [(name, colour, one.poses.frames, one.frame_covariances) for name, colour, one in every if one is not None]


def _draw_way(axes: Any, result: Localisation, room: Space | None) -> None:
    """Draw the tags, the way with ellipses, and the tags that changed."""
    if room is not None:
        draw_plan(axes, room, lw=0.8, zorder=1)
        axes.lines[0].set_label("room")
    known, every = result.known, result.changes
    lines = axes.plot(*edge_lines(known.poses, known.edges), color=LANDMARK, linewidth=2.0, zorder=2)
    lines[0].set_label("tag of the map")
    same = ~np.isin(known.ids, [change.tag for change in every])
    for number, pose in zip(known.ids[same], known.poses[same], strict=True):
        axes.annotate(f" {number}", pose[:2, 3], color=LANDMARK, fontsize=8)
    ways = _ways(result)
    for name, colour, frames, _ in ways:
        dotted = {"linewidth": 0.4, "marker": "."} if name == "single images" else {"linewidth": 1.2}
        axes.plot(*frames[:, :2, 3].T, color=colour, label=name, zorder=3, **dotted)
    _, colour, frames, covariances = ways[-1]
    there = np.flatnonzero(np.isfinite(frames[:, 0, 0]))
    axes.set_title("from above", fontsize=11)
    if len(there):
        some = there[:: -(-len(there) // MOST_ELLIPSES)]
        own = in_world(frames[some], covariances[some])[:, :2, :2]
        places = np.concatenate([frames[there][:, :2, 3], known.poses[:, :2, 3]])
        extent = float(np.ptp(places, axis=0).max())
        sigma = float(np.median(np.sqrt(np.trace(own, axis1=1, axis2=2))))
        scale = max(LARGE_SHARE * extent / (ELLIPSE_SIGMAS * sigma), 1.0)
        for pose, covariance in zip(frames[some], own, strict=True):
            (line,) = axes.plot(
                *(pose[:2, 3, None] + scale * ellipse(covariance)), color=colour, linewidth=0.6, zorder=4
            )
        line.set_label(f"{ELLIPSE_SIGMAS:g} sigma, {scale:.0f} times as large")
    for kind, colour in CHANGED.items():
        own_changes = [change for change in every if change.kind == kind]
        if not own_changes:
            continue
        at = np.array([one.before if kind == "vanished" else one.pose for one in own_changes])
        axes.plot(*at[:, :2, 3].T, MARKERS[kind], color=colour, markersize=8, zorder=5, label=kind)
        for change, pose in zip(own_changes[:MOST_NAMED], at, strict=False):
            axes.annotate(f" {change.tag}", pose[:2, 3], color=colour, fontsize=10)
    axes.legend(loc="upper center", bbox_to_anchor=(0.5, -0.15), ncols=4, fontsize=9, frameon=False)
    axes.set(xlabel="x [m]", ylabel="y [m]", aspect="equal")


def _draw_deviations(axes: Any, result: Localisation) -> None:
    """Draw the standard deviation of the position in its worst direction, by time."""
    seconds = seconds_of(result.detected.times)
    timed = bool(np.isfinite(seconds).all())
    along = seconds - seconds.min() if timed else np.arange(len(seconds), dtype=np.float64)
    for name, colour, frames, covariances in _ways(result):
        there = np.flatnonzero(np.isfinite(frames[:, 0, 0]))
        worst = np.sqrt(np.linalg.eigvalsh(covariances[there][:, 3:, 3:])[:, -1])
        axes.semilogy(along[there], 1e3 * worst, ".", color=colour, label=name, markersize=4)
    refused = np.flatnonzero(~result.found.poses.known_frames)
    if len(refused):
        axes.plot(along[refused], np.zeros(len(refused)), "|", color=CHANGED["vanished"], markersize=10,
                  transform=axes.get_xaxis_transform(), label="refused", clip_on=False)  # fmt: skip
    axes.set(xlabel="time [s]" if timed else "image", ylabel="standard deviation of the position [mm]")
    axes.legend(loc="best", fontsize=9)
    axes.grid(alpha=0.3)
