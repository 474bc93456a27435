"""Stores of tracked sweeps as the pipelines leave them, without the work, and reports on them."""

import sys

import numpy as np
import pytest
import stores  # noqa: F401 - new ones get their tables from it
from composing import composed
from omegaconf import OmegaConf

import pipelines.report
from lmd.core.tables import write_table
from lmd.optimisers.ledger import Record, columns_of
from pipelines.building import build_problem
from pipelines.operations.tracking import PARENT_TAG, MlflowTracker, RunStart
from pipelines.score import HISTORY_FILE

SMALL = ("room.spacing=1.5", "deployment.count=6", "objective.thold_p=0.5", "threads=1")
AVERAGE, MAXIMUM = 0.6, 0.9  # of every run


def small_config():
    """A problem of 36 positions and six landmarks."""
    return composed("optimise", *SMALL, "deployment=uniform")


def record_sweep(uri, folder, name, jobs, pipeline="optimise"):
    """Record a sweep and its jobs; returns the id of the parent run.

    Args:
        uri: the store.
        folder: for the files that jobs keep.
        name: of the sweep.
        jobs: for each job the overrides that tell it from the others, its qualified ratio and its status.
        pipeline: what ran.
    """
    cfg = small_config()
    problem = build_problem(cfg)
    problem.start.draw(problem.scene.room, np.random.default_rng(0)).to_csv(folder / "landmarks.csv")
    OmegaConf.save(cfg, folder / "config.yaml")
    sweep = {"sweep": name, "pipeline": pipeline}
    parent = MlflowTracker(uri, "lmd")
    tags = sweep | {"override.seed": "0,1", "override.experiment": name}
    parent.start(RunStart(f"sweep {name}", folder / name, tags=tags))
    for number, (overrides, ratio, status) in enumerate(jobs):
        tracker = MlflowTracker(uri, "lmd")
        tags = sweep | {"job": f"job-{number}", PARENT_TAG: parent.run_id}
        tags |= {f"choice.{key}": value for key, value in overrides.items() if "." not in key}
        settings = {"seed": number, "budget.evaluations": 60, "objective.n": 2, "objective.thold_p": 0.65}
        params = settings | {"deployment.count": 90} | overrides
        tracker.start(RunStart(f"{name} {number}", folder / name / str(number), params, tags))
        if status == "FINISHED":
            tracker.log_metrics(
                {
                    "qualified_ratio": ratio,
                    "average_coverage_probability": AVERAGE,
                    "maximum_coverage_probability": MAXIMUM,
                }
            )
            write_table(folder / HISTORY_FILE, columns_of([Record(30, ratio / 2.0, 0.1), Record(60, ratio, 0.2)]))
            tracker.log_artifacts([folder / name for name in ("landmarks.csv", "history.csv", "config.yaml")])
        tracker.finish(status)
    parent.log_metrics({"jobs": len(jobs)})
    parent.finish("FINISHED")
    return parent.run_id


def record_all(uri, folder):
    """Every sweep that a report is made of; returns the parents' ids by name."""

    def done(*jobs):
        return [(overrides, ratio, "FINISHED") for overrides, ratio in jobs]

    seeds = [({"optimiser": "ega"}, 0.4), ({"optimiser": "ega"}, 0.6), ({"optimiser": "ega"}, 0.5)]
    pairs = [({"objective.n": n, "objective.thold_p": p}, 0.9 - 0.2 * n + p / 10) for n in (2, 3) for p in (0.5, 0.65)]
    sweeps = {
        "table2": (done(*seeds, ({"optimiser": "sga"}, 0.3)), "optimise"),
        "table2_baselines": (done(({"deployment": "random"}, 0.1), ({"deployment": "uniform"}, 0.2)), "evaluate"),
        "table3": (done(*pairs), "evaluate"),
        "table3_reoptimised": (done(*((pair, ratio + 0.1) for pair, ratio in pairs)), "optimise"),
        "landmark_count": (done(*(({"deployment.count": k}, k / 100) for k in (30, 60, 90))), "optimise"),
        "optimisers": (done(({"optimiser": "annealing"}, 0.9), ({"optimiser": "ega"}, 0.5)), "optimise"),
    }
    return {name: record_sweep(uri, folder, name, jobs, pipeline) for name, (jobs, pipeline) in sweeps.items()}


def write_report(folder, *overrides):
    """Report into `folder`, which must not exist, in this process; returns the Markdown."""
    folder.mkdir()
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(pipelines.report, "run_directory", lambda: folder)
        patch.setattr(sys, "argv", ["report", *overrides])
        pipelines.report.report(composed("report", *overrides))
    return (folder / "report.md").read_text()
