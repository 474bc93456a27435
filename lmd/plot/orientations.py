"""Picture of an orientation PDF and of its estimate, as a PNG."""

from pathlib import Path
from typing import Any

import numpy as np

from lmd.orientation.procedure import Marginal, PdfEstimate
from lmd.plot import common
from lmd.plot.common import new_panels

HISTOGRAM = "#bdbdbd"
CHOSEN = "#1a9641"  # colour of the chosen fit, as in the paper


def save_orientation_figure(path: str | Path, estimate: PdfEstimate, title: str) -> None:
    """Write a PNG of 1500 x 500 pixels with three panels about an orientation PDF.

    Two panels show histograms of yaw and of pitch with all fitted densities. The third panel shows the joint PDF of yaw
    and pitch.
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
