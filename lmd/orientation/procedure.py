"""Monte Carlo procedure of the paper (Sec. V-D): estimate of an orientation PDF from a recording, in five steps.

1. record yaw and pitch of the randomly moving camera (`lmd.orientation.recording`);
2. sample the recording at random intervals;
3. make histograms of both angles;
4. test their independence;
5. fit a density to each angle (`lmd.orientation.density`) and multiply both densities, or estimate the joint density if
   independence is rejected.

The density is then summed over the cells of an orientation grid as in the paper.
"""

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from scipy.stats import circmean, iqr

from lmd.core.checks import FloatArray, IntArray, real
from lmd.orientation import density
from lmd.orientation.density import (
    AngleCells,
    Candidate,
    Density,
    Family,
    Independence,
    circular_difference,
    independence_test,
)
from lmd.orientation.recording import OrientationRecording, Samples, sample_at_random_intervals
from lmd.scene.pdf import OrientationPdf, divisions_of

# Least number of fine cells on 180 degrees: the resolution of densities is 1.9 degrees or finer.
FINE_CELLS = 96
YAW_FAMILIES = (density.uniform, density.von_mises, density.kernel_estimate)
PITCH_FAMILIES = (density.uniform, density.normal, density.kernel_estimate)
# Least probability of a cell of the orientation grid; less probable cells are dropped to save time.
NEGLIGIBLE = 1e-6


@dataclass(frozen=True)
class Marginal:
    """Samples, histogram and fit of one angle."""

    samples: FloatArray
    """Samples of the angle, radians, `(S,)`."""
    axis: AngleCells
    """Fine cells over which the angle's density is represented."""
    block: int
    """Number of fine cells in each cell of the orientation grid."""
    density: Density
    """Density that was chosen for the angle; for a fixed angle, a density of the family `fixed` with a single cell."""
    candidates: tuple[Candidate, ...]
    """Fits of all families that were compared; empty for a fixed angle."""

    @property
    def is_fixed(self) -> bool:
        """True if all samples lie within the width of a fine cell."""
        return self.density.family == "fixed"

    @property
    def angles(self) -> FloatArray:
        """Middles of the density's M fine cells, `(M,)`, radians; if the angle is fixed, this angle, `(1,)`."""
        return np.array([self.density.parameters["value"]]) if self.is_fixed else self.axis.centres

    @property
    def grid_cell(self) -> IntArray:
        """Index of the orientation grid's cell in which each of `angles` lies, `(M,)`; 0 for a fixed angle."""
        return np.arange(len(self.angles)) // self.block

    @property
    def histogram(self) -> tuple[FloatArray, FloatArray]:
        """Histogram of the samples: edges of the bins `(B + 1,)`, radians, and densities `(B,)`, 1/rad.

        Bins are cells of the orientation grid, divided into equal parts if the Freedman-Diaconis rule requires narrower
        bins.
        """
        around_mean = circular_difference(self.samples, circmean(self.samples))
        width = 2.0 * iqr(around_mean) / np.cbrt(len(self.samples))
        parts = (p for p in range(self.block, 0, -1) if self.block % p == 0)
        bar = next((p for p in parts if p * self.axis.width <= width), 1)
        edges = self.axis.edges[::bar]
        counts = np.bincount(self.axis.index(self.samples) // bar, minlength=len(edges) - 1)
        return edges, np.asarray(counts / (len(self.samples) * np.diff(edges)))

    def summary(self) -> dict[str, Any]:
        """Data for JSON: the chosen density, all candidate densities, and the histogram."""
        edges, heights = self.histogram
        return {
            "family": self.density.family,
            "parameters": self.density.parameters,
            "candidates": [
                {
                    "family": c.density.family,
                    "parameters": c.density.parameters,
                    "cross_validated_log_likelihood": c.log_likelihood,
                    "behind_the_best": c.behind,
                    "standard_error": c.standard_error,
                }
                for c in self.candidates
            ],
            "histogram": {"edges": edges.tolist(), "density": heights.tolist()},
        }

    def described(self) -> str:
        """Text with the chosen density and with all candidates.

        For each candidate, the text states how far its log-likelihood is below that of the best candidate.
        """
        parameters = ", ".join(f"{key.replace('_', ' ')} {value:.3g}" for key, value in self.density.parameters.items())
        name = self.density.family.replace("_", " ") + (f" ({parameters})" if parameters else "")
        behind = ", ".join(
            f"{c.density.family.replace('_', ' ')} {c.behind:.4f} +- {c.standard_error:.4f}" for c in self.candidates
        )
        return f"{name}; behind the best: {behind}" if behind else name


@dataclass(frozen=True)
class PdfEstimate:
    """Orientation PDF, with the results of the steps of its estimation."""

    pdf: OrientationPdf
    """PDF on the orientation grid."""
    samples: Samples
    """Samples of the recording at random intervals."""
    yaw: Marginal
    """Samples, histogram and fit of the yaw."""
    pitch: Marginal
    """Samples, histogram and fit of the pitch."""
    independence: Independence | None
    """Outcome of the independence test; None if an angle is fixed."""
    joint: Density | None
    """Joint kernel estimate, probabilities `(M_yaw, M_pitch)`; None if the product of the marginals is used."""

    @property
    def form(self) -> str:
        """Form of the density: `product` of the marginals, or `joint`."""
        return "product" if self.joint is None else "joint"

    def summary(self) -> dict[str, Any]:
        """Data for JSON: the results of all steps, without the PDF itself; angles in radians, times in seconds."""
        test = self.independence
        return {
            "sampling": {
                "samples": len(self.samples),
                "mean_interval": self.samples.mean_interval,
                "correlation_time": self.samples.correlation_time,
            },
            "independence": None if test is None else {**asdict(test), "rejected": test.rejected},
            "form": self.form,
            "joint": None if self.joint is None else self.joint.parameters,
            "yaw": self.yaw.summary(),
            "pitch": self.pitch.summary(),
        }

    def metrics(self) -> dict[str, float]:
        """Metrics of the estimate, keyed by name."""
        figures: dict[str, float] = {
            "samples": len(self.samples),
            "correlation_time": self.samples.correlation_time,
            "mean_interval": self.samples.mean_interval,
            "orientations": len(self.pdf.weight),
        }
        if self.independence is not None:
            figures["independence/statistic"] = self.independence.statistic
            figures["independence/p_value"] = self.independence.p_value
        for angle, marginal in (("yaw", self.yaw), ("pitch", self.pitch)):
            figures |= {f"{angle}/{key}": value for key, value in marginal.density.parameters.items()}
            for candidate in marginal.candidates:
                figures[f"{angle}/log_likelihood/{candidate.density.family}"] = candidate.log_likelihood
        return figures

    def lines(self) -> dict[str, str]:
        """Lines of text for a terminal, keyed by label: samples, fit of each angle, and independence test."""
        samples = self.samples
        return {
            "samples": f"{len(samples)}, {samples.mean_interval:.3g} s apart on average (the motion stays correlated "
            f"for {samples.correlation_time:.3g} s)",
            "yaw": self.yaw.described(),
            "pitch": self.pitch.described(),
            "independence": _verdict(self.independence),
        }


def _verdict(test: Independence | None) -> str:
    if test is None:
        return "nothing to test, an angle is fixed"
    outcome = "rejected: the joint density is used" if test.rejected else "not rejected: the product is used"
    return f"{outcome} (chi-squared {test.statistic:.1f}, p = {test.p_value:.4f})"


def estimate_pdf(
    recording: OrientationRecording,
    rng: np.random.Generator,
    *,
    divisions: int = 12,
    mean_interval: float | None = None,
    significance: float = 0.05,
) -> PdfEstimate:
    """Estimate an orientation PDF from a recording: steps 2 to 5 of the procedure.

    An angle whose samples all lie within a fine cell (1.9 degrees or less) is fixed: a fixed pitch gives a PDF in yaw
    alone, at that pitch.

    Args:
        recording: yaw and pitch over time.
        rng: random generator for the times of the samples and for the tables of the independence test.
        divisions: the step of the orientation grid is pi / divisions.
        mean_interval: mean interval between samples, seconds; None for twice the correlation time.
        significance: significance level of the independence test.

    Raises:
        InputError: a setting is out of range, or the recording gives too few samples.
    """
    divisions = divisions_of(divisions)
    significance = real("significance", significance, low=0.0, high=1.0)
    samples = sample_at_random_intervals(recording, mean_interval, rng)
    block = -(-FINE_CELLS // divisions)
    half_step = np.pi / divisions / 2.0
    around = AngleCells(-np.pi - half_step, np.pi - half_step, 2 * divisions * block, circular=True)
    upward = AngleCells(-np.pi / 2, np.pi / 2, divisions * block, circular=False)
    yaw = _marginal(samples.yaw, around, block, YAW_FAMILIES)
    pitch = _marginal(samples.pitch, upward, block, PITCH_FAMILIES)
    test, joint = None, None
    if not (yaw.is_fixed or pitch.is_fixed):
        test = independence_test(samples, significance, rng)
        if test.rejected:
            index = (around.index(samples.yaw), upward.index(samples.pitch))
            probability, widths = density.kernel_density(index, (around, upward))
            parameters = {"yaw_bandwidth": widths[0], "pitch_bandwidth": widths[1]}
            joint = Density("kernel", parameters, probability)
    product = np.asarray(np.outer(yaw.density.probability, pitch.density.probability), dtype=np.float64)
    pdf = _gathered(product if joint is None else joint.probability, yaw, pitch, f"the PDF of {recording.name}")
    return PdfEstimate(pdf, samples, yaw, pitch, test, joint)


def _marginal(angle: FloatArray, axis: AngleCells, block: int, families: Sequence[Family]) -> Marginal:
    fixed = density.fixed_angle(angle, axis)
    if fixed is not None:
        return Marginal(angle, axis, block, Density("fixed", {"value": fixed}, np.ones(1)), ())
    chosen, candidates = density.choose(angle, axis, families)
    return Marginal(angle, axis, block, chosen, candidates)


def _gathered(table: FloatArray, yaw: Marginal, pitch: Marginal, name: str) -> OrientationPdf:
    """Orientation PDF: the mean orientation and the total probability of each cell of the orientation grid.

    The mean orientation is used in place of the centre of the cell, so that the mean of a pitch that hardly varies is
    preserved. Cells with a negligible probability are dropped.

    Args:
        table: probabilities of the fine cells of yaw (rows) and pitch (columns), `(M_yaw, M_pitch)`.
        yaw: samples and fit of the yaw, with its fine cells.
        pitch: samples and fit of the pitch, with its fine cells.
        name: name of the PDF, for messages.
    """
    cell = yaw.grid_cell[:, None] * (pitch.grid_cell[-1] + 1) + pitch.grid_cell
    yaws, pitches = np.meshgrid(yaw.angles, pitch.angles, indexing="ij")
    weight, *moments = (
        np.bincount(cell.reshape(-1), weights=(table * factor).reshape(-1)) for factor in (1.0, yaws, pitches)
    )
    kept = weight > NEGLIGIBLE
    mean_yaw, mean_pitch = (moment[kept] / weight[kept] for moment in moments)
    # The first cells of the yaw extend half a step beyond -pi.
    mean_yaw = np.where(mean_yaw < -np.pi - 1e-9, mean_yaw + 2.0 * np.pi, mean_yaw)
    return OrientationPdf(mean_yaw, mean_pitch, weight[kept] / weight[kept].sum(), name)
