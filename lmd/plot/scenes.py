"""Figures of deployments in the style of the paper, as PNGs: room, landmarks, and the objective at each position."""

import math
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np

from lmd.core.checks import BoolArray, FloatArray
from lmd.plot import common
from lmd.problem import Problem
from lmd.scene.deployment import Deployment
from lmd.space.space import Space

SCENE = (15.0, 7.5)  # width and height of the figure of a scene, inches
BACK, BALLS, FRONT = 1, 2, 3  # z-orders
BALL_POINTS = 7.0  # diameter of a ball, points
# Marker of the legend, as a path: for a text, matplotlib would load its parser of formulas.
ARROW = ((-1.0, 0.0), (1.0, 0.0), (0.4, 0.35), (1.0, 0.0), (0.4, -0.35))

Groups: TypeAlias = Sequence[common.Group]


def save_scene_figure(path: str | Path, problem: Problem, deployment: Deployment, title: str) -> None:
    """Write a PNG of 1500 x 750 pixels with two pictures of the room.

    In one picture, the colour of a position shows the objective's value there. In the other, the colour shows if the
    position is qualified, i.e. if the value reaches the threshold. If all positions have one height, the room is drawn
    from above, with the ids of the landmarks.

    Args:
        path: path of the PNG.
        problem: problem whose room is drawn in black, with the reachable area dashed and grey.
        deployment: landmarks, drawn as arrows along their normals: blue for fixed landmarks, red for all others.
        title: title of the figure.
    """
    room, objective = problem.scene.room, problem.objective
    values = problem.by_place(problem.values(deployment))
    good = objective.qualified(values)
    groups = common.landmark_groups(len(deployment), problem.fixed_count)
    is_level = np.ptp(problem.places[:, 2]) == 0.0
    draw = _draw_from_above if is_level else _draw_in_space
    figure, bar = draw(problem, values, good, deployment, groups, title)
    bar.set_label(objective.value_label, fontsize=12)
    bar.ax.axvline(objective.threshold, color="white", linewidth=4.0)
    bar.ax.axvline(objective.threshold, color="black", linewidth=1.5)
    lines, dots = _legends(room, groups, common.qualified_labels(good, objective.threshold))
    if is_level:
        figure.legend(handles=[*lines, *dots], loc="outside lower center", ncols=6, frameon=False, fontsize=11)
    else:
        for handles, x, y in ((lines, 0.5, 0.9), (dots, 0.75, 0.095)):
            figure.legend(handles=handles, loc="center", bbox_to_anchor=(x, y), ncols=6, frameon=False, fontsize=12)
    figure.savefig(path)


def _draw_in_space(
    problem: Problem, values: FloatArray, good: BoolArray, deployment: Deployment, groups: Groups, title: str
) -> tuple[Any, Any]:
    """Draw two pictures of the room in perspective; return the figure and the colour bar of the first picture.

    The first picture shows the objective's value `values` at each position. The second shows the qualified positions,
    the mask `good`.
    """
    from matplotlib.figure import Figure

    room, positions = problem.scene.room, problem.places
    figure = Figure(figsize=SCENE, dpi=100, facecolor="white")
    figure.suptitle(common.wrapped(title, SCENE[0]), fontsize=15, y=0.985)
    left, right = (
        figure.add_axes((x, 0.1, 0.5, 0.86), projection="3d", computed_zorder=False) for x in (-0.005, 0.495)
    )
    for axes in (left, right):
        _draw_surroundings(axes, room, deployment, groups)
    balls = _draw_balls(left, room, positions, c=values, cmap=common.COLOUR_MAP, vmin=0.0, vmax=1.0, alpha=0.7)
    _draw_balls(right, room, positions, c=_faces(good))
    return figure, figure.colorbar(balls, cax=figure.add_axes((0.1, 0.1, 0.3, 0.022)), orientation="horizontal")


def _draw_from_above(
    problem: Problem, values: FloatArray, good: BoolArray, deployment: Deployment, groups: Groups, title: str
) -> tuple[Any, Any]:
    """Draw two pictures of the room from above; return the figure and the colour bar of the first picture.

    The first picture shows the objective's value `values` at each position. The second shows the qualified positions,
    the mask `good`.
    """
    from matplotlib.collections import PatchCollection
    from matplotlib.patches import Rectangle

    room, positions = problem.scene.room, problem.places
    length, width, _ = common.size_of(room)
    shape = (2, 1) if length > 2.0 * width else (1, 2)
    figure, panels = common.new_panels(SCENE, title, *shape, sharex=True, sharey=True)
    panels = panels.reshape(-1)
    side = 1.03 * min(common.spacing_of(room, positions), max(length, width) / 10.0)  # no gaps by rounding
    squares = [Rectangle(tuple(at - side / 2.0), side, side) for at in positions[:, :2]]
    coloured: dict[str, Any] = {"cmap": common.COLOUR_MAP, "clim": (0.0, 1.0)}
    for axes, colours in zip(panels, (coloured, {"facecolors": _faces(good)}), strict=True):
        axes.add_collection(PatchCollection(squares, linewidths=0, zorder=0, **colours))
        common.draw_plan(axes, room, lw=1.0)
        common.draw_tags(axes, deployment, groups)
        common.from_above(axes)
    panels[0].collections[0].set_array(values)
    return figure, figure.colorbar(panels[0].collections[0], ax=list(panels), orientation="horizontal", aspect=60)


def _legends(room: Space, groups: Groups, labels: tuple[str, str]) -> tuple[list[Any], list[Any]]:
    """Make two lists of legend entries: one of the room and the landmarks, one of the positions.

    `labels` are the labels of the qualified and of the unqualified positions.
    """
    from matplotlib.lines import Line2D

    lines = [
        *(Line2D([], [], color=colour, linestyle=style, label=part) for part, _, colour, style in _parts(room)),
        *_arrows(groups),
    ]
    colours = (common.QUALIFIED, common.UNQUALIFIED)
    return lines, [
        Line2D([], [], **_symbol("o", 9, colour), label=label) for colour, label in zip(colours, labels, strict=True)
    ]


def save_deployments_figure(
    path: str | Path, deployments: Mapping[str, tuple[Problem, Deployment]], title: str
) -> None:
    """Write a PNG with a panel for each deployment, two panels in a row.

    A panel shows the landmarks of the deployment and the qualified positions.

    Args:
        path: path of the PNG.
        deployments: problem and deployment of each panel, keyed by the heading of the panel.
        title: title of the figure.
    """
    from matplotlib.figure import Figure
    from matplotlib.lines import Line2D

    rows = math.ceil(len(deployments) / 2)
    figure = Figure(figsize=(11.0, 4.6 * rows + 0.8), dpi=80, facecolor="white")
    figure.suptitle(common.literal(title), fontsize=14, y=1.0 - 0.1 / figure.get_figheight())
    margin = 0.4 / figure.get_figheight()
    height = (1.0 - 2.0 * margin) / rows
    drawn: list[common.Group] = []
    for i, (name, (problem, deployment)) in enumerate(deployments.items()):
        left, bottom = 0.5 * (i % 2), 1.0 - margin - (1 + i // 2) * height
        axes = figure.add_axes((left, bottom, 0.5, height), projection="3d", computed_zorder=False)
        good = problem.objective.qualified(problem.by_place(problem.values(deployment)))
        groups = common.landmark_groups(len(deployment), problem.fixed_count)
        drawn += groups
        _draw_surroundings(axes, problem.scene.room, deployment, groups)
        _draw_balls(axes, problem.scene.room, problem.places, c=_faces(good))
        label = f"{common.literal(name)}: {good.mean():.2%} qualified"
        figure.text(left + 0.25, bottom + 0.97 * height, label, ha="center", va="top", fontsize=13)
    handles = [
        *_arrows(drawn),
        Line2D([], [], **_symbol("o", 9, common.QUALIFIED), label="qualified position"),
        Line2D([], [], **_symbol("o", 9, common.UNQUALIFIED), label="unqualified position"),
    ]
    figure.legend(handles=handles, loc="lower center", ncols=4, frameon=False, fontsize=11)
    figure.savefig(path)


def _draw_surroundings(axes: Any, room: Space, deployment: Deployment, groups: Groups) -> None:
    """Draw the room, the reachable area, the groups of landmarks and the axes, but not the balls at positions."""
    from matplotlib.ticker import MaxNLocator, MultipleLocator
    from mpl_toolkits.mplot3d.art3d import Line3DCollection

    axes.view_init(elev=common.ELEVATION, azim=common.AZIMUTH)
    axes.set_proj_type("persp", focal_length=1.4)
    # The box is scaled to the panel by its diagonal; a tower has to shrink to stay between title and colour bar.
    (low, high), size = room.bounds(), common.size_of(room)
    axes.set_box_aspect(tuple(size), zoom=min(1.0, 0.6 * math.hypot(*size) / size[2]))
    axes.grid(False)
    step = np.diff(MaxNLocator(8, steps=[1, 2, 5, 10]).tick_values(0.0, max(size)))[0]
    for axis, label, *limits in zip("xyz", common.AXIS_LABELS, low, high, strict=True):
        axes.set(**{f"{axis}lim": limits, f"{axis}label": label})
        getattr(axes, f"{axis}axis").set_major_locator(MultipleLocator(step))
        getattr(axes, f"{axis}axis").pane.set_visible(False)
    # matplotlib has no depth buffer: edges and arrows nearer to the viewer than the balls get a higher z-order.
    viewer = common.viewer()
    for _, edges, colour, style in _parts(room):
        near = (edges.mean(axis=1) - (low + high) / 2.0) @ viewer > 0.0
        for part, zorder in ((near, FRONT), (~near, BACK)):
            axes.add_collection(
                Line3DCollection(edges[part], colors=colour, linestyles=style, linewidths=1.2, zorder=zorder)
            )
    near = deployment.normals @ viewer < 0.0  # on walls whose backs face the viewer
    for group in groups:
        for part, zorder in ((near, FRONT), (~near, BACK)):
            chosen = part & group.chosen
            start, arrow = deployment.positions[chosen], common.ARROW_LENGTH * deployment.normals[chosen]
            axes.quiver(*start.T, *arrow.T, color=group.colour, linewidth=1.6, arrow_length_ratio=0.4, zorder=zorder)


def _arrows(groups: Iterable[common.Group]) -> list[Any]:
    """Legend entries of the groups of landmarks; groups with equal labels have one entry in common."""
    from matplotlib.lines import Line2D

    entries = {group.label: group.colour for group in groups}
    open_head: dict[str, Any] = {"fillstyle": "none", "markeredgewidth": 1.6}
    return [Line2D([], [], **_symbol(ARROW, 20, colour), **open_head, label=of) for of, colour in entries.items()]


def _parts(room: Space) -> list[tuple[str, FloatArray, str, Any]]:
    """Parts of a room that are drawn: name, edge lines, colour and line style of each part."""
    outline = room.outline()
    return [
        (part, outline[part], colour, "--" if dashed else "-")
        for part, (colour, dashed) in common.PARTS.items()
        if part in outline
    ]


def _draw_balls(axes: Any, room: Space, positions: FloatArray, **colours: Any) -> Any:
    area = (BALL_POINTS * common.ball_scale(room, positions)) ** 2
    return axes.scatter(*positions.T, s=area, linewidths=0, depthshade=False, zorder=BALLS, **colours)


def _faces(is_qualified: BoolArray) -> Any:
    """Colours of the balls at P positions, red, green, blue and opacity, `(P, 4)`.

    `is_qualified` `(P,)` is the mask of the qualified positions.
    """
    from matplotlib.colors import to_rgba_array

    colours = np.where(is_qualified, common.QUALIFIED, common.UNQUALIFIED)
    return to_rgba_array(colours, np.where(is_qualified, 0.8, 0.45))


def _symbol(marker: Any, size: float, colour: str) -> dict[str, Any]:
    return {"marker": marker, "markersize": size, "color": colour, "linestyle": "none"}
