"""Measure how well `lmd.orientation` recovers known distributions: `python benchmarks/orientation_pdf.py [RECORDINGS]`.

Each row is over many simulated recordings of 20 minutes: how many samples they give, how often independence is rejected
at the level of 5 %, how often the family of the yaw is the true one, and the total variation distance between the yaw
of the estimated PDF and the truth on the 24 cells of the orientation grid (median).
"""

import sys
from typing import Any

import numpy as np
from scipy.stats import vonmises

from lmd.orientation.procedure import PdfEstimate, estimate_pdf
from lmd.orientation.recording import SimulatedRecording

MOTION = {
    "duration": 1200.0,
    "rate": 10.0,
    "correlation_time": 1.0,
    "yaw_mean": 3.0,
    "yaw_concentration": 0.0,
    "pitch_mean": 0.0,
    "pitch_std": 0.1,
    "coupling": 0.0,
}
ROWS: dict[str, tuple[dict[str, float], dict[str, Any]]] = {
    "uniform yaw": ({}, {}),
    "von Mises yaw, kappa = 1": ({"yaw_concentration": 1.0}, {}),
    "von Mises yaw, kappa = 1, coupling 0.3": ({"yaw_concentration": 1.0, "coupling": 0.3}, {}),
    "von Mises yaw, kappa = 1, coupling 0.6": ({"yaw_concentration": 1.0, "coupling": 0.6}, {}),
    "uniform yaw, sampled every 0.5 s": ({}, {"mean_interval": 0.5}),
}


def distance(estimate: PdfEstimate, motion: dict[str, float]) -> float:
    """Total variation distance of the yaw to the truth."""
    step = np.pi / 12
    cell = np.rint(estimate.pdf.yaw / step).astype(int) % 24
    found = np.bincount(cell, weights=estimate.pdf.weight, minlength=24)
    edges = (np.arange(25) - 0.5) * step
    truth = np.diff(vonmises.cdf(edges, motion["yaw_concentration"], loc=motion["yaw_mean"]))
    return float(np.abs(found - truth).sum() / 2.0)


def main() -> None:
    """Print one row for each case."""
    recordings = int(sys.argv[1]) if len(sys.argv) > 1 else 100
    columns = ("motion", "samples", "independence rejected", "family of the yaw right", "distance")
    print(f"| {' | '.join(columns)} |\n{'| --- ' * len(columns)}|")
    for label, (changes, settings) in ROWS.items():
        motion = MOTION | changes
        family = "von_mises" if motion["yaw_concentration"] else "uniform"
        estimates = []
        for seed in range(recordings):
            rng = np.random.default_rng(seed)
            estimates.append(estimate_pdf(SimulatedRecording(**motion).record(rng), rng, **settings))
        samples = np.mean([len(e.samples) for e in estimates])
        rejected = np.mean([e.joint is not None for e in estimates])
        right = np.mean([e.yaw.density.family == family for e in estimates])
        far = np.median([distance(e, motion) for e in estimates])
        print(f"| {label} | {samples:.0f} | {rejected:.0%} | {right:.0%} | {far:.3f} |", flush=True)


if __name__ == "__main__":
    main()
