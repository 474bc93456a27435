"""Pictures of rooms from above, as PNGs.

The pictures show the camera positions of a room, the predicted accuracy of the position from one image, surveyed tags
with their planned places, or the camera poses of a localisation.
"""

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from lmd.core.checks import FloatArray
from lmd.plot import common
from lmd.plot.common import LANDMARK, draw_plan, dress, literal, new_panels, shrink
from lmd.problem import Problem
from lmd.scene.deployment import Deployment
from lmd.space.crowd import RADIUS, X, Y
from lmd.space.space import Space, outwards

if TYPE_CHECKING:
    import pandas as pd

    from lmd.localise.localise import Localisation
    from lmd.survey.survey import Survey

ABOVE_ALL = 1e9  # stands for an infinite error, mm
NO_MEDIAN_COLOUR = "#c8c8c8"  # colour of places without a finite median
PLANNED, UNSEEN = "#9e9e9e", "#ff7f0e"
POSITION = "#1f77b4"
ELLIPSE_SIGMAS = 2.0  # semi-axes of ellipses, standard deviations
ARROW_SHARE = 0.08  # length of the median arrow over the length of the room
LONGEST_SHARE = 0.2  # length of the longest arrow over the length of the room
BORDER = 1.2  # distance at which tags far off are drawn, in distances of the farthest other tag
ELLIPSE_POINTS = 40
PERSON, PERSON_ALPHA = "tab:orange", 0.2  # colour and opacity of a person; those of several states overlap
MOST_WALLS, NAME_POINTS = 60, 7.0  # largest number of named walls, and the distance of their names, points
MOST_NAMED = 12  # largest number of tags named in the right panel: the tags farthest off
FAR = 5.0  # a tag is far from its plan if its distance exceeds this many medians


def save_room_figure(path: str | Path, room: Space, title: str, people: FloatArray | None = None) -> None:
    """Write a PNG: a room from above, with the walls that may carry landmarks and the positions of the camera.

    Args:
        path: path of the PNG.
        room: room.
        title: title of the figure.
        people: cylinders of the N people in each of S crowd states, `(S, N, 5)`; None without a crowd.
    """
    import shapely
    from matplotlib.collections import LineCollection, PatchCollection
    from matplotlib.patches import Circle

    length, width, _ = common.size_of(room)
    inches = 11.0, float(np.clip(11.0 * width / length, 4.0, 22.0)) + 0.8
    figure, ((axes,),) = new_panels(inches, title, 1, 1)
    common.from_above(axes)
    axes.plot(*room.grid()[:, :2].T, ".", color=POSITION, markersize=2.0, label="position of the camera", zorder=1)
    draw_plan(axes, room, lw=1.0)
    carried, level = [], [surface.name for surface in room.surfaces() if not surface.is_upright]
    for surface in sorted(room.surfaces(), key=lambda one: -one.extent[0])[:MOST_WALLS]:
        if surface.is_upright:
            middle, way = surface.point(surface.extent[0] / 2.0, 0.0)[:2], NAME_POINTS * outwards(room, surface)
            axes.annotate(literal(surface.name), middle, way, textcoords="offset points", ha="center", va="center",
                          fontsize=7, color=LANDMARK, rotation=90.0 * (abs(way[0]) > abs(way[1])))  # fmt: skip
    for surface in room.surfaces():
        allowed = shapely.box(0.0, 0.0, *surface.extent) if surface.allowed is None else surface.allowed
        for piece in shapely.get_parts(allowed) if surface.is_upright else ():
            left, _, right, _ = piece.bounds
            carried.append(surface.point(np.array([left, right]), np.zeros(2))[:, :2])
    label = ", on ".join(["landmarks may hang here", *level])
    axes.add_collection(LineCollection(carried, colors=LANDMARK, linewidths=4.0, zorder=1, label=label))
    handles, labels = axes.get_legend_handles_labels()
    if people is not None:
        circles = [Circle(each[[X, Y]], each[RADIUS]) for state in people for each in state]
        axes.add_collection(PatchCollection(circles, facecolor=PERSON, alpha=PERSON_ALPHA, zorder=0))
        handles.append(Circle((0.0, 0.0), facecolor=PERSON, alpha=0.5))
        labels.append(f"in the way, in {len(people)} crowd states")
    figure.legend(handles, labels, loc="outside lower center", ncols=4, frameon=False)
    figure.savefig(path)
    shrink(path)


def save_accuracy_figure(
    path: str | Path, deployments: Mapping[str, tuple[Problem, Deployment, "pd.DataFrame"]], title: str
) -> None:
    """Write a PNG with a panel for each deployment: the room from above, with landmarks and predicted errors.

    The colour of a place is the median predicted error of the position. The median is taken over all orientations and
    heights at the place. All panels have one colour scale. A recording is drawn as its path; the colour scale then has
    steps at `lmd.evaluation.accuracy.TOLERANCES`.

    Args:
        path: path of the PNG.
        deployments: problem, deployment and table `lmd.evaluation.accuracy.plan_of_errors` of each panel, keyed by the
            heading of the panel.
        title: title of the figure.
    """
    from matplotlib import colormaps
    from matplotlib.colors import BoundaryNorm, LogNorm

    from lmd.evaluation.accuracy import TOLERANCES

    tables = [table for *_, table in deployments.values()]
    known = 1e3 * np.concatenate([table.iloc[:, -1] for table in tables])  # millimetres
    known = known[np.isfinite(known)]
    low, high = (known.min(), known.max()) if len(known) else (1.0, 10.0)
    along, steps = "time" in tables[0], [0.0, *np.multiply(1e3, TOLERANCES), 1e3]
    norm = BoundaryNorm(steps, 256, extend="max") if along else LogNorm(low, high)
    colours = colormaps[f"{common.COLOUR_MAP}_r"].with_extremes(over=NO_MEDIAN_COLOUR)  # bright is good
    length, width, _ = np.max([common.size_of(problem.scene.room) for problem, *_ in deployments.values()], axis=0)
    size = (1.0 + 5.0 * len(tables), 2.2 + 5.0 * width / length)
    figure, (panels,) = new_panels(size, title, 1, len(tables), sharex=True, sharey=True)
    for axes, (heading, (problem, deployment, table)) in zip(panels, deployments.items(), strict=True):
        shown = (1e3 * table.iloc[:, -1]).replace(np.inf, ABOVE_ALL)  # infinite values have no logarithm
        if along:
            mesh = axes.scatter(table.x, table.y, 12.0, shown, cmap=colours, norm=norm)
        else:
            plan = table.assign(shown=shown).pivot(index="y", columns="x", values="shown")
            mesh = axes.pcolormesh(plan.columns, plan.index, plan, shading="nearest", cmap=colours, norm=norm)
        draw_plan(axes, problem.scene.room, lw=1.0)
        common.draw_tags(axes, deployment, common.landmark_groups(len(deployment), problem.fixed_count))
        common.from_above(axes, title=literal(heading), ylabel=common.AXIS_LABELS[1] if axes is panels[0] else "")
    label = "median predicted error of the position [mm];\ngrey where most views see too few landmarks"
    bar = figure.colorbar(mesh, ax=list(panels), label=label, extend="max", orientation="horizontal", aspect=60)
    if not along:
        common.set_log_ticks(bar, low, high)
    figure.savefig(path)


def save_survey_figure(path: str | Path, survey: "Survey", room: Space | None, title: str) -> None:
    """Write a PNG of 1500 x 700 pixels with two panels about a survey of tags.

    The left panel shows the tags from above. The right panel shows the offset of each tag from its planned place.
    Without a plan, the right panel shows the standard deviations of the tags' positions.

    Args:
        path: path of the PNG.
        survey: survey that is drawn.
        room: room whose outline is drawn; None if unknown.
        title: title of the figure.
    """
    draw = _draw_sigmas if survey.known.plan is None else _draw_offsets
    _save_panels(path, title, lambda left: _draw_above(left, survey, room), lambda right: draw(right, survey))


def _save_panels(path: str | Path, title: str, left: Callable[[Any], None], right: Callable[[Any], None]) -> None:
    """Write a PNG of 1500 x 700 pixels with two panels; the functions `left` and `right` draw on the axes."""
    figure, (both,) = new_panels((15.0, 7.0), title, 1, 2)
    for draw, axes in zip((left, right), both, strict=True):
        draw(axes)
    figure.savefig(path)
    shrink(path)


def _draw_above(axes: Any, survey: "Survey", room: Space | None) -> None:
    """Draw the tags of a survey from above, with uncertainty ellipses.

    If there is a plan, arrows lead from the planned to the measured places. Planned tags that the survey has not placed
    are marked at their planned places, with their ids.
    """
    from lmd.adjust.gauge import in_world

    if room is not None:
        draw_plan(axes, room, lw=0.8, zorder=1)
    placed, planned = survey.placed, survey.known.planned(survey.ids)
    tags = survey.found.poses.tags
    axes.plot(*edge_lines(tags[placed], survey.found.sightings.edges[placed]), color=LANDMARK, linewidth=2.0, zorder=3)
    size = np.ptp(tags[placed][:, :2, 3], axis=0).max(initial=1.0)
    covariances = in_world(tags, survey.found.gauge_free_covariances)
    sigma = 1e3 * np.nanmedian(np.sqrt(covariances[placed][:, 0, 0] + covariances[placed][:, 1, 1]))
    scale = ARROW_SHARE * size
    if survey.known.plan is not None:
        both = placed & np.isfinite(planned[:, 0, 0])
        way = tags[both][:, :2, 3] - planned[both][:, :2, 3]
        length = np.linalg.norm(way, axis=1)
        scale /= max(float(np.median(length)), 1e-6)
        way *= np.minimum(1.0, LONGEST_SHARE * size / scale / np.maximum(length, 1e-9))[:, None]
        for k in np.flatnonzero(both)[length > FAR * np.median(length)]:
            axes.annotate(f"{survey.ids[k]}", tags[k, :2, 3], fontsize=9, va="bottom")
        common.draw_arrows(axes, planned[both][:, :2, 3], scale * way, zorder=4)
        missing = np.isfinite(planned[:, 0, 0]) & ~placed
        axes.plot(*planned[missing][:, :2, 3].T, "x", color=UNSEEN, zorder=5)
        for number, (x, y) in zip(survey.ids[missing], planned[missing][:, :2, 3], strict=True):
            axes.annotate(f"{number}", (x, y), color=UNSEEN, fontsize=9)
        axes.set_title(f"from above; arrows from the plan, {scale:.0f} times as long", fontsize=11)
    else:
        scale /= 1e-3 * sigma
        head = f"against the z axis; ellipses of {ELLIPSE_SIGMAS:g} sigma, {scale:.0f} times as large"
        axes.set_title(head, fontsize=11)
    for pose, covariance in zip(tags[placed], covariances[placed][:, :2, :2], strict=True):
        axes.plot(*(pose[:2, 3, None] + scale * ellipse(covariance)), color="black", linewidth=0.6, zorder=4)
    common.from_above(axes)


def edge_lines(tags: FloatArray, edges: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Ends of the lines that show K tags from above: x and y coordinates, metres, `(2, K)` each.

    The line of a tag is horizontal, goes through the tag's centre and is as long as the tag is wide. `tags` `(K, 4, 4)`
    are the poses of the tags, and `edges` `(K,)` their edge lengths, metres.
    """
    half = edges[:, None] / 2.0 * tags[:, :2, 0]
    ends = np.stack([tags[:, :2, 3] - half, tags[:, :2, 3] + half])
    return ends[..., 0], ends[..., 1]


def ellipse(covariance: FloatArray) -> FloatArray:
    """Points on the ellipse of `ELLIPSE_SIGMAS` standard deviations around the origin, `(2, N)`.

    `covariance` is the covariance matrix `(2, 2)` of the position.
    """
    values, axes = np.linalg.eigh(covariance)
    angle = np.linspace(0.0, 2.0 * np.pi, ELLIPSE_POINTS)
    circle = np.stack([np.cos(angle), np.sin(angle)])
    return np.asarray(ELLIPSE_SIGMAS * axes @ (np.sqrt(np.maximum(values, 0.0))[:, None] * circle))


def _draw_offsets(axes: Any, survey: "Survey") -> None:
    """Draw the offset of each tag from its planned place, in the plane of the tag, with an uncertainty ellipse.

    The tags with the largest offsets are marked by their ids.
    """
    from lmd.survey.results import tag_columns

    columns = tag_columns(survey)
    offset = 1e3 * np.stack([np.asarray(columns[name], dtype=np.float64) for name in ("right", "up", "out")], axis=1)
    there, length = np.flatnonzero(np.isfinite(offset[:, 0])), np.linalg.norm(offset, axis=1)
    far = there[length[there] > FAR * np.median(length[there])] if len(there) else there
    near = np.setdiff1d(there, far)
    if len(near) and len(far):  # tags far off are drawn in their direction at the border
        border = BORDER * length[near].max()
        offset[far] *= np.minimum(1.0, border / length[far])[:, None]
        axes.plot(*offset[far, :2].T, "s", mfc="none", color=UNSEEN, ms=11, label="farther off than drawn", zorder=4)
        axes.legend(loc="best", fontsize=9)
    dots = axes.scatter(*offset[there, :2].T, c=offset[there, 2], cmap="coolwarm", s=28, zorder=3)
    for k in near if len(near) else there:
        around = 1e3 * ellipse(survey.found.gauge_free_covariances[k, 3:5, 3:5])
        axes.plot(*(offset[k, :2, None] + around), color="0.5", linewidth=0.6, zorder=2)
    for k in there[np.argsort(-length[there])][:MOST_NAMED]:
        text = f"  {survey.ids[k]} ({length[k]:.0f} mm)" if k in far else f" {survey.ids[k]}"
        axes.annotate(text, offset[k, :2], fontsize=9)
    axes.axhline(0.0, color=PLANNED, linewidth=0.8, zorder=1)
    axes.axvline(0.0, color=PLANNED, linewidth=0.8, zorder=1)
    axes.figure.colorbar(dots, ax=axes, label="off the wall [mm]")
    axes.set(xlabel="to the right of the plan [mm]", ylabel="above the plan [mm]", aspect="equal")
    head = f"how far tags are off, each as one stands before it; ellipses of {ELLIPSE_SIGMAS:g} sigma"
    axes.set_title(head, fontsize=11)


def _draw_sigmas(axes: Any, survey: "Survey") -> None:
    """Draw the standard deviation of each tag's position against the number of sightings that determine it."""
    from lmd.survey.results import tag_columns

    columns = tag_columns(survey)
    sigma, seen = 1e3 * np.asarray(columns["sigma"]), survey.used
    axes.loglog(seen[survey.placed], sigma[survey.placed], "o", color=LANDMARK, markersize=5)
    for k in np.argsort(-np.where(survey.placed, sigma, -np.inf))[:MOST_NAMED]:
        axes.annotate(f" {survey.ids[k]}", (seen[k], sigma[k]), fontsize=9)
    dress(axes, xlabel="sightings that place a tag", ylabel="standard deviation relative to the others [mm]")


SINGLE, SMOOTHED = "#9e9e9e", "#1f77b4"
CHANGED, REFUSED = {"moved": "#9467bd", "new": "#2ca02c"}, "#ff7f0e"
MARKERS = {"moved": "D", "new": "P"}
MOST_ELLIPSES = 40  # largest number of ellipses along the path
LARGE_SHARE = 0.02  # radius of the median ellipse over the extent of the picture
MOST_CHANGED = 12  # largest number of changed tags that are named


def save_localised_figure(path: str | Path, result: "Localisation", room: Space | None, title: str) -> None:
    """Write a PNG of 1500 x 700 pixels with two panels about the camera poses of a localisation.

    The left panel shows the poses from above. The right panel plots the standard deviation of the camera's position
    against time.

    Args:
        path: path of the PNG.
        result: localisation that is drawn.
        room: room whose outline is drawn; None if unknown.
        title: title of the figure.
    """
    _save_panels(path, title, lambda left: _draw_way(left, result, room), lambda right: _draw_deviations(right, result))


def _ways(result: "Localisation") -> list[tuple[str, str, FloatArray, FloatArray]]:
    """Paths of the camera that are drawn: the poses from single images, and the smoothed poses of a drive.

    A path that the localisation lacks is omitted.

    Returns:
        name, colour, poses and covariances of each path.
    """
    every = ("single images", SINGLE, result.found), ("smoothed", SMOOTHED, result.smoothed)
    return [(name, colour, one.poses.frames, one.frame_covariances) for name, colour, one in every if one is not None]


def _draw_way(axes: Any, result: "Localisation", room: Space | None) -> None:
    """Draw the tags, the paths of the camera with uncertainty ellipses, and the tags that have moved or are new."""
    from lmd.adjust.gauge import in_world

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
            points = pose[:2, 3, None] + scale * ellipse(covariance)
            (line,) = axes.plot(*points, color=colour, linewidth=0.6, zorder=4)
        line.set_label(f"{ELLIPSE_SIGMAS:g} sigma, {scale:.0f} times as large")
    for kind, colour in CHANGED.items():
        own_changes = [change for change in every if change.kind == kind]
        if not own_changes:
            continue
        at = np.array([one.pose for one in own_changes])
        axes.plot(*at[:, :2, 3].T, MARKERS[kind], color=colour, markersize=8, zorder=5, label=kind)
        for change, pose in zip(own_changes[:MOST_CHANGED], at, strict=False):
            axes.annotate(f" {change.tag}", pose[:2, 3], color=colour, fontsize=10)
    axes.legend(loc="upper center", bbox_to_anchor=(0.5, -0.15), ncols=4, fontsize=9, frameon=False)
    common.from_above(axes)


def _draw_deviations(axes: Any, result: "Localisation") -> None:
    """Draw the standard deviation of the camera's position, in the direction in which it is largest, against time."""
    from lmd.adjust.motion import seconds_of

    seconds = seconds_of(result.detected.times)
    timed = bool(np.isfinite(seconds).all())
    along = seconds - seconds.min() if timed else np.arange(len(seconds), dtype=np.float64)
    for name, colour, frames, covariances in _ways(result):
        there = np.flatnonzero(np.isfinite(frames[:, 0, 0]))
        worst = np.sqrt(np.linalg.eigvalsh(covariances[there][:, 3:, 3:])[:, -1])
        axes.semilogy(along[there], 1e3 * worst, ".", color=colour, label=name, markersize=4)
    refused = np.flatnonzero(~result.found.poses.known_frames)
    if len(refused):
        axes.plot(along[refused], np.zeros(len(refused)), "|", color=REFUSED, markersize=10,
                  transform=axes.get_xaxis_transform(), label="refused", clip_on=False)  # fmt: skip
    axes.set(xlabel="time [s]" if timed else "image", ylabel="standard deviation of the position [mm]")
    axes.legend(loc="best", fontsize=9)
    axes.grid(alpha=0.3)
