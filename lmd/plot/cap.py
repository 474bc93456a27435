"""The n-ple coverage spherical cap on the reachable unit sphere of one position, as a PNG."""

from pathlib import Path
from typing import Any

import numpy as np

from lmd.core.checks import FloatArray
from lmd.plot import common
from lmd.plot.common import new_figure
from lmd.scene.deployment import Deployment
from lmd.scene.scene import Scene
from lmd.sight.reference import cap_count, coverage_caps, coverage_probability

PIXELS = 320  # across a hemisphere
HALF_TITLES = ("the half that faces the viewer of the scene", "the other half, from behind")


def screen(viewer: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Unit vectors to the right and up as someone sees them towards whom `viewer` `(3,)`, not vertical, points."""
    right = np.array([-viewer[1], viewer[0], 0.0]) / np.hypot(viewer[0], viewer[1])
    return right, np.cross(viewer, right)


def hemisphere(viewer: FloatArray, pixels: int) -> FloatArray:
    """Unit vectors of the half sphere that faces `viewer`, as orthographically projected, z up.

    Args:
        viewer: unit vector from the centre towards the viewer, `(3,)`, not vertical.
        pixels: N, of the square that the half sphere fills.

    Returns:
        `(N, N, 3)`, rows from the bottom up; NaN outside the disc.
    """
    right, up = screen(viewer)
    across, along = np.meshgrid(*2 * [(np.arange(pixels) + 0.5) / pixels * 2.0 - 1.0])
    squared = 1.0 - across**2 - along**2
    towards = np.sqrt(np.where(squared >= 0.0, squared, np.nan))
    return np.asarray(across[..., None] * right + along[..., None] * up + towards[..., None] * viewer)


def save_cap_figure(
    path: str | Path, scene: Scene, deployment: Deployment, position: FloatArray, n: int, title: str
) -> None:
    """Write a PNG: the reachable unit sphere at `position`, coloured by how many caps each optical axis passes through.

    An optical axis in the n-ple cap S^n(p) (outlined, green) covers at least n landmarks; P_n(p) is the probability of
    that region under the scene's orientation PDF.

    Args:
        scene: camera, visibility and PDF.
        deployment: the landmarks l_k whose coverage spherical caps overlap.
        position: p, `(3,)`, metres.
        n: caps that must overlap.
    """
    from matplotlib.colors import BoundaryNorm, ListedColormap
    from matplotlib.patches import Circle

    views = (common.viewer(), -common.viewer())
    halves = [_counts(scene, deployment, position, hemisphere(view, PIXELS)) for view in views]
    most = max(n, *(int(np.nanmax(half)) for half in halves))
    colours = ListedColormap([*_shades("Greys", 0.08, 0.35, n), *_shades("Greens", 0.4, 0.95, most - n + 1)])

    figure = new_figure((10.0, 5.6))
    figure.suptitle(common.literal(title), fontsize=14)
    panels = figure.subplots(1, 2)
    for axes, half, view, name in zip(panels, halves, views, HALF_TITLES, strict=True):
        image = axes.imshow(
            half,
            origin="lower",
            extent=(-1.0, 1.0, -1.0, 1.0),
            cmap=colours,
            norm=BoundaryNorm(np.arange(most + 2) - 0.5, most + 1),
            interpolation="nearest",
        )
        if np.nanmin(half) < n <= np.nanmax(half):
            pixel = (np.arange(PIXELS) + 0.5) / PIXELS * 2.0 - 1.0
            axes.contour(pixel, pixel, half, levels=[n - 0.5], colors="black", linewidths=1.2)
        axes.set_title(name, fontsize=11)
        axes.set_axis_off()
        axes.add_patch(Circle((0.0, 0.0), 1.0, fill=False, clip_on=False))
        _mark_directions(axes, view)
    bar = figure.colorbar(image, ax=panels, orientation="horizontal", shrink=0.6, aspect=40, ticks=range(most + 1))
    orientations = scene.orientations.axes[scene.orientations.index_of]
    counts = cap_count(coverage_caps(scene, deployment, position, orientations))
    probability = float(coverage_probability(counts[None], scene.pdf, n, position[None])[0])
    x, y, z = position
    bar.set_label(
        f"landmarks covered by a camera at ({x:.2f}, {y:.2f}, {z:.2f}) m that looks this way; "
        f"outlined: {n}-ple cap, probability {probability:.1%}"
    )
    figure.savefig(path)


def _counts(scene: Scene, deployment: Deployment, position: FloatArray, axes: FloatArray) -> FloatArray:
    """How many landmarks each optical axis `(N, N, 3)` of a level camera covers, `(N, N)`; NaN for an axis of NaN."""
    inside = ~np.isnan(axes[..., 0])
    level = np.stack([axes[..., 1], -axes[..., 0], np.zeros(inside.shape)], axis=-1)  # axis x up
    with np.errstate(invalid="ignore"):
        right = level / np.linalg.norm(level, axis=-1, keepdims=True)
    axes = np.concatenate([axes, right], axis=-1)
    counts = np.full(inside.shape, np.nan)
    counts[inside] = cap_count(coverage_caps(scene, deployment, position, axes[inside]))
    return counts


def _mark_directions(axes: Any, view: FloatArray) -> None:
    """Write +x, -x, ... where these directions meet the half sphere that faces `view`."""
    right, up = screen(view)
    for name, direction in zip("xyz", np.eye(3), strict=True):
        for sign, label in ((1.0, f"+{name}"), (-1.0, f"-{name}")):
            if sign * (direction @ view) > 0.0:
                at = sign * float(direction @ right), sign * float(direction @ up)
                axes.plot(*at, marker="+", color="black")
                axes.annotate(label, at, xytext=(4, 4), textcoords="offset points")


def _shades(name: str, first: float, last: float, count: int) -> Any:
    import matplotlib as mpl

    return mpl.colormaps[name](np.linspace(first, last, count))
