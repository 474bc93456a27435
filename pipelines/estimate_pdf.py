"""Estimate an orientation PDF: `python -m pipelines.estimate_pdf recording.path=flight.csv [overrides]`."""

from typing import TYPE_CHECKING

from omegaconf import DictConfig

from .app import flat_settings, run_directory
from .command import Command
from .nodes import instantiate, keyed, note, settings_of
from .study import Report, Study

if TYPE_CHECKING:
    from lmd.orientation.procedure import Marginal, PdfEstimate

MOTION = {"_target_": "lmd.orientation.recording.SimulatedRecording"}  # class of `simulate`
SETTINGS = ("divisions", "mean_interval", "significance")


def estimate(cfg: DictConfig) -> Study:
    """Estimate the PDF of the configured recording."""
    import numpy as np

    from lmd.core.checks import seed_number
    from lmd.orientation.procedure import estimate_pdf
    from lmd.plot.orientations import save_orientation_figure

    rng = np.random.default_rng(seed_number(cfg.seed))
    key = "recording" if cfg.simulate is None else "simulate"
    source = instantiate(settings_of(cfg, key), **(MOTION if key == "simulate" else {}))
    with keyed(key):
        recording = source.record(rng)
    note(recording.note)
    result = estimate_pdf(recording, rng, **{name: cfg[name] for name in SETTINGS})
    about = {"name": recording.name, "records": len(recording.time), "duration": recording.duration}
    files = {
        "pdf.csv": result.pdf.to_csv,
        "pdf_estimate.json": {
            "recording": about,
            **result.summary(),
            "settings": flat_settings(cfg, key, *SETTINGS, "seed"),
        },
        "pdf.png": lambda path: save_orientation_figure(path, result, f"orientation PDF of {recording.name}"),
    }
    lines = _lines(result) | {
        "picture": str(run_directory() / "pdf.png"),
        "use it with": f"pdf=samples pdf.path={run_directory() / 'pdf.csv'}",
    }
    return Study(f"estimate_pdf {key}", lambda _: Report(files, _figures(result), lines=lines))


def _lines(result: "PdfEstimate") -> dict[str, str]:
    """Labelled lines for the terminal."""
    samples = result.samples
    return {
        "samples": f"{len(samples)}, {samples.mean_interval:.3g} s apart on average (the motion stays correlated for "
        f"{samples.correlation_time:.3g} s)",
        "yaw": _described(result.yaw),
        "pitch": _described(result.pitch),
        "independence": _verdict(result),
    }


def _figures(result: "PdfEstimate") -> dict[str, float]:
    """Figures for the tracked run."""
    figures: dict[str, float] = {
        "samples": len(result.samples),
        "correlation_time": result.samples.correlation_time,
        "mean_interval": result.samples.mean_interval,
        "orientations": len(result.pdf.weight),
    }
    if result.independence is not None:
        figures["independence/statistic"] = result.independence.statistic
        figures["independence/p_value"] = result.independence.p_value
    for angle, marginal in (("yaw", result.yaw), ("pitch", result.pitch)):
        figures |= {f"{angle}/{key}": value for key, value in marginal.density.parameters.items()}
        for candidate in marginal.candidates:
            figures[f"{angle}/log_likelihood/{candidate.density.family}"] = candidate.log_likelihood
    return figures


def _described(marginal: "Marginal") -> str:
    """Text of the chosen density, and of the log-likelihood differences of the other densities from the best."""
    parameters = ", ".join(f"{key.replace('_', ' ')} {value:.3g}" for key, value in marginal.density.parameters.items())
    name = marginal.density.family.replace("_", " ") + (f" ({parameters})" if parameters else "")
    behind = ", ".join(
        f"{c.density.family.replace('_', ' ')} {c.behind:.4f} +- {c.standard_error:.4f}" for c in marginal.candidates
    )
    return f"{name}; behind the best: {behind}" if behind else name


def _verdict(result: "PdfEstimate") -> str:
    test = result.independence
    if test is None:
        return "nothing to test, an angle is fixed"
    outcome = "rejected: the joint density is used" if test.rejected else "not rejected: the product is used"
    return f"{outcome} (chi-squared {test.statistic:.1f}, p = {test.p_value:.4f})"


main = Command("estimate_pdf", estimate)

if __name__ == "__main__":
    main()
