"""Drawing of a body with its cameras from above and from its right side, in millimetres, as a PNG."""

import math
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from lmd.cameras.body import Body
from lmd.core.checks import FloatArray
from lmd.plot.common import FIXED, LANDMARK, new_figure
from lmd.scene.rig import Mount, Rig

if TYPE_CHECKING:
    from matplotlib.axes import Axes

MM = 1000.0
BODY = "#d9d9d9"
# Rows: right and up in the drawing, in the body frame (forward, left, up).
VIEWS = {
    "from above": np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0]]),
    "from the right": np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]),
}
AXES = {"from above": ("y, left [mm]", "x, forward [mm]"), "from the right": ("x, forward [mm]", "z, up [mm]")}
FIELD_LENGTH = 0.3  # length of the drawn field of view over the size of the body


def save_body_figure(path: Path, body: Body, rig: Rig, title: str) -> None:
    """Draw the cameras of a rig on a body, with dimensions, and a table of their mounts.

    Args:
        path: path of the PNG.
        body: body that carries the cameras.
        rig: rig with the cameras.
        title: title of the figure.
    """
    figure = new_figure((10.0, 6.2 + 0.25 * len(rig.mounts)), title)
    grid = figure.add_gridspec(2, 2, height_ratios=[5.4, 0.8 + 0.25 * len(rig.mounts)])
    for i, (view, onto) in enumerate(VIEWS.items()):
        _draw(figure.add_subplot(grid[0, i]), view, onto, body, rig)
    cells = [_row(i, mount) for i, mount in enumerate(rig.mounts, 1)]
    below = figure.add_subplot(grid[1, :])
    below.axis("off")
    names = ["camera", "x [mm]", "y [mm]", "z [mm]", "yaw", "pitch (down)", "roll"]
    below.table(cells, colLabels=names, loc="center", cellLoc="right").scale(1.0, 1.3)
    figure.savefig(path, dpi=150)


def _row(number: int, mount: Mount) -> list[str]:
    x, y, z = (f"{MM * value:.0f}" for value in mount.translation)
    return [str(number), x, y, z, *(f"{math.degrees(getattr(mount, name)):.1f}°" for name in ("yaw", "pitch", "roll"))]


def _draw(axes: "Axes", view: str, onto: FloatArray, body: Body, rig: Rig) -> None:
    from matplotlib.patches import Polygon, Rectangle

    low, high = body.corners
    ends = np.stack([low @ onto.T, high @ onto.T]) * MM
    for start, stop in zip(ends.min(axis=0), ends.max(axis=0), strict=True):
        axes.add_patch(Rectangle(tuple(start), *(stop - start), facecolor=BODY, edgecolor="black", zorder=1))
    first, last = ends.min(axis=(0, 1)), ends.max(axis=(0, 1))
    size = float((last - first).max())
    _dimension(axes, (first[0], first[1] - 0.12 * size), (last[0], first[1] - 0.12 * size))
    _dimension(axes, (first[0] - 0.12 * size, first[1]), (first[0] - 0.12 * size, last[1]))
    axes.plot(0.0, 0.0, "+", color="black", markersize=12, zorder=4)
    for i, mount in enumerate(rig.mounts, 1):
        at = onto @ np.array(mount.translation) * MM
        fan = [at, *(at + FIELD_LENGTH * size * (onto @ edge) for edge in _edges(mount, across=view == "from above"))]
        axes.add_patch(Polygon(fan, facecolor=FIXED, alpha=0.25, zorder=2))
        behind = np.cross(*onto) @ (np.array(mount.translation) - (low.min(axis=0) + high.max(axis=0)) / 2.0) < 0.0
        hidden = behind and bool(((at > first) & (at < last)).all())
        axes.plot(*at, "o", color=LANDMARK, fillstyle="none" if hidden else "full", zorder=5)
        text = f"{i} ({', '.join(f'{MM * mount.translation[axis]:.0f}' for axis in _shown(onto))})"
        axes.annotate(text, tuple(at), (5, 6), textcoords="offset points", fontsize=8, zorder=6)
    axes.set_title(view)
    if view == "from above":
        axes.xaxis.set_major_formatter(lambda value, _: f"{0.0 - value:.0f}")
    (x_low, y_low), (x_high, y_high) = first - 0.45 * size, last + 0.45 * size
    limits = {"xlim": (x_low, x_high), "ylim": (y_low, y_high)}
    axes.set(xlabel=AXES[view][0], ylabel=AXES[view][1], aspect="equal", **limits)


def _shown(onto: FloatArray) -> list[int]:
    """Axes of the body that a view shows, in their order."""
    return [axis for axis in range(3) if onto[:, axis].any()]


def _edges(mount: Mount, across: bool) -> list[FloatArray]:
    """Directions from one border of the image to the opposite border, body frame, `(3,)` each.

    Args:
        mount: mount of the camera.
        across: True for directions from the left to the right border, False for top to bottom.
    """
    left, right, top, bottom = mount.camera.field_of_view
    found = []
    for angle in np.linspace(left, -right, 9) if across else np.linspace(top, -bottom, 9):
        aside = (math.sin(angle), 0.0) if across else (0.0, math.sin(angle))
        found.append(np.asarray(mount.rotation @ np.array([math.cos(angle), *aside])))
    return found


def _dimension(axes: "Axes", start: tuple[float, float], stop: tuple[float, float]) -> None:
    """Draw an arrow between two points with their distance."""
    axes.annotate("", start, stop, arrowprops={"arrowstyle": "<->", "lw": 0.8})
    middle = ((start[0] + stop[0]) / 2.0, (start[1] + stop[1]) / 2.0)
    upright = start[0] == stop[0]
    axes.annotate(
        f"{math.dist(start, stop):.0f}", middle, (-4, 0) if upright else (0, -4), textcoords="offset points",
        rotation=90.0 if upright else 0.0, ha="right" if upright else "center", va="center" if upright else "top",
    )  # fmt: skip
