"""Figure of a deployment as an interactive HTML page that needs no network."""

import html
import re
from pathlib import Path
from typing import Any

import numpy as np

from lmd.core.checks import FloatArray
from lmd.geometry.squares import corners
from lmd.plot import common
from lmd.problem import Problem
from lmd.scene.deployment import Deployment
from lmd.scene.tag import Tag
from lmd.space.space import Space

BALL_PIXELS = 5.5  # diameter of a ball, pixels
CAMERA = {"eye": {"x": 0.82, "y": -1.84, "z": 0.58}, "center": {"x": 0.0, "y": 0.0, "z": -0.05}}
PLAIN_AXIS = {"showgrid": False, "zeroline": False, "showspikes": False}  # no grid, as the box of the room suffices
HEAD_SHARE = 0.5  # length of the head of an arrow over the length of the arrow

PAGE = """<!DOCTYPE html>
<html lang="en">
<head><meta charset="utf-8"><title>{title}</title><style>html, body {{ margin: 0; height: 100%; }}</style></head>
<body>{figure}</body>
</html>
"""


def save_scene_page(path: str | Path, problem: Problem, deployment: Deployment, title: str) -> None:
    """Write a self-contained page with the scene of `save_scene_figure`, which the user can turn, zoom and point at.

    Two buttons colour the positions by the objective's value, or by qualification.

    Args:
        path: path of the page.
        problem: problem whose room is drawn in black, with the reachable area dotted and grey.
        deployment: landmarks, drawn as red arrows along the normals, or blue arrows if they hung already.
        title: title of the page.
    """
    import plotly.graph_objects as go

    room, objective, positions = problem.scene.room, problem.objective, problem.places
    values = problem.by_place(problem.values(deployment))
    good = objective.qualified(values)
    surroundings = _box_traces(room)
    for group in common.landmark_groups(len(deployment), problem.fixed_count):
        surroundings += _landmark_traces(deployment[group.chosen], problem.scene.tag, group.label, group.colour)
    name = re.sub("_(.*)", r"<sub>\1</sub>", html.escape(objective.value_name))
    hover = [f"{name} = {value:.4f}<br>{_place(at)}" for value, at in zip(values, positions, strict=True)]

    def balls(chosen: Any, name: str, **marker: Any) -> Any:
        """Draw balls at the positions with the indices `chosen`."""
        return go.Scatter3d(
            **_xyz(positions[chosen]),
            mode="markers",
            name=name,
            text=[hover[i] for i in chosen],
            hoverinfo="text",
            marker={"size": BALL_PIXELS * common.ball_scale(room, positions), **marker},
        )

    by_probability = balls(
        np.arange(len(positions)),
        "position",
        color=values,
        colorscale=common.COLOUR_MAP.capitalize(),
        cmin=0.0,
        cmax=1.0,
        opacity=0.8,
        colorbar={"title": {"text": objective.value_label, "side": "right"}, "len": 0.7},
    )
    labels = common.qualified_labels(good, objective.threshold)
    green = balls(np.flatnonzero(good), labels[0], color=common.QUALIFIED, opacity=0.8)
    grey = balls(np.flatnonzero(~good), labels[1], color=common.UNQUALIFIED, opacity=0.4)
    green.visible = grey.visible = False

    figure = go.Figure([*surroundings, by_probability, green, grey])
    buttons = [
        {"label": label, "method": "restyle", "args": [{"visible": [True] * len(surroundings) + shown}]}
        for label, shown in (("probability", [True, False, False]), ("qualified or not", [False, True, True]))
    ]
    axes = {
        f"{axis}axis": {"title": {"text": text}, "range": limits, **PLAIN_AXIS}
        for axis, text, *limits in zip("xyz", common.AXIS_LABELS, *room.bounds(), strict=True)
    }
    figure.update_layout(
        template="plotly_white",
        title={"text": html.escape(title), "x": 0.5, "y": 0.97},
        margin={"l": 0, "r": 120, "t": 60, "b": 0, "autoexpand": False},  # buttons move nothing
        legend={"x": 0.01, "y": 0.9, "bgcolor": "rgba(255, 255, 255, 0.6)"},
        scene={"aspectmode": "data", "camera": CAMERA, **axes},
        updatemenus=[
            {"type": "buttons", "direction": "right", "x": 0.01, "y": 1.0, "xanchor": "left", "buttons": buttons}
        ],
    )
    body = figure.to_html(
        config={"displaylogo": False, "responsive": True, "showSendToCloud": False},
        include_plotlyjs=True,
        full_html=False,
        default_height="100vh",
    )
    Path(path).write_text(PAGE.format(title=html.escape(title), figure=body), encoding="utf-8")


def _box_traces(room: Space) -> list[Any]:
    import plotly.graph_objects as go

    return [
        go.Scatter3d(
            **_xyz(_strokes(edges)),
            mode="lines",
            name=name,
            line={"width": 3, "color": common.PARTS[name][0], "dash": "dot" if common.PARTS[name][1] else "solid"},
            hoverinfo="skip",
        )
        for name, edges in room.outline().items()
    ]


def _landmark_traces(deployment: Deployment, tag: Tag, label: str, colour: str) -> list[Any]:
    """Shafts of arrows with the black squares of tags, and heads with the hover text."""
    import plotly.graph_objects as go

    tips = deployment.positions + common.ARROW_LENGTH * deployment.normals
    heads = HEAD_SHARE * common.ARROW_LENGTH * deployment.normals
    edges = deployment.edges_of(tag)
    hover = [
        f"landmark {number}<br>{_place(at)}<br>normal ({normal[0]:.4g}, {normal[1]:.4g}, {normal[2]:.4g})"
        + (f"<br>edge {edge:g} m ({tag.square})" if edge else "")
        for number, at, normal, edge in zip(
            deployment.ids, deployment.positions, deployment.normals + 0.0, edges, strict=True
        )
    ]
    lines = _strokes(np.stack([deployment.positions, tips], axis=1))
    if not tag.is_point:
        squares = corners(deployment.positions, deployment.normals, deployment.ups, edges)
        lines = np.vstack([lines, _strokes(squares[:, [0, 1, 2, 3, 0]])])
    shafts = go.Scatter3d(
        **_xyz(lines),
        mode="lines",
        name=label,
        legendgroup=label,
        line={"width": 4, "color": colour},
        hoverinfo="skip",
    )
    cones = go.Cone(
        **_xyz(tips),
        **dict(zip("uvw", heads.T, strict=True)),
        anchor="tip",
        sizemode="raw",
        sizeref=1.0,
        legendgroup=label,
        colorscale=[colour, colour],
        showscale=False,
        text=hover,
        hoverinfo="text",
    )
    return [shafts, cones]


def _strokes(segments: FloatArray) -> FloatArray:
    """Join M strokes of N points each, `(M, N, 3)`, to one line `((N + 1) M, 3)` that NaN interrupts."""
    gaps = np.full((len(segments), 1, 3), np.nan)
    return np.asarray(np.concatenate([segments, gaps], axis=1).reshape(-1, 3))


def _xyz(points: FloatArray) -> dict[str, FloatArray]:
    return dict(zip("xyz", points.T, strict=True))


def _place(at: FloatArray) -> str:
    return f"x {at[0]:.3f} m, y {at[1]:.3f} m, z {at[2]:.3f} m"
