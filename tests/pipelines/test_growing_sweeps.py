"""Sweeps that grow by values, are refused in part or in whole, or are stored."""

import json
import re

import pandas as pd
import pytest
from faulty_sweeps import PARENT, found_in, told_by
from mlflow import MlflowClient
from processes import call

pytestmark = pytest.mark.slow
QUICK = ("localisation=false", "losses=false")


def sweep_n(cwd, values):
    overrides = ("hydra.mode=MULTIRUN", f"objective.n={values}", "validate=true", "tracking.uri=sqlite:///store.db")
    return call("evaluate", *overrides, *QUICK, cwd=cwd)


@pytest.fixture(scope="module")
def refused(tmp_path_factory):
    """A sweep of two jobs, one of which is refused."""
    cwd = tmp_path_factory.mktemp("refused")
    return cwd, sweep_n(cwd, "2,500")


def test_bad_input_in_one_job_is_a_failed_run_and_one_sentence(refused):
    cwd, done = refused
    assert done.returncode == 1
    assert "objective.n = 500 exceeds the number of landmarks, 90" in done.stderr
    found = MlflowClient(tracking_uri=f"sqlite:///{cwd}/store.db").search_runs(["1"])
    (failed,) = [run for run in found if run.info.status == "FAILED" and PARENT in run.data.tags]
    assert failed.data.tags["reason"] == "objective.n = 500 exceeds the number of landmarks, 90."
    assert sum(run.info.status == "FINISHED" for run in found) == 1


def test_a_sweep_grows_by_values_and_shows_the_figure_off_the_grid(refused):
    cwd, _ = refused
    grown = sweep_n(cwd, "3,4")
    assert grown.returncode == 0, grown.stderr
    assert "going on after 1 finished jobs" in grown.stdout
    assert (
        len(re.findall(r"^finished in \d+ s: objective.n=\d: [\d.]+% on the grid, [\d.]+% off it$", grown.stdout, re.M))
        == 2
    )
    again = sweep_n(cwd, "3,2")
    assert again.stdout.count("done already: objective.n=") == 2
    (table,) = cwd.glob("outputs/evaluate_sweep/*/jobs.csv")
    rows = pd.read_csv(table)
    assert rows["objective.n"].tolist() == [3, 2, 4]  # those of the last command in its order; 500 is asked no more
    figures = [json.loads((table.parent / name / "metrics.json").read_text()) for name in rows.folder]
    off_grid = [metrics["validation"]["grid_free_qualified_ratio"] for metrics in figures]
    assert rows.off_grid.tolist() == off_grid == [metrics["off_grid"] for metrics in figures]
    (parent,) = [run for run in found_in(cwd) if PARENT not in run.data.tags]
    assert (parent.info.status, parent.data.metrics["jobs"]) == ("FINISHED", 3.0)
    assert "best/off_grid" not in parent.data.metrics  # each was of another problem
    assert told_by(parent).endswith("parameters: those that the jobs of the first command share")
    assert f"| 4 | 1 of 1 | {rows.fitness[2]:.2%} | {rows.fitness[2]:.2%} | {off_grid[2]:.2%}" in told_by(parent)
    assert {run.data.metrics.get("off_grid") for run in found_in(cwd) if PARENT in run.data.tags} == {None, *off_grid}


def test_a_sweep_that_cannot_be_composed_leaves_nothing(tmp_path):
    done = call("optimise", "hydra.mode=MULTIRUN", "optimiser=ega,egg", "tracking.uri=sqlite:///store.db", cwd=tmp_path)
    assert done.returncode == 1
    assert "Could not find 'optimiser/egg'" in done.stderr
    assert not list((tmp_path / "outputs" / "optimise_sweep").iterdir())
    assert not MlflowClient(tracking_uri=f"sqlite:///{tmp_path}/store.db").search_runs(["1"])


def test_a_stored_sweep_can_be_narrowed_and_its_files_used_as_they_are(tmp_path):
    quick = ("tracking=none", *QUICK)
    done = call("evaluate", "experiment=table2_baselines", "seed=0", "deployment=uniform", *quick, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    (landmarks,) = tmp_path.glob("outputs/evaluate_sweep/table2_baselines-*/*/landmarks.csv")
    path = f"deployment.path={landmarks.relative_to(tmp_path)}"
    done = call("evaluate", "experiment=table3", path, *quick, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    (jobs,) = tmp_path.glob("outputs/evaluate_sweep/table3-*/jobs.csv")
    rows = pd.read_csv(jobs)
    assert rows["objective.n"].tolist() == [2, 3, 4]  # thold_p is given on the command line
    assert rows.average_coverage_probability.is_monotonic_decreasing
