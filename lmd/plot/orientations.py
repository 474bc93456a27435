"""Pictures of directions, as PNGs: optical axes with n landmarks in view from a position, and orientation densities."""

from pathlib import Path
from typing import Any

import numpy as np

from lmd.core.checks import FloatArray
from lmd.orientation.procedure import Marginal, PdfEstimate
from lmd.plot import common
from lmd.plot.common import new_panels
from lmd.scene.deployment import Deployment
from lmd.scene.scene import Scene
from lmd.sight.reference import cap_count, coverage_caps, coverage_probability

PIXELS = 320  # width of a hemisphere, pixels
HISTOGRAM = "#bdbdbd"
CHOSEN = "#1a9641"  # colour of the chosen fit, as in the paper
HALF_TITLES = ("the half that faces the viewer of the scene", "the other half, from behind")


def screen(viewer: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Right and up of the image of a viewer in the direction `viewer` `(3,)`, not vertical; unit vectors `(3,)`."""
    right = np.array([-viewer[1], viewer[0], 0.0]) / np.hypot(viewer[0], viewer[1])
    return right, np.cross(viewer, right)


def hemisphere(viewer: FloatArray, pixels: int) -> FloatArray:
    """Unit vectors of the half sphere that faces `viewer`, in orthographic projection, z up.

    Args:
        viewer: unit vector from the centre towards the viewer, `(3,)`, not vertical.
        pixels: N, edge of the square that the half sphere fills, pixels.

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
    """Write a PNG: the reachable unit sphere at `position`, coloured by the number of caps at each optical axis.

    An optical axis in the n-ple cap S^n(p) (outlined, green) covers at least n landmarks; P_n(p) is the probability of
    that region under the scene's orientation PDF.

    Args:
        path: path of the PNG.
        scene: camera, visibility and PDF.
        deployment: the landmarks l_k whose coverage spherical caps overlap.
        position: p, `(3,)`, metres.
        n: number of caps that must overlap.
        title: title of the figure.
    """
    from matplotlib.colors import BoundaryNorm, ListedColormap
    from matplotlib.patches import Circle

    views = (common.viewer(), -common.viewer())
    halves = [_counts(scene, deployment, position, hemisphere(view, PIXELS)) for view in views]
    most = max(n, *(int(np.nanmax(half)) for half in halves))
    colours = ListedColormap([*_shades("Greys", 0.08, 0.35, n), *_shades("Greens", 0.4, 0.95, most - n + 1)])

    figure, (panels,) = new_panels((10.0, 5.6), title, 1, 2)
    for axes, half, view, name in zip(panels, halves, views, HALF_TITLES, strict=True):
        norm, square = BoundaryNorm(np.arange(most + 2) - 0.5, most + 1), (-1.0, 1.0, -1.0, 1.0)
        image = axes.imshow(half, colours, norm, origin="lower", extent=square, interpolation="nearest")
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
    """Number of landmarks that a level camera covers along each optical axis `(N, N, 3)`, `(N, N)`; NaN where the axis
    is NaN.
    """
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


def save_orientation_figure(path: str | Path, estimate: PdfEstimate, title: str) -> None:
    """Write a PNG of 1500 x 500 pixels: histograms of yaw and pitch with all fitted densities, and the PDF of both
    angles.
    """
    figure, ((left, middle, right),) = new_panels((15.0, 5.0), title, 1, 3, width_ratios=(1.2, 1.0, 1.2))
    _draw_marginal(left, estimate.yaw, "yaw")
    _draw_marginal(middle, estimate.pitch, "pitch")
    _draw_pdf(right, estimate)
    figure.savefig(path)


def _draw_marginal(axes: Any, marginal: Marginal, name: str) -> None:
    edges, heights = marginal.histogram
    degrees = np.degrees(edges)
    axes.stairs(heights, degrees, fill=True, color=HISTOGRAM, label=f"{len(marginal.samples)} samples")
    if marginal.is_fixed:
        value = np.degrees(marginal.density.parameters["value"])
        axes.axvline(value, color=CHOSEN, linewidth=2.5, label=f"fixed at {value:.1f}°")
    for candidate in marginal.candidates:
        density, is_chosen = candidate.density, candidate.density.family == marginal.density.family
        style = {"color": CHOSEN, "linewidth": 2.5} if is_chosen else {"linewidth": 1.0, "linestyle": "--"}
        label = density.family.replace("_", " ") + (", chosen" if is_chosen else "")
        axes.plot(np.degrees(marginal.axis.centres), density.probability / marginal.axis.width, label=label, **style)
    axes.set(xlabel=f"{name} [°]", ylabel="density [1/rad]", xlim=(degrees[0], degrees[-1]))
    axes.xaxis.set_major_locator(_steps())
    axes.set_ylim(top=1.35 * axes.get_ylim()[1])  # room for the legend
    axes.legend(frameon=False, loc="upper left", ncols=2)


def _draw_pdf(axes: Any, estimate: PdfEstimate) -> None:
    pdf, samples = estimate.pdf, estimate.samples
    low = np.degrees(estimate.yaw.axis.low)
    measured, yaw = ((np.degrees(angle) - low) % 360.0 + low for angle in (samples.yaw, pdf.yaw))
    axes.plot(measured, np.degrees(samples.pitch), ".", color="0.75", markersize=3.0, zorder=1)
    area = 15.0 + 60.0 * pdf.weight / pdf.weight.max()
    dots = axes.scatter(yaw, np.degrees(pdf.pitch), area, pdf.weight, cmap=common.COLOUR_MAP, vmin=0.0, zorder=2)
    axes.set(xlabel="yaw [°]", ylabel="pitch [°]", xlim=(low, low + 360.0), ylim=(-92.0, 92.0))
    axes.set_title(f"{len(pdf.weight)} orientations, {estimate.form}", fontsize="medium")
    axes.xaxis.set_major_locator(_steps())
    axes.figure.colorbar(dots, ax=axes, label="probability")


def _steps() -> Any:
    from matplotlib.ticker import MultipleLocator

    return MultipleLocator(45.0)
