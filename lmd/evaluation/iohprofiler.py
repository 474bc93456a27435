"""Runs in the format of IOHprofiler, which IOHanalyzer and iohinspector read.

A folder for each optimiser holds `IOHprofiler_f<id>_<problem>.json` and the records of all seeds in
`data_f<id>_<problem>/IOHprofiler_f<id>_DIM<d>.dat`. Evaluations are whole numbers there: a part counts as one.
"""

import json
import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from lmd.core.checks import FloatArray
from lmd.evaluation.comparison import OptimiserRun

HEADER = "evaluations raw_y"
NOTHING = -1.0
"""Value of a run before its first record."""
VERSION = "0.4.2"
"""Version of IOHexperimenter whose format this is."""


def whole_evaluations(run: OptimiserRun) -> FloatArray:
    """Evaluations of the records of a run, rounded up, `(N,)`."""
    return np.array([math.ceil(record.evaluations) for record in run.history], dtype=np.float64)


def write_iohprofiler(folder: Path, runs: Sequence[OptimiserRun], problem: str, number: int, dim: int) -> Path:
    """Write the runs of one optimiser on one problem; returns the JSON file.

    Args:
        folder: folder of the optimiser; made if missing.
        runs: runs of different seeds.
        problem: name of the problem.
        number: number of the problem, from 1 on.
        dim: number of genes of a candidate.
    """
    data = Path(f"data_f{number}_{problem}", f"IOHprofiler_f{number}_DIM{dim}.dat")
    (folder / data).parent.mkdir(parents=True, exist_ok=True)
    records, entries = list[str](), list[dict[str, object]]()
    for run in runs:
        reached = {1: NOTHING}  # a run begins where a record has one evaluation
        reached |= {
            int(at): record.best_fitness for at, record in zip(whole_evaluations(run), run.history, strict=True)
        }
        best, last = max(reached.values()), max(reached)
        records += [HEADER, *(f"{at} {value!r}" for at, value in reached.items())]
        found = {"evals": next(at for at, value in reached.items() if value == best), "y": best, "x": []}
        entries.append({"instance": 1, "evals": last, "best": found})
    (folder / data).write_text("\n".join(records) + "\n", encoding="utf-8")
    document = {
        "version": VERSION,
        "suite": "lmd",
        "function_id": number,
        "function_name": problem,
        "maximization": True,
        "algorithm": {"name": runs[0].optimiser, "info": "lmd"},
        "attributes": HEADER.split(),
        "scenarios": [{"dimension": dim, "path": data.as_posix(), "runs": entries}],
    }
    path = folder / f"IOHprofiler_f{number}_{problem}.json"
    path.write_text(json.dumps(document, indent=1) + "\n", encoding="utf-8")
    return path


def attained_share(runs: Sequence[OptimiserRun], at: FloatArray, low: float, high: float) -> FloatArray:
    """Share of all targets between two values that the runs have reached, `(N,)`: the ECDF of IOHprofiler.

    Targets are uniform in [low, high], so the share of a run is its best fitness by then, scaled to [0, 1].

    Args:
        runs: runs, each with equal weight.
        at: whole evaluations, `(N,)`.
        low, high: least and greatest target.
    """
    shares = []
    for run in runs:
        best = np.array([low, *(record.best_fitness for record in run.history)])
        by_then = best[np.searchsorted(whole_evaluations(run), at, side="right")]
        shares.append(np.clip((by_then - low) / (high - low), 0.0, 1.0))
    return np.asarray(np.mean(shares, axis=0))
