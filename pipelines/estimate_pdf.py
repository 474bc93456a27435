"""Estimate an orientation PDF: `python -m pipelines.estimate_pdf recording.path=flight.csv [overrides]`."""

from omegaconf import DictConfig

from .app import flat_settings, run_directory
from .command import Command
from .nodes import instantiate, keyed, note, settings_of
from .study import Report, Study

MOTION = {"_target_": "lmd.orientation.recording.SimulatedRecording"}  # class of `simulate`
SETTINGS = ("divisions", "mean_interval", "significance")


def estimate(cfg: DictConfig) -> Study:
    """Estimate the orientation PDF from the configured recording; return a study that reports on the result."""
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
    settings = {"settings": flat_settings(cfg, key, *SETTINGS, "seed")}
    files = {
        "pdf.csv": result.pdf.to_csv,
        "pdf_estimate.json": {"recording": about, **result.summary(), **settings},
        "pdf.png": lambda path: save_orientation_figure(path, result, f"orientation PDF of {recording.name}"),
    }
    lines = {**result.lines(), "use it with": f"pdf=samples pdf.path={run_directory() / 'pdf.csv'}"}
    return Study(f"estimate_pdf {key}", lambda _: Report(files, result.metrics(), lines=lines))


main = Command("estimate_pdf", estimate)

if __name__ == "__main__":
    main()
