"""Estimate an orientation PDF: `python -m pipelines.estimate_pdf recording.path=flight.csv [overrides]`."""

from pathlib import Path
from typing import TYPE_CHECKING

from omegaconf import DictConfig

from .app import flat_settings, run_directory
from .nodes import instantiate, keyed, note, settings_of
from .outputs import write_document
from .pipeline import Pipeline

MOTION = {"_target_": "lmd.orientation.recording.SimulatedRecording"}  # class of `simulate`

if TYPE_CHECKING:
    from lmd.orientation.procedure import Marginal, PdfEstimate


def estimate(cfg: DictConfig) -> None:
    """Estimate the PDF of the configured recording."""
    import numpy as np

    from lmd.core.checks import seed_number
    from lmd.orientation.procedure import estimate_pdf
    from lmd.plot.orientations import save_orientation_figure

    from .outputs import all_or_none
    from .tracked_run import keep, tracked

    rng = np.random.default_rng(seed_number(cfg.seed))
    key = "recording" if cfg.simulate is None else "simulate"
    source = instantiate(settings_of(cfg, key), **(MOTION if key == "simulate" else {}))
    with keyed(key):
        recording = source.record(rng)
    note(recording.note)
    result = estimate_pdf(
        recording,
        rng,
        divisions=cfg.divisions,
        mean_interval=cfg.mean_interval,
        significance=cfg.significance,
    )
    directory, subject = run_directory(), f"orientation PDF of {recording.name}"
    document = {
        "recording": {"name": recording.name, "records": len(recording.time), "duration": recording.duration},
        **result.summary(),
        "settings": flat_settings(cfg, key, "divisions", "mean_interval", "significance", "seed"),
    }

    def write(partial: Path) -> None:
        result.pdf.to_csv(partial / "pdf.csv")
        write_document(partial / "pdf_estimate.json", document)
        save_orientation_figure(partial / "pdf.png", result, subject)

    with tracked(cfg, f"estimate_pdf {key}") as tracker:
        files = all_or_none(directory, write)
        keep(tracker, files, _figures(result))
    samples = result.samples
    _show("samples", f"{len(samples)}, {samples.mean_interval:.3g} s apart on average (the motion stays correlated for "
          f"{samples.correlation_time:.3g} s)")  # fmt: skip
    _show("yaw", _described(result.yaw))
    _show("pitch", _described(result.pitch))
    _show("independence", _verdict(result))
    _show("files", f"{directory}: {', '.join(path.name for path in files)}")
    _show("picture", str(directory / "pdf.png"))
    _show("use it with", f"pdf=samples pdf.path={directory / 'pdf.csv'}")
    _show("mlflow", tracker.describe())


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


def _show(label: str, text: str) -> None:
    print(f"{label:<20} {text}", flush=True)


main = Pipeline("estimate_pdf", estimate)

if __name__ == "__main__":
    main()
