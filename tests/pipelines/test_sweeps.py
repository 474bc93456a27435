"""Sweeps as a user meets them: what they leave, what a failing job does to the others, and going on."""

import base64
import json
import os
import re
import signal
import subprocess
import time
import zlib

import pandas as pd
import pytest
from mlflow import MlflowClient
from processes import call, command, start

# Fails in the way it is told to, once it has evaluated something, until the file `repaired` is there.
PLUGIN = """
import os, signal, sys, time
from pathlib import Path

from lmd.optimisers.random_search import RandomSearch


class Faulty(RandomSearch):
    def __init__(self, fault, seed=0):
        super().__init__(10, seed=seed, encoding="wall")
        self.fault = fault

    def _tell(self, genes, fitness):
        print("threads", *(os.environ.get(f"{name}_NUM_THREADS") for name in ("NUMBA", "OMP", "OPENBLAS")))
        if Path("repaired").exists():
            return
        if self.fault == "raise":
            raise ValueError("no such luck")
        if self.fault == "exit":
            sys.exit(3)
        if self.fault == "kill":
            os.kill(os.getpid(), signal.SIGKILL)
        if self.fault == "slow":
            Path("pid").write_text(str(os.getpid()))
            time.sleep(0.3)
"""
PARENT = "mlflow.parentRunId"
pytestmark = [pytest.mark.slow, pytest.mark.long]


@pytest.fixture
def work(tmp_path):
    return prepared(tmp_path)


def prepared(cwd):
    """A working directory with the optimiser `faulty`."""
    (cwd / "mine" / "optimiser").mkdir(parents=True)
    (cwd / "mine" / "optimiser" / "faulty.yaml").write_text("_target_: faulty.Faulty\nfault: none\n")
    (cwd / "faulty.py").write_text(PLUGIN)
    return cwd


def settings(cwd, faults):
    return [
        "hydra.mode=MULTIRUN", f"hydra.searchpath=[file://{cwd}/mine]", "deployment.count=20",
        "budget.evaluations=400", "tracking.uri=sqlite:///store.db", "optimiser=faulty", f"optimiser.fault={faults}",
    ]  # fmt: skip


def sweep(cwd, faults, *overrides):
    return call("optimise", *settings(cwd, faults), *overrides, cwd=cwd, folders=[cwd])


def start_sweep(cwd, faults, *overrides):
    """Start a sweep and wait until its slow job is at work."""
    line = command("optimise", *settings(cwd, faults), *overrides)
    process = start(line, cwd=cwd, folders=[cwd], stderr=subprocess.PIPE)
    deadline = time.monotonic() + 120
    while not (cwd / "pid").exists() and time.monotonic() < deadline:
        time.sleep(0.02)
    return process


def runs(cwd):
    """The parent run of the only sweep, and its children by what they were told to do."""
    client = MlflowClient(tracking_uri=f"sqlite:///{cwd}/store.db")
    found = client.search_runs(["1"])
    (parent,) = [run for run in found if PARENT not in run.data.tags]
    children = {}
    for run in found:
        if run is not parent:
            assert run.data.tags[PARENT] == parent.info.run_id
            children.setdefault(run.data.tags["override.optimiser.fault"], []).append(run)
    return parent, children


def table(cwd):
    (path,) = cwd.glob("outputs/optimise_sweep/*/jobs.csv")
    return pd.read_csv(path).set_index("optimiser.fault")


def statuses(children):
    return {fault: sorted(run.info.status for run in found) for fault, found in children.items()}


@pytest.fixture(scope="module")
def faulty(tmp_path_factory):
    """A sweep of four jobs under joblib, three of which fail."""
    cwd = prepared(tmp_path_factory.mktemp("faulty"))
    return cwd, sweep(cwd, "none,raise,exit,kill", "hydra/launcher=joblib", "hydra.launcher.n_jobs=2")


def test_failing_jobs_do_not_lose_the_others_and_the_sweep_names_them(faulty):
    cwd, done = faulty
    assert done.returncode == 1
    assert "1 of 4 jobs finished" in done.stdout
    assert "failed: optimiser.fault=raise: ValueError: no such luck" in done.stderr
    assert "failed: optimiser.fault=exit: exited with code 3 before it had finished" in done.stderr
    assert "killed: optimiser.fault=kill: killed by SIGKILL" in done.stderr
    rows = table(cwd)
    assert rows.status.to_dict() == {"none": "finished", "raise": "failed", "exit": "failed", "kill": "killed"}
    assert rows.qualified_ratio.notna().to_dict() == {"none": True, "raise": False, "exit": False, "kill": False}
    left = json.loads((cwd / "outputs/optimise_sweep" / folder(cwd) / rows.folder["none"] / "metrics.json").read_text())
    assert left["qualified_ratio"] == rows.qualified_ratio["none"]


def folder(cwd):
    (path,) = (cwd / "outputs" / "optimise_sweep").iterdir()
    return path.name


def test_a_pipeline_without_threads_is_swept_in_parallel_too(tmp_path):
    overrides = ("hydra.mode=MULTIRUN", "recording=simulated", "seed=1,2", "tracking=none", "hydra/launcher=joblib")
    done = call("estimate_pdf", *overrides, cwd=tmp_path, settings=())
    assert done.returncode == 0, done.stderr
    (table,) = tmp_path.glob("outputs/estimate_pdf_sweep/*/jobs.csv")
    assert pd.read_csv(table).status.tolist() == ["finished", "finished"]


def test_a_sweep_is_one_parent_run_with_a_child_for_each_job(faulty):
    cwd, done = faulty
    out = done.stdout
    parent, children = runs(cwd)
    about = "n=2 thold_p=0.5 count=20 evaluations=400"
    assert parent.info.run_name == f"sweep optimiser.fault {about} #{parent.info.run_id[:4]}"
    assert (parent.data.params["optimiser"], parent.data.params["objective.n"]) == ("faulty", "2")
    assert "optimiser.fault" not in parent.data.params
    told = told_by(parent)
    assert told.startswith("**FAILED**: 3 of 4 jobs failed\n\nvaries: `optimiser.fault` (4 values)\n")
    assert re.search(r"\n\| none \| 1 of 1 \| [\d.]+% \| [\d.]+% \|\n\| raise \| 0 of 1 \|  \|  \|\n", told)
    assert parent.info.status == "FAILED"
    assert parent.data.tags["reason"] == "3 of 4 jobs failed"
    assert parent.data.tags["override.optimiser.fault"] == "none,raise,exit,kill"
    assert (parent.data.metrics["jobs"], parent.data.metrics["failed"]) == (4.0, 3.0)
    finished = children["none"][0].data.metrics["qualified_ratio"]
    assert parent.data.metrics["best/qualified_ratio"] == parent.data.metrics["median/qualified_ratio"] == finished
    client = MlflowClient(tracking_uri=f"sqlite:///{cwd}/store.db")
    assert [file.path for file in client.list_artifacts(parent.info.run_id)] == ["jobs.csv"]
    for mode in ("TABLE", "CHART"):  # views of the jobs, grouped by what varies
        assert (
            f"/runs?workflowType=machine_learning&compareRunsMode={mode}&viewStateShareKey={parent.info.run_id}" in out
        )
    shared = client.get_experiment("1").tags[f"mlflow.sharedViewState.{parent.info.run_id}"]
    view = json.loads(zlib.decompress(base64.b64decode(shared.removeprefix("deflate;"))))
    assert view["groupBy"]["groupByKeys"] == [{"mode": "param", "groupByData": "optimiser.fault"}]
    assert statuses(children) == {"none": ["FINISHED"], "raise": ["FAILED"], "exit": ["FAILED"], "kill": ["FAILED"]}
    reasons = {fault: found[0].data.tags.get("reason") for fault, found in children.items()}
    assert reasons == {
        "none": None,
        "raise": "ValueError: no such luck",
        "exit": "exited with code 3 before it had finished",
        "kill": "killed by SIGKILL",
    }


def test_a_child_says_what_it_is(faulty):
    cwd, _ = faulty
    _, children = runs(cwd)
    (child,) = children["none"]
    assert child.info.run_name == f"fault=none faulty #{child.info.run_id[:4]}"
    tags, params = child.data.tags, child.data.params
    assert (tags["sweep"], tags["pipeline"], tags["choice.optimiser"]) == ("optimiser.fault", "optimise", "faulty")
    assert tags["job"] == table(cwd).folder["none"]
    assert tags["override.deployment.count"] == params["deployment.count"] == "20"
    assert (params["optimiser"], params["optimiser.fault"]) == ("faulty", "none")
    client = MlflowClient(tracking_uri=f"sqlite:///{cwd}/store.db")
    assert len(client.get_metric_history(child.info.run_id, "best_fitness")) == 40


def test_jobs_that_share_a_machine_have_one_thread_each(faulty):
    cwd, _ = faulty
    (output,) = cwd.glob("outputs/optimise_sweep/*/fault-none_*/output.log")
    assert "threads 1 1 1\n" in output.read_text()


def test_the_same_sweep_again_does_only_what_is_missing(faulty):
    cwd, _ = faulty
    untouched = table(cwd).folder["none"]
    before = (cwd / "outputs/optimise_sweep" / folder(cwd) / untouched / "metrics.json").stat().st_mtime_ns
    (cwd / "repaired").touch()
    damaged = cwd / "outputs/optimise_sweep" / folder(cwd) / table(cwd).folder["raise"] / "job.json"
    damaged.write_text(damaged.read_text()[:100])
    again = sweep(cwd, "none,raise,exit,kill")
    assert again.returncode == 0, again.stderr
    assert f"warning: {damaged.relative_to(cwd)} is damaged (JSONDecodeError" in again.stderr
    assert "going on after 1 finished jobs" in again.stdout
    assert "done already: optimiser.fault=none" in again.stdout
    assert again.stdout.count("finished in") == 3
    assert (table(cwd).status == "finished").all()
    assert (cwd / "outputs/optimise_sweep" / folder(cwd) / untouched / "metrics.json").stat().st_mtime_ns == before
    parent, children = runs(cwd)
    assert parent.info.status == "FINISHED"
    assert "reason" not in parent.data.tags
    assert statuses(children)["none"] == ["FINISHED"]
    assert statuses(children)["kill"] == ["FAILED", "FINISHED"]


def test_a_sweep_killed_with_its_job_goes_on_with_what_is_missing(work):
    process = start_sweep(work, "none,slow")
    process.kill()
    os.kill(int((work / "pid").read_text()), signal.SIGKILL)
    process.communicate(timeout=60)
    parent, children = runs(work)
    assert parent.info.status == "RUNNING"
    assert statuses(children) == {"none": ["FINISHED"], "slow": ["RUNNING"]}

    (work / "repaired").touch()
    again = sweep(work, "none,slow")
    assert again.returncode == 0, again.stderr
    assert "done already: optimiser.fault=none" in again.stdout
    parent, children = runs(work)
    assert parent.info.status == "FINISHED"
    assert statuses(children) == {"none": ["FINISHED"], "slow": ["FAILED", "FINISHED"]}
    (lost,) = [run for run in children["slow"] if run.info.status == "FAILED"]
    assert lost.data.tags["reason"] == "its process was killed, and the sweep with it"


def test_the_jobs_of_a_sweep_that_is_killed_under_joblib_stop(work):
    process = start_sweep(work, "slow", "hydra/launcher=joblib", "hydra.launcher.n_jobs=2")
    process.kill()
    process.wait(timeout=60)
    (record,) = work.glob("outputs/optimise_sweep/*/*/job.json")
    deadline = time.monotonic() + 60
    while (status := json.loads(record.read_text())["status"]) == "running" and time.monotonic() < deadline:
        time.sleep(0.05)
    assert status == "interrupted"


def test_an_interrupted_job_goes_on_from_its_checkpoint(work):
    process = start_sweep(work, "slow")
    process.send_signal(signal.SIGINT)
    _, err = process.communicate(timeout=60)
    assert process.returncode == 130
    assert "the same command again does what is missing" in err
    parent, children = runs(work)
    assert (parent.info.status, parent.data.tags["reason"]) == ("FAILED", "the sweep was cut short")
    (child,) = children["slow"]
    assert child.info.status == "KILLED"
    spent = child.data.metrics["evaluations"]
    assert 0 < spent < 400

    (work / "repaired").touch()
    again = sweep(work, "slow")
    assert again.returncode == 0, again.stderr
    _, children = runs(work)
    assert statuses(children) == {"slow": ["FINISHED"]}
    assert children["slow"][0].info.run_id == child.info.run_id
    assert children["slow"][0].data.metrics["evaluations"] == 400
    assert "reason" not in children["slow"][0].data.tags


def test_a_job_killed_under_submitit_does_not_lose_the_others(work):
    done = sweep(work, "none,kill", "hydra/launcher=submitit_local")
    assert done.returncode == 1
    assert "killed: optimiser.fault=kill: killed by SIGKILL" in done.stderr
    _, children = runs(work)
    assert statuses(children) == {"none": ["FINISHED"], "kill": ["FAILED"]}
    (output,) = work.glob("outputs/optimise_sweep/*/fault-none_*/output.log")
    assert "threads 1 1 1\n" in output.read_text()


def sweep_n(cwd, values):
    overrides = ("hydra.mode=MULTIRUN", f"objective.n={values}", "validate=true", "tracking.uri=sqlite:///store.db")
    return call("evaluate", *overrides, cwd=cwd)


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
    assert f"| 4 | 1 of 1 | {rows.fitness[2]:.2%} | {rows.fitness[2]:.2%} | {off_grid[2]:.2%}" in told_by(parent)
    assert {run.data.metrics.get("off_grid") for run in found_in(cwd) if PARENT in run.data.tags} == {None, *off_grid}


def told_by(run):
    return run.data.tags["mlflow.note.content"]


def found_in(cwd):
    return MlflowClient(tracking_uri=f"sqlite:///{cwd}/store.db").search_runs(["1"])


def test_a_sweep_that_cannot_be_composed_leaves_nothing(tmp_path):
    done = call("optimise", "hydra.mode=MULTIRUN", "optimiser=ega,egg", "tracking.uri=sqlite:///store.db", cwd=tmp_path)
    assert done.returncode == 1
    assert "Could not find 'optimiser/egg'" in done.stderr
    assert not list((tmp_path / "outputs" / "optimise_sweep").iterdir())
    assert not MlflowClient(tracking_uri=f"sqlite:///{tmp_path}/store.db").search_runs(["1"])


def test_a_stored_sweep_can_be_narrowed_and_its_files_used_as_they_are(tmp_path):
    done = call(
        "evaluate", "experiment=table2_baselines", "seed=0", "deployment=uniform", "tracking=none", cwd=tmp_path
    )
    assert done.returncode == 0, done.stderr
    (landmarks,) = tmp_path.glob("outputs/evaluate_sweep/table2_baselines-*/*/landmarks.csv")
    path = f"deployment.path={landmarks.relative_to(tmp_path)}"
    done = call("evaluate", "experiment=table3", path, "tracking=none", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    (jobs,) = tmp_path.glob("outputs/evaluate_sweep/table3-*/jobs.csv")
    rows = pd.read_csv(jobs)
    assert rows["objective.n"].tolist() == [2, 3, 4]  # thold_p is given on the command line
    assert rows.average_coverage_probability.is_monotonic_decreasing
